"""J-ring test: spread of concrete through a ring of bars (EN 12350-12), by discrete elements."""

from collections.abc import Iterator
from dataclasses import dataclass

from warpcrete.core.errors import at_least, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.dem.pumping.vessel_checks import check_vessel, vessel_knobs
from warpcrete.dem.scene.scene import Scene
from warpcrete.standards import J_RING

from .jring import Ring
from .slump_dem import SlumpElements, lifted_cone


@dataclass(frozen=True, kw_only=True)
class RingElements(SlumpElements, Ring):
    """Dimensions of the mould and of the ring of bars; defaults follow EN 12350-12."""


@scene_function(RingElements)
def scene(parameters: RingElements) -> Scene:
    """Model the J-ring test: a cone of grains spreads through a ring of bars. Results: spread, T500, blocking step.

    The cone stands on a plate inside the ring, and its mould is lifted. The scene is the slump test (scene
    `slump-dem`) with additional bars, which stand on the plate and have no ring on top. Mould and bars resist sliding
    equally (`mould_grip`). The blocking step is the height of the concrete in the middle minus its height around the
    ring. To see how strongly the bars hold concrete back, compare the spread with the spread in `slump-dem` with the
    same seed.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    given.check_gap()
    least = max(given.base_diameter, given.top_diameter) + 2 * given.size_max + given.bar_diameter
    if given.ring_diameter < least:
        problem = "is too small: a grain of the size 'size_max' must fit between the mould and the bars"
        refuse("ring_diameter", given.ring_diameter, problem, f"use {at_least(least)} m or more")
    return lifted_cone(given, J_RING, (given.wall(),), "mould and bars")


check = check_vessel


def _knobs(given: RingElements) -> Iterator[Knob]:
    return vessel_knobs(given, min(given.top_diameter, given.mould_height, 4 * given.gap))


trading = Trading(_knobs, quantities=("spread", "blocking_step"))
