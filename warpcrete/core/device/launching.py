"""Kernel launches: recorded once, then replayed in graphs of several steps; each CPU thread replays its own graphs.

Arguments are bound to a kernel's parameters by name, never by position.
"""

import functools
import math
import time
import weakref
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeAlias

import warp as wp

from ...kernels.common.barrier import GATE, barrier  # pyright: ignore[reportUnknownVariableType]
from .arrays import Kernel, KernelModule, launch_kernel, load_module, zeros
from .cores import CoreContention, thread_pinner
from .device import default_threads, parallel
from .graphs import GraphLaunch, captured
from .interrupts import defer_interrupts, stop_if_requested
from .kernel_files import kernel_cache_errors, note_use, stop_run_clock

PARALLEL_COMPILATIONS = 16
"""Maximum number of kernels compiled in parallel."""
COMPILE_PROGRESS_DELAY = 0.5
"""Compile time below which no progress is shown [s]."""
CHECK_INTERVAL = 0.1
"""Time between two checks for progress and for requests to stop while kernels are compiled [s]."""
DEFAULT_BLOCK = 256
"""Threads per CUDA block in a Warp launch that does not specify a number."""
BLOCK = 64
"""Threads per CUDA block of a stage (kernel launch). Blocks of 64 threads occupy all multiprocessors even if a scene is
small. In a scene of a million spheres, a step takes 95 % of the time that it takes with blocks of 256 threads."""
Size: TypeAlias = int | tuple[int, ...]
"""Number of parallel tasks of a kernel launch, as one integer or as a tuple of several dimensions."""


Arguments: TypeAlias = dict[str, Any]
"""Arguments of a kernel by parameter name: arrays, structs and numbers."""


def tasks_of(dim: Size) -> int:
    """Return the number of tasks of a kernel launch with dimensions `dim`, which is the product of the dimensions."""
    return dim if isinstance(dim, int) else math.prod(dim)


def parameter_names(kernel: Kernel) -> list[str]:
    """Return the names of a kernel's parameters, in order."""
    return [argument.label for argument in kernel.adj.args]


def bound(kernel: Kernel, named: Mapping[str, object]) -> list[object]:
    """Return named arguments in the order of a kernel's parameters.

    Raises TypeError if an argument is missing or matches no parameter.
    """
    names = parameter_names(kernel)
    missing, strange = [n for n in names if n not in named], sorted(set(named) - set(names))
    if missing or strange:
        raise TypeError(
            f"kernel {kernel.key}: missing arguments: {', '.join(missing) or 'none'}; arguments that are not "
            f"parameters of the kernel: {', '.join(strange) or 'none'}"
        )
    return [named[name] for name in names]


def completed(kernel: Kernel, named: Mapping[str, object], common: Mapping[str, object]) -> dict[str, object]:
    """Return a kernel's arguments by parameter name: those in `named`, and missing arguments from `common`."""
    return {**{name: common[name] for name in parameter_names(kernel) if name in common}, **named}


def struct_arguments(kernel: Kernel, **structs: object) -> Arguments:
    """Return kernel arguments taken from `structs`: parameter ``bodies_mass`` gets the member ``mass`` of ``bodies``.

    The result has an entry for each kernel parameter whose name consists of a struct's name and a member's name.
    """
    arguments: Arguments = {}
    for name in parameter_names(kernel):
        for prefix, struct in structs.items():
            member = name.removeprefix(f"{prefix}_")
            if member != name and hasattr(struct, member):
                arguments[name] = getattr(struct, member)
    return arguments


def launch(kernel: Kernel, dim: Size, device: wp.Device, **named: object) -> None:
    """Launch `dim` tasks of a kernel once; `named` holds the kernel's arguments by parameter name."""
    if tasks_of(dim):
        _load_if_missing(kernel, DEFAULT_BLOCK, device)
        launch_kernel(kernel, dim=dim, inputs=bound(kernel, named), device=device)


