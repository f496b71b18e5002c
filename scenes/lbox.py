"""L-box test: how far and how level concrete flows, with or without bars (EN 12350-10), as a 3D flow on a grid."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from warpcrete.core.errors import at_least, at_most, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above, Needs, OneOf, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.geometry.walls import MeshWall
from warpcrete.mps.common.mixes import SELF_COMPACTING, ConcreteName
from warpcrete.mps.free.checks import check_flow
from warpcrete.mps.free.knobs import free_knobs, free_variants
from warpcrete.mps.free.scene import REST_SPEED, FreeConcrete, FreeScene
from warpcrete.standards import L_BOX
from warpcrete.suspension.scene import AggregateParameters, vessel_scene

WITH_BARS = Needs("bars", bool, "is 2 or 3", refused=False)
GAPS = {0: 0.0, 2: 0.059, 3: 0.041}
"""Free distance between neighbouring bars of the L-box [m], by the number of bars (EN 12350-10)."""
THICK = 2.5
"""Thickness of the gate and of the front wall of the L-box's column, in grid cells."""
FEWEST = 3
"""Minimum number of grid cells over the height of the opening below the front wall of the L-box's column."""
SEEN = 1.5
"""Minimum number of grid cells across the diameter of a bar of the L-box; a coarser grid would miss the bar."""
AROUND = 24
"""Number of sides of the prism that represents a round bar of the L-box."""
VOLUME = 0.07
"""Largest accepted numerical error of the volume below the free surface, as a fraction of the concrete's volume.

In test runs of this scene with bars and cells of 8 mm the errors reached 0.064.
"""


suspension = {"aggregate_fraction": 0.2}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""


@dataclass(frozen=True, kw_only=True)
class BoxParameters(FreeConcrete, AggregateParameters):
    """Dimensions of the L-box; defaults follow EN 12350-10."""

    concrete: ConcreteName = SELF_COMPACTING
    column_width: Annotated[float, "Inner width of the column, along the box [m]", Above()] = 0.1
    column_height: Annotated[float, "Height of the concrete in the column at the start [m]", Above()] = 0.6
    length: Annotated[float, "Inner length of the box, including the column [m]", Above()] = 0.7
    width: Annotated[float, "Inner width of the box [m]", Above()] = 0.2
    opening: Annotated[float, "Height of the gate opening [m]", Above()] = 0.15
    bars: Annotated[int, "Number of bars behind the gate: 0, 2 or 3", OneOf((0, 2, 3))] = 0
    bar_diameter: Annotated[float, "Diameter of the bars [m]", Above(), WITH_BARS] = 0.012
    lift_time: Annotated[float, "Duration of lifting the gate [s]; 0 removes it at once", Within(0)] = 0.5
    surfaces: Annotated[str, "Condition on all walls and bars: concrete sticks, or slips on its slip layer",
                        OneOf(("sticks", "slips"))] = "sticks"  # fmt: skip
    spacing: Annotated[
        float, "Edge length of the cells [m]; with bars, at most two thirds of their diameter", Above()
    ] = 0.0125
    # The concrete is at rest when 90 % of it is slower than this speed. The scene `lbox-dem` has the same threshold for
    # the speed of the fastest grain. Even at rest, the surface moves slightly because the arrangement of the particles
    # changes, so a lower threshold might never be reached.
    rest_speed: Annotated[float, REST_SPEED, Above()] = 1e-3


