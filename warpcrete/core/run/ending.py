"""Reason why a run ended, as result.json and :class:`Run` state it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from ..errors import ConvergenceError, InstabilityError, WarpcreteError, is_full, one_line
from ..narrowing import is_dict
from ..records import Record
from ..units import number, quantity

REASONS = {
    "travel": "the piston has completed its travel",
    "duration": "the run has reached the simulated time that the scene states",
    "steady": "the flow became steady",
    "rest": "the concrete came to rest",
    "empty": "the concrete has flowed out",
    "blocked": "the pipe is blocked, and the scene ends blocked runs",
    "interrupted": "Ctrl-C, SIGTERM or a program stopped the run",
    "unstable": "the state lost its physical meaning (InstabilityError)",
    "unconverged": "an iterative solve did not converge (ConvergenceError)",
    "disk full": "a file could not be written because the disk was full",
    "failed": "any other error",
}
"""Meaning of each reason for which a run may end."""


@dataclass(frozen=True)
class Ending:
    """Reason why a run ended, with a sentence about it and the simulated time."""

    reason: str
    """One of the keys of :data:`REASONS`, such as "steady"."""
    message: str
    """Sentence about the end of the run, which the command prints."""
    time: float
    """Simulated time at which the run ended [s]; 0 if it ended while the concrete was packed or settled."""

    def __str__(self) -> str:
        return self.message

    def entry(self) -> Record:
        """Return the entry `ended` of result.json."""
        return {"reason": self.reason, "message": self.message, "time": quantity(self.time, "s")}

    @classmethod
    def of(cls, result: Mapping[str, object]) -> Ending | None:
        """Return the ending stored in the contents of a result.json, or None if it has no such entry."""
        entry = result.get("ended")
        if not is_dict(entry):
            return None
        return cls(str(entry["reason"]), str(entry["message"]), number(cast(Any, entry["time"])))


def failure(error: BaseException, time: float) -> Ending:
    """Return the ending for a run that was stopped by `error`, which may be an interruption.

    `time` is the simulated time [s] at which the run ended.
    """
    if not isinstance(error, Exception):
        return interruption(time)
    if isinstance(error, ConvergenceError):
        reason = "unconverged"
    elif isinstance(error, InstabilityError):
        reason = "unstable"
    else:
        reason = "disk full" if is_full(error) else "failed"
    return Ending(reason, one_line(str(error) if isinstance(error, WarpcreteError) else repr(error)), time)


def interruption(time: float) -> Ending:
    """Return the ending of a run that was interrupted at the simulated time `time` [s]."""
    return Ending("interrupted", f"interrupted at t = {time:.3f} s", time)
