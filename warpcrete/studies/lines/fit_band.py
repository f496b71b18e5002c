"""Uncertainty band of a slip layer that was fitted to pressures along a trial line.

The band takes into account what was known of the layer before the measurement, and it contains the readings of the
gauges unless their errors explain the difference.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...geometry.pipe_line import PipeLine
from ...theory.pipe import Concrete
from .line_fit import Contradiction, LineFit, Stretch
from .losses import GRAVITY
from .tap_model import TapModel, metre_model

SCALED = "not determined by these points; multiplied by the same factor as the viscosity, to fit what was known before"
"""Text on a yield stress of the slip layer that the measured pressures do not determine. It says that the yield stress
was multiplied by the same factor as the viscosity, when the fit was combined with earlier knowledge of the layer."""
LAYER_FACTORS, UNCERTAINTIES, BISECTIONS = (1e-6, 1e6), (1e-9, 1e6), 60
"""Settings of searches by bisection: range of the factor on a fitted slip layer, range of the uncertainty of the layer,
and number of bisection steps."""
LAYER_STEP = 1.001
"""Factor by which a slip layer is made stiffer and weaker to find how its resistance changes the friction."""


def with_known(fit: LineFit, line: PipeLine, concrete: Concrete, prior: tuple[Concrete, Concrete]) -> LineFit:
    """Return a fit that combines the fitted slip layer with what was known of the layer before the measurement.

    `concrete` has the slip layer that was expected before, and `prior` holds the concretes at the lower and the upper
    end of the uncertainty band of this expected layer. The fit and the earlier knowledge each give a friction of
    straight pipe at the mean flow, with a band. The logarithm of the result's friction is the mean of the two
    logarithms, weighted by the inverse squares of the widths of the bands. The fitted constants of the layer are
    multiplied by one factor that gives this friction. If the fit lies outside the earlier band, this band is first
    widened to contain the fit. Earlier knowledge therefore counts less if the gauges contradict it more.
    """
    pipe = metre_model(line, concrete, fit.taps)
    own = np.array([fit.constants[0].value, fit.constants[1].value, 1.0])

    def friction(constants: np.ndarray) -> float:
        return float(pipe.pressures(constants)[0])

    def constants_of(each: Concrete) -> np.ndarray:
        return np.array([each.slip_viscosity, each.slip_yield, 1.0])

    before = friction(constants_of(concrete))
    low, high = (friction(constants_of(end)) for end in prior)
    ratio = friction(own) / before
    wide_before = 0.5 * math.log(high / low)
    wide_before = max(wide_before, abs(math.log(friction(own) / before)))
    wide = math.log1p(fit.friction_uncertainty)
    share = wide**2 / (wide**2 + wide_before**2) if wide_before > 0 else 0.0
    wanted = friction(own) * (before / friction(own)) ** share
    factor = _bisected(LAYER_FACTORS, lambda x: friction(own * [x, x, 1.0]) < wanted)
    narrower = math.sqrt(1 - share)
    layer = [replace(each, value=factor * each.value,
                     low=factor * (each.value + narrower * (each.low - each.value)),
                     high=factor * (each.value + narrower * (each.high - each.value)),
                     reason=each.reason if each.fitted or share == 0 or each.value == 0 else SCALED)
             for each in fit.constants[:2]]  # fmt: skip
    fit = replace(fit, constants=(*layer, *fit.constants[2:]), friction_uncertainty=math.expm1(wide * narrower),
                  prior_share=share, surprise=None if low <= ratio * before <= high else ratio,
                  yield_slope=None if fit.yield_slope is None else factor * fit.yield_slope,
                  yield_deviation=factor * fit.yield_deviation)  # fmt: skip
    fit = of_layer(fit, line, concrete)
    return replace(fit, pressures=tuple(_at_taps(fit, line, concrete)(1.0).tolist()))


def of_layer(fit: LineFit, line: PipeLine, concrete: Concrete) -> LineFit:
    """Return a fit whose uncertainty of the slip layer follows from the uncertainty of the friction.

    The friction of straight pipe grows with the layer's resistance to the power e, the elasticity. If the layer is
    stiff, the concrete is sheared as well, and e is below 1. The same uncertainty of the friction then means a larger
    uncertainty of the layer: 1 + u of the friction becomes (1 + u)^(1 / e) of the layer.
    """
    pipe = metre_model(line, concrete, fit.taps)
    eta, tau = (each.value for each in fit.constants[:2])
    power = elasticity(lambda *layer: float(pipe.pressures(np.array([*layer, 1.0]))[0]), eta, tau)
    return replace(fit, uncertainty=math.expm1(layer_deviation(math.log1p(fit.friction_uncertainty), power)))


def elasticity(friction: Callable[[float, float], float], viscosity: float, stress: float) -> float:
    """Return the relative change of a friction, divided by the relative change of the slip layer's resistance.

    The arguments of `friction` are the viscosity [Pa s/m] and the yield stress [Pa] of a slip layer. Both change by the
    same factor, from the values `viscosity` and `stress`.
    """
    low, high = (friction(x * viscosity, x * stress) for x in (1 / LAYER_STEP, LAYER_STEP))
    return math.log(high / low) / (2 * math.log(LAYER_STEP))


def layer_deviation(friction: float, power: float) -> float:
    """Return the logarithm of the factor on a slip layer that multiplies a friction by exp(`friction`).

    `power` is the elasticity of the friction. If the friction hardly depends on the layer, it gives the layer no useful
    limit, and the factor is the largest of `UNCERTAINTIES`.
    """
    if friction <= 0:
        return 0.0
    largest = math.log1p(UNCERTAINTIES[1])
    return friction / power if friction < largest * power else largest


def with_gauges(fit: LineFit, line: PipeLine, concrete: Concrete) -> LineFit:
    """Return a fit whose uncertainty band is wide enough for the readings of the gauges.

    If the mean readings of all gauges lie inside the band, or outside it by at most the error limit of a gauge, the fit
    explains the gauges. The band is then only widened to contain the mean reading of the gauge nearest to the pump.
    Otherwise, no slip layer explains all gauges. The band is then widened to contain the mean readings of all gauges,
    and the result names the two stretches of the line that contradict each other most. With an error limit of 0, all
    deviations count as scatter, so that the gauges never contradict each other.
    """
    model = _at_taps(fit, line, concrete)
    places = np.array([tap.place for tap in fit.taps])
    measured = np.array([tap.pressure for tap in fit.taps])
    gauges = [places == place for place in np.unique(places)]

    def outside(uncertainty: float, among: list[np.ndarray]) -> float:
        low, high = model(1 / (1 + uncertainty)), model(1 + uncertainty)
        return max(max(float(np.mean((low - measured)[own])), float(np.mean((measured - high)[own]))) for own in among)

    explained = fit.gauge == 0 or outside(fit.uncertainty, gauges) <= fit.gauge
    wanted = gauges[:1] if explained else gauges
    uncertainty = fit.uncertainty
    if outside(uncertainty, wanted) > 0:
        uncertainty = _bisected(
            (max(uncertainty, UNCERTAINTIES[0]), UNCERTAINTIES[1]), lambda x: outside(x, wanted) > 0
        )
    wider = uncertainty / fit.uncertainty if fit.uncertainty > 0 else 1.0
    layer = [replace(each, low=max(each.value - wider * (each.value - each.low), 0.0),
                     high=each.value + wider * (each.high - each.value)) for each in fit.constants[:2]]  # fmt: skip
    return replace(fit, constants=(*layer, *fit.constants[2:]), uncertainty=uncertainty,
                   yield_deviation=wider * fit.yield_deviation,
                   contradiction=None if explained else _contradiction(fit, line, concrete))  # fmt: skip


def with_expected(fit: LineFit, line: PipeLine, concrete: Concrete, prior: tuple[Concrete, Concrete] | None) -> LineFit:
    """Return a fit that is compared with the slip layer of `concrete`, and with the band of this layer in `prior`."""
    pipe = metre_model(line, concrete, fit.taps)
    own = fit.concrete(concrete)
    friction, expected = (
        float(pipe.pressures(np.array([each.slip_viscosity, each.slip_yield, 1.0]))[0]) for each in (own, concrete)
    )
    outside = []
    for name, each in zip(("slip_viscosity", "slip_yield"), fit.constants[:2], strict=True):
        if prior is not None and each.fitted:
            low, high = (getattr(end, name) for end in prior)
            outside += [] if low <= each.value <= high else [f"{each.name} ({low:.4g} to {high:.4g} {each.unit})"]
    return replace(fit, expected=friction / expected, outside=tuple(outside))


def _bisected(ends: tuple[float, float], is_below: Callable[[float], bool]) -> float:
    """Return the value between the positive `ends` at which `is_below` changes from true to false.

    The value is found by bisection of logarithms. The result lies above it by a tiny fraction, so that `is_below` is
    false for the result.
    """
    low, high = ends
    for _ in range(BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return high


def _at_taps(fit: LineFit, line: PipeLine, concrete: Concrete) -> Callable[[float], np.ndarray]:
    """Return a function that gives the pressures at the taps, which are the places of gauges [Pa].

    The argument of the function is a factor by which both constants of the fitted slip layer are multiplied.
    """
    factor = fit.bend_factor
    model = TapModel(line, concrete, fit.taps, bends=factor is not None)
    eta, tau = (each.value for each in fit.constants[:2])
    return lambda x: model.pressures(np.array([x * eta, x * tau, factor or 1.0]))


def _contradiction(fit: LineFit, line: PipeLine, concrete: Concrete) -> Contradiction | None:
    """Return the two stretches of a trial line at one flow whose measured frictions disagree most.

    The measured friction of each stretch is compared with the friction by the fit. Returns None if no flow was measured
    at two places.
    """
    weights = concrete.density * GRAVITY * np.array(TapModel(line, concrete, fit.taps).rises)
    by_flow: dict[float, dict[float, tuple[float, float]]] = {}
    for tap, fitted, weight in zip(fit.taps, fit.pressures, weights.tolist(), strict=True):
        by_flow.setdefault(tap.flow, {}).setdefault(tap.place, (tap.pressure - weight, fitted - weight))
    found = []
    for readings in by_flow.values():
        places = sorted(readings)
        stretches = []
        for begin, end in zip(places, [*places[1:], None], strict=True):
            length = (line.length if end is None else end) - begin
            behind = (0.0, 0.0) if end is None else readings[end]
            measured, own = ((a - b) / length for a, b in zip(readings[begin], behind, strict=True))
            stretches.append(Stretch(begin, end, measured, own))
        stretches.sort(key=lambda x: x.measured / x.fitted)
        if len(stretches) > 1:
            found.append(Contradiction(stretches[0], stretches[-1]))
    return max(found, key=lambda x: x.high.measured / x.high.fitted - x.low.measured / x.low.fitted, default=None)
