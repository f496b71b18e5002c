"""Kernel launches: recorded once, then replayed in graphs of several steps; on a CPU, one thread replays each chunk.

Arguments are bound to a kernel's parameters by name, never by position.
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

from ...kernels.common.barrier import GATE, barrier
from .cores import Crowding, own_cores
from .device import default_threads, parallel
from .graphs import AtOnce, captured
from .interrupts import put_off

COMPILING = 16
"""Maximum number of kernels compiled in parallel."""
PATIENCE = 0.5
"""Compile time below which no progress is shown [s]."""
DEFAULT_BLOCK = 256
"""Threads per CUDA block in a Warp launch that does not specify a number."""
BLOCK = 64
"""Threads per CUDA block of a stage. Such small blocks keep all multiprocessors busy in a small scene. A step of a
million spheres takes 95 % of the time that it takes with blocks of 256 threads."""
Size = int | tuple[int, ...]
"""Number of tasks of a launch, as one integer or as a tuple of several dimensions."""


def tasks_of(dim: Size) -> int:
    """Return the total number of tasks of a launch."""
    return dim if isinstance(dim, int) else math.prod(dim)


def parameter_names(kernel: Any) -> list[str]:
    """Return the names of a kernel's parameters, in order."""
    return [argument.label for argument in kernel.adj.args]


def bound(kernel: Any, named: Mapping[str, Any]) -> list[Any]:
    """Return named arguments in the order of a kernel's parameters.

    Raises TypeError if an argument is missing or matches no parameter.
    """
    names = parameter_names(kernel)
    missing, strange = [n for n in names if n not in named], sorted(set(named) - set(names))
    if missing or strange:
        raise TypeError(
            f"kernel {kernel.key}: arguments {missing} are missing, and {strange} are not parameters of the kernel"
        )
    return [named[name] for name in names]


