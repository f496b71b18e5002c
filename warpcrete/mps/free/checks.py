"""Acceptance checks of standard tests that are simulated as a flow with a free surface."""

from ...core.run.checks import NO_SAMPLE, Check, with_cures
from ...core.run.run import Run

CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "volume": "a smaller --spacing, or a smaller --time-step",
    "at rest": "a longer --duration or, for soft concrete, a smaller --spacing",
    "light is seen": "a longer --duration",
}


def check_flow(volume_error: float) -> Check:
    """Return a function that checks a run: its relative error of the volume must be less than `volume_error`."""

    @with_cures(CURES)
    def check(run: Run) -> dict[str, tuple[bool, str]]:
        """Return the checks of a run by name: whether each one passed, and the measured value as text."""
        if "volume_error" not in run.result:
            return NO_SAMPLE
        volume = run.result["volume_error"]
        checks = {"volume": (abs(volume) < volume_error, f"{100 * volume:+.2f} % largest change")}
        test = run.scene.test
        return checks | test.judge(run) if test else checks

    return check
