"""Runs of a trade-off study on a worker, one at a time, so that their wall times are valid."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import WarpcreteError
from ...core.run.files import read_json
from ...methods import Simulation
from ..cases import Case
from ..cluster import hardware
from ..running import heard, kept, run_cases, simulation_of

FEW = 3
"""Minimum number of runs at which the median wall time ignores a single run that also loaded kernels."""


@dataclass(frozen=True)
class Trial:
    """Runs of one setting that a worker performs one after the other."""

    cases: list[Case]
    """Cases of the setting, one for each seed."""
    warm: bool
    """Whether to load the kernels before the first run."""
    left: float
    """Time left for the runs [s]; the first run takes place even if there is none."""


def run_trial(record: dict[str, Any], module: Any, folder: Path, trial: Trial, asked: Callable[[], bool]) -> list[Any]:
    """Run the cases until the time is used up, a case fails, or the callback `asked` returns True.

    Returns the outcomes of the cases so far: the contents of result.json, the exception that ended the case, or None if
    it was stopped. Raises :class:`WarpcreteError` if the worker's processor differs from that of earlier runs.
    """
    here = hardware(record["device"])
    if here != record["hardware"]:
        raise WarpcreteError(
            f"scheduler: has a worker on {here}, but this trade measured times on {record['hardware']}, which cannot "
            "be compared; use workers of one kind"
        )
    found: list[Any] = []
    begun, warm = time.perf_counter(), trial.warm
    for case in trial.cases:
        took = time.perf_counter() - begun
        if found and took + took / len(found) > trial.left:
            break
        outcome = kept(folder / case.name)  # a worker that was lost may have finished the case
        if outcome is None:
            outcome, warm = _run(record, module, folder, case, warm, asked), False
        found.append(outcome)
        if not isinstance(outcome, dict) or not outcome.get("finished"):
            break
    return found


def warm_up(simulation: Simulation) -> None:
    """Load the kernels of a setting, so that the next run is not charged for loading them."""
    simulation.prepare()
    simulation.stepper.take(1)
    simulation.release()


def _run(record: dict[str, Any], module: Any, folder: Path, case: Case, warm: bool, asked: Callable[[], bool]) -> Any:
    try:
        if warm:
            warm_up(simulation_of(record, module, folder, case, heard(asked, []))[0])
    except KeyboardInterrupt:
        return None
    except Exception as error:
        return error
    (outcome,) = run_cases(record, module, folder, [case], asked)
    if isinstance(outcome, dict) and outcome.get("finished"):
        # Read the file, so that a resumed study sees exactly the same numbers.
        return read_json(folder / case.name / "result.json")
    return outcome
