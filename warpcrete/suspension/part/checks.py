"""Acceptance checks of mortar with aggregates that flows through a part of a pump line."""

from ...core.run.checks import NO_SAMPLE, with_cures
from ...core.run.run import Run
from ...core.units import number
from ..checks import no_overlap, steadiness

OUTFLOW = 1e-3
"""Largest accepted difference of outflow and inflow, divided by the inflow."""
CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "steady": "a longer --duration",
    "not blocked": "smaller aggregates, a smaller --aggregate-fraction, or a wider pipe",
    "volume": "a smaller --tolerance, or a smaller --time-step",
    "no overlap": "a smaller --time-step",
}


@with_cures(CURES)
def check_part(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a finished run by name: whether each one passed, and the measured value as text."""
    result = run.result
    if "pressure" not in result:
        return NO_SAMPLE
    outflow = float(result["outflow_error"])
    at = "" if not result["blocked"] else f"blocked at {number(result['blocked_at']):.3g} m"
    return {
        "steady": steadiness(result),
        "not blocked": (not result["blocked"], at or "no part of the aggregates stood still"),
        "volume": (abs(outflow) < OUTFLOW, f"{100 * outflow:+.3f} % difference of outflow from inflow"),
        "no overlap": no_overlap(result),
    }
