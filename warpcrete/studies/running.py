"""Execution of a study's cases: at the same time on a GPU, in separate processes on a CPU."""

import importlib
import shutil
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from ..core.device.device import default_threads
from ..core.device.interrupts import StopAtSample
from ..core.errors import WarpcreteError
from ..core.inputs.origin import check_files
from ..core.inputs.text_files import saved_text
from ..core.records import Record
from ..core.run.files import read_json
from ..core.run.folders import FolderLock
from ..core.run.progress import Progress
from ..core.run.run import Run
from ..core.run.scene_module import SceneModule
from ..methods import Simulation, method_of
from ..record.recorders import recorders_of
from .cases import Case
from .workers import NoWorker, WorkerPool

CASES_TOGETHER = 128
"""Maximum number of cases that a GPU runs at the same time.

The cases of a larger study run in groups of this size. After each group, its outcomes are stored and its memory is
freed. An interruption therefore loses at most the initial packings of elements in one group.
"""
FAILED = "failed.txt"
"""Name of the file in a case's folder that states why the case failed. A case with this file is not run again."""
OutcomeCallback = Callable[[Case, Any], None]
"""Callback that receives a case and its outcome: a run, the contents of its result.json, or an exception."""


def simulation_of(
    record: Record, module: SceneModule, folder: Path, case: Case, progress: Progress
) -> tuple[Simulation, Path | None]:
    """Return the simulation of a case, and the path of the checkpoint from which it continues, or None without one."""
    here, command = folder / case.name, record["command"]
    every = command["checkpoint_every"]
    checkpoint = here / "checkpoint.npz"
    scene = module.scene(**case.parameters)
    begun = record.get("files", {})
    check_files(folder / "study.json", {path: begun[path] for path in scene.parameters.files if path in begun})
    simulation = Simulation(
        scene,
        device=record["device"],
        precision=record.get("precision"),
        threads=record.get("threads", 1),
        recorders=recorders_of(
            here, module.check, command, going_on=here.is_dir(), pictures=record.get("figure", True)
        ),
        frame_interval=1.0 / command["frames"] if command["frames"] else None,
        progress=progress,
        checkpoint_path=checkpoint if every else None,
        checkpoint_every=every,
    )
    simulation.shares_cores = True
    return simulation, checkpoint if checkpoint.is_file() else None


def simulations_of(
    record: Record, module: SceneModule, folder: Path, cases: list[Case], progress_of: Callable[[Case], Progress]
) -> tuple[dict[str, tuple[Simulation, Path | None]], dict[str, Any]]:
    """Return the simulations and checkpoints of the cases by case name, and the exceptions of cases that are refused.

    `progress_of` returns the progress callback of a case.
    """
    by_name, refused = {}, {}
    for case in cases:
        try:
            by_name[case.name] = simulation_of(record, module, folder, case, progress_of(case))
        except Exception as error:  # Catch everything, so that an invalid case does not stop the other cases.
            refused[case.name] = error
    return by_name, refused


def run_on_gpu(
    record: Record,
    module: SceneModule,
    folder: Path,
    pending: list[Case],
    store_outcome: OutcomeCallback,
    progress: Progress,
) -> None:
    """Run the `pending` cases on a GPU in groups, and call `store_outcome` for each case.

    Discrete elements run in batches, and flows at the same time, each on its own CUDA stream.
    """
    done = dict.fromkeys((c.name for c in pending), 0.0)

    def progress_of(case: Case) -> Progress:
        def report_progress(phase: str, fraction: float, figures: dict[str, float]) -> None:
            if phase == "running":
                done[case.name] = fraction
                progress("running", sum(done.values()) / len(done), {})

        return report_progress

    def store(case: Case, outcome: object) -> None:
        store_outcome(case, outcome)
        # A case that failed or finished counts as complete in the progress, even if its run ended early.
        if isinstance(outcome, Exception) or (isinstance(outcome, Run) and outcome.finished):
            progress_of(case)("running", 1.0, {})

    for first in range(0, len(pending), CASES_TOGETHER):
        group = pending[first : first + CASES_TOGETHER]
        if _run_group(record, module, folder, group, store, progress_of, progress):
            return


def _run_group(
    record: Record,
    module: SceneModule,
    folder: Path,
    group: list[Case],
    store_outcome: OutcomeCallback,
    progress_of: Callable[[Case], Progress],
    progress: Progress,
) -> bool:
    """Run a group of cases at the same time on a GPU, and store their outcomes; return whether Ctrl-C ended them."""
    simulations: list[Simulation] = []
    with StopAtSample(simulations) as stop:
        by_name, outcomes = simulations_of(record, module, folder, group, progress_of)
        simulations += [simulation for simulation, _ in by_name.values()]
        for simulation in simulations:
            # The simulation has not received the request to stop if the user pressed Ctrl-C before it was created.
            simulation.stop_requested |= stop.requested

        def packing(phase: str, fraction: float) -> None:
            if phase == "packing":
                if stop.requested:
                    raise KeyboardInterrupt
                progress(phase, fraction, {})

        outcomes |= _outcomes(by_name, packing)
    for case in group:
        store_outcome(case, outcomes[case.name])
    for simulation in simulations:
        simulation.release()
    return stop.requested or any(isinstance(outcome, KeyboardInterrupt) for outcome in outcomes.values())


