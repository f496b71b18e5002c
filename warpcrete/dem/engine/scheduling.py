"""Scheduling of many scenes: each scene has a coroutine that yields goals, and a batch steps towards all goals.

Only this module turns the goals of coroutines (of runs, packings and single steppers) into launches of a batch.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import warp as wp

from ...core.device.graphs import GraphLaunch
from ...core.device.interpreter_priority import run_is_waiting
from ...core.device.interrupts import defer_interrupts
from ...core.errors import CapacityError
from ...core.run.coroutines import Coroutine
from .batch import Batch
from .device_rebuild import DeviceRebuild
from .regrouping import Regrouping
from .stages import step_stages
from .stepper_protocol import SceneStepper

POLL_INTERVAL = 50e-6
"""Time that the host waits between two checks whether some batch has completed its launched steps [s]."""


class _Scene:
    """Scene of a batch with its coroutine, which yields the times or numbers of steps to which the batch must advance.

    `waiting` is True while the coroutine waits for the time steps to its latest goal. `result` is the value that the
    coroutine has returned, or the exception that ended it.
    """

    def __init__(self, stepper: SceneStepper, coroutine: Coroutine) -> None:
        self.stepper, self.coroutine = stepper, coroutine
        self._goal_steps: Coroutine | None = None
        self.waiting = False
        self.result: Any = None

    def proceed(self, error: BaseException | None = None) -> None:
        """Run the coroutine until it needs time steps or ends.

        If `error` is not None, it is first raised inside the coroutine.
        """
        self.waiting = False
        try:
            while True:
                if error is None and self._goal_steps is not None:
                    try:
                        next(self._goal_steps)
                        self.waiting = True
                        return
                    except StopIteration:
                        self._goal_steps = None
                    except (Exception, KeyboardInterrupt) as failure:
                        error = failure
                self._goal_steps = None
                goal = next(self.coroutine) if error is None else self.coroutine.throw(error)
                error = None
                self._goal_steps = self.stepper.reaching(goal)
        except StopIteration as end:
            self.result = end.value
        except (Exception, KeyboardInterrupt) as failure:
            self.result = failure


class _Drive:
    """Driver of one batch: it launches time steps, then continues the coroutines of scenes that have reached goals."""

    def __init__(
        self, scenes: dict[int, tuple[SceneStepper, Coroutine]], stream: wp.Stream | None, *, regroups: bool
    ) -> None:
        self._members = {number: _Scene(*pair) for number, pair in scenes.items()}
        self._stream = stream
        self._regroup = Regrouping() if regroups else None
        # Batch on which the latest time steps were launched; None before the first launch.
        self._launched: Batch | None = None
        self.stop: KeyboardInterrupt | None = None

    @property
    def waiting(self) -> list[_Scene]:
        """Scenes that have not yet reached their goal, in the order of their indices in the batch."""
        return sorted((m for m in self._members.values() if m.waiting), key=lambda member: member.stepper.index)

    @property
    def is_running(self) -> bool:
        """True if any scene has not yet reached its goal, a time or a number of steps."""
        return any(member.waiting for member in self._members.values())

    @property
    def results(self) -> dict[int, Any]:
        """Return value of each coroutine, or the exception that ended it, by the number of its scene."""
        return {number: member.result for number, member in self._members.items()}

    @property
    def settled(self) -> bool:
        """True if the device has completed the latest launch of time steps."""
        assert self._launched is not None
        return self._launched.settled

    def begin(self, stop: KeyboardInterrupt | None) -> None:
        """Run all coroutines until each one yields its first goal.

        After an interruption, the exception `stop` is raised inside the coroutines instead, so that the coroutines end.
        """
        self.stop = stop
        with self._stream_context():
            for member in self._members.values():
                self._proceed(member, self.stop)

    def launch(self) -> None:
        """Launch the next time steps of the batch.

        After an interruption, raise the interruption inside the coroutines instead.
        """
        self._guarded(self._launch)

    def collect(self) -> None:
        """Wait for the launched steps, then continue the coroutines whose scenes have reached their goals."""
        self._guarded(self._collect)

    def interrupt(self, stop: KeyboardInterrupt) -> None:
        """Raise the interruption `stop` (Ctrl-C) inside every coroutine that waits for steps."""
        self.stop = stop
        self._guarded(lambda: None)

    def _stream_context(self) -> AbstractContextManager[object]:
        return nullcontext() if self._stream is None else wp.ScopedStream(self._stream, sync_enter=False)

    def _proceed(self, member: _Scene, error: BaseException | None = None) -> None:
        member.proceed(error)
        if not member.waiting:
            if isinstance(member.result, KeyboardInterrupt):
                self.stop = member.result
            elif getattr(member.result, "interrupted", False):
                self.stop = self.stop or KeyboardInterrupt()

    def _guarded(self, what: Callable[[], None]) -> None:
        with self._stream_context():
            try:
                if self.stop is None and self.is_running:
                    what()
            except KeyboardInterrupt as interruption:
                self.stop = interruption
            except CapacityError as full:
                # An array that all scenes share has become too long, so raise the error inside every waiting coroutine.
                for member in self.waiting:
                    self._proceed(member, full)
            if self.stop is not None:
                for member in self.waiting:
                    self._proceed(member, self.stop)

    def _launch(self) -> None:
        steppers = [member.stepper for member in self.waiting]
        if self._regroup is not None:
            with defer_interrupts():
                self._regroup(steppers)
        stepper = steppers[0]
        self._launched = batch = stepper.batch
        if not batch.has_step:
            batch.use_step(step_stages(batch), *self._device_launches(stepper))
        batch.launch()

    @staticmethod
    def _device_launches(stepper: SceneStepper) -> tuple[GraphLaunch | None, GraphLaunch | None]:
        """Return two variants of the work that a GPU launches after each group of time steps.

        The first variant rebuilds stale neighbour lists. The second does the same and then estimates stable time steps.
        A GPU can rebuild lists without the host only for a batch of one scene. For several scenes, the first variant is
        therefore None, and the second variant only estimates stable time steps. On a CPU, both variants are None.
        """
        batch = stepper.batch
        batch.planner.rebuilds_on_device = DeviceRebuild.possible(batch)
        if not batch.parallel:
            return None, None
        rebuild = []
        if batch.planner.rebuilds_on_device:
            stepper.lists.lay_out_cells()
            rebuild = [DeviceRebuild(stepper.lists)]
        return GraphLaunch(rebuild, batch.device) if rebuild else None, stepper.stable_step.by_device(rebuild)

    def _collect(self) -> None:
        assert self._launched is not None
        waiting, flags = self.waiting, self._launched.settle()
        stepper = waiting[0].stepper
        for member in waiting:
            error = member.stepper.failure(flags[member.stepper.index])
            if error is not None:
                self._proceed(member, error)
        batch, running = stepper.batch, [m.stepper.index for m in waiting if m.waiting]
        if len(stale := batch.planner.scenes_to_rebuild(flags, batch.rows["sort_every"], running)):
            with defer_interrupts():
                batch.mark_stale(stale)
                stepper.lists()
        ready = [m for m in waiting if m.waiting and m.stepper.reached(flags[m.stepper.index])]
        estimate = stepper.stable_step
        try:
            estimate.precompute([m.stepper.index for m in ready if m.stepper.wants_estimate()])
            for member in ready:
                self._proceed(member, self.stop)
        finally:
            estimate.discard_precomputed()


def drive(scenes: dict[int, tuple[SceneStepper, Coroutine]]) -> dict[int, Any]:
    """Run the coroutines of all scenes of one batch to their ends.

    `scenes` maps the number of each scene to its stepper, which advances the scene, and its coroutine. The result maps
    these numbers to the value that each coroutine returned, or to the exception that ended it. An interruption (Ctrl-C)
    is raised inside every coroutine that is waiting. The function may move some scenes to another batch, so do not pass
    the same steppers to it again.
    """
    (results,) = drive_batches([(scenes, None)])
    return results


def drive_batches(
    groups: Sequence[tuple[dict[int, tuple[SceneStepper, Coroutine]], wp.Stream | None]], *, regroups: bool = True
) -> list[dict[int, Any]]:
    """Run the coroutines of several batches at the same time, each batch on its own GPU stream, as :func:`drive` does.

    `groups` contains for each batch its scenes, as in :func:`drive`, and its stream (None: the default stream). While
    the GPU computes steps of some batches, the host works for other batches. The host must therefore read arrays
    through an `Exchange`, which copies asynchronously, because ``numpy()`` waits for all streams. With `regroups`, a
    batch is made smaller once most of its scenes have ended.
    """
    drives = [_Drive(*group, regroups=regroups) for group in groups]
    stop: KeyboardInterrupt | None = None
    launched: list[_Drive] = []

    def each(act: Callable[[_Drive], None], members: Iterable[_Drive]) -> None:
        nonlocal stop
        for one in members:
            act(one)
            stop = stop or one.stop

    each(lambda one: one.begin(stop), drives)
    while is_running := [one for one in drives if one.is_running]:
        try:
            if stop is not None:
                for one in is_running:
                    one.interrupt(stop)
                continue
            each(_Drive.launch, [one for one in is_running if one not in launched])
            launched = [one for one in is_running if one.is_running]
            ready = [one for one in launched if len(launched) == 1 or one.settled]
            if not ready:
                with run_is_waiting():
                    time.sleep(POLL_INTERVAL)
            each(_Drive.collect, ready)
            launched = [one for one in launched if one not in ready]
        except KeyboardInterrupt as interruption:
            stop = interruption
    return [one.results for one in drives]


def drive_one(stepper: SceneStepper, coroutine: Coroutine) -> Any:
    """Run the coroutine of one scene to its end; return the coroutine's value, or raise its exception."""
    result = drive_batches([({0: (stepper, coroutine)}, None)], regroups=False)[0][0]
    if isinstance(result, BaseException):
        raise result
    return result
