"""J-ring test: spread of concrete through a ring of bars (EN 12350-12), by discrete elements."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from warpcrete.core.errors import refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.dem.pumping.vessel_checks import check_vessel, vessel_knobs
from warpcrete.dem.scene.scene import Scene
from warpcrete.geometry.prisms import truncated_cone
from warpcrete.geometry.walls import MeshWall
from warpcrete.standards import J_RING

from .slump_dem import SlumpElements, lifted_cone

SIDES = 12
"""Number of flat sides that approximate the round surface of a bar of the J-ring."""


@dataclass(frozen=True, kw_only=True)
class RingElements(SlumpElements):
    """Dimensions of the J-ring, a ring of bars; defaults follow EN 12350-12."""

    bars: Annotated[int, "Number of bars of the ring; 16 leave gaps of 41 mm, 12 of 59 mm", Within(3)] = 16
    bar_diameter: Annotated[float, "Diameter of the bars [m]", Above()] = 0.018
    ring_diameter: Annotated[float, "Diameter of the circle through the axes of the bars [m]", Above()] = 0.3
    ring_height: Annotated[float, "Height of the bars [m]", Above()] = 0.125

    @property
    def gap(self) -> float:
        """Free distance between neighbouring bars of the J-ring [m]."""
        return self.ring_diameter * math.sin(math.pi / self.bars) - self.bar_diameter


@scene_function(RingElements)
def scene(parameters: RingElements) -> Scene:
    """Model a cone of grains on a plate whose mould is lifted inside a ring of bars: spread, T500, blocking step.

    The scene equals `slump-dem` with additional bars, which stand on the plate and have no ring on top. Mould and bars
    resist sliding equally (`mould_grip`). The blocking step is the height of the concrete in the middle minus that
    around the ring. To see how strongly the bars hold concrete back, compare the spread with that of `slump-dem` with
    the same seed.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    if given.gap <= 0:
        fit = math.floor(math.pi / math.asin(min(given.bar_diameter / given.ring_diameter, 1.0)) - 1e-9)
        refuse("bars", given.bars, f"must leave gaps between bars of {given.bar_diameter:g} m on a ring of "
               f"{given.ring_diameter:g} m", f"use {fit} or fewer" if fit >= 3 else
               "increase 'ring_diameter', or reduce 'bar_diameter'")  # fmt: skip
    inner = given.ring_diameter - given.bar_diameter
    if inner < max(given.base_diameter, given.top_diameter) + 2 * given.size_max:
        refuse("ring_diameter", given.ring_diameter, "is too small: a grain of the size 'size_max' must fit between "
                                                     "the mould and the bars",
               f"use {max(given.base_diameter, given.top_diameter) + 2 * given.size_max + given.bar_diameter:.3g} m "
               "or more")  # fmt: skip
    return lifted_cone(given, J_RING, (_bars(given),), "mould and bars")


def _bars(given: RingElements) -> MeshWall:
    """Return all bars of the J-ring as one wall, a triangle mesh."""
    bar = truncated_cone(given.bar_diameter / 2, given.bar_diameter / 2, given.ring_height, SIDES)
    angle = 2 * np.pi * np.arange(given.bars) / given.bars
    axes = 0.5 * given.ring_diameter * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    vertices = (axes[:, None] + bar.vertices).reshape(-1, 3)
    faces = (len(bar.vertices) * np.arange(given.bars)[:, None, None] + bar.faces).reshape(-1, 3)
    return MeshWall(name="bars", vertices=vertices, faces=faces, material="mould")


check = check_vessel


def _knobs(given: RingElements) -> Iterator[Knob]:
    return vessel_knobs(given, min(given.top_diameter, given.mould_height, 4 * given.gap))


trading = Trading(_knobs, quantities=("spread", "blocking_step"))
