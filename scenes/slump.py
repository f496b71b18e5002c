"""Slump test and slump flow test: a cone of concrete whose mould is lifted (EN 12350-2, -8), as a flow on a grid."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above, OneOf, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.geometry.walls import Wall
from warpcrete.mps.common.mixes import CONSTANTS
from warpcrete.mps.free.checks import check_flow
from warpcrete.mps.free.knobs import free_knobs, free_variants
from warpcrete.mps.free.scene import FreeConcrete, FreeScene
from warpcrete.standards import SLUMP, StandardTest
from warpcrete.suspension.scene import AggregateParameters, vessel_scene
from warpcrete.theory.vessels import cone_volume, long_heap_spread

PUBLISHED = {"no1": 0.13, "no2": 0.18, "no3": 0.22}
"""Slumps that Xu, Li & Jiang (2021) measured for their concretes [m]."""
TOP, BASE, HEIGHT = 0.1, 0.2, 0.3
"""Top diameter, base diameter and height of the mould in EN 12350-2 [m]."""
RELEASED = "the friction of the mould is neglected: concrete is released from below as the mould rises"
QUARTER = "a quarter of the cone is simulated, between two planes of symmetry"
QUARTER_OF_AGGREGATES = "a quarter of the cone is simulated, and no aggregate crosses its planes of symmetry"
MAX_PART = 0.7
"""Largest accepted diameter of an aggregate, divided by the radius of the mould's top. A quarter of the cone is
simulated, and at the top this quarter is as wide as that radius."""
SHELL, ABOVE = 3, 3
"""Thickness of the slump cone's mould, and height of the simulated space above the mould, both in grid cells."""
VOLUME = 0.05
"""Largest accepted numerical error of the volume below the free surface, as a fraction of the concrete's volume.

In most test runs the error was at most 0.027; it was largest while the surface moved fastest. If a yield stress of 20
Pa lets the concrete spread into a layer only a few cells thick, the error is 0.07 to 0.14. A run of this kind should
fail the check.
"""


suspension = {"aggregate_fraction": 0.2}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""


@dataclass(frozen=True, kw_only=True)
class SlumpParameters(FreeConcrete, AggregateParameters):
    """Dimensions of the mould and of the plate; defaults follow EN 12350-2."""

    top_diameter: Annotated[float, "Top diameter of the mould [m]", Above()] = TOP
    base_diameter: Annotated[float, "Base diameter of the mould [m]", Above()] = BASE
    mould_height: Annotated[float, "Height of the mould [m]", Above()] = HEIGHT
    lift_time: Annotated[float, "Duration of lifting the mould by its height [s]; 0 removes it at once", Within(0)] = (
        3.0
    )
    plate: Annotated[
        str, "Condition on the plate: concrete sticks, or slips on its slip layer", OneOf(("sticks", "slips"))
    ] = "sticks"
    plate_radius: Annotated[
        float | None, "Radius of the plate [m]; default: large enough for the expected spread", Above()
    ] = None
    spacing: Annotated[float, "Edge length of the cells [m]", Above()] = 7.5e-3


@scene_function(SlumpParameters)
def scene(parameters: SlumpParameters) -> FreeScene:
    """Model the slump test, in which the mould of a cone of concrete is lifted from a plate: slump, spread, T500.

    The mould opens from below as it is lifted, and has no friction; the concrete sticks to the plate by default. The
    concrete is a yield stress fluid, and the flow is symmetric about the axis. With aggregates, a quarter of the cone
    is simulated in three dimensions, between two planes of symmetry.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    return lifted_mould(parameters, SLUMP)


def lifted_mould(
    given: SlumpParameters, test: StandardTest, walls: tuple[Wall, ...] = (), least_room: float = 0.0
) -> FreeScene:
    """Build the scene of a `test` in which a mould is lifted from a plate; `walls` are walls that stand on the plate.

    With walls or aggregates, a quarter of the mould and plate is simulated in three dimensions. The default radius of
    the plate is at least `least_room` [m].
    """
    concrete = given.make_concrete(given.plate == "slips")
    top, base, height = given.top_diameter / 2, given.base_diameter / 2, given.mould_height
    room = given.plate_radius or max(
        least_room, _room(top, base, height, concrete.yield_stress, concrete.density, given.gravity)
    )
    outline = ((0.0, 0.0), (base, 0.0), (top, height), (0.0, height))
    # Fit a whole number of cells into the height of the mould, and also into the radius of its base.
    rows, rings = max(4, round(height / given.spacing)), max(4, round(base / given.spacing))
    thick = SHELL * base / rings
    gate = ((base, 0.0), (base + thick, 0.0), (top + thick, height), (top, height)) if given.lift_time else ()
    standard = (given.top_diameter, given.base_diameter, given.mould_height) == (TOP, BASE, HEIGHT)
    as_printed = given.concrete in PUBLISHED and all(getattr(given, name) is None for name in CONSTANTS)
    width = base / rings * math.ceil(room * rings / base)
    quarter: dict[str, Any] = {}
    remark = (QUARTER,) * bool(walls)
    if given.aggregate_fraction:
        _check_aggregates(given)
        remark = (QUARTER_OF_AGGREGATES,)
    if walls or given.aggregate_fraction:
        quarter = {"depth": width, "round": True, "sides": {"left": "mirror", "front": "mirror"}}
    return vessel_scene(
        given,
        name=test.name,
        test=test,
        concrete=concrete,
        axial=not quarter,
        width=width,
        height=height * (rows + ABOVE) / rows,
        spacing=given.spacing,
        outline=outline,
        walls=walls,
        gate=gate,
        lift_speed=height / given.lift_time if given.lift_time else 0.0,
        plate_slips=given.plate == "slips",
        dimensions=test.sizes(given),
        published={"slump": PUBLISHED[given.concrete]} if test is SLUMP and standard and as_printed else {},
        remarks=(RELEASED,) * bool(gate) + remark,
        **quarter,
        **given.settings(),
    )


def _check_aggregates(given: SlumpParameters) -> None:
    """Raise :class:`SceneError` for aggregates that cannot be simulated in a mould."""
    top = given.top_diameter / 2
    given.check_largest(MAX_PART * top, f"a quarter of the cone is simulated, and its top is only {top:g} m wide")


def _room(top: float, base: float, height: float, yield_stress: float, density: float, gravity: float) -> float:
    """Return the radius of a plate that the concrete will not leave [m].

    It is 1.2 times the radius that theory gives for a heap much wider than high, which is an upper bound for all heaps.
    The result is limited to between 1.5 and 5 times the radius of the mould's base.
    """
    widest = 5 * base
    if yield_stress > 0:
        widest = 0.6 * long_heap_spread(cone_volume(top, base, height), yield_stress, density, gravity)
    return max(min(widest, 5 * base), 1.5 * base)


check = check_flow(VOLUME)


def _knobs(given: SlumpParameters) -> Iterator[Knob]:
    # The coarsest grid has at least four cells over the radius of the mould's top and over the mould's height.
    coarsest = min(given.top_diameter / 8, given.mould_height / 4)
    return free_knobs(given, given.spacing, given.mould_height, coarsest, (1.6, 1.25, 1.0, 0.7, 0.5), -3.0)


trading = Trading(_knobs, quantities=("slump", "spread"), variants=free_variants)
