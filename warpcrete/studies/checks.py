"""A scene's own acceptance of a run, kept in its result.json."""

from __future__ import annotations

from typing import Any

from ..core.files import write_json
from ..core.run_loop import Run

Checks = dict[str, tuple[bool, str]]
"""Name of a check -> whether it passed, and what was found."""


def checked(module: Any, run: Run) -> Checks:
    """What `module.check` has to say of a finished run; also kept in its `result` and its folder, if it has one."""
    if not run.finished:
        return {}
    checks: Checks = module.check(run)
    run.result["checks"] = {name: {"passed": bool(passed), "found": found} for name, (passed, found) in checks.items()}
    if run.folder is not None:
        write_json(run.folder / "result.json", run.result)
    return checks


def failed_checks(result: dict[str, Any]) -> list[str]:
    """Names of the checks that failed, by a result.json."""
    return [name for name, check in result.get("checks", {}).items() if not check["passed"]]
