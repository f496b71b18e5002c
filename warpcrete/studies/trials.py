"""Runs of a trade on a worker, one at a time, or their times would mean nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.errors import WarpcreteError
from ..core.files import read_json
from ..methods import Simulation
from .cases import Case
from .cluster import hardware
from .running import heard, kept, run_cases, simulation_of

FEW = 3
"""Runs of which the median leaves out one that was charged for loading kernels."""


@dataclass(frozen=True)
class Trial:
    """Runs of one setting that a worker makes one after the other."""

    cases: list[Case]
    """The setting with different seeds."""
    warm: bool
    """Kernels are to be loaded before the first run."""
    left: float
    """Time that there is for them [s]; without it the first one is made all the same."""


def run_trial(record: dict[str, Any], module: Any, folder: Path, trial: Trial, asked: Callable[[], bool]) -> list[Any]:
    """Run cases until there is no time left for another, one fails or `asked` says stop.

    Returns result.json, what it failed with, or None if it was stopped, of each as far as that came. Raises
    :class:`WarpcreteError` where a worker computes on something else than those of the trade before.
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
        outcome = kept(folder / case.name)  # a lost worker may have come so far
        if outcome is None:
            outcome, warm = _run(record, module, folder, case, warm, asked), False
        found.append(outcome)
        if not isinstance(outcome, dict) or not outcome.get("finished"):
            break
    return found


def warm_up(simulation: Simulation) -> None:
    """Load the kernels of a setting, for which a run after that is not charged."""
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
        return read_json(folder / case.name / "result.json")  # as whoever goes on with the trade reads it
    return outcome
