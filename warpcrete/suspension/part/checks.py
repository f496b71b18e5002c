"""Acceptance checks of mortar with aggregates that flows through a part of a pump line."""

from __future__ import annotations

from ...core.run.checks import with_cures
from ...core.run.run import Run
from ...core.units import number

OUTFLOW = 1e-3
"""Largest accepted difference of outflow and inflow, divided by the inflow."""
OVERLAP = 0.05
"""Largest overlap of two aggregates, or of an aggregate and a wall, in radii."""
CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "steady": "a longer --duration",
    "not blocked": "smaller aggregates, a smaller --aggregate-fraction, or a wider pipe",
    "volume": "a smaller --tolerance, or a smaller --time-step",
    "no overlap": "a smaller --time-step",
}


@with_cures(CURES)
def check_part(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a finished run by name: whether each one passed, and what it found."""
    result = run.result
    if "pressure" not in result:
        return {"finished": (False, "the run recorded no sample after its start")}
    outflow, gap = float(result["outflow_error"]), float(result["smallest_gap"])
    at = "" if not result["blocked"] else f"blocked at {number(result['blocked_at']):.3g} m"
    return {
        "steady": (bool(result["steady"]), f"after {number(result['simulated_time']):g} s"),
        "not blocked": (not result["blocked"], at or "no part of the aggregates stood still"),
        "volume": (abs(outflow) < OUTFLOW, f"{100 * outflow:+.3f} % difference of outflow from inflow"),
        "no overlap": (gap > -OVERLAP, f"smallest gap {gap:+.4f} radii"),
    }
