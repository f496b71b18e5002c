"""Coarse runs of a calibration: simulations with wide cells, which train the emulators at a small part of the cost."""

from collections.abc import Mapping

from ...core.errors import SceneError
from ...core.records import SceneArguments
from ...core.run.scene_module import SceneModule
from ..cases import is_random
from .targets import Target, Task

COARSENING = (2.0, 1.5)
"""Cell width in a coarse run, divided by the cell width in a full run; the first ratio that the scene accepts is used.
With cells twice as wide, runs of the slump test and the V-funnel took 0.16 times as long (measured on two cores)."""
WIDEST = 2.0
"""Largest cell width in a coarse run, divided by the default cell width of the scene. Wider cells hardly tell soft
concretes apart: with 2.7 times the default width, slump tests with spreads of 597, 608 and 671 mm (default cells) gave
576, 573 and 585 mm."""


def coarse_changes(task: Task, modules: Mapping[str, SceneModule]) -> dict[str, SceneArguments]:
    """Return the parameters that are changed in coarse runs, by the key of each group of targets that has coarse runs.

    Only standard tests that are simulated as flows on a grid have coarse runs, because other scenes of a calibration
    take only seconds, or have no cells. A group of targets has no coarse runs in the following cases:

    - The flow contains aggregates, which wider cells would change.
    - The cell width is a free parameter, or the cells are already wide.
    - The scene refuses wider cells.
    """
    by_group = {}
    for target, *_ in task.groups:
        changes = _changes(task, target, modules)
        if changes:
            by_group[target.key] = changes
    return by_group


def _changes(task: Task, target: Target, modules: Mapping[str, SceneModule]) -> SceneArguments:
    """Return the changed parameters of the coarse runs of a target's scene; empty if it has no coarse runs."""
    module = modules[target.scene]
    if any(free.name == "spacing" for free in task.free):
        return {}
    points = [[unit] * len(task.free) for unit in (0.5, 0.0, 1.0)]
    given = [task.parameters(target, task.values(point), module) for point in points]
    scene = module.scene(**given[0])
    spacing = getattr(scene, "spacing", None)
    if spacing is None or getattr(scene, "test", None) is None or is_random(scene):
        return {}
    widest = WIDEST * module.scene(**{k: value for k, value in given[0].items() if k != "spacing"}).spacing
    for ratio in COARSENING:
        changes = {"spacing": ratio * spacing}
        if changes["spacing"] > 1.001 * widest:
            continue
        try:
            for parameters in given:
                module.scene(**{**parameters, **changes})
        except SceneError:
            continue
        return changes
    return {}
