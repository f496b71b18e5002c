"""Recorder that stores the scene's own acceptance checks with the results of a run."""

from ..core.records import Record
from ..core.run.checks import Check
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.simulation_base import SimulationBase


class CheckRecorder(Recorder):
    """Recorder that adds the results of the scene's `check` to the result of a finished run.

    This recorder must finish before the recorder of tables, which writes the result.
    """

    def __init__(self, check: Check) -> None:
        self.check = check

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Add the results of the scene's checks to the result of a run, if the run reached its end."""
        if run.finished:
            outcomes = self.check(run)
            run.result["checks"] = {
                name: {"passed": bool(passed), "found": text} for name, (passed, text) in outcomes.items()
            }


def failed_checks(result: Record) -> list[str]:
    """Return the names of the scene's checks that a run failed, from the contents of its result.json."""
    return [name for name, check in result.get("checks", {}).items() if not check["passed"]]
