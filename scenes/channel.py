"""Upward flow of concrete, a yield stress fluid with a slip layer, between two planes in 2D (Xu, Li & Jiang 2021)."""

from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.mps.column import column_scene
from warpcrete.mps.scene import FluidScene
from warpcrete.suspension.stretch.columns import ColumnWithAggregates, check_column, column_trading, suspended_column
from warpcrete.suspension.stretch.scene import StretchScene

PAPER = {"no1": {"pressure": 9.40e3, "slip_velocity": 0.186}}
"""Published results of Xu, Li & Jiang (2021) for a flow of 1500 cm3/s, by name of the concrete.

Each entry contains the pressure [Pa] and the slip velocity at the wall [m/s].
"""
suspension = {"aggregate_fraction": 0.2}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""


@scene_function(ColumnWithAggregates)
def scene(parameters: ColumnWithAggregates) -> FluidScene | StretchScene:
    """Model concrete that a piston drives up a channel, by implicit moving particles (MPS) in two dimensions.

    The defaults are the case of Xu, Li & Jiang (2021): planes 10 cm apart and a column 30 cm high. As in that paper,
    the piston's speed is flow / (pi R^2), where R is half the distance between the planes.

    If `aggregate_fraction` is set but `aggregates` is not, the simulation uses a three-dimensional grid: aggregates
    move as rigid bodies in mortar through a stretch of an endless channel. The driving force keeps the mean velocity
    constant.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated, and if nothing would flow.
    """
    if parameters.suspended:
        return suspended_column("channel", 2, parameters)
    return column_scene("channel", 2, parameters, PAPER)


check = check_column
trading = column_trading(2)
