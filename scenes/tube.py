"""Upward flow of concrete, a yield stress fluid with a slip layer, in a round pipe (3D case of Xu, Li & Jiang 2021)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.mps.column import FlowParameters, check_flow, column_scene, flow_trading
from warpcrete.mps.scene import FluidScene


@dataclass(frozen=True, kw_only=True)
class TubeParameters(FlowParameters):
    """Parameters of a concrete column in a round pipe."""

    spacing: Annotated[float, "Spacing of the particles [m], rounded so that it divides the radius"] = 10e-3


@scene_function(TubeParameters)
def scene(parameters: TubeParameters) -> FluidScene:
    """Model concrete that a piston drives up a round pipe, by implicit moving particles (MPS) in three dimensions.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated, and if nothing would flow.
    """
    return column_scene("tube", 3, parameters)


check = check_flow
trading = flow_trading(3)
