"""L-box test: how far concrete levels out when a gate opens (EN 12350-10), by discrete elements."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from warpcrete.core.errors import at_most, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.dem.pumping.vessel_checks import check_vessel, vessel_knobs, vessel_remarks
from warpcrete.dem.pumping.vessels import VesselParameters
from warpcrete.dem.scene.scene import Scene
from warpcrete.geometry.prisms import prism, rectangle
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed, Wall
from warpcrete.standards import L_BOX

ABOVE = 0.2
"""Height by which the front wall of the L-box's column extends above the concrete in the column [m]."""


@dataclass(frozen=True, kw_only=True)
class BoxElements(VesselParameters):
    """Dimensions of the L-box without bars; defaults follow EN 12350-10."""

    column_width: Annotated[float, "Inner width of the column, along the box [m]", Above()] = 0.1
    column_height: Annotated[
        float, "Height of the concrete in the column at the start, before it settles [m]", Above()
    ] = 0.6
    length: Annotated[float, "Inner length of the box, including the column [m]", Above()] = 0.7
    width: Annotated[float, "Inner width of the box [m]", Above()] = 0.2
    opening: Annotated[float, "Height of the gate opening [m]", Above()] = 0.15
    lift_time: Annotated[float, "Duration of lifting the gate [s]", Above()] = 0.5


@scene_function(BoxElements)
def scene(parameters: BoxElements) -> Scene:
    """Model a column of grains that flows into the L-box when the gate between column and box is lifted.

    There are three results. One is the ratio H2/H1, the depth at the box's far end divided by the depth at the gate.
    The others are the times T200 and T400 at which the front is 200 and 400 mm away from the gate.

    The gate lies in front of the column's wall, at a distance of the smallest grain's radius, so that no grain touches
    both. `plate_grip` scales the floor's resistance to sliding, and `mould_grip` scales the resistance of all sides and
    of the gate.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    gate, width, opening, top = given.column_width, given.width, given.opening, given.column_height
    if given.length < gate + 0.1:
        problem = f"must exceed 'column_width' = {gate:g} m by at least 0.1 m"
        refuse("length", given.length, problem, f"use {gate + 0.3:g} m or more")
    if top < opening + 0.05:
        problem = f"must exceed 'opening' = {given.opening:g} m by at least 0.05 m"
        refuse("column_height", top, problem, "use 0.6 m, the height of the standard box, or reduce 'opening'")
    narrowest = min(gate, width, opening)
    if given.size_max > narrowest / 4:
        problem = "is too large: at least four grains must fit side by side in the column and in the opening"
        refuse("size_max", given.size_max, problem, f"use {at_most(narrowest / 4)} m or less")
    inside = prism(((0.0, 0.0), (gate, 0.0), (gate, top), (0.0, top)), width, (gate / 2, top / 2))
    before = 0.5 * given.size_min
    across = (0.0, 2 * width, 0.0)
    front = rectangle((gate, -width, opening), across, (0.0, 0.0, top + ABOVE - opening))
    shut = rectangle((gate + before, -width, -before), across, (0.0, 0.0, opening + 2 * before))
    lift = Prescribed(velocity=(0.0, 0.0, opening / given.lift_time))
    planes: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
        "back": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        "end": ((given.length, 0.0, 0.0), (-1.0, 0.0, 0.0)),
        "left": ((0.0, -width / 2, 0.0), (0.0, 1.0, 0.0)),
        "right": ((0.0, width / 2, 0.0), (0.0, -1.0, 0.0)),
    }
    walls: list[Wall] = [PlaneWall(name="floor", point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), material="plate")]
    walls += [PlaneWall(name=name, point=at, normal=n, material="mould") for name, (at, n) in planes.items()]
    walls += [
        MeshWall(name="front", vertices=front[0], faces=front[1], material="mould"),
        MeshWall(name="gate", vertices=shut[0], faces=shut[1], material="mould", motion=lift),
    ]
    return Scene(
        name="lbox-dem",
        fill=given.fill(inside),
        walls=tuple(walls),
        vessel=given.vessel(L_BOX, given.lift_time),
        remarks=vessel_remarks(given, "the box's sides"),
        **given.settings(),
    )


check = check_vessel


def _knobs(given: BoxElements) -> Iterator[Knob]:
    return vessel_knobs(given, min(given.column_width, given.width, given.opening))


trading = Trading(_knobs, quantities=("passing_ratio",))
