"""V-funnel test: time in which concrete flows out of a funnel (EN 12350-9), by discrete elements."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

from warpcrete.core.errors import at_most, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.dem.pumping.vessel_checks import check_vessel, vessel_knobs, vessel_remarks
from warpcrete.dem.pumping.vessels import VesselParameters
from warpcrete.dem.scene.scene import Scene
from warpcrete.geometry.prisms import prism, rectangle
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed
from warpcrete.standards import FUNNEL

FALL = 0.3
"""Height of the V-funnel's outlet above the floor [m]. If it were smaller, grains on the floor could pile up to the
outlet. If it were larger, falling grains would become so fast that these soft particles pass into one another."""
DOOR_SPEED = 5.0
"""Speed at which the trap door falls away [m/s]. The concrete starts from rest and cannot catch up with the trap
door."""
EDGE = 0.01
"""Distance by which the trap door extends beyond the edge of the V-funnel's outlet on each side [m]."""


@dataclass(frozen=True, kw_only=True)
class FunnelElements(VesselParameters):
    """Dimensions of the V-funnel; defaults follow EN 12350-9."""

    HOLDING: ClassVar[dict[str, float]] = {"mortar": 1.0, "plastic": 1.0}

    top_width: Annotated[float, "Inner width at the top [m]", Above()] = 0.515
    outlet_width: Annotated[float, "Inner width of the outlet [m]", Above()] = 0.065
    breadth: Annotated[float, "Distance between the parallel sides [m]", Above()] = 0.075
    cone_height: Annotated[float, "Height of the tapered section [m]", Above()] = 0.45
    outlet_height: Annotated[float, "Height of the straight section below the tapered one [m]", Above()] = 0.15


@scene_function(FunnelElements)
def scene(parameters: FunnelElements) -> Scene:
    """Model a V-funnel full of grains whose lower end opens at once; measure the time until light shines through.

    Light shines through when the grains in the funnel, seen from above, cover less than half of the outlet. The trap
    door falls away at 5 m/s, and the grains that have left the funnel lie on a floor 0.3 m below.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    narrowest = min(given.outlet_width, given.breadth)
    if given.size_max > narrowest / 2:
        problem = "is too large: at least two grains must fit side by side in the outlet"
        refuse("size_max", given.size_max, problem, f"use {at_most(narrowest / 2)} m or less")
    narrow, brim = given.outlet_width / 2, given.top_width / 2
    throat, whole = given.outlet_height, given.outlet_height + given.cone_height
    inside = prism(
        ((-narrow, 0.0), (narrow, 0.0), (narrow, throat), (brim, whole), (-brim, whole), (-narrow, throat)),
        given.breadth, (0.0, throat),
    )  # fmt: skip
    vertices, faces = rectangle(
        (-narrow - EDGE, -given.breadth / 2 - EDGE, 0.0), (2 * narrow + 2 * EDGE, 0.0, 0.0),
        (0.0, given.breadth + 2 * EDGE, 0.0),
    )  # fmt: skip
    door = MeshWall(
        name="door", vertices=vertices, faces=faces, material="mould",
        motion=Prescribed(velocity=(0.0, 0.0, -DOOR_SPEED)),
    )  # fmt: skip
    return Scene(
        name="funnel-dem",
        fill=given.fill(inside),
        walls=(
            PlaneWall(name="floor", point=(0.0, 0.0, -FALL), normal=(0.0, 0.0, 1.0), material="plate"),
            MeshWall(name="funnel", vertices=inside.vertices, faces=inside.without(0, 3), material="mould"),
            door,
        ),
        vessel=given.vessel(FUNNEL, 0.0),
        remarks=vessel_remarks(given, "the funnel"),
        **given.settings(),
    )


check = check_vessel


def _knobs(given: FunnelElements) -> Iterator[Knob]:
    return vessel_knobs(given, min(given.outlet_width, given.breadth))


trading = Trading(_knobs, quantities=("funnel_time",))
