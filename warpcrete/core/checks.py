"""Acceptance of runs: what a scene checks, and the option that cures a check that failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps

from .run import Run

Check = Callable[[Run], dict[str, tuple[bool, str]]]
"""Takes a finished run and returns for each name of a check whether it passed, and what was found."""


def with_cures(cures: Mapping[str, str]) -> Callable[[Check], Check]:
    """Return a decorator of a check: it adds the usual cure to what was found of each entry that failed."""

    def decorate(check: Check) -> Check:
        @wraps(check)
        def cured(run: Run) -> dict[str, tuple[bool, str]]:
            return {
                name: (passed, found if passed or name not in cures else f"{found}; usual cure: {cures[name]}")
                for name, (passed, found) in check(run).items()
            }

        return cured

    return decorate
