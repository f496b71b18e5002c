"""L-box test: how far and how level concrete flows when a gate opens (EN 12350-10)."""

from ..core.run.method import Quantity
from ..theory.vessels import box_at_rest
from .standard_test import ClosedForm, Outcome, Sizes, Specimen, StandardTest

FAR_END = 0.05
"""Length of the stretch at the far end of the L-box over which the depth of the concrete is averaged [m]."""
FRONT = "the front moves {} mm beyond the gate before the run ends"


def _measure(concrete: Specimen, size: Sizes) -> dict[str, float]:
    gate, length, width = size["column_width"], size["length"], size["width"]
    return {
        "near_depth": concrete.depth(0.5 * gate, gate, width),
        "far_depth": concrete.depth(length - FAR_END, length, width),
        "front": max(concrete.front() - gate, 0.0),
    }


def _ratio(k: Outcome) -> float | None:
    return k.last("far_depth") / k.last("near_depth") if k.last("near_depth") > 0 else None


def _ratio_of_slow_flow(k: Outcome) -> float:
    concrete, size = k.concrete, k.size
    near, far, _ = box_at_rest(
        k.whole, size["length"], size["width"], concrete.yield_stress, concrete.density, k.gravity
    )
    return far / near


L_BOX = StandardTest(
    name="lbox",
    dimensions=("column_width", "length", "width"),
    columns={"near_depth": "m", "far_depth": "m", "front": "m"},
    measure=_measure,
    quantities=(
        Quantity("passing_ratio", "1", _ratio, "H2/H1", None, True,
                 meaning="Ratio of the depths of the concrete, H2 / H1"),
        Quantity("h1", "m", lambda k: k.last("near_depth"), "H1",
                 meaning="Depth H1 of the concrete at rest behind the gate"),
        Quantity("h2", "m", lambda k: k.last("far_depth"), "H2",
                 meaning="Depth H2 of the concrete at rest at the end of the box"),
        Quantity("t200", "s", lambda k: k.when("front", 0.2), "T200", None, True,
                 meaning="Time until the front is 200 mm away from the gate", only_if=FRONT.format(200)),
        Quantity("t400", "s", lambda k: k.when("front", 0.4), "T400", None, True,
                 meaning="Time until the front is 400 mm away from the gate", only_if=FRONT.format(400)),
    ),
    forms=(ClosedForm("passing_ratio", "theory", "slow flow, no bars", _ratio_of_slow_flow),),
    slow_share=0.9,
    in_space=True,
    curves={"front": "position of the front", "near_depth": "depth at the gate", "far_depth": "depth at the end"},
)  # fmt: skip
