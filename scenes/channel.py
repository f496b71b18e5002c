"""Upward flow of concrete, a yield stress fluid with a slip layer, between two planes in 2D (Xu, Li & Jiang 2021)."""

from __future__ import annotations

from warpcrete.core.inputs.parameters import scene_function
from warpcrete.mps.column import FlowParameters, check_flow, column_scene, flow_trading
from warpcrete.mps.scene import FluidScene

PAPER = {"no1": {"pressure": 9.40e3, "slip_velocity": 0.186}}
"""Pressure [Pa] and slip velocity [m/s] that the paper prints for a flow of 1500 cm3/s, by concrete."""


@scene_function(FlowParameters)
def scene(parameters: FlowParameters) -> FluidScene:
    """Model concrete that a piston drives up a channel, by implicit moving particles (MPS) in two dimensions.

    The defaults are the paper's case: planes 10 cm apart and a column of 30 cm. As in the paper, the piston moves at
    flow / (pi R^2), where R is half the distance of the planes.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated, and if nothing would flow.
    """
    return column_scene("channel", 2, parameters, PAPER)


check = check_flow
trading = flow_trading(2)
