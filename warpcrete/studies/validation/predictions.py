"""Blind predictions of measured cases, each calculated in the way that the documentation describes for users."""

import math
from collections.abc import Callable, Mapping

from ...core.errors import one_of, refuse
from ...core.inputs.amounts import amount
from ...core.inputs.yaml_files import merged
from ...geometry.pipe_line import PipeLine
from ...mix.mix import Mix, mix_of
from ...mix.rheology import HEAP_CENTRE, HEAP_CENTRE_MEDIAN, READ_SPREAD
from ...theory.bands import Band, combined
from ...theory.inverse import BASE, HEIGHT, TOP, VOLUME
from ...theory.pipe import Concrete, Line, layer_share, steady
from ...theory.vessels import funnel_time, heap_at_rest, long_heap_spread, tall_cone_slump
from ..lines.losses import ASSUMED_DENSITY, line_of
from ..lines.run import run_line
from .cases import Case

LEAST_SLUMP = 0.005
"""Lower limit for the predicted slump [m]: half of the 10 mm to which a measured slump is rounded."""


def mix_of_case(case: Case, section: Mapping[str, object] | None = None) -> Mix:
    """Return the mix of a case, or the mix that `section` describes.

    If the publication states no density, the density is assumed (:data:`.ASSUMED_DENSITY`).
    """
    given = merged(case.mix if section is None else section)
    if "density" not in given and "parts" not in given:
        given["density"] = ASSUMED_DENSITY
    return mix_of(given, case.folder, case.name)


def _number(case: Case, key: str, unit: str) -> float:
    """Return the number under `key` in the section `test` of a validation case, converted to `unit`."""
    return amount(f"case test: {key}", case.test[key], unit)


def _line_of(case: Case) -> PipeLine:
    """Return the pump line of a case."""
    name = str(case.test["line"])
    if not case.lines:
        problem = "is described nowhere, because the file of cases has no section 'lines'"
        refuse("case test: line", name, problem, "add it, as in 'lines: {site: {diameter: 125 mm, parts: [...]}}'")
    one_of("case test: line", name, case.lines)
    return line_of(case.lines[name], case.name, case.folder)


def _banded(mix: Mix, evaluate: Callable[[Concrete], float]) -> Band:
    """Return the quantity that `evaluate` computes from a concrete, with its band due to uncertain properties of a mix.

    `evaluate` is called for the concrete of the mix, and for concretes at the ends of the bands of its properties.
    """
    ends = {cause: (evaluate(low), evaluate(high)) for cause, (low, high) in mix.variants.items()}
    return combined(evaluate(mix.concrete), ends)


def _gradient(concrete: Concrete, diameter: float, flow: float) -> float:
    """Return the friction of straight pipe per metre [Pa/m] for a `diameter` [m] and a `flow` [m3/s]."""
    return steady(concrete, Line(radius=diameter / 2, length=1.0, rise=0.0), flow).pressure


def _pipe(case: Case) -> list[Band]:
    mix, diameter = mix_of_case(case), _number(case, "diameter", "m")
    return [_banded(mix, lambda c, q=q: _gradient(c, diameter, q)) for q in case.flows]


def _ratio(case: Case) -> list[Band]:
    """Predict the friction of one concrete divided by the friction of another, in one pipe at one flow."""
    diameter = _number(case, "diameter", "m")
    mix, other = mix_of_case(case), mix_of_case(case, case.test["reference"])
    found = []
    for q in case.flows:
        over, under = (_banded(each, lambda c, q=q: _gradient(c, diameter, q)) for each in (mix, other))
        ends = {
            "concrete": (over.low / under.value, over.high / under.value),
            "reference": (over.value / under.high, over.value / under.low),
        }
        found.append(combined(over.value / under.value, ends))
    return found


def _line(case: Case) -> list[Band]:
    """Predict the friction of a whole line [Pa]: the pressure at the pump minus the pressure due to weight."""
    mix = mix_of_case(case)
    line = _line_of(case)
    found = []
    for q in case.flows:
        result = run_line(line, mix.concrete, q, simulate=False, variants=mix.variants)
        band, weight = result.band(), sum(loss.weight for loss in result.losses)
        found.append(Band(band.value - weight, max(band.low - weight, 0.0), band.high - weight, band.shares))
    return found


def _fitting(case: Case) -> list[Band]:
    """Predict the friction of a part, divided by the friction of straight pipe of the same length."""
    line = line_of({"diameter": case.test["diameter"], "parts": [case.test["part"]]}, case.name, case.folder)
    found = []
    for q in case.flows:
        (loss,) = run_line(line, mix_of_case(case).concrete, q, simulate=False).losses
        low, high = (loss.at(each) / loss.straight for each in (0, 1))
        found.append(Band(loss.friction / loss.straight, low, high))
    return found


