"""V-funnel test: time in which concrete flows out of a funnel (EN 12350-9), as a three-dimensional flow on a grid."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from warpcrete.core.errors import at_most, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above, OneOf
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.mps.common.mixes import SELF_COMPACTING, ConcreteName
from warpcrete.mps.free.checks import check_flow
from warpcrete.mps.free.knobs import free_knobs, free_variants
from warpcrete.mps.free.scene import FreeConcrete, FreeScene
from warpcrete.standards import FUNNEL
from warpcrete.suspension.scene import AggregateParameters, vessel_scene

VOLUME = 0.04
"""Largest accepted numerical error of the volume below the free surface, as a fraction of the concrete's volume.

In test runs of this scene the errors reached 0.021.
"""
MAX_PART = 0.9
"""Largest accepted diameter of an aggregate, divided by the width of the simulated outlet. Only a quarter of the
V-funnel is simulated, so this width is half the smaller side of the V-funnel's outlet."""
REMARKS = (
    "a quarter of the funnel is simulated, between its planes of symmetry",
    "concrete is removed at the outlet, so the weight of what has flowed out does not pull on the rest",
)


AGGREGATE_REMARKS = (
    "an aggregate is removed when it has left the outlet entirely; until then its whole weight acts",
    "no aggregate crosses a plane of symmetry, so aggregates block the quarter more easily than the whole funnel",
)


suspension = {"aggregate_fraction": 0.2, "spacing": 0.007}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""


@dataclass(frozen=True, kw_only=True)
class FunnelParameters(FreeConcrete, AggregateParameters):
    """Dimensions of the V-funnel; defaults follow EN 12350-9."""

    concrete: ConcreteName = SELF_COMPACTING
    top_width: Annotated[float, "Inner width at the top [m]", Above()] = 0.515
    outlet_width: Annotated[float, "Inner width of the outlet [m]", Above()] = 0.065
    breadth: Annotated[float, "Distance between the parallel sides [m]", Above()] = 0.075
    cone_height: Annotated[float, "Height of the tapered section [m]", Above()] = 0.45
    outlet_height: Annotated[float, "Height of the straight section below the tapered one [m]", Above()] = 0.15
    surfaces: Annotated[str, "Condition on all sides: concrete sticks, or slips on its slip layer",
                        OneOf(("sticks", "slips"))] = "sticks"  # fmt: skip
    spacing: Annotated[float, "Edge length of the cells [m]", Above()] = 7.5e-3


@scene_function(FunnelParameters)
def scene(parameters: FunnelParameters) -> FreeScene:
    """Model a V-funnel full of concrete whose lower end opens at once; measure the time until light shines through.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    narrow, brim, throat = given.outlet_width / 2, given.top_width / 2, given.outlet_height
    whole = throat + given.cone_height
    if given.spacing > min(given.outlet_width, given.breadth) / 4:
        hint = f"use {at_most(min(given.outlet_width, given.breadth) / 4, 2)} m or less"
        refuse("spacing", given.spacing, "is too coarse: at least four cells must fit across the outlet", hint)
    quarter = min(given.outlet_width, given.breadth) / 2
    if given.aggregate_fraction:
        given.check_largest(
            MAX_PART * quarter, f"a quarter of the funnel is simulated, and its outlet is only {quarter:g} m wide"
        )
    # Choose the cell size such that the height of the V-funnel is a whole number of cells. Two more rows of cells lie
    # above the V-funnel.
    rows = max(8, round(whole / given.spacing))
    cell = whole / rows
    width, out = cell * math.ceil(max(brim, narrow) / cell + 1), 10 * cell
    side = ((narrow, -out), (narrow, throat), (brim, whole), (width + out, whole), (width + out, -out))
    return vessel_scene(
        given,
        name="funnel",
        test=FUNNEL,
        concrete=given.make_concrete(given.surfaces == "slips"),
        plate_slips=given.surfaces == "slips",
        walls_slip=given.surfaces == "slips",
        axial=False,
        width=width,
        depth=given.breadth / 2,
        height=cell * (rows + 2),
        spacing=cell,
        outline=((-out, 0.0), (width, 0.0), (width, whole), (-out, whole)),
        blocks=(side,),
        sides={"left": "mirror", "front": "mirror", "bottom": "open"},
        dimensions=FUNNEL.sizes(given),
        remarks=REMARKS + (AGGREGATE_REMARKS if given.aggregate_fraction else ()),
        **given.settings(),
    )


check = check_flow(VOLUME)


def _knobs(given: FunnelParameters) -> Iterator[Knob]:
    # Put at least four cells across the V-funnel's outlet in both directions.
    coarsest = min(given.outlet_width, given.breadth) / 4
    fall = given.cone_height + given.outlet_height
    return free_knobs(given, given.spacing, fall, coarsest, (2.0, 1.6, 1.25, 1.0, 0.7, 0.5), -4.0)


trading = Trading(_knobs, quantities=("funnel_time",), variants=free_variants)
