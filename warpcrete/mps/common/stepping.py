"""Time stepping of flows: launch recorded graphs of several steps, for one flow or for several flows on one GPU.

After several graphs, the host reads the control flags from the device. They contain the number of completed steps.
"""

import math
import traceback
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ...core.device.arrays import Kernel
from ...core.device.device import parallel
from ...core.device.launching import Arguments, Launcher, Size, Stage, Step, completed, graph_sizes, report_compiling
from ...core.errors import CapacityError, ConvergenceError, InstabilityError
from ...core.run.coroutines import Coroutine
from ...core.run.method import Progress, run_in_turn
from ...core.run.run import Run
from ...kernels.common.control import FAILED, HALTED, STALE, STEPS
from ...kernels.mps.conjugate_gradient import AFTER, BEFORE, ITERATIONS
from ...kernels.mps.structs import DENSITY, LOST, PRESSURE, VISCOSITY
from .run import FlowRun

# Maximum number of steps in one launch graph, on one CPU thread, on several CPU threads, and on a GPU.
LARGEST_GRAPH = {"cpu": 2, "threads": 8, "cuda": 16}
GRAPHS_PER_CHECK = 4
"""Maximum number of launch graphs that are replayed between two reads of the control flags, if the graphs have the
maximum number of steps."""
SOLVE_NAMES = {VISCOSITY: "viscosity", PRESSURE: "pressure", DENSITY: "density"}
VELOCITY_ERROR = 1e-6
"""Tolerance of the viscosity solve, which stops when the norm of its residual is below this fraction of a typical norm.
The typical norm is the norm that the residual has if every velocity is wrong by the typical speed of the flow. In a
pipe, the typical speed is the mean velocity."""
ABSOLUTE_PRESSURE_FACTOR = 1e-4
"""Absolute tolerance of the pressure solve, divided by its relative tolerance, which is the scene's `tolerance`. The
solve stops when the norm of its residual is below either tolerance times a reference norm. For the relative tolerance,
the reference norm is the norm of the initial residual. For the absolute tolerance, it is the norm of the residual that
belongs to a uniform divergence: a typical speed of the flow divided by a typical length (in a pipe, the radius)."""
MAX_CONCURRENT_FLOWS = 64
"""Maximum number of independent flows that are simulated on one GPU at the same time."""