class Stage:
    """One kernel launch, which is recorded once and replayed until one of its arrays changes.

    On a GPU, all stages of a step run one after the other on the main stream, except stages with `on_side_stream`.
    These run on a side stream, at the same time as later stages of the main stream. A stage with `joins_side_stream`
    waits until the side stream has no work left.

    A stage with `every` = n runs once in n steps: in the first of every n steps of a graph. If a graph has fewer than n
    / 2 steps, the :class:`Launcher` runs this stage between graphs instead.
    """

    def __init__(
        self,
        kernel: Kernel,
        dim: Size,
        named: Mapping[str, object],
        device: wp.Device,
        *,
        block: int | None = None,
        on_side_stream: bool = False,
        joins_side_stream: bool = False,
        every: int = 1,
    ) -> None:
        self.kernel, self.dim, self.device = kernel, dim, device
        self.on_side_stream, self.joins_side_stream, self.every = on_side_stream, joins_side_stream, every
        self.arguments = bound(kernel, named)
        self.block = (block or BLOCK) if parallel(device) else 1
        self._command: wp.Launch | None = None

    @property
    def name(self) -> str:
        """Name of the kernel function."""
        return self.kernel.func.__name__

    def is_due(self, turn: int, size: int) -> bool:
        """Return whether this launch is part of step `turn` (from 0) of a launch graph with `size` steps."""
        return turn % self.every == 0 and 2 * size >= self.every

    def record(self) -> None:
        """Load the kernel and record its launch, without running it."""
        if self._command is None and tasks_of(self.dim):
            _load_if_missing(self.kernel, self.block, self.device)
            self._command = launch_kernel(
                self.kernel, dim=self.dim, inputs=self.arguments, device=self.device, record_cmd=True,
                block_dim=self.block,
            )  # fmt: skip

    def set(self, name: str, value: object) -> None:
        """Set the argument `name` of the recorded launch to `value`."""
        self.record()
        if self._command is not None:
            self._command.set_param_by_name(name, value)

    def __call__(self, stream: wp.Stream | None = None) -> None:
        if tasks_of(self.dim):
            self.record()
            assert self._command is not None
            self._command.launch(stream)


_compile_callback: ContextVar[Callable[[str, float], None] | None] = ContextVar("compile_callback", default=None)


@contextmanager
def report_compiling(tell: Callable[[str, float], None]) -> Generator[None]:
    """Report the progress of compiling inside the `with` block.

    If compiling takes longer than `COMPILE_PROGRESS_DELAY`, call `tell` with the word "compiling" and the fraction of
    the modules that is done.
    """
    token = _compile_callback.set(tell)
    try:
        yield
    finally:
        _compile_callback.reset(token)


def load(stages: Iterable[Stage | Kernel], device: wp.Device) -> None:
    """Compile the kernels of `stages` in parallel, or load them from the cache.

    An entry of `stages` is a stage (a recorded launch) or a kernel that is launched without a stage.
    """
    wanted: dict[tuple[int, int], tuple[KernelModule, int]] = {}
    for stage in stages:
        # A kernel that is launched directly, not as a stage, uses Warp's default block size.
        kernel, block = (stage.kernel, stage.block) if isinstance(stage, Stage) else (stage, DEFAULT_BLOCK)
        block = block if parallel(device) else 1
        wanted[id(kernel.module), block] = kernel.module, block
    _load_modules(wanted.values(), device)


def _load_if_missing(kernel: Kernel, block: int, device: wp.Device) -> None:
    """Load the module of a kernel for blocks of `block` threads, unless it has been loaded for this device."""
    block = block if parallel(device) else 1
    if (device.context, block) in kernel.module.execs:  # pyright: ignore[reportUnknownMemberType]
        note_use(kernel.module)
    else:
        _load_modules([(kernel.module, block)], device)


def _load_modules(wanted: Iterable[tuple[KernelModule, int]], device: wp.Device) -> None:
    """Compile pairs of a kernel module and a block size in parallel, or load them from the cache.

    Other threads compile, because Python calls no signal handler while its main thread compiles. After Ctrl-C or a
    request to stop, each of them still completes the module on which it works, but nobody waits for it.
    """
    left, loaded = deque(_in_order(wanted)), list[KernelModule]()
    start, count, reported = time.monotonic(), len(left), 0.0

    def work() -> None:
        while True:
            try:
                module, block = left.popleft()
            except IndexError:
                return
            note_use(module)
            with kernel_cache_errors():
                load_module(module, device=device, block_dim=block)
            loaded.append(module)

    workers = [_compilers().submit(work) for _ in range(min(PARALLEL_COMPILATIONS, default_threads(), count))]
    tell = _compile_callback.get()
    try:
        with stop_run_clock():
            while wait(workers, CHECK_INTERVAL, FIRST_EXCEPTION).not_done:
                stop_if_requested()
                fraction = len(loaded) / count
                if tell is not None and fraction > reported and time.monotonic() - start > COMPILE_PROGRESS_DELAY:
                    tell("compiling", fraction)
                    reported = fraction
                for worker in workers:
                    if worker.done():
                        worker.result()
    finally:
        left.clear()
    for worker in workers:
        worker.result()
    if tell is not None and time.monotonic() - start > COMPILE_PROGRESS_DELAY:
        tell("compiling", 1.0)