def line_weight(case: Case) -> float:
    """Return the pressure due to the weight of the concrete in the pump line of a validation case [Pa]."""
    line = _line_of(case)
    return mix_of_case(case).concrete.density * Line().gravity * line.rise


def _layer(case: Case) -> list[Band]:
    """Predict the wall stress [Pa] of the slip layer at the slip velocity of the case."""
    speed = _number(case, "speed", "m/s")
    return [_banded(mix_of_case(case), lambda c: float(c.layer_law.stress(speed)))]


def _layer_share(case: Case) -> list[Band]:
    """Predict the slip velocity at the wall of a pipe, divided by the largest velocity in the cross-section."""
    mix, line = mix_of_case(case), Line(radius=_number(case, "diameter", "m") / 2, length=1.0, rise=0.0)
    return [_banded(mix, lambda c, q=q: layer_share(c, line, q)) for q in case.flows]


def _slump(case: Case) -> list[Band]:
    """Predict the slump [m] from the yield stress of the mix, which may itself follow from the spread.

    One theory holds for wide heaps and another one for tall cones. The smaller of the two slumps that they give is the
    slump of a homogeneous heap. In a real heap, aggregate piles up in the centre, which reduces the slump by 30 mm in
    the median and by up to 100 mm (:data:`HEAP_CENTRE`). For the prediction, 30 mm are therefore subtracted from the
    slump of the homogeneous heap, and for the lower end of the band, 100 mm from the lower end of its band. The upper
    end of the band is the upper end for the homogeneous heap.
    """
    mix = mix_of_case(case)

    def slump(concrete: Concrete) -> float:
        tau, rho = concrete.yield_stress, concrete.density
        return min(HEIGHT - heap_at_rest(VOLUME, tau, rho)[1], tall_cone_slump(TOP, BASE, HEIGHT, tau, rho))

    homogeneous = _banded(mix, slump)
    value = max(homogeneous.value - HEAP_CENTRE_MEDIAN, LEAST_SLUMP)
    low = min(value, max(homogeneous.low - HEAP_CENTRE, LEAST_SLUMP))
    return [Band(value, low, max(value, homogeneous.high), homogeneous.shares)]


def _spread(case: Case) -> list[Band]:
    """Predict the spread [m] from the yield stress of the mix.

    The prediction takes the concrete's resistance to stretching into account (:func:`heap_at_rest`). The uncertainty
    band has three causes: the yield stress, the error with which a spread is read, and the error of the theory. The
    error of the theory is estimated as the difference from the spread that a theory without this resistance gives.
    """
    mix = mix_of_case(case)
    own = mix.concrete

    def width(stress: float) -> float:
        return 2 * heap_at_rest(VOLUME, stress, own.density)[0]

    spread = width(own.yield_stress)
    ends = {
        "yield stress": (width(mix["yield stress"].high), width(mix["yield stress"].low)),
        "theory": (spread, long_heap_spread(VOLUME, own.yield_stress, own.density)),
        "reading": (spread - READ_SPREAD, spread + READ_SPREAD),
    }
    return [combined(spread, ends)]


FUNNEL = (0.0325, 0.2575), (0.15, 0.6), 0.075
"""Dimensions of the V-funnel of EN 12350-9 [m]: half widths at the outlet and at the brim, heights of the straight
outlet and of the whole funnel, and distance between the parallel sides."""


def _funnel(case: Case) -> list[Band]:
    """Predict the time in which concrete flows out of the V-funnel [s].

    On the funnel's wet steel, concrete slips less than in a pipe, but does not stick. One time is computed with the
    slip layer of a pipe, and one without slip. The prediction is the geometric mean of the two times, and its band
    contains both.
    """
    mix = mix_of_case(case)

    def time(concrete: Concrete, slips: bool) -> float:
        layer = (concrete.slip_viscosity, concrete.slip_yield, concrete.slip_flow_index,
                 concrete.slip_quadratic_viscosity) if slips else None  # fmt: skip
        law = {"flow_index": concrete.flow_index, "quadratic_viscosity": concrete.quadratic_viscosity}
        return funnel_time(*FUNNEL, concrete.viscosity, concrete.yield_stress, concrete.density, layer=layer, **law)

    slips, sticks = (_banded(mix, lambda c, s=slips: time(c, s)) for slips in (True, False))
    value = math.sqrt(slips.value * sticks.value)
    ends = {
        "walls": (slips.value, sticks.value),
        "concrete": (value * slips.low / slips.value, value * sticks.high / sticks.value),
    }
    return [combined(value, ends)]


PREDICTORS = {
    "pipe": _pipe,
    "ratio": _ratio,
    "line": _line,
    "fitting": _fitting,
    "layer": _layer,
    "profile": _layer_share,
    "slump": _slump,
    "spread": _spread,
    "funnel": _funnel,
}
"""Prediction functions, by the kind of the case. Each function takes a case and returns a list with the predicted
values and their uncertainty bands, one for each measured value of the case."""
