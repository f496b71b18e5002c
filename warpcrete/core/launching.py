"""How kernels are launched: recorded once, replayed by graphs of several steps, on a CPU by a thread for each chunk.

Arguments are bound to a kernel's parameters by name, never by place.
"""

from __future__ import annotations

import functools
import math
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import warp as wp

from ..kernels.common.barrier import GATE, barrier
from .cores import Crowding, own_cores
from .device import default_threads, parallel
from .graphs import AtOnce, captured
from .interrupts import put_off

COMPILING = 16
"""Kernels that are compiled at once, at most."""
PATIENCE = 0.5
"""Time of compiling that nobody is told of [s]."""
DEFAULT_BLOCK = 256
"""Threads of a CUDA block where a launch of Warp's does not say."""
BLOCK = 64
"""Threads of a CUDA block of a stage: so few that all multiprocessors have some of a small scene. A step of a million
spheres takes 0.95 of what it takes with blocks of 256."""
Size = int | tuple[int, ...]
"""Tasks of a launch, in one dimension or several."""


def tasks_of(dim: Size) -> int:
    """Tasks of a launch in all."""
    return dim if isinstance(dim, int) else math.prod(dim)


def parameter_names(kernel: Any) -> list[str]:
    """Names of a kernel's parameters, in their order."""
    return [argument.label for argument in kernel.adj.args]


def bound(kernel: Any, named: Mapping[str, Any]) -> list[Any]:
    """Arguments in the order of the kernel's parameters; raises TypeError unless there is just one for each."""
    names = parameter_names(kernel)
    missing, strange = [n for n in names if n not in named], sorted(set(named) - set(names))
    if missing or strange:
        raise TypeError(
            f"kernel {kernel.key}: arguments {missing} are missing, and {strange} are not parameters of the kernel"
        )
    return [named[name] for name in names]


def members(kernel: Any, **structs: Any) -> dict[str, Any]:
    """Members of structs for those parameters of a kernel that are called ``STRUCT_member``, by parameter name."""
    found = {}
    for name in parameter_names(kernel):
        for prefix, struct in structs.items():
            member = name.removeprefix(f"{prefix}_")
            if member != name and hasattr(struct, member):
                found[name] = getattr(struct, member)
    return found


def launch(kernel: Any, dim: Size, device: Any, **named: Any) -> None:
    """Launch once, arguments by name."""
    if tasks_of(dim):
        wp.launch(kernel, dim=dim, inputs=bound(kernel, named), device=device)


class Stage:
    """One kernel launch, recorded once and replayed until an array of its changes.

    On a GPU stages that are `beside` run at the same time as those that follow, up to one that `meets` them; all that
    are beside a step's others run one after the other. One that is taken `every` so many steps goes before the first
    of as many in a graph; where graphs hold less than half of that, behind some of them: see :class:`Launcher`.
    """

    def __init__(
        self,
        kernel: Any,
        dim: Size,
        named: Mapping[str, Any],
        device: Any,
        *,
        block: int | None = None,
        beside: bool = False,
        meets: bool = False,
        every: int = 1,
    ) -> None:
        self.kernel, self.dim, self.device = kernel, dim, device
        self.beside, self.meets, self.every = beside, meets, every
        self.arguments = bound(kernel, named)
        self.block = (block or BLOCK) if parallel(device) else 1
        self._command: Any = None

    @property
    def name(self) -> str:
        """The kernel function's."""
        return self.kernel.func.__name__

    def is_due(self, turn: int, size: int) -> bool:
        """Whether it is taken in a step of a graph of so many."""
        return turn % self.every == 0 and 2 * size >= self.every

    def record(self) -> None:
        """Make ready, kernel loaded; nothing runs."""
        if self._command is None and tasks_of(self.dim):
            self._command = wp.launch(
                self.kernel, dim=self.dim, inputs=self.arguments, device=self.device, record_cmd=True,
                block_dim=self.block,
            )  # fmt: skip

    def __call__(self, stream: Any = None) -> None:
        if tasks_of(self.dim):
            self.record()
            self._command.launch(stream)