def completed(kernel: Any, named: Mapping[str, Any], common: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments `named`, and from `common` those of the kernel's other parameters, by parameter name."""
    return {**{name: common[name] for name in parameter_names(kernel) if name in common}, **named}


def members(kernel: Any, **structs: Any) -> dict[str, Any]:
    """Return struct members for a kernel's parameters that are named ``STRUCT_member``, by parameter name."""
    found = {}
    for name in parameter_names(kernel):
        for prefix, struct in structs.items():
            member = name.removeprefix(f"{prefix}_")
            if member != name and hasattr(struct, member):
                found[name] = getattr(struct, member)
    return found


def launch(kernel: Any, dim: Size, device: Any, **named: Any) -> None:
    """Launch a kernel once, with its arguments by name."""
    if tasks_of(dim):
        wp.launch(kernel, dim=dim, inputs=bound(kernel, named), device=device)


class Stage:
    """One kernel launch, which is recorded once and replayed until one of its arrays changes.

    On a GPU, stages with `beside` run on a side stream, at the same time as the stages that follow, until a stage with
    `meets` waits for them. All `beside` stages of a step run one after the other. A stage with `every` = n runs once in
    n steps: before the first of every n steps of a graph, or after some of the graphs if a graph has fewer than n / 2
    steps (see :class:`Launcher`).
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
        """Name of the kernel function."""
        return self.kernel.func.__name__

    def is_due(self, turn: int, size: int) -> bool:
        """Return whether this stage runs at step `turn` of a graph of `size` steps."""
        return turn % self.every == 0 and 2 * size >= self.every

    def record(self) -> None:
        """Load the kernel and record its launch, without running it."""
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
    """Report the progress of compiling while the block runs.

    The function `tell` is called with "compiling" and the fraction done, if compiling takes a while.
    """
    token = _told.set(tell)
    try:
        yield
    finally:
        _told.reset(token)


def load(stages: Iterable[Any], device: Any) -> None:
    """Compile kernels in parallel, or load them from the cache.

    `stages` holds stages, and also kernels that are launched without a stage.
    """
    wanted: dict[tuple[int, int], tuple[Any, int]] = {}
    for stage in stages:
        # A kernel without a stage is launched with Warp's default block size.
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
    """Return the thread pool that compiles kernels; its threads stay alive between calls."""
    return ThreadPoolExecutor(COMPILING)


def _in_order(wanted: Iterable[tuple[Any, int]]) -> list[tuple[Any, int]]:
    """Return modules with their block sizes, most kernel parameters first, because these compile longest."""
    return sorted(wanted, key=lambda each: -sum(len(kernel.adj.args) for kernel in each[0].kernels.values()))


Step = list[list[Any]]
"""Stages of one time step, as one list per thread."""


def graph_sizes(count: int, largest: int) -> list[int]:
    """Split `count` steps into graphs whose sizes are powers of two, at most `largest` steps."""
    rest = [1 << bit for bit in reversed(range(largest.bit_length())) if count % largest >> bit & 1]
    return [largest] * (count // largest) + rest


def by_one_thread(step: Step) -> Step:
    """Merge the threads' stage lists into a list for one thread, barrier by barrier.

    The single thread runs the stages of all threads up to a barrier, then those up to the next barrier.
    """
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
    """Runs time steps by replaying graphs of several steps, with one thread per list of stages in a step.

    During core contention, one thread does the work of all threads; see :mod:`.cores`.
    """

    def __init__(self, threads: int, device: Any) -> None:
        self.threads, self.device = threads, device
        self._graphs: dict[tuple[int, bool, AtOnce | None], list[Any]] = {}
        self._now_and_then: Callable[[], None] | None = None
        self._without = 0  # number of steps since the stages last ran that are not part of every step
        self.gate = wp.zeros(GATE, dtype=wp.int32, device=device)
        """Counters of the barrier at which the threads wait for one another, shape (GATE,)."""
        self.crowding = Crowding()
        self._pool = ThreadPoolExecutor(threads, initializer=own_cores(threads)) if threads > 1 else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.shutdown, wait=False)

    def barrier(self) -> list[Stage]:
        """Return the stage with which a thread waits for the other threads, or no stage if there is one thread."""
        if self.threads == 1:
            return []
        return [Stage(barrier, 1, {"gate": self.gate, "parties": self.threads}, self.device)]

    def invalidate_graphs(self) -> None:
        """Discard all graphs, because arrays or chunks that they contain have changed."""
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
        """Replay one graph for each entry of `sizes`, which is the number of steps in the graph.

        `step` has the stages of each thread. `alone` returns the same step for one thread that does all the work, and
        the stages of `behind` become the end of each graph on a GPU. On a CPU, `ended` is called after each graph; if
        it returns True, the remaining steps would do nothing and are left out.
        """
        left = list(sizes)
        while left:
            # During core contention, or while contention is still unknown, check again after each graph.
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
        """Launch stages that run once in several steps, if graphs of these sizes are too short to contain them."""
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
            # `ended` gives all threads the same answer: a thread that goes on waits for the others at the next barrier,
            # and the flags that `ended` reads change only after that barrier.
            if not parallel(self.device) and ended():
                return

    def apart(self, stages: list[Stage]) -> None:
        """Launch independent stages of several chunks, each on a thread of its own.

        During core contention, one thread launches all of them.
        """
        for stage in stages:
            stage.record()
        if self.crowding.crowded:  # During core contention, one thread does all work.
            self._together([lambda: [stage() for stage in stages]])
        else:
            self._together(stages)

    def _together(self, calls: Sequence[Callable[[], Any]]) -> None:
        if self._pool is None:
            for call in calls:
                call()
            return
        if len(calls) == 1:  # Use the calling thread, because it is not pinned to a core.
            with put_off():
                calls[0]()
            return
        # Defer interruptions. If only some threads started, they would wait for the others at the barrier forever, and
        # all threads must have finished before Python reads their arrays.
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
    """Launch a GPU's stages during a graph capture, those with `beside` on a side stream.

    The main stream waits for the side stream before a stage with `meets`, and at the end.
    """
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
