"""First parameter set of a calibration: the one whose closed-form predictions are closest to the targets."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...core.errors import SceneError
from ...core.run.scene_module import SceneModule
from ...methods import method_of
from .targets import Target, Task

START_CANDIDATES = 32
"""Number of parameter sets for which the closed forms are compared with the targets. The number is small because the
closed form of a funnel takes a quarter of a second."""


def closed_form_start(task: Task, modules: Mapping[str, SceneModule]) -> list[list[float]]:
    """Return a list with the best starting point for a calibration, or an empty list if no target has a closed form.

    The coordinates of the point are the free parameters, each scaled to 0 to 1 over its range. The closed forms of all
    targets are computed at `START_CANDIDATES` points, and the point with the smallest sum of squared deviations from
    the targets is chosen.
    """
    from scipy.stats import qmc

    points = qmc.Sobol(len(task.free), seed=0).random_base2(int(math.log2(START_CANDIDATES)))
    predictions_at = [_closed_forms(task, task.fitted, point, modules) for point in points]
    known = [target for target in task.fitted if any(target in predictions for predictions in predictions_at)]
    misfits = [_misfit(known, predictions) for predictions in predictions_at] if known else []
    if not np.isfinite(min(misfits, default=np.inf)):
        return []
    return [points[int(np.argmin(misfits))].tolist()]


def closed_forms(task: Task, point: object, modules: Mapping[str, SceneModule]) -> dict[Target, float]:
    """Return the closed-form predictions at a point, by target; targets without a closed form are left out.

    The coordinates of the point are the free parameters, each scaled to 0 to 1 over its range.
    """
    return _closed_forms(task, task.targets, point, modules)


def _misfit(known: Sequence[Target], predictions: Mapping[Target, float]) -> float:
    """Return the sum of the squared deviations of closed-form predictions from the targets, in standard deviations.

    `known` holds the targets that have a closed form. The result is infinite if one of them has no prediction.
    """
    return sum(((predictions.get(target, math.inf) - target.value) / target.uncertainty) ** 2 for target in known)


def _closed_forms(
    task: Task, targets: Sequence[Target], point: object, modules: Mapping[str, SceneModule]
) -> dict[Target, float]:
    """Return the closed-form predictions of some `targets` at a `point` in the ranges of the free parameters.

    Targets that have no closed form, or whose parameters are impossible at this point, are left out. One evaluation of
    a scene's closed form gives all its quantities, so it is computed only once for all targets of the same scene.
    """
    expected: dict[str, Mapping[str, float]] = {}
    values: dict[Target, float] = {}
    for target in targets:
        if target.key not in expected:
            expected[target.key] = _expected(task, target, point, modules)
        if target.quantity in expected[target.key]:
            values[target] = expected[target.key][target.quantity]
    return values


def _expected(task: Task, target: Target, point: object, modules: Mapping[str, SceneModule]) -> Mapping[str, float]:
    """Return the closed-form predictions of all quantities of a target's scene at a `point` in the parameter ranges.

    The mapping is empty if the parameters at this point are impossible.
    """
    module = modules[target.scene]
    try:
        scene = module.scene(**task.parameters(target, task.values(point), module))
    except SceneError:
        return {}
    return method_of(scene).expected(scene)
