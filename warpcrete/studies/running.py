"""How the cases of a study run: together on a GPU, in processes on a CPU."""

from __future__ import annotations

import importlib
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from ..core.device import default_threads
from ..core.errors import WarpcreteError
from ..core.files import read_json
from ..core.folders import Hold
from ..core.interrupts import StopAtSample
from ..core.origin import check_files
from ..core.run_loop import Run
from ..core.text_files import saved_text
from ..methods import Simulation, method_of
from ..record.recorders import recorders_of
from .cases import Case
from .workers import Crew, NoWorker

FAILED = "failed.txt"
"""Says in a case's folder what it failed with for good."""
Progress = Callable[[str, float, dict[str, Any]], None]
Book = Callable[[Case, Any], None]
"""Told what came of a case: a run, its result.json, or an exception."""


def simulation_of(
    record: dict[str, Any], module: Any, folder: Path, case: Case, tell: Progress
) -> tuple[Simulation, Path | None]:
    """Simulation of a case, into its run folder, and the checkpoint that it goes on from, if there is one."""
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
        recorders=recorders_of(here, module.check, command, going_on=here.is_dir()),
        frame_interval=1.0 / command["frames"] if command["frames"] else None,
        progress=tell,
        checkpoint_path=checkpoint if every else None,
        checkpoint_every=every,
    )
    simulation.shares_cores = True
    return simulation, checkpoint if checkpoint.is_file() else None


def simulations_of(
    record: dict[str, Any], module: Any, folder: Path, cases: list[Case], told: Callable[[Case], Progress]
) -> tuple[dict[str, tuple[Simulation, Path | None]], dict[str, Any]]:
    """What :func:`simulation_of` makes of each case, and what those failed with that it refuses."""
    made, refused = {}, {}
    for case in cases:
        try:
            made[case.name] = simulation_of(record, module, folder, case, told(case))
        except Exception as error:  # of this case alone
            refused[case.name] = error
    return made, refused


def run_on_gpu(
    record: dict[str, Any], module: Any, folder: Path, pending: list[Case], book: Book, tell: Progress
) -> None:
    """All cases as the method runs many."""
    done = dict.fromkeys((c.name for c in pending), 0.0)

    def told(case: Case) -> Progress:
        def hear(phase: str, fraction: float, figures: dict[str, Any]) -> None:
            if phase == "running":
                done[case.name] = fraction
                tell("running", sum(done.values()) / len(done), {})

        return hear

    made, found = simulations_of(record, module, folder, pending, told)
    simulations = [simulation for simulation, _ in made.values()]
    with StopAtSample(simulations) as stop:

        def packing(phase: str, fraction: float) -> None:
            if phase == "packing":
                if stop.asked:
                    raise KeyboardInterrupt
                tell(phase, fraction, {})

        found |= _outcomes(made, packing)
    for case in pending:
        book(case, found[case.name])


def _outcomes(
    made: dict[str, tuple[Simulation, Path | None]], tell: Callable[[str, float], None]
) -> dict[str, Run | BaseException]:
    """Run simulations as their method runs many."""
    if not made:
        return {}
    simulations, checkpoints = zip(*made.values())
    return dict(zip(made, method_of(simulations[0].scene).run_many(simulations, checkpoints, tell)))


def run_in_processes(
    record: dict[str, Any], module: Any, folder: Path, pending: list[Case], processes: int | None, book: Book
) -> None:
    """One case a process at a time, so that after a Ctrl-C nothing begins that has not begun."""
    workers = min(processes or default_threads(), len(pending))
    left = list(pending)
    running: dict[Any, Case] = {}
    with ThreadPoolExecutor(workers) as pool, Crew() as crew:
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
                    book(case, outcome)
            except KeyboardInterrupt:
                crew.stop()  # those that run end at their next sample


def run_case(record: dict[str, Any], module_name: str, folder: str, case: Case, asked: Callable[[], bool]) -> Any:
    """Run one case in a worker process; return its result.json, or what it failed with."""
    return run_cases(record, importlib.import_module(module_name), Path(folder), [case], asked)[0]


def run_cases(
    record: dict[str, Any], module: Any, folder: Path, cases: list[Case], asked: Callable[[], bool]
) -> list[Any]:
    """Run cases as the method runs many, on a CPU with one thread or as many as `record` says, until `asked` to stop.

    Returns for each its result.json, what it failed with, or None if it had not begun.
    """
    simulations: list[Simulation] = []
    hear = heard(asked, simulations)
    if not cases or asked():
        return [None] * len(cases)
    made, found = simulations_of(record, module, folder, cases, lambda case: hear)
    simulations += [simulation for simulation, _ in made.values()]
    outcomes = _outcomes(made, lambda phase, fraction: hear(phase, fraction, {}))
    found |= {name: _plain(outcome) for name, outcome in outcomes.items()}
    return [found[case.name] for case in cases]


def heard(asked: Callable[[], bool], simulations: Sequence[Simulation]) -> Progress:
    """Progress callback that ends a run at its next sample, and what comes before it at once, when `asked` says so."""

    def hear(phase: str, fraction: float, figures: dict[str, Any]) -> None:
        if asked():
            if phase not in ("running", "compiling"):
                raise KeyboardInterrupt
            for simulation in simulations:
                simulation.stop_requested = True

    return hear


def _plain(outcome: Any) -> Any:
    """What of an outcome goes from a process to another."""
    if isinstance(outcome, Run):
        return outcome.result
    return outcome if isinstance(outcome, Exception) else None


def outcome_of(folder: Path) -> Any:
    """What came of a case before: its result.json, its error, or None."""
    if (folder / FAILED).is_file():
        return WarpcreteError(saved_text(folder / FAILED).strip())
    if (folder / "result.json").is_file() and not (folder / "checkpoint.npz").is_file():
        result = read_json(folder / "result.json")
        if result.get("finished") and "checks" in result:
            return result
    return None


def kept(folder: Path) -> Any:
    """The same; a case that was cut before its first checkpoint is cleared away."""
    found = outcome_of(folder)
    if found is None and folder.exists() and not (folder / "checkpoint.npz").is_file():
        hold = Hold(folder)
        try:
            shutil.rmtree(folder)
        finally:
            hold.release()
    return found
