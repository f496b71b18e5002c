"""List of the simulation methods. The type of a scene selects the method that simulates it."""

from typing import Any

from .core.run.method import Method
from .core.run.run import Run
from .core.run.run_loop import Simulation
from .core.run.simulation_base import refuse_scene
from .dem.method import METHOD as DISCRETE_ELEMENTS
from .mps.free.method import METHOD as FREE_FLOWS
from .mps.method import METHOD as MOVING_PARTICLES
from .mps.part.method import METHOD as PARTS_OF_LINES
from .suspension.method import METHOD as SUSPENSIONS
from .suspension.part.method import METHOD as PARTS_WITH_AGGREGATES
from .suspension.stretch.method import METHOD as STRETCHES

__all__ = ["METHODS", "Run", "Simulation", "method_of"]

METHODS: tuple[Method, ...] = (
    DISCRETE_ELEMENTS,
    MOVING_PARTICLES,
    # `method_of` returns the first method in this list whose scene type fits. The scene types of suspensions are
    # subclasses of the scene types of flows without aggregates, so suspensions must come first.
    SUSPENSIONS,
    FREE_FLOWS,
    PARTS_WITH_AGGREGATES,
    PARTS_OF_LINES,
    STRETCHES,
)


def method_of(scene: Any) -> Method:
    """Return the simulation method for a scene; raise :class:`SceneError` if `scene` is not a scene."""
    for method in METHODS:
        if isinstance(scene, method.scene_type):
            return method
    refuse_scene(scene, [method.scene_type for method in METHODS])
