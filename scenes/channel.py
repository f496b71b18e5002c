"""Concrete as a Bingham fluid with a slip layer, up a channel between two planes (Xu, Li & Jiang 2021; 2D)."""

from __future__ import annotations

from warpcrete.core.parameters import scene_function
from warpcrete.mps.column import FlowParameters, check_flow, column_scene, flow_trading
from warpcrete.mps.scene import FluidScene

PAPER = {"no1": {"pressure": 9.40e3, "slip_velocity": 0.186}}
"""Printed for 1500 cm3/s [Pa, m/s]."""


@scene_function(FlowParameters)
def scene(parameters: FlowParameters) -> FluidScene:
    """Concrete that a piston drives up a channel, by implicit moving particles in two dimensions.

    The paper's case: planes 10 cm apart, a column of 30 cm. The piston moves at flow / (pi R^2), as there.

    Raises :class:`warpcrete.SceneError` for anything that cannot be simulated, and where nothing would flow.
    """
    return column_scene("channel", 2, parameters, PAPER)


check = check_flow
trading = flow_trading(2)
