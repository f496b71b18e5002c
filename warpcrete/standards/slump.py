"""Slump test, slump flow test and J-ring test: a cone of concrete whose mould is lifted (EN 12350-2, -8, -12)."""

from ..core.run.method import Quantity
from ..theory.vessels import heap_at_rest, long_heap_spread, tall_cone_slump
from .standard_test import ClosedForm, Outcome, Sizes, Specimen, StandardTest

T500 = 0.5
"""Spread [m] at which the time T500 is read (EN 12350-8)."""
BESIDE = 0.025
"""Width of the annulus around the J-ring over which the height outside the ring is averaged [m]."""
MOULD = ("top_diameter", "base_diameter", "mould_height")


def _measure(concrete: Specimen, size: Sizes) -> dict[str, float]:
    # The height is averaged over a circle with half the diameter of the mould's top, where a stiff heap stays level.
    return {"top": concrete.top(size["top_diameter"] / 4), "spread": concrete.spread()}


def _measure_ring(concrete: Specimen, size: Sizes) -> dict[str, float]:
    ring = 0.5 * (size["ring_diameter"] + size["bar_diameter"])
    return _measure(concrete, size) | {"outside": concrete.height_around(ring, ring + BESIDE)}


def _slump(k: Outcome) -> float:
    """Return how far the top of the concrete has fallen since the start [m].

    The height of the settled concrete is measured in the same way at the start and at the end. Two effects therefore do
    not count as slump: the roughness of the surface, and the settlement in the mould.
    """
    return (k.size["mould_height"] if k.fill_height is None else k.fill_height) - k.last("top")


def _slump_of_cone(k: Outcome) -> float:
    cone = k.size["top_diameter"] / 2, k.size["base_diameter"] / 2, k.size["mould_height"]
    return tall_cone_slump(*cone, k.concrete.yield_stress, k.concrete.density, k.gravity)


def _spread_of_long_heap(k: Outcome) -> float | None:
    if k.concrete.yield_stress == 0:
        return None
    return long_heap_spread(k.whole, k.concrete.yield_stress, k.concrete.density, k.gravity)


def _heap(k: Outcome) -> tuple[float, float] | None:
    """Return the radius and the central depth [m] at which a wide heap comes to rest, according to theory.

    The theory includes the heap's resistance to stretching. The result is None for concrete without yield stress, or if
    the radius would not exceed the depth, because the theory does not hold then.
    """
    if k.concrete.yield_stress == 0:
        return None
    reach, depth = heap_at_rest(k.whole, k.concrete.yield_stress, k.concrete.density, k.gravity)
    return (reach, depth) if reach > depth else None


def _slump_of_heap(k: Outcome) -> float | None:
    return k.size["mould_height"] - heap[1] if (heap := _heap(k)) else None


def _spread_of_heap(k: Outcome) -> float | None:
    return 2 * heap[0] if (heap := _heap(k)) else None


SLUMP = StandardTest(
    name="slump",
    dimensions=MOULD,
    columns={"top": "m", "spread": "m"},
    measure=_measure,
    quantities=(
        Quantity("slump", "m", _slump, "slump", None, True,
                 meaning="Height by which the concrete sinks when the cone is lifted"),
        Quantity("fill_height", "m", lambda k: k.fill_height, "height at the start",
                 meaning="Height of the settled concrete in the cone before the cone is lifted"),
        Quantity("spread", "m", lambda k: k.last("spread"), "spread", None, True,
                 meaning="Diameter of the heap at the end"),
        Quantity("t500", "s", lambda k: k.when("spread", T500), "T500", None, True,
                 meaning="Time after which the diameter of the heap reaches 500 mm",
                 only_if="the spread grows to 500 mm before the run ends"),
    ),
    forms=(
        ClosedForm("slump", "theory", "theory of a tall cone", _slump_of_cone),
        ClosedForm("slump", "heap", "theory of a heap", _slump_of_heap),
        ClosedForm("spread", "theory", "theory of a long heap", _spread_of_long_heap, is_estimate=False),
        ClosedForm("spread", "heap", "theory of a heap", _spread_of_heap),
    ),
    on_plate=True,
)  # fmt: skip
J_RING = StandardTest(
    name="jring",
    dimensions=(*MOULD, "ring_diameter", "bar_diameter"),
    columns={"top": "m", "spread": "m", "outside": "m"},
    measure=_measure_ring,
    quantities=(
        *SLUMP.quantities,
        Quantity("blocking_step", "m", lambda k: k.last("top") - k.last("outside"), "blocking step", None, True,
                 meaning="Height of the concrete in the middle of the ring minus its height just outside the ring"),
    ),
    on_plate=True,
    ring=lambda size: 0.5 * size["ring_diameter"],
)  # fmt: skip