class Stepping(ABC):
    """Base class of flows that advance in time by replaying launch graphs.

    All time steps have the same length unless a subclass adapts it.
    """

    scene: Any
    device: Any
    threads: int
    """Number of CPU threads that work on the flow."""
    flags: wp.array
    parallel: bool
    time: float
    steps: int
    abreast: int = 1
    """Number of flows that are simulated on the GPU at the same time; the method :meth:`share` sets it."""
    _launcher: Launcher
    _step: Step | None
    _goal: int = 0
    """Number of time steps, counted from the start of the run, at which the flow stops until a new goal is set."""

    @property
    @abstractmethod
    def step(self) -> Step:
        """Stages of one time step (kernel launches and barriers), one list for each thread."""

    @abstractmethod
    def solves(self) -> dict[int, Any]:
        """Return the working arrays of each linear solve; the keys are VISCOSITY, PRESSURE and DENSITY."""

    def stage(self, kernel: Kernel, dim: Size, *, block: int | None = None, **named: object) -> Stage:
        """Return a part of a time step (stage) that launches `kernel`.

        The kernel receives the arguments in `named`. All its other parameters receive the flow's arrays of the same
        names.
        """
        return Stage(kernel, dim, completed(kernel, named, self._kernel_arrays), self.device, block=block)

    @property
    @abstractmethod
    def _kernel_arrays(self) -> Arguments:
        """Arrays and structs of the flow, by the names of the kernel parameters that receive them."""

    def _single_thread_step(self) -> Step:
        return self.step

    def build(self) -> None:
        """Do the work that must precede the next step, such as a requested rebuild of the neighbour lists."""
        raise TypeError(f"{type(self).__name__} has no neighbour lists to rebuild between steps")

    def share(self, abreast: int) -> None:
        """Set the number of flows that share the GPU.

        The solves of each flow may occupy only the flow's share of the GPU's thread blocks.
        """
        if abreast != self.abreast:
            self.abreast, self._step = abreast, None
            self._launcher.invalidate_graphs()

    def take(self, steps: int) -> None:
        """Take a number of steps; raise :class:`ConvergenceError` or :class:`InstabilityError` if a step fails."""
        self.set_goal(steps=self.steps + steps)
        self._run_to_goal()

    def advance(self, until: float) -> None:
        """Take whole steps until the time is as close to `until` [s] as possible.

        The method raises the same errors as :meth:`take`.
        """
        self.set_goal(until)
        self._run_to_goal()

    def _run_to_goal(self) -> None:
        while not self.goal_reached:
            self.launch()
            self.settle()

    def set_goal(self, until: float = math.inf, steps: int | None = None) -> None:
        """Set the number of steps at which the flow stops: `steps`, or the step that ends nearest to `until` [s]."""
        self._goal = math.floor(until / self.scene.time_step + 0.5) if steps is None else steps

    @property
    def goal_reached(self) -> bool:
        """True once the flow has taken all steps up to the goal that `set_goal` set."""
        return self.steps >= self._goal

    @property
    def _steps_left(self) -> int:
        """Number of steps to the goal, at least 1 before the goal is reached. A subclass may return an estimate."""
        return self._goal - self.steps

    def launch(self) -> None:
        """Launch some of the steps that the flow still needs to reach its goal, a time or a number of steps.

        On a GPU the method returns before the steps are completed.
        """
        largest = self._largest_graph
        sizes = graph_sizes(min(self._steps_left, GRAPHS_PER_CHECK * largest), largest)
        self._launcher.replay(self.step, self._single_thread_step, sizes, lambda: bool(self.flags.numpy()[int(HALTED)]))

    @property
    def _largest_graph(self) -> int:
        """Maximum number of steps in one launch graph."""
        return LARGEST_GRAPH["cuda" if self.parallel else "threads" if self.threads > 1 else "cpu"]

    def settle(self) -> None:
        """Wait for the launched steps, read how many are completed, and rebuild the neighbour lists if necessary.

        A launched step does nothing if an earlier step has failed or has requested a rebuild, so not all launched steps
        need be completed. If a step failed, its error is raised.
        """
        flags = self.read_progress()
        if flags[int(FAILED)]:
            self._fail(int(flags[int(FAILED)]))
        if flags[int(STALE)]:
            self.build()

    def read_progress(self) -> np.ndarray:
        """Read the control flags; store the number of completed steps, which they contain, and the simulated time [s].

        Return the control flags.
        """
        flags: np.ndarray = self.flags.numpy()
        self.steps = int(flags[int(STEPS)])
        self.time = self.steps * self.scene.time_step
        return flags

    def _fail(self, what: int) -> None:
        if what == LOST:
            raise InstabilityError(
                "a particle left the vessel, or its position is not a number",
                time=self.time,
                cure="a smaller 'time_step'",
            )
        solve = self.solves()[what]
        outcome = solve.outcome.numpy()
        count = int(outcome[int(ITERATIONS)])
        history = [float(outcome[int(BEFORE)]), *map(float, solve.history.numpy()[:count])]
        raise ConvergenceError(
            self.time, SOLVE_NAMES[what], count, history, float(outcome[int(AFTER)]), self.scene.maximum_iterations
        )

    def outcomes(self) -> dict[str, dict[str, float]]:
        """Return, for each linear solve in the last step, the number of iterations and the residuals."""
        by_solve = {}
        for what, solve in self.solves().items():
            outcome: np.ndarray = solve.outcome.numpy()
            numbers = {"iterations": ITERATIONS, "before": BEFORE, "after": AFTER}
            by_solve[SOLVE_NAMES[what]] = {key: float(outcome[int(slot)]) for key, slot in numbers.items()}
        return by_solve


