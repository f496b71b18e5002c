"""Initial parameters of a calibration: those whose closed-form predictions are closest to the targets."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...core.errors import SceneError
from ...methods import method_of
from .targets import Target, Task

START_CANDIDATES = 32
"""Number of parameter sets for which the closed forms are compared with the targets. The number is small because the
closed form of a funnel takes a quarter of a second."""


def closed_form_start(task: Task, modules: Mapping[str, Any]) -> list[list[float]]:
    """Return a list with the best starting point for a calibration, or an empty list if no target has a closed form.

    The coordinates of the point are the free parameters, each scaled from its range to the range from 0 to 1. Among
    `START_CANDIDATES` points, the best one is the point whose closed-form predictions fit the targets best.
    """
    from scipy.stats import qmc

    points = qmc.Sobol(len(task.free), seed=0).random_base2(int(math.log2(START_CANDIDATES)))
    known = [target for target in task.fitted
             if any(_closed_form(task, target, point, modules) is not None for point in points)]  # fmt: skip
    misfits = [_misfit(task, known, point, modules) for point in points] if known else []
    if not np.isfinite(min(misfits, default=np.inf)):
        return []
    return [points[int(np.argmin(misfits))].tolist()]


def closed_forms(task: Task, point: Any, modules: Mapping[str, Any]) -> dict[Target, float]:
    """Return the closed-form predictions at a point, by target; targets without a closed form are left out.

    The coordinates of the point are the free parameters, each scaled from its range to 0 to 1.
    """
    found = {target: _closed_form(task, target, point, modules) for target in task.targets}
    return {target: value for target, value in found.items() if value is not None}


def _misfit(task: Task, known: list[Target], point: Any, modules: Mapping[str, Any]) -> float:
    values = [_closed_form(task, target, point, modules) for target in known]
    return sum(math.inf if value is None else ((value - target.value) / target.uncertainty) ** 2
               for value, target in zip(values, known))  # fmt: skip


def _closed_form(task: Task, target: Target, point: Any, modules: Mapping[str, Any]) -> float | None:
    """Return the closed-form prediction of a target's quantity at a `point` in the ranges of the free parameters.

    The coordinates of the point are the parameters, each scaled from its range to 0 to 1. The result is None if the
    scene has no closed form for the quantity, or if the parameters are impossible.
    """
    module = modules[target.scene]
    try:
        scene = module.scene(**task.parameters(target, task.values(point), module))
    except SceneError:
        return None
    return method_of(scene).expected(scene).get(target.quantity)
