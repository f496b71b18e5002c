"""Acceptance checks of mortar with aggregates in a stretch of pipe."""

from ...core.run.checks import NO_SAMPLE, with_cures
from ...core.run.run import Run
from ...core.units import number
from ..checks import no_overlap, steadiness

BALANCE = 0.02
"""Largest accepted relative difference between the friction at the wall and the force of the pressure gradient."""
CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "steady": "a longer --duration",
    "balance of forces": "a longer --duration, or a smaller --courant",
    "no overlap": "a smaller --courant",
}


@with_cures(CURES)
def check_stretch(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a run by name: whether each one passed, and the measured value as text."""
    result = run.result
    if "flow" not in result:
        return NO_SAMPLE
    error = number(result["wall_stress"]) / number(result["wall_stress_theory"]) - 1
    return {
        "steady": steadiness(result),
        "balance of forces": (abs(error) < BALANCE, f"{100 * error:+.2f} % of the driving force at the wall"),
        "no overlap": no_overlap(result),
    }
