"""Upward flow of concrete, a yield stress fluid with a slip layer, between two planes in 2D (Xu, Li & Jiang 2021)."""

from __future__ import annotations

from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.mps.column import FlowParameters, check_flow, column_scene, flow_trading
from warpcrete.mps.scene import FluidScene

PAPER = {"no1": {"pressure": 9.40e3, "slip_velocity": 0.186}}
"""Published results of Xu, Li & Jiang (2021) for a flow of 1500 cm3/s, by name of the concrete.

Each entry contains the pressure [Pa] and the slip velocity at the wall [m/s].
"""


@scene_function(FlowParameters)
def scene(parameters: FlowParameters) -> FluidScene:
    """Model concrete that a piston drives up a channel, by implicit moving particles (MPS) in two dimensions.

    The defaults are the case of Xu, Li & Jiang (2021): planes 10 cm apart and a column 30 cm high. As in that paper,
    the piston's speed is flow / (pi R^2), where R is half the distance between the planes.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated, and if nothing would flow.
    """
    return column_scene("channel", 2, parameters, PAPER)


check = check_flow
trading = flow_trading(2)