@functools.cache
def _compilers() -> ThreadPoolExecutor:
    """Return the thread pool that compiles kernels; its threads stay alive between calls."""
    return ThreadPoolExecutor(PARALLEL_COMPILATIONS)


def _in_order(wanted: Iterable[tuple[KernelModule, int]]) -> list[tuple[KernelModule, int]]:
    """Sort pairs of a kernel module and a block size by decreasing compile time.

    The number of kernel parameters in a module serves as the measure of its compile time.
    """
    return sorted(wanted, key=lambda each: -sum(len(kernel.adj.args) for kernel in each[0].kernels.values()))


Step: TypeAlias = list[list[Stage]]
"""Stages (recorded kernel launches) of one time step, as one list for each CPU thread."""


def graph_sizes(count: int, largest: int) -> list[int]:
    """Split `count` time steps into launch graphs, and return the number of steps in each graph.

    A launch graph is a recorded sequence of steps. Its number of steps is a power of two, at most `largest`.
    """
    rest = [1 << bit for bit in reversed(range(largest.bit_length())) if count % largest >> bit & 1]
    return [largest] * (count // largest) + rest


def merge_thread_stages(step: Step) -> Step:
    """Merge the stage lists of several threads into one list, for a single thread.

    The single thread runs the stages of all threads up to the first barrier, then the stages of all threads up to the
    next barrier, and so on.
    """
    parts: list[list[list[Stage]]] = []
    for stages in step:
        between: list[list[Stage]] = [[]]
        for stage in stages:
            if stage.kernel is barrier:
                between.append([])
            else:
                between[-1].append(stage)
        parts.append(between)
    return [[stage for phase in zip(*parts, strict=True) for stages in phase for stage in stages]]


class Launcher:
    """Launcher of time steps: it records launch graphs of several steps each, and replays them.

    A step consists of one list of stages (kernel launches) for each thread, and each thread replays graphs of its own
    list. While other processes use the cores, one thread does all the work; :mod:`.cores` explains why this is faster.
    """

    def __init__(self, threads: int, device: wp.Device) -> None:
        self.threads, self.device = threads, device
        self._graphs: dict[tuple[int, bool, GraphLaunch | None], list[wp.Graph]] = {}
        self._periodic_launch: Callable[[], None] | None = None
        # Periodic stages are kernel launches that run once in several steps (`every` > 1). The attribute
        # `_steps_without_periodic` is the number of steps since they last ran.
        self._steps_without_periodic = 0
        self.gate = zeros(GATE, dtype=wp.int32, device=device)
        """Counters of the barrier at which the threads wait for one another; GATE is the number of counters."""
        self.contention = CoreContention()
        self._pool = ThreadPoolExecutor(threads, initializer=thread_pinner(threads)) if threads > 1 else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.shutdown, wait=False)

    def barrier(self) -> list[Stage]:
        """Return a list with the kernel launch that makes a thread wait for all others; empty for a single thread."""
        if self.threads == 1:
            return []
        kernel: Kernel = barrier  # pyright: ignore[reportAssignmentType, reportUnknownVariableType]
        return [Stage(kernel, 1, {"gate": self.gate, "parties": self.threads}, self.device)]

    def invalidate_graphs(self) -> None:
        """Discard all recorded graphs of steps, because their arrays or the division of work have changed."""
        self._graphs.clear()
        self._periodic_launch = None

    def replay(
        self,
        step: Step,
        single_thread_step: Callable[[], Step],
        sizes: list[int],
        ended: Callable[[], bool],
        appended: GraphLaunch | None = None,
    ) -> None:
        """Replay recorded graphs of time steps; `sizes` are the numbers of steps in the successive graphs.

        `step` contains the kernel launches of each thread in one step. `single_thread_step` returns the same step for
        one thread that does all the work. The launches in `appended` run at the end of each graph, on a GPU only. On a
        CPU, `ended` is called after each graph. If it returns True, the remaining steps would change nothing and are
        left out.
        """
        left = list(sizes)
        while left:
            # Core contention means that other processes use the CPU cores on which the threads of this run compute.
            # While there is contention, or while this is not known, check for it after each launch graph.
            contended = self._pool is not None and self.contention.use_one_thread()
            count = 1 if self._pool is not None and (contended or self.contention.is_uncertain) else len(left)
            now, left = left[:count], left[count:]
            for size in set(now):
                if (size, contended, appended) not in self._graphs:
                    self._graphs[size, contended, appended] = self._capture(
                        single_thread_step() if contended else step, size, appended
                    )
            start = time.perf_counter()
            parts = range(1 if contended else self.threads)
            self._together([functools.partial(self._run, part, now, contended, ended, appended) for part in parts])
            if self._pool is not None and not contended:
                self.contention.add_step_time(time.perf_counter() - start)
            self._catch_up(step[0], now)
            if left and not parallel(self.device) and ended():
                return

    def _catch_up(self, stages: list[Stage], sizes: list[int]) -> None:
        """Run periodic kernel launches (stages with `every` > 1) between graphs that are too short to contain them.

        A stage with `every` = n must run once in n steps, and only graphs of at least n / 2 steps contain it. `stages`
        are the stages of a step, and `sizes` are the numbers of steps in the graphs that have just been replayed.
        """
        periodic = [stage for stage in stages if stage.every > 1]
        if not periodic:
            return
        contained = any(stage.is_due(0, size) for stage in periodic for size in sizes)
        self._steps_without_periodic = 0 if contained else self._steps_without_periodic + sum(sizes)
        if self._steps_without_periodic >= periodic[0].every:
            self._periodic_launch = self._periodic_launch or GraphLaunch(periodic, self.device)
            self._periodic_launch()
            self._steps_without_periodic = 0

    def _run(
        self, part: int, sizes: list[int], contended: bool, ended: Callable[[], bool], appended: GraphLaunch | None
    ) -> None:
        if not contended:
            self.contention.register_thread()
        for size in sizes:
            wp.capture_launch(self._graphs[size, contended, appended][part])
            # All threads get the same result from `ended`, although they call it at different times: the flags that
            # `ended` reads change only after the next barrier, which no thread passes before all have called `ended`.
            if not parallel(self.device) and ended():
                return

    def apart(self, stages: list[Stage]) -> None:
        """Launch stages (kernel launches) that do not depend on one another, each in a thread of its own.

        The stages may belong to different groups of bodies, for example. While other processes use the cores, one
        thread launches all stages.
        """
        for stage in stages:
            stage.record()
        if self.contention.contended:  # While other processes use the cores, one thread does all work.
            self._together([lambda: [stage() for stage in stages]])
        else:
            self._together(stages)

    def _together(self, calls: Sequence[Callable[[], object]]) -> None:
        if self._pool is None:
            for call in calls:
                call()
            return
        # A thread of the pool is pinned to a core, which another program may be using. A single call therefore runs
        # in the calling thread, which the system can move to a free core.
        if len(calls) == 1:
            with defer_interrupts():
                calls[0]()
            return
        # Defer interruptions until all threads have finished, for two reasons. If only some threads started, these
        # threads would wait forever at the barrier. Python must also not read arrays while a thread writes to them.
        with defer_interrupts():
            running = [self._pool.submit(call) for call in calls]
            wait(running)
        for one in running:
            one.result()

    def _capture(self, step: Step, size: int, appended: GraphLaunch | None) -> list[wp.Graph]:
        load((stage for part in step for stage in part), self.device)

        def launch(part: list[Stage]) -> None:
            for turn in range(size):
                due = [stage for stage in part if stage.is_due(turn, size)]
                if parallel(self.device) and self.device.is_cuda:
                    _launch_on_side_stream(due, self.device)
                else:
                    for stage in due:
                        stage()
            for stage in appended.stages if appended is not None else ():
                stage()

        return [captured(self.device, functools.partial(launch, part)) for part in step]


def _launch_on_side_stream(stages: list[Stage], device: wp.Device) -> None:
    """Launch stages (kernel launches) while a GPU's launch graph is captured.

    Stages with `on_side_stream` run on a side stream. The main stream waits for the side stream before each stage with
    `joins_side_stream`, and after the last stage.
    """
    main, side, apart = device.stream, None, False
    for stage in stages:
        if stage.on_side_stream:
            if side is None:
                side = wp.Stream(device, priority=main.priority)
                side.wait_event(main.record_event())
            stage(side)
            apart = True
            continue
        if stage.joins_side_stream and side is not None and apart:
            main.wait_event(side.record_event())
            apart = False
        stage()
    if side is not None and apart:
        main.wait_event(side.record_event())
