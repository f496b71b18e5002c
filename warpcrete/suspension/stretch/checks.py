"""Acceptance checks of mortar with aggregates in a stretch of pipe."""

from __future__ import annotations

from ...core.run.checks import with_cures
from ...core.run.run import Run
from ...core.units import number

BALANCE = 0.02
"""Largest relative difference between the friction at the wall and the force of the pressure gradient."""
OVERLAP = 0.05
"""Largest overlap of two aggregates, or of an aggregate and the wall, in radii."""
CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "steady": "a longer --duration",
    "balance of forces": "a longer --duration, or a smaller --courant",
    "no overlap": "a smaller --courant",
}


@with_cures(CURES)
def check_stretch(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a run by name: whether each one passed, and what it found."""
    result = run.result
    if "flow" not in result:
        return {"finished": (False, "the run recorded no sample after its start")}
    error = number(result["wall_stress"]) / number(result["wall_stress_theory"]) - 1
    gap = number(result["smallest_gap"])
    return {
        "steady": (bool(result["steady"]), f"after {number(result['simulated_time']):g} s"),
        "balance of forces": (abs(error) < BALANCE, f"{100 * error:+.2f} % of the driving force at the wall"),
        "no overlap": (gap > -OVERLAP, f"smallest gap {gap:+.4f} radii"),
    }
