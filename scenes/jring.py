"""J-ring test: spread of concrete through a ring of bars (EN 12350-12), as a three-dimensional flow on a grid."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from warpcrete.core.errors import at_least, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.geometry.prisms import truncated_cone
from warpcrete.geometry.walls import MeshWall
from warpcrete.mps.free.checks import check_flow
from warpcrete.mps.free.knobs import free_knobs, free_variants
from warpcrete.mps.free.scene import FreeScene
from warpcrete.standards import J_RING
from warpcrete.standards.slump import BESIDE

from .lbox import SEEN
from .slump import SlumpParameters, lifted_mould

SIDES = 12
"""Number of flat sides that approximate the round surface of a bar of the J-ring."""
FEWEST = 3
"""Minimum number of grid cells across the gap between two bars, and over the height of the bars."""
AROUND = 4
"""Minimum width of the plate beyond the annulus in which the height outside the ring is measured, in grid cells."""
VOLUME = 0.05
"""Largest error of the volume below the free surface that a run may have, as a fraction of the concrete's volume.

In test runs of this scene the errors reached 0.006, with cells of 12 mm. Without bars, that is in `slump`, they reached
0.027.
"""


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Dimensions of the J-ring, a ring of bars; defaults follow EN 12350-12."""

    bars: Annotated[
        int, "Number of bars of the ring; the gaps are 41 mm wide with 16 bars, 59 mm with 12", Within(3)
    ] = 16
    bar_diameter: Annotated[float, "Diameter of the bars [m]", Above()] = 0.018
    ring_diameter: Annotated[float, "Diameter of the circle through the axes of the bars [m]", Above()] = 0.3
    ring_height: Annotated[float, "Height of the bars [m]", Above()] = 0.125

    @property
    def gap(self) -> float:
        """Free distance between neighbouring bars of the J-ring [m]."""
        return self.ring_diameter * math.sin(math.pi / self.bars) - self.bar_diameter

    def check_gap(self) -> None:
        """Raise :class:`SceneError` if neighbouring bars leave no gap."""
        if self.gap <= 0:
            fit = math.floor(math.pi / math.asin(min(self.bar_diameter / self.ring_diameter, 1.0)) - 1e-9)
            refuse("bars", self.bars, f"must leave gaps between bars of {self.bar_diameter:g} m on a ring of "
                   f"{self.ring_diameter:g} m", f"use {fit} or fewer" if fit >= 3 else
                   "increase 'ring_diameter', or reduce 'bar_diameter'")  # fmt: skip

    def wall(self, count: int | None = None, low: float = 0.0) -> MeshWall:
        """Return the first `count` bars, by default all of them, as one triangle mesh from the height `low` [m] up.

        The first bar stands on the x axis.
        """
        bar = truncated_cone(self.bar_diameter / 2, self.bar_diameter / 2, self.ring_height - low, SIDES)
        number = np.arange(self.bars if count is None else count)
        angle = 2 * np.pi * number / self.bars
        axes = 0.5 * self.ring_diameter * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
        vertices = (axes[:, None] + bar.vertices + [0.0, 0.0, low]).reshape(-1, 3)
        faces = (len(bar.vertices) * number[:, None, None] + bar.faces).reshape(-1, 3)
        return MeshWall(name="bars", vertices=vertices, faces=faces, material="mould")


suspension = {"aggregate_fraction": 0.2, "spacing": 0.005}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""


@dataclass(frozen=True, kw_only=True)
class RingParameters(Ring, SlumpParameters):
    """Dimensions of the mould, of the plate and of the ring of bars; defaults follow EN 12350-12."""

    spacing: Annotated[
        float, "Edge length of the cells [m]; with bars, at most two thirds of their diameter", Above()
    ] = 0.009


@scene_function(RingParameters)
def scene(parameters: RingParameters) -> FreeScene:
    """Model the J-ring test: a cone of concrete spreads through a ring of bars. Results: spread, T500, blocking step.

    The cone stands on a plate inside the ring, and its mould is lifted. The scene is the slump test (scene `slump`)
    with additional bars, which stand on the plate and have no ring on top. Concrete sticks to the bars. The blocking
    step is the height of the concrete in the middle minus its height around the ring.
    A quarter of the ring is simulated. Bars stand on both planes of symmetry, so that all gaps are whole, and the
    number of bars must be a multiple of four. With aggregates, the results also state which fractions of the aggregates
    and of the mortar have passed the bars.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    given.check_gap()
    if given.bars % 4:
        problem = "must be a multiple of 4, because a quarter of the ring is simulated"
        refuse("bars", given.bars, problem, f"use {4 * max(1, round(given.bars / 4))}")
    narrowest = max(given.base_diameter, given.top_diameter) + given.bar_diameter
    if given.ring_diameter < narrowest:
        problem = "is too small: the mould must fit between the bars"
        refuse("ring_diameter", given.ring_diameter, problem, f"use {at_least(narrowest)} m or more")
    coarsest = _coarsest(given)
    if given.spacing > coarsest:
        refuse("spacing", given.spacing, f"is too coarse to represent bars of {1e3 * given.bar_diameter:g} mm and gaps "
                                         f"of {1e3 * given.gap:.3g} mm between them",
               f"use {coarsest:.3g} m or less")  # fmt: skip
    if given.ring_height < FEWEST * given.spacing:
        hint = f"use {at_least(FEWEST * given.spacing)} m or more, or a smaller 'spacing'"
        refuse("ring_height", given.ring_height, f"must be at least {FEWEST} cells high", hint)
    least = 0.5 * (given.ring_diameter + given.bar_diameter) + BESIDE + AROUND * given.spacing
    if given.plate_radius is not None and given.plate_radius < least:
        problem = "is too small for the ring and the concrete around it"
        refuse("plate_radius", given.plate_radius, problem, f"use {at_least(least)} m or more")
    # The bars begin two cells below the plate, so that no gap remains there.
    return lifted_mould(given, J_RING, (given.wall(given.bars // 4 + 1, -2 * given.spacing),), least)


def _coarsest(given: RingParameters) -> float:
    """Return the largest width of the cells that resolves bars and gaps [m], rounded down to three digits."""
    coarsest = min(given.bar_diameter / SEEN, given.gap / FEWEST)
    digit = 10 ** (math.floor(math.log10(coarsest)) - 2)
    return math.floor(coarsest / digit + 1e-6) * digit * (1 + 1e-9)


check = check_flow(VOLUME)


def _knobs(given: RingParameters) -> Iterator[Knob]:
    coarsest = min(_coarsest(given), given.top_diameter / 8, given.mould_height / 4)
    return free_knobs(given, given.spacing, given.mould_height, coarsest, (1.3, 1.15, 1.0, 0.7, 0.5), -4.0)


trading = Trading(_knobs, quantities=("spread", "blocking_step"), variants=free_variants)