def _outcomes(
    by_name: dict[str, tuple[Simulation, Path | None]], progress: Callable[[str, float], None]
) -> dict[str, Run | BaseException]:
    """Run simulations at the same time, and return the outcome of each one by case name.

    All simulations belong to one simulation method, whose function `run_many` runs them.
    """
    if not by_name:
        return {}
    simulations, checkpoints = zip(*by_name.values())
    return dict(zip(by_name, method_of(simulations[0].scene).run_many(simulations, checkpoints, progress)))


def run_in_processes(
    record: Record,
    module: SceneModule,
    folder: Path,
    pending: list[Case],
    processes: int | None,
    store_outcome: OutcomeCallback,
) -> None:
    """Run the `pending` cases in worker processes, one case per process at a time; call `store_outcome` for each case.

    A case is submitted only when a process is free. No further case is therefore waiting, and none starts, after the
    user has pressed Ctrl-C or a process has received SIGTERM.
    """
    workers = min(processes or default_threads(), len(pending))
    left = list(pending)
    running: dict[Any, Case] = {}
    with ThreadPoolExecutor(workers) as pool, WorkerPool() as crew:
        while left or running:
            try:
                while left and len(running) < workers and not crew.stopping:
                    job = (__name__, "run_case"), (record, module.__name__, str(folder), left[0])
                    running[pool.submit(crew.run, *job)] = left.pop(0)
                if not running:
                    break
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    case = running.pop(future)
                    try:
                        outcome = future.result()
                    except NoWorker:
                        raise
                    except Exception as error:
                        outcome = error
                    store_outcome(case, outcome)
            except KeyboardInterrupt:
                crew.stop()  # The running cases end the next time they take measurements.
        if crew.terminated:
            print("interrupted, because a worker process received SIGTERM", file=sys.stderr, flush=True)


def run_case(record: Record, module_name: str, folder: str, case: Case, stop_requested: Callable[[], bool]) -> Any:
    """Run one case in a worker process; return the contents of its result.json, or the exception that ended it."""
    return run_cases(record, importlib.import_module(module_name), Path(folder), [case], stop_requested)[0]


def run_cases(
    record: Record, module: SceneModule, folder: Path, cases: list[Case], stop_requested: Callable[[], bool]
) -> list[Any]:
    """Run cases of a study at the same time, and return their outcomes.

    Each run on a CPU has as many threads as `record` states (default 1). The runs end early when the callback
    `stop_requested` returns True. The result has one element for each case: the contents of its result.json, the
    exception that ended it, or None if it was stopped before it ran.
    """
    simulations: list[Simulation] = []
    report_progress = stop_callback(stop_requested, simulations)
    if not cases or stop_requested():
        return [None] * len(cases)
    by_name, found = simulations_of(record, module, folder, cases, lambda case: report_progress)
    simulations += [simulation for simulation, _ in by_name.values()]
    outcomes = _outcomes(by_name, lambda phase, fraction: report_progress(phase, fraction, {}))
    found |= outcomes
    return [_plain(found[case.name]) for case in cases]


def stop_callback(stop_requested: Callable[[], bool], simulations: Sequence[Simulation]) -> Progress:
    """Return a progress callback that ends the `simulations` when `stop_requested` returns True.

    A simulation that is running ends the next time it takes measurements. If it is still in an earlier phase, such as
    packing, it is interrupted at once by a `KeyboardInterrupt`.
    """

    def report_progress(phase: str, fraction: float, figures: dict[str, float]) -> None:
        if stop_requested():
            if phase not in ("running", "compiling"):
                raise KeyboardInterrupt
            for simulation in simulations:
                simulation.stop_requested = True

    return report_progress


def _plain(outcome: object) -> Any:
    """Return an outcome in a form that can be sent to another process.

    A run is replaced by the contents of its result.json. An exception loses its traceback, because the traceback holds
    the arrays of the failed run: Dask would free their memory in another thread, and CUDA refuses to capture a graph
    while another thread frees memory (error 906). Anything else becomes None.
    """
    if isinstance(outcome, Run):
        return outcome.result
    if not isinstance(outcome, Exception):
        return None
    linked: BaseException | None = outcome
    while linked is not None:  # The causes of the error hold arrays of the run, too.
        linked.__traceback__ = None
        linked = linked.__cause__ or linked.__context__
    return outcome


def outcome_of(folder: Path) -> Any:
    """Return the outcome of a case from its folder: the contents of its result.json, its error, or None."""
    if (folder / FAILED).is_file():
        return WarpcreteError(saved_text(folder / FAILED).strip())
    if (folder / "result.json").is_file() and not (folder / "checkpoint.npz").is_file():
        result = read_json(folder / "result.json")
        if result.get("finished") and "checks" in result:
            return result
    return None


def previous_outcome(folder: Path) -> Any:
    """Return a case's outcome from an earlier call of the study, or None if it has none.

    If the case has neither an outcome nor a checkpoint, its folder is deleted, so that the case can start again.
    """
    outcome = outcome_of(folder)
    if outcome is None and folder.exists() and not (folder / "checkpoint.npz").is_file():
        hold = FolderLock(folder)
        try:
            shutil.rmtree(folder)
        finally:
            hold.release()
    return outcome
