"""Stretch of an endless pipe: mortar with aggregates that are simulated one by one, driven by a pressure gradient."""

import math
from dataclasses import dataclass, fields, replace
from typing import Annotated

from warpcrete.core.errors import refuse
from warpcrete.core.inputs.knobs import Trading
from warpcrete.core.inputs.limits import check_velocity
from warpcrete.core.inputs.parameters import Above, OneOf, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.mps.common.mixes import NO_LAYER, ConcreteParameters
from warpcrete.suspension.scene import MAX_FRACTION, AggregateParameters
from warpcrete.suspension.stretch.checks import check_stretch
from warpcrete.suspension.stretch.columns import stretch_knobs
from warpcrete.suspension.stretch.scene import StretchScene, StretchSettings

REMARKS = (
    "the ends of the stretch are connected: what leaves one end enters the other",
    "the pressure gradient does not include the weight of the concrete",
)


@dataclass(frozen=True, kw_only=True)
class StretchParameters(ConcreteParameters, AggregateParameters, StretchSettings):
    """Dimensions of the stretch, and the pressure gradient in it."""

    diameter: Annotated[float, "Inner diameter of the pipe [m]", Above()] = 0.1
    length: Annotated[
        float, "Length of the stretch [m], at least three diameters of the largest aggregate", Above()
    ] = 0.1
    gradient: Annotated[
        float,
        "Pressure gradient that drives the flow, in addition to that of the weight of mortar and aggregates [Pa/m]",
        Above(),
    ] = 2e4
    surfaces: Annotated[str, "Condition on the wall: mortar sticks, or slips on its slip layer",
                        OneOf(("sticks", "slips"))] = "sticks"  # fmt: skip
    spacing: Annotated[
        float, "Edge length of the cells [m], adjusted so that a whole number fits into the radius", Above()
    ] = 4e-3
    aggregate_fraction: Annotated[
        float,
        "Volume fraction of the aggregates, which are rigid bodies in mortar",
        Within(0, MAX_FRACTION),
    ] = 0.2


@scene_function(StretchParameters)
def scene(parameters: StretchParameters) -> StretchScene:
    """Model mortar with aggregates in a stretch of an endless upright pipe whose ends are connected.

    A constant pressure gradient drives the flow. The results are the volume flow, the velocity and the fraction of
    aggregates over the radius, how far aggregates move towards the axis, and, for a mortar without yield stress, the
    viscosity in the core and the apparent slip velocity at the wall.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    if given.slip_thickness:
        problem = "must be 0, because the slip layer in this scene has no thickness"
        refuse("slip_thickness", given.slip_thickness, problem, "reduce 'diameter' by twice the thickness instead")
    concrete = given.make_concrete(given.surfaces == "slips")
    if given.surfaces == "sticks":
        concrete = replace(concrete, **NO_LAYER)
    stretch = given.with_mortar(StretchScene(
        name="stretch",
        concrete=concrete,
        radius=given.diameter / 2,
        length=given.length,
        gradient=given.gradient,
        spacing=given.spacing,
        slips=given.surfaces == "slips",
        remarks=REMARKS,
        **given.aggregates(),
        **{f.name: getattr(given, f.name) for f in fields(StretchSettings)},
    ))  # fmt: skip
    check_velocity("gradient", given.gradient, stretch.mortar_alone.flow / (math.pi * stretch.radius**2))
    return stretch


check = check_stretch


trading = Trading(stretch_knobs, quantities=("flow",))
