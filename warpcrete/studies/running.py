"""How the cases of a study run: together on a GPU, in processes on a CPU."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import shutil
import threading
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from ..core.device import default_threads
from ..core.errors import PlausibilityWarning, WarpcreteError
from ..core.files import read_json
from ..core.interrupts import StopAtSample, leave_to_parent
from ..core.run_loop import Run
from ..core.text_files import saved_text
from ..methods import Simulation, method_of
from ..record.recorders import recorders_of
from .cases import Case

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
    simulation = Simulation(
        module.scene(**case.parameters),
        device=record["device"],
        precision=record.get("precision"),
        threads=record.get("threads", 1),
        recorders=recorders_of(here, module.check, command),
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
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    left = list(pending)
    running: dict[Any, Case] = {}
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(stop,)) as pool:
        while left or running:
            try:
                while left and len(running) < workers and not stop.is_set():
                    future = pool.submit(_run_case, record, module.__name__, str(folder), left[0])
                    running[future] = left.pop(0)
                if not running:
                    break
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    case = running.pop(future)
                    try:
                        outcome = future.result()
                    except Exception as broken:  # a process that was killed, or what nobody foresaw
                        outcome = WarpcreteError(f"its process failed: {type(broken).__name__}: {broken}")
                    book(case, outcome)
            except KeyboardInterrupt:
                stop.set()  # those that run end at their next sample
            except BrokenExecutor as broken:
                for case in left:
                    book(case, WarpcreteError(f"not run: {broken}"))
                left.clear()


_stop_event: Any = None


def _begin_worker(stop: Any) -> None:
    """A worker leaves Ctrl-C to its parent, which tells it through `stop`, and ends when its parent is gone."""
    global _stop_event
    _stop_event = stop
    leave_to_parent()
    warnings.simplefilter("ignore", PlausibilityWarning)  # the parent has given them
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the parent's end, whatever it dies of, and end at once: nobody is left to run cases for."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_case(record: dict[str, Any], module_name: str, folder: str, case: Case) -> Any:
    """One case in a process of its own; returns its result.json, or what it failed with."""
    module = importlib.import_module(module_name)
    return run_cases(record, module, Path(folder), [case], lambda: _stop_event is not None and _stop_event.is_set())[0]


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
        shutil.rmtree(folder)
    return found
