"""Many scenes of one batch, each a coroutine that says where it wants to be, carried forward together.

This is the only place that knows how coroutines of runs, packings and single steppers become launches of a batch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.errors import CapacityError
from ..core.interrupts import put_off
from ..core.run_loop import Coroutine
from ..kernels.common.control import STALE
from .stages import step_stages


@dataclass(frozen=True)
class Steps:
    """Where a coroutine may want to be instead of at a time: so many steps of the present size further."""

    count: int


class _Scene:
    """One scene's coroutine, and the way to the goal that it set last."""

    def __init__(self, stepper: Any, coroutine: Coroutine) -> None:
        self.stepper, self.coroutine = stepper, coroutine
        self._under_way: Coroutine | None = None
        self.waiting = False
        self.result: Any = None

    def go_on(self, error: BaseException | None = None) -> None:
        """Run until the batch must take steps, or to the end; an `error` is raised inside the coroutine."""
        self.waiting = False
        try:
            while True:
                if error is None and self._under_way is not None:
                    try:
                        next(self._under_way)
                        self.waiting = True
                        return
                    except StopIteration:
                        self._under_way = None
                    except (Exception, KeyboardInterrupt) as failure:
                        error = failure
                self._under_way = None
                goal = next(self.coroutine) if error is None else self.coroutine.throw(error)
                error = None
                self._under_way = self.stepper.reaching(goal)
        except StopIteration as end:
            self.result = end.value
        except (Exception, KeyboardInterrupt) as failure:
            self.result = failure


def drive(scenes: dict[int, tuple[Any, Coroutine]]) -> dict[int, Any]:
    """Drive the coroutines of scenes of one batch, each with its stepper, to their ends, by scene number.

    Returns what each returned or raised. An interruption (Ctrl-C), wherever it falls, is raised inside every coroutine
    that waits.
    """
    members = {s: _Scene(*pair) for s, pair in scenes.items()}
    stop: KeyboardInterrupt | None = None

    def go_on(s: int, error: BaseException | None = None) -> None:
        nonlocal stop
        scene = members[s]
        scene.go_on(error)
        if not scene.waiting:
            if isinstance(scene.result, KeyboardInterrupt):
                stop = scene.result
            elif getattr(scene.result, "interrupted", False):
                stop = stop or KeyboardInterrupt()

    for s in members:
        go_on(s, stop)
    while waiting := sorted(s for s, scene in members.items() if scene.waiting):
        lists = members[waiting[0]].stepper.lists
        try:
            if stop is None:
                if not lists.batch.has_step:
                    estimate = members[waiting[0]].stepper.stable_step
                    between = estimate.by_device() if lists.batch.parallel else None
                    lists.batch.use_step(step_stages(lists.batch), between)
                flags = lists.batch.launch()
                for s in waiting:
                    if (error := members[s].stepper.trouble(flags[s])) is not None:
                        go_on(s, error)
                if np.any(flags[:, int(STALE)]):
                    with put_off():
                        lists()
                ready = [s for s in waiting if members[s].waiting and members[s].stepper.reached(flags[s])]
                estimate = members[waiting[0]].stepper.stable_step
                try:
                    estimate.foresee([s for s in ready if members[s].stepper.wants_estimate()])
                    for s in ready:
                        go_on(s, stop)
                finally:
                    estimate.forget()
        except KeyboardInterrupt as interruption:
            stop = interruption
        except CapacityError as full:  # of the lists, which all scenes share
            for s in waiting:
                if members[s].waiting:
                    go_on(s, full)
        if stop is not None:
            for s in waiting:
                if members[s].waiting:
                    go_on(s, stop)
    return {s: scene.result for s, scene in members.items()}


def drive_one(stepper: Any, coroutine: Coroutine) -> Any:
    """Drive one scene's coroutine; returns what it returns, raises what it raises."""
    result = drive({stepper.index: (stepper, coroutine)})[stepper.index]
    if isinstance(result, BaseException):
        raise result
    return result
