"""V-funnel test: time in which concrete flows out of a funnel (EN 12350-9)."""

import math

from ..core.run.method import Quantity
from ..theory.vessels import funnel_time
from .standard_test import ClosedForm, Outcome, Outflow, Sizes, Specimen, StandardTest

LIGHT = 0.5
"""Fraction of the outlet, seen from above, that concrete covers when the test ends. Below this fraction, the V-funnel
counts as empty, because light can be seen through the outlet."""


def _measure(concrete: Specimen, size: Sizes) -> dict[str, float]:
    return {"screen": concrete.screen(size["outlet_width"], size["breadth"]), "inside": concrete.inside}


def _height(size: Sizes) -> float:
    return size["outlet_height"] + size["cone_height"]


def _time_of_ducts(k: Outcome) -> float | None:
    """Return the theoretical time in which the funnel empties [s]; None if the yield stress holds the concrete back."""
    size, concrete = k.size, k.concrete
    halves = (size["outlet_width"] / 2, size["top_width"] / 2)
    time = funnel_time(halves, (size["outlet_height"], _height(size)), size["breadth"], concrete.viscosity,
                       concrete.yield_stress, concrete.density, k.gravity, flow_index=concrete.flow_index,
                       quadratic_viscosity=concrete.quadratic_viscosity)  # fmt: skip
    return time if math.isfinite(time) else None


FUNNEL = StandardTest(
    name="funnel",
    dimensions=("top_width", "outlet_width", "breadth", "cone_height", "outlet_height"),
    columns={"screen": "1", "inside": "1"},
    measure=_measure,
    quantities=(
        Quantity("funnel_time", "s", lambda k: k.when("screen", LIGHT, True), "funnel time", None, True,
                 meaning="Time from the opening of the gate until light is seen through the outlet",
                 only_if="light is seen through the outlet before the run ends"),
        Quantity("remaining", "1", lambda k: k.last("inside"), "remaining",
                 lambda run: f"{100 * run.result['remaining']:.1f} %",
                 meaning="Fraction of the concrete that is in the funnel at the end"),
    ),
    forms=(ClosedForm("funnel_time", "theory", "row of ducts", _time_of_ducts),),
    outflow=Outflow("screen", LIGHT, "funnel_time", "light is seen", _height),
    curves={"inside": "remaining"},
)  # fmt: skip