class _Run:
    """One of several simulations that run at the same time, each on a separate CUDA stream."""

    def __init__(self, simulation: FlowRun, checkpoint: Path | None) -> None:
        self.simulation, self.checkpoint = simulation, checkpoint
        self.outcome: Run | BaseException | None = None
        self._stream = wp.Stream(simulation.device) if simulation.device.is_cuda else None
        self._coroutine: Coroutine | None = None

    @property
    def _flow(self) -> Stepping:
        return self.simulation.flow

    def begin(self, abreast: int) -> None:
        """Prepare the simulation and run it until its first steps can be launched.

        Raises :class:`CapacityError` if the free memory of the device is too small for the simulation at present.
        """
        simulation = self.simulation
        if self.checkpoint is not None or not simulation.prepared:
            simulation.begin(self.checkpoint)
        self._flow.share(abreast)
        self._coroutine = simulation.running()
        self._resume(None)

    def launch_steps(self) -> None:
        """Launch steps towards the time or the number of steps that the run has requested, without waiting for them."""
        try:
            with wp.ScopedStream(self._stream) if self._stream else nullcontext():
                self._flow.launch()
        except Exception as failure:
            self._resume(failure)

    def check_steps(self) -> None:
        """Check the completed steps, and resume the run's coroutine if they failed or reached its goal.

        The goal is the time or the number of steps that the coroutine has requested. The coroutine then requests its
        next goal, or it ends. When it ends, its result or its error is stored.
        """
        try:
            self._flow.settle()
        except (Exception, KeyboardInterrupt) as failure:
            self._resume(failure)
        else:
            if self._flow.goal_reached:
                self._resume(None)

    def _resume(self, error: BaseException | None) -> None:
        """Resume the run's coroutine until it requests steps or ends; an `error` is raised inside the coroutine."""
        assert self._coroutine is not None
        try:
            while True:
                request = next(self._coroutine) if error is None else self._coroutine.throw(error)
                error = None
                self._flow.set_goal(request.time)
                if not self._flow.goal_reached:
                    return
        except StopIteration as end:
            self.outcome = end.value
        except (Exception, KeyboardInterrupt) as failure:
            # Clear the frames of the traceback, because their local variables keep device memory allocated.
            traceback.clear_frames(failure.__traceback__)
            self.outcome = failure

    def stop(self, why: KeyboardInterrupt) -> None:
        """End the run now after an interruption (Ctrl-C).

        If the run has begun, its outcome is its unfinished result. Otherwise its outcome is the interruption `why`.
        """
        if self.outcome is None:
            if self._coroutine is None:
                self.outcome = why
            else:
                self._resume(why)


def run_abreast(
    simulations: Sequence[FlowRun], checkpoints: Sequence[Path | None], progress: Progress
) -> list[Run | BaseException]:
    """Run several flows on one device; return the result of each run, or the error with which it failed.

    `checkpoints` contains for each flow the checkpoint from which it resumes, or None. On a GPU, as many flows as fit
    run at the same time, each on its own stream. On a CPU the flows run in turn. Reading an array waits for all streams
    of the device, so in each round all flows are launched before any of them is checked. Each flow gives the same bits
    as when it is the only one, and a failed flow does not affect the other flows. After an interruption (Ctrl-C), the
    function returns unfinished results of the runs that had begun, and `KeyboardInterrupt` for all other runs.
    """
    if len(simulations) < 2 or not parallel(simulations[0].device):
        return run_in_turn(simulations, checkpoints, progress)
    runs = [_Run(*pair) for pair in zip(simulations, checkpoints)]
    try:
        with report_compiling(progress):
            _run_together(runs, simulations[0].device, progress)
    except KeyboardInterrupt as why:
        for run in runs:
            run.stop(why)
            run.simulation.release()
    return [run.outcome for run in runs if run.outcome is not None]


def _run_together(runs: list[_Run], device: wp.Device, progress: Progress) -> None:
    left, under_way, full = list(runs), [], False
    abreast = min(len(runs), MAX_CONCURRENT_FLOWS)
    while left or under_way:
        while left and len(under_way) < MAX_CONCURRENT_FLOWS and not full:
            run = left[0]
            try:
                if run.simulation.stop_requested:
                    raise KeyboardInterrupt
                run.begin(abreast)
            except CapacityError as error:
                run.simulation.release()
                if under_way:
                    # The memory of the device has no room for a further run until one of the present runs has ended.
                    full = True
                    break
                run.outcome = error
            except (Exception, KeyboardInterrupt) as failure:
                run.outcome = failure
            under_way.append(left.pop(0))
        for run in under_way:
            if run.outcome is None:
                run.launch_steps()
        wp.synchronize_device(device)
        for run in list(under_way):
            if run.outcome is None:
                run.check_steps()
            if run.outcome is not None:
                under_way.remove(run)
                full = False
                run.simulation.release()
                progress("running", sum(each.outcome is not None for each in runs) / len(runs))