_told: ContextVar[Callable[[str, float], None] | None] = ContextVar("told", default=None)


@contextmanager
def telling(tell: Callable[[str, float], None]) -> Iterator[None]:
    """Have `tell` called with "compiling" and the fraction done where that takes a while."""
    token = _told.set(tell)
    try:
        yield
    finally:
        _told.reset(token)


def load(stages: Iterable[Any], device: Any) -> None:
    """Compile kernels, several at once, or read them from the cache: those of stages, and kernels that are launched
    without one.
    """
    wanted: dict[tuple[int, int], tuple[Any, int]] = {}
    for stage in stages:
        # A kernel alone is launched in blocks of Warp's own size.
        kernel, block = (stage.kernel, stage.block) if isinstance(stage, Stage) else (stage, DEFAULT_BLOCK)
        block = block if parallel(device) else 1
        wanted[id(kernel.module), block] = kernel.module, block
    left = deque(_in_order(wanted.values()))
    begun, count, told = time.monotonic(), len(left), False

    def work() -> None:
        nonlocal told
        while True:
            try:
                module, block = left.popleft()
            except IndexError:
                return
            wp.load_module(module, device=device, block_dim=block)
            if (tell := _told.get()) is not None and time.monotonic() - begun > PATIENCE:
                told = True
                tell("compiling", 1.0 - len(left) / count)

    others = [_compilers().submit(work) for _ in range(min(COMPILING, default_threads(), len(left)) - 1)]
    try:
        work()
    finally:
        left.clear()
        wait(others)
    for other in others:
        other.result()
    if told and (tell := _told.get()) is not None:
        tell("compiling", 1.0)


@functools.cache
def _compilers() -> ThreadPoolExecutor:
    """Threads that stay."""
    return ThreadPoolExecutor(COMPILING)


def _in_order(wanted: Iterable[tuple[Any, int]]) -> list[tuple[Any, int]]:
    """Return modules and their blocks, those with most parameters first: they take longest to compile."""
    return sorted(wanted, key=lambda each: -sum(len(kernel.adj.args) for kernel in each[0].kernels.values()))


Step = list[list[Any]]
"""Stages of one step, a list for each thread."""


