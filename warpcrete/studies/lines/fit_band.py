"""Uncertainty band of a slip layer that was fitted to pressures along a trial line.

The band takes into account the slip layer that was expected before the measurement, and it contains the readings of the
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
from .taps import SAME_FLOW, Tap

SCALED = "not determined by these points; multiplied by the same factor as the viscosity, to fit what was known before"
"""Remark on a yield stress of the slip layer that the measured pressures do not determine. It says that the yield
stress was multiplied by the same factor as the viscosity, when the fit was combined with earlier knowledge of the
layer."""
LAYER_FACTORS, UNCERTAINTIES, BISECTIONS = (1e-6, 1e6), (1e-9, 1e6), 60
"""Settings of searches by bisection: the range of the factor by which a slip layer is multiplied, the range of the
layer's uncertainty, and the number of bisection steps."""
LAYER_STEP = 1.001
"""Factor by which a slip layer's resistance is multiplied and divided for a numerical derivative of the friction."""


def with_known(fit: LineFit, line: PipeLine, concrete: Concrete, prior: tuple[Concrete, Concrete]) -> LineFit:
    """Return a fit that combines the fitted slip layer with the layer that was expected before the measurement.

    `concrete` has the expected slip layer, and `prior` holds two concretes, whose layers are at the lower and at the
    upper end of the expected layer's uncertainty band. The fitted and the expected layer each give a friction of
    straight pipe at the mean flow, with a band. Their logarithms are averaged, weighted by the inverse squares of the
    widths of the bands. Both constants of the fitted layer are then multiplied by the same factor, so that they give
    the averaged friction. If the fit lies outside the expected band, this band is first widened until it contains the
    fit. The expected layer therefore has less weight if the gauges contradict it.
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

    The friction of straight pipe is proportional to the layer's resistance to the power e, the elasticity. If the layer
    is stiff, the bulk of the concrete is sheared as well, and e is below 1. An uncertainty of the friction by the
    factor 1 + u then corresponds to a larger uncertainty of the layer's resistance, by the factor (1 + u)^(1 / e).
    """
    pipe = metre_model(line, concrete, fit.taps)
    eta, tau = (each.value for each in fit.constants[:2])
    power = elasticity(lambda *layer: float(pipe.pressures(np.array([*layer, 1.0]))[0]), eta, tau)
    return replace(fit, uncertainty=math.expm1(layer_deviation(math.log1p(fit.friction_uncertainty), power)))


def elasticity(friction: Callable[[float, float], float], viscosity: float, stress: float) -> float:
    """Return the elasticity of a friction: the derivative of its logarithm by the logarithm of the layer's resistance.

    The function `friction` gives the friction for the viscosity [Pa s/m] and the yield stress [Pa] of a slip layer. The
    derivative is taken at the values `viscosity` and `stress`, which are both multiplied by the same factor.
    """
    low, high = (friction(x * viscosity, x * stress) for x in (1 / LAYER_STEP, LAYER_STEP))
    return math.log(high / low) / (2 * math.log(LAYER_STEP))


def layer_deviation(friction: float, power: float) -> float:
    """Convert a deviation of the friction to the deviation of the slip layer's resistance that causes it.

    Both deviations are logarithms of factors. `power` is the elasticity of the friction (:func:`elasticity`). If the
    friction hardly depends on the layer, the result is limited to the upper end of `UNCERTAINTIES`.
    """
    if friction <= 0:
        return 0.0
    largest = math.log1p(UNCERTAINTIES[1])
    return friction / power if friction < largest * power else largest


