"""Rounds of a calibration: which parameter sets the next round simulates."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...core.records import Record
from ...core.run.scene_module import SceneModule
from ..cases import is_random
from .calibration import Calibration
from .starts import closed_form_start

MIN_VALUES = 3
"""Minimum number of runs that must yield a target's quantity before a posterior is computed."""


def verification_runs(calibration: Calibration, modules: Mapping[str, SceneModule]) -> int:
    """Return the number of verification runs of the likeliest parameters.

    The number is the setting `repeat`, but at most 1 if no scene depends on a random seed.
    """
    task, repeat = calibration.task, calibration.record["settings"]["repeat"]
    values = task.values([0.5] * len(task.free))
    for target, *_ in task.groups:
        module = modules[target.scene]
        if is_random(module.scene(**task.parameters(target, values, module))):
            return repeat
    return min(repeat, 1)


def next_round(
    calibration: Calibration, left: int, settings: Mapping[str, Any], modules: Mapping[str, Any]
) -> Record | None:
    """Return the next round, or None if the calibration needs no further round.

    `left` is the number of full trials that are still allowed. The round is a dictionary with these entries:

    - `units`: the parameter sets, with each parameter scaled to 0 to 1 over its range,
    - `seeds`: one random seed for each parameter set,
    - `proof`: True if the round verifies the likeliest parameters,
    - `coarse`: the changed parameters of each group of targets; only in a coarse round.
    """
    begun = settings["seed"] + len(calibration.trials)
    if calibration.posterior is not None and (calibration.settled or left <= 0):
        if settings["repeat"] == 0:
            return None
        units = [calibration.posterior.best.tolist()] * verification_runs(calibration, modules)
        return {"units": units, "seeds": list(range(begun, begun + len(units))), "proof": True}
    if left <= 0:
        return None
    batch = settings["batch"]
    coarse: dict[str, Any] = {}
    if calibration.coarsened and not calibration.coarse:
        units = _first_points(calibration, 2 * batch, settings, modules)
        coarse = {"coarse": [calibration.coarsened.get(group[0].key, {}) for group in calibration.task.groups]}
    elif calibration.guide is None:
        count = min(batch, left)
        count = min(max(count, 2 * count - len(calibration.trials)), left)
        units = _first_points(calibration, count, settings, modules)
    else:
        # After a coarse round, the emulator is already trained, so small rounds of full trials suffice.
        count = max(batch // 2, MIN_VALUES + 1) if calibration.coarse else batch
        units = _next_points(calibration, min(count, left), begun)
    return {"units": units, "seeds": list(range(begun, begun + len(units))), "proof": False} | coarse


def _first_points(
    calibration: Calibration, count: int, settings: Mapping[str, object], modules: Mapping[str, SceneModule]
) -> list[list[float]]:
    """Return the parameter sets of the first round, with each parameter scaled to 0 to 1 over its range.

    The first of the `count` sets is an estimate from closed forms, if the scenes have any. The others form a Sobol
    sequence, which fills the parameter ranges evenly.
    """
    from scipy.stats import qmc

    free = len(calibration.task.free)
    sequence = qmc.Sobol(free, seed=settings["seed"])
    skipped = len(calibration.trials)
    known = [] if skipped else closed_form_start(calibration.task, modules)
    many = sequence.random_base2(max(1, math.ceil(math.log2(skipped + count))))
    return (known + many[skipped:].tolist())[:count]


def _next_points(calibration: Calibration, count: int, seed: int) -> list[list[float]]:
    """Return the parameter sets of the next round: a quarter proposed by Optuna, the others taken from the posterior.

    Each parameter is scaled to 0 to 1 over its range. The first set from the posterior is its maximum. Every further
    set is the posterior sample that is farthest from all sets so far; distances are scaled by the posterior's standard
    deviations.
    """
    guide = calibration.guide
    assert guide is not None
    random = np.random.default_rng(seed)
    optuna_points = _optuna_points(calibration, count // 4, seed) if calibration.searched else []
    tried_points = np.array([trial.units for trial in calibration.searched] + optuna_points).reshape(
        -1, guide.best.size
    )
    drawn = random.choice(guide.samples, min(256, len(guide.samples)), replace=False)
    chosen: list[list[float]] = [guide.best.tolist()] if count - len(optuna_points) > 1 else []
    width = np.maximum(guide.samples.std(0), 1e-2)
    while len(chosen) < count - len(optuna_points):
        others = np.concatenate([tried_points, np.array(chosen).reshape(-1, tried_points.shape[1])])
        distance = np.min((((drawn[:, None] - others[None]) / width) ** 2).sum(-1), axis=1)
        chosen.append(drawn[np.argmax(distance)].tolist())
    return optuna_points + chosen


def _optuna_points(calibration: Calibration, count: int, seed: int) -> list[list[float]]:
    """Return `count` parameter sets that the optimiser Optuna proposes, each parameter scaled to 0 to 1 over its range.

    Optuna receives all trials so far, and treats failed trials as infeasible.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    names = [free.name for free in calibration.task.free]
    ranges: Any = {name: optuna.distributions.FloatDistribution(0.0, 1.0) for name in names}
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed, n_startup_trials=0))
    for trial in calibration.searched:
        off = [(trial.values[t] - t.value) / t.uncertainty for t in calibration.task.fitted if t in trial.values]
        sound = len(off) == len(calibration.task.fitted)
        study.add_trial(
            optuna.trial.create_trial(
                params=dict(zip(names, trial.units)),
                distributions=ranges,
                value=float(np.sum(np.square(off))) if sound else 1e6,
                constraints={"failed": float(not sound)},
            )
        )
    trials = [study.ask(ranges) for _ in range(count)]
    return [[trial.params[name] for name in names] for trial in trials]
