"""Slump test and slump flow test: a cone whose mould is lifted (EN 12350-2, EN 12350-8), by discrete elements."""

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
from warpcrete.geometry.prisms import truncated_cone
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed, Wall
from warpcrete.standards import SLUMP, StandardTest


@dataclass(frozen=True, kw_only=True)
class SlumpElements(VesselParameters):
    """Dimensions of the mould; defaults follow EN 12350-2."""

    top_diameter: Annotated[float, "Top diameter of the mould [m]", Above()] = 0.1
    base_diameter: Annotated[float, "Base diameter of the mould [m]", Above()] = 0.2
    mould_height: Annotated[float, "Height of the mould [m]", Above()] = 0.3
    lift_time: Annotated[float, "Duration of lifting the mould by its height [s]", Above()] = 3.0


@scene_function(SlumpElements)
def scene(parameters: SlumpElements) -> Scene:
    """Model the slump test, in which the mould of a cone of grains is lifted from a plate: slump, spread, T500.

    The mould is a thin shell of 48 facets that rises at constant speed. The plate is an infinite plane.
    `mould_grip` and `plate_grip` scale the resistance of mould and plate to sliding. The grains are packed into the
    full height of the mould and then settle in it, so that the concrete is somewhat lower than the mould when lifting
    starts (`fill_height`). The slump is measured from that height.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    return lifted_cone(parameters, SLUMP, (), "the mould")


def lifted_cone(given: SlumpElements, test: StandardTest, around: tuple[Wall, ...], what: str) -> Scene:
    """Build the scene of a `test` in which a mould is lifted from a plate; `around` contains further walls, if any.

    `what` is a text for a remark to the user; it names the surfaces on which the concrete may slide freely.
    """
    cone = truncated_cone(given.base_diameter / 2, given.top_diameter / 2, given.mould_height)
    narrowest = min(given.top_diameter, given.base_diameter, given.mould_height)
    if given.size_max > narrowest / 4:
        problem = "is too large: at least four grains must fit side by side in the mould"
        refuse("size_max", given.size_max, problem, f"use {at_most(narrowest / 4)} m or less")
    lift = Prescribed(velocity=(0.0, 0.0, given.mould_height / given.lift_time))
    return Scene(
        name=f"{test.name}-dem",
        fill=given.fill(cone),
        walls=(
            PlaneWall(name="plate", point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), material="plate"),
            MeshWall(name="mould", vertices=cone.vertices, faces=cone.sides, material="mould", motion=lift),
            *around,
        ),
        vessel=given.vessel(test, given.lift_time),
        remarks=vessel_remarks(given, what),
        **given.settings(),
    )


check = check_vessel


def _knobs(given: SlumpElements) -> Iterator[Knob]:
    return vessel_knobs(given, min(given.top_diameter, given.mould_height))


trading = Trading(_knobs, quantities=("slump", "spread"))
