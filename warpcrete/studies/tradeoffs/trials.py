"""Runs of a trade-off study on a worker, one at a time, so that their wall times are valid."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import WarpcreteError
from ...core.records import Record
from ...core.run.files import read_json
from ...core.run.scene_module import SceneModule
from ...methods import Simulation
from ..cases import Case
from ..cluster import hardware
from ..running import previous_outcome, run_cases, simulation_of, stop_callback

MIN_RUNS_FOR_MEDIAN = 3
"""Minimum number of runs of a setting at which their median wall time is reliable. With this number, a single run that
took longer because it also loaded kernels does not affect the median."""


@dataclass(frozen=True)
class WorkerJob:
    """Runs of one setting that a worker performs one after the other."""

    cases: list[Case]
    """Runs of the setting, one for each seed."""
    load_kernels: bool
    """True if the kernels must be loaded before the first run."""
    time_left: float
    """Time left for the runs [s]. The first run takes place even if no time is left."""


def run_worker_job(
    record: Record, module: SceneModule, folder: Path, trial: WorkerJob, stop_requested: Callable[[], bool]
) -> list[Any]:
    """Run the cases of the job `trial` until its time is used up, a case fails, or `stop_requested` returns True.

    The result is a list with the outcome of each case that was run: the contents of its result.json, the exception that
    ended it, or None if it was stopped. Raises :class:`WarpcreteError` if earlier runs of the study took place on
    another kind of processor.
    """
    here = hardware(record["device"])
    if here != record["hardware"]:
        raise WarpcreteError(
            f"scheduler: has a worker on {here}, but this trade-off study measured wall times on {record['hardware']}; "
            "wall times on different processors cannot be compared; use workers with the same processor"
        )
    found: list[Any] = []
    start_time, load_kernels = time.perf_counter(), trial.load_kernels
    for case in trial.cases:
        elapsed = time.perf_counter() - start_time
        if found and elapsed + elapsed / len(found) > trial.time_left:
            break
        # Use an existing result, because a worker that was lost may have finished this case before.
        outcome = previous_outcome(folder / case.name)
        if outcome is None:
            outcome, load_kernels = _run(record, module, folder, case, load_kernels, stop_requested), False
        found.append(outcome)
        if not isinstance(outcome, dict) or not outcome.get("finished"):
            break
    return found


def warm_up(simulation: Simulation) -> None:
    """Take one step of a simulation, so that its kernels are loaded before the wall time of a run is measured."""
    simulation.prepare()
    simulation.stepper.take(1)
    simulation.release()


def _run(
    record: Record,
    module: SceneModule,
    folder: Path,
    case: Case,
    load_kernels: bool,
    stop_requested: Callable[[], bool],
) -> Any:
    try:
        if load_kernels:
            warm_up(simulation_of(record, module, folder, case, stop_callback(stop_requested, []))[0])
    except KeyboardInterrupt:
        return None
    except Exception as error:
        return error
    (outcome,) = run_cases(record, module, folder, [case], stop_requested)
    if isinstance(outcome, dict) and outcome.get("finished"):
        # Read the results from the file, so that a new and a resumed study work with the same numbers.
        return read_json(folder / case.name / "result.json")
    return outcome
