"""Acceptance checks of finished runs, with the usual remedy for each failed check."""

from collections.abc import Callable, Mapping
from functools import wraps

from .run import Run

Check = Callable[[Run], dict[str, tuple[bool, str]]]
"""Function that takes a finished run and returns a dictionary of its checks. Each key is the name of a check, and each
value is a pair: whether the run passed the check, and a text that says what the check found."""
NO_SAMPLE = {"finished": (False, "the run recorded no sample after its start")}
"""Result of the checks of a run whose time series has no row after t = 0: a single check, which failed."""


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
