"""A scene's own acceptance of its runs, kept with their results."""

from __future__ import annotations

from typing import Any

from ..core.checks import Check
from ..core.run_loop import Recorder, Run, Simulation


class CheckRecorder(Recorder):
    """Enters into the result of a finished run what the scene's `check` has to say of it.

    It must finish before the table does, which writes the result.
    """

    def __init__(self, check: Check) -> None:
        self.check = check

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Check a run that went to its end."""
        if run.finished:
            found = self.check(run)
            run.result["checks"] = {
                name: {"passed": bool(passed), "found": text} for name, (passed, text) in found.items()
            }


def failed_checks(result: dict[str, Any]) -> list[str]:
    """Names of the checks that failed, by a result.json."""
    return [name for name, check in result.get("checks", {}).items() if not check["passed"]]
