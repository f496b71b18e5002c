"""Acceptance checks of finished runs, with the command option that usually cures a failed check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps

from .run import Run

Check = Callable[[Run], dict[str, tuple[bool, str]]]
"""Function that takes a finished run. It returns, by the name of each check, whether the run passed this check, and a
text with the finding."""
NO_SAMPLE = {"finished": (False, "the run recorded no sample after its start")}
"""Checks of a run that ended before its first sample, of which nothing else can be checked."""


def with_cures(cures: Mapping[str, str] | Callable[[Run], Mapping[str, str]]) -> Callable[[Check], Check]:
    """Return a decorator that adds the usual remedy to the message of each failed check.

    `cures` maps the name of a check to the text of the remedy. It may be a function of the run, if the remedies depend
    on the scene.
    """

    def decorate(check: Check) -> Check:
        @wraps(check)
        def cured(run: Run) -> dict[str, tuple[bool, str]]:
            known = cures(run) if callable(cures) else cures
            return {
                name: (passed, found if passed or name not in known else f"{found}; usual cure: {known[name]}")
                for name, (passed, found) in check(run).items()
            }

        return cured

    return decorate