def with_gauges(fit: LineFit, line: PipeLine, concrete: Concrete) -> LineFit:
    """Return a fit whose uncertainty band is wide enough for the readings of the gauges.

    The fit explains the gauges if the mean reading of each gauge lies inside the band, or outside it by at most the
    error limit of a gauge. In this case, the band is widened only if it does not contain the mean reading of the gauge
    nearest to the pump. Otherwise, the band is widened until it contains the mean readings of all gauges, and the
    result names the two stretches of the line that contradict each other most. If the error limit is 0, all deviations
    count as scatter, so that the gauges never contradict each other.
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
    """Return a fit whose attributes `expected` and `outside` compare it with the layer expected before the measurement.

    `concrete` has the expected slip layer. `prior` holds two concretes, whose layers are at the lower and at the upper
    end of the expected band.
    """
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
    """Return the number between the positive `ends` at which `is_below` changes from true to false.

    The number is found by bisection on a logarithmic scale. It is rounded up slightly, so that `is_below` is false for
    the result.
    """
    low, high = ends
    for _ in range(BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return high


def _at_taps(fit: LineFit, line: PipeLine, concrete: Concrete) -> Callable[[float], np.ndarray]:
    """Return a function that gives the pressures [Pa] at the taps (places of gauges), shape (taps,).

    The argument of the function is a factor by which both constants of the fitted slip layer are multiplied.
    """
    factor = fit.bend_factor
    model = TapModel(line, concrete, fit.taps, bends=factor is not None)
    eta, tau = (each.value for each in fit.constants[:2])
    return lambda x: model.pressures(np.array([x * eta, x * tau, factor or 1.0]))


def _contradiction(fit: LineFit, line: PipeLine, concrete: Concrete) -> Contradiction | None:
    """Return the two stretches of a trial line whose measured frictions contradict each other most.

    For each stretch, the measured friction is divided by the friction of the fit at the same flow. The result is the
    pair of stretches at one flow for which these ratios differ most. Flows that differ by at most the fraction
    `SAME_FLOW` count as one flow. If no flow was measured at two places, the readings at all flows are compared. The
    result is None if there is only one place.
    """
    groups: list[list[Tap]] = []
    for tap in sorted(fit.taps, key=lambda tap: tap.flow):
        if groups and tap.flow <= (1 + SAME_FLOW) * groups[-1][0].flow:
            groups[-1].append(tap)
        else:
            groups.append([tap])
    for among in (groups, [list(fit.taps)]):
        compared = [_contradiction_among(replace(fit, taps=tuple(taps)), line, concrete) for taps in among]
        contradictions = [each for each in compared if each is not None]
        if contradictions:
            return max(contradictions, key=lambda x: x.high.measured / x.high.fitted - x.low.measured / x.low.fitted)
    return None


def _contradiction_among(fit: LineFit, line: PipeLine, concrete: Concrete) -> Contradiction | None:
    """Return the two stretches that contradict each other most, from all readings in `fit.taps`; None for one place.

    The friction of each reading is converted to the mean flow, in proportion to the friction of the fit. The friction
    at each place is the mean of its readings.
    """
    flow = float(np.mean([tap.flow for tap in fit.taps]))
    at_mean = replace(fit, taps=tuple(replace(tap, flow=flow) for tap in fit.taps))
    weights = concrete.density * GRAVITY * np.array(TapModel(line, concrete, fit.taps).rises)
    own, fitted = (_at_taps(each, line, concrete)(1.0) - weights for each in (fit, at_mean))
    measured = (np.array([tap.pressure for tap in fit.taps]) - weights) * np.where(own > 0, fitted / own, 1.0)
    at = np.array([tap.place for tap in fit.taps])
    readings = {x: (float(measured[at == x].mean()), float(fitted[at == x].mean())) for x in np.unique(at).tolist()}
    stretches = []
    for begin, end in zip(readings, [*list(readings)[1:], None], strict=True):
        length = (line.length if end is None else end) - begin
        behind = (0.0, 0.0) if end is None else readings[end]
        stretches.append(Stretch(begin, end, *((a - b) / length for a, b in zip(readings[begin], behind, strict=True))))
    stretches.sort(key=lambda x: x.measured / x.fitted)
    return Contradiction(stretches[0], stretches[-1]) if len(stretches) > 1 else None