@scene_function(BoxParameters)
def scene(parameters: BoxParameters) -> FreeScene:
    """Model a column of concrete that flows into the L-box when the gate between column and box is lifted.

    The results are the ratio H2/H1 (depth at the box's far end divided by depth at the gate), and the times T200 and
    T400 at which the front is 200 and 400 mm away from the gate. Raises :class:`warpcrete.SceneError` for parameters
    that cannot be simulated.
    """
    given = parameters
    if given.length < given.column_width + 0.1:
        problem = f"must exceed 'column_width' = {given.column_width:g} m by at least 0.1 m"
        refuse("length", given.length, problem, f"use {given.column_width + 0.3:g} m or more")
    if given.column_height < given.opening + 0.05:
        problem = f"must exceed 'opening' = {given.opening:g} m by at least 0.05 m"
        hint = "use 0.6 m, the height of the standard box, or reduce 'opening'"
        refuse("column_height", given.column_height, problem, hint)
    if given.bars and given.spacing > given.bar_diameter / SEEN:
        hint = f"use {at_most(given.bar_diameter / SEEN, 2)} m or less, or 'bars' = 0 for no bars"
        refuse("spacing", given.spacing, f"is too coarse to represent bars of {1e3 * given.bar_diameter:g} mm", hint)
    if given.opening < FEWEST * given.spacing:
        hint = f"use {at_least(FEWEST * given.spacing, 2)} m or more, or a smaller 'spacing'"
        refuse("opening", given.opening, f"must be at least {FEWEST} cells high", hint)
    smallest = min(given.column_width, given.width / 2)
    if given.spacing > smallest / 4:
        problem = "is too coarse: at least four cells must fit across the column and across half the box"
        refuse("spacing", given.spacing, problem, f"use {at_most(smallest / 4)} m or less")
    outermost = (given.bars - 1) / 2 * (GAPS[given.bars] + given.bar_diameter) + given.bar_diameter / 2
    if given.bars and outermost > given.width / 2:
        problem = f"leaves no room for {given.bars} bars"
        refuse("width", given.width, problem, f"use {at_least(2 * outermost)} m or more")
    gate, opening, top = given.column_width, given.opening, given.column_height
    thick = THICK * given.spacing
    high = top + 3 * given.spacing
    front = ((gate, opening), (gate + thick, opening), (gate + thick, 2 * high), (gate, 2 * high))
    shut = ((gate, -thick), (gate + thick, -thick), (gate + thick, opening), (gate, opening))
    return vessel_scene(
        given,
        name="lbox",
        test=L_BOX,
        concrete=given.make_concrete(given.surfaces == "slips"),
        axial=False,
        width=given.length,
        depth=given.width / 2,
        height=high,
        spacing=given.spacing,
        outline=((-thick, 0.0), (gate, 0.0), (gate, top), (-thick, top)),
        blocks=(front,),
        walls=tuple(_bars(given, gate + thick)),
        amid=(gate / 2, given.width / 4, opening),
        sides={"front": "mirror"},
        gate=shut if given.lift_time else (),
        lift_speed=opening / given.lift_time if given.lift_time else 0.0,
        plate_slips=given.surfaces == "slips",
        walls_slip=given.surfaces == "slips",
        dimensions=L_BOX.sizes(given),
        remarks=("half of the box is simulated, between its middle plane and a side",),
        **given.settings(),
    )


def _bars(given: BoxParameters, place: float) -> Iterator[MeshWall]:
    """Yield the upright bars in the simulated half of the L-box.

    Their centres lie one bar diameter behind the coordinate x = `place` [m]. A bar on the plane of symmetry is yielded
    whole.
    """
    # Import trimesh only here, because the import takes half a second, and only bars need it.
    import trimesh

    pitch = GAPS[given.bars] + given.bar_diameter
    first = 0.0 if given.bars % 2 else pitch / 2
    for n in range(math.ceil(given.bars / 2)):
        # The bar begins two cells below the floor, so that no gap remains between bar and floor. It ends at the height
        # of the opening.
        high = given.opening + 2 * given.spacing
        bar = trimesh.creation.cylinder(given.bar_diameter / 2, high, AROUND)
        bar.apply_translation((place + given.bar_diameter, first + n * pitch, given.opening - high / 2))
        yield MeshWall(name=f"bar{n + 1}", vertices=bar.vertices, faces=bar.faces)


check = check_flow(VOLUME)


def _knobs(given: BoxParameters) -> Iterator[Knob]:
    # With coarser cells, the grid would miss the bars of the L-box or hardly resolve the opening.
    coarsest = given.bar_diameter / SEEN if given.bars else given.opening / 8
    return free_knobs(given, given.spacing, given.column_height, coarsest, (1.4, 1.2, 1.0, 0.7, 0.5), -4.0)


trading = Trading(_knobs, quantities=("passing_ratio",), variants=free_variants)