def graph_sizes(count: int, largest: int) -> list[int]:
    """Graphs, each of a power of two steps up to `largest`, that make `count` steps together."""
    rest = [1 << bit for bit in reversed(range(largest.bit_length())) if count % largest >> bit & 1]
    return [largest] * (count // largest) + rest


def by_one_thread(step: Step) -> Step:
    """A step of several threads as one thread takes it: what all do up to a barrier, then up to the next."""
    parts: list[list[list[Any]]] = []
    for stages in step:
        between: list[list[Any]] = [[]]
        for stage in stages:
            if isinstance(stage, Stage) and stage.kernel is barrier:
                between.append([])
            else:
                between[-1].append(stage)
        parts.append(between)
    return [[stage for phase in zip(*parts, strict=True) for stages in phase for stage in stages]]


class Launcher:
    """Replays graphs of so many steps each, with as many threads as a step has lists of stages.

    While other processes want the cores, one thread does the work of all; see :mod:`.cores`.
    """

    def __init__(self, threads: int, device: Any) -> None:
        self.threads, self.device = threads, device
        self._graphs: dict[tuple[int, bool, AtOnce | None], list[Any]] = {}
        self._now_and_then: Callable[[], None] | None = None
        self._without = 0  # steps since what is taken now and then was
        self.gate = wp.zeros(GATE, dtype=wp.int32, device=device)
        """Where threads wait for one another, shape (GATE,)."""
        self.crowding = Crowding()
        self._pool = ThreadPoolExecutor(threads, initializer=own_cores(threads)) if threads > 1 else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.shutdown, wait=False)

    def barrier(self) -> list[Stage]:
        """What a thread does to wait for the others; nothing if it is alone."""
        if self.threads == 1:
            return []
        return [Stage(barrier, 1, {"gate": self.gate, "parties": self.threads}, self.device)]

    def invalidate_graphs(self) -> None:
        """Forget the graphs: they hold arrays or chunks that are no more."""
        self._graphs.clear()
        self._now_and_then = None

    def replay(
        self,
        step: Step,
        alone: Callable[[], Step],
        sizes: list[int],
        ended: Callable[[], bool],
        behind: AtOnce | None = None,
    ) -> None:
        """Take as many steps as `sizes` add up to. On a CPU, `ended` says after each graph whether the rest is idle.

        `alone` gives the step as one thread takes it for all; what is `behind` each graph of a GPU becomes part of it.
        """
        left = list(sizes)
        while left:
            crowded = self._pool is not None and self.crowding.look()
            count = 1 if self._pool is not None and (crowded or self.crowding.on_trial) else len(left)
            now, left = left[:count], left[count:]
            for size in set(now):
                if (size, crowded, behind) not in self._graphs:
                    self._graphs[size, crowded, behind] = self._capture(alone() if crowded else step, size, behind)
            begun = time.perf_counter()
            parts = range(1 if crowded else self.threads)
            self._together([functools.partial(self._run, part, now, crowded, ended, behind) for part in parts])
            if self._pool is not None and not crowded:
                self.crowding.stepped(time.perf_counter() - begun)
            self._catch_up(step[0], now)
            if left and not parallel(self.device) and ended():
                return

    def _catch_up(self, stages: list[Any], sizes: list[int]) -> None:
        """Launch what is taken every so many steps, where graphs of these sizes are too short to hold it."""
        seldom = [stage for stage in stages if stage.every > 1]
        if not seldom:
            return
        held = any(stage.is_due(0, size) for stage in seldom for size in sizes)
        self._without = 0 if held else self._without + sum(sizes)
        if self._without >= seldom[0].every:
            self._now_and_then = self._now_and_then or AtOnce(seldom, self.device)
            self._now_and_then()
            self._without = 0

    def _run(
        self, part: int, sizes: list[int], crowded: bool, ended: Callable[[], bool], behind: AtOnce | None
    ) -> None:
        if not crowded:
            self.crowding.enter()
        for size in sizes:
            wp.capture_launch(self._graphs[size, crowded, behind][part])
            # Threads see the same: who goes on waits for the others at the next barrier, before flags change.
            if not parallel(self.device) and ended():
                return

    def apart(self, stages: list[Stage]) -> None:
        """Launch stages that chunks have apart, each on a thread of its own while that is so of steps."""
        for stage in stages:
            stage.record()
        if self.crowding.crowded:  # as steps are
            self._together([lambda: [stage() for stage in stages]])
        else:
            self._together(stages)

    def _together(self, calls: Sequence[Callable[[], Any]]) -> None:
        if self._pool is None:
            for call in calls:
                call()
            return
        if len(calls) == 1:  # by this thread, which the system may move to any core
            with put_off():
                calls[0]()
            return
        # Every thread must set out, or those that did wait for it at the barrier; none may still write when Python
        # reads again.
        with put_off():
            running = [self._pool.submit(call) for call in calls]
            wait(running)
        for one in running:
            one.result()

    def _capture(self, step: Step, size: int, behind: AtOnce | None) -> list[Any]:
        load((stage for part in step for stage in part), self.device)

        def launch(part: list[Any]) -> None:
            for turn in range(size):
                due = [stage for stage in part if stage.is_due(turn, size)]
                if parallel(self.device) and self.device.is_cuda:
                    _launch_beside(due, self.device)
                else:
                    for stage in due:
                        stage()
            for stage in behind.stages if behind is not None else ():
                stage()

        return [captured(self.device, functools.partial(launch, part)) for part in step]


def _launch_beside(stages: list[Any], device: Any) -> None:
    """Launch a GPU's stages into the graph that is captured, those that are `beside` on a stream of their own."""
    main, side, apart = device.stream, None, False
    for stage in stages:
        if stage.beside:
            if side is None:
                side = wp.Stream(device, priority=main.priority)
                side.wait_event(main.record_event())
            stage(side)
            apart = True
            continue
        if stage.meets and side is not None and apart:
            main.wait_event(side.record_event())
            apart = False
        stage()
    if side is not None and apart:
        main.wait_event(side.record_event())
