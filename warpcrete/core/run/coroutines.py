"""Runs as coroutines: a generator requests steps from its caller, which can take the steps of many runs together."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Until:
    """Request to step a run until the end of the step that reaches `time` [s]."""

    time: float


Coroutine = Generator[Any, None, Any]
"""Generator for a run, or for a part of a run. Each `yield` requests the time up to which the caller must step the run.
The caller resumes the generator when the state has reached this time. In this way, the caller can take the steps of
many runs together.
"""


def run_coroutine(coroutine: Coroutine, advance: Callable[[float], None]) -> Any:
    """Run a generator that yields :class:`Until` requests, and return its result.

    For each request, the function `advance` steps the state to the requested time [s]. An error of `advance` is raised
    inside the generator.
    """
    try:
        goal = next(coroutine)
        while True:
            try:
                advance(goal.time)
            except BaseException as error:
                goal = coroutine.throw(error)
            else:
                goal = next(coroutine)
    except StopIteration as end:
        return end.value
