"""Upward flow of concrete, a yield stress fluid with a slip layer, in a round pipe (3D case of Xu, Li & Jiang 2021)."""

from dataclasses import dataclass
from typing import Annotated

from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.mps.column import column_scene
from warpcrete.mps.scene import FluidScene
from warpcrete.suspension.stretch.columns import ColumnWithAggregates, check_column, column_trading, suspended_column
from warpcrete.suspension.stretch.scene import StretchScene

suspension = {"aggregate_fraction": 0.2, "spacing": 0.005}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""


@dataclass(frozen=True, kw_only=True)
class TubeParameters(ColumnWithAggregates):
    """Parameters of a concrete column in a round pipe."""

    spacing: Annotated[
        float, "Particle spacing or cell width [m], adjusted so that a whole number fits into the radius"
    ] = 10e-3


@scene_function(TubeParameters)
def scene(parameters: TubeParameters) -> FluidScene | StretchScene:
    """Model concrete that a piston drives up a round pipe, by implicit moving particles (MPS) in three dimensions.

    If `aggregate_fraction` is set but `aggregates` is not, the simulation uses a three-dimensional grid: aggregates
    move as rigid bodies in mortar through a stretch of an endless pipe. The driving force keeps the flow rate constant.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated, and if nothing would flow.
    """
    if parameters.suspended:
        return suspended_column("tube", 3, parameters)
    return column_scene("tube", 3, parameters)


check = check_column
trading = column_trading(3)
