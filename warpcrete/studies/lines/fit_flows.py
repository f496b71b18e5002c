"""Range of the yield stress of a slip layer that was fitted to a trial line, and its effect at other flows.

Pressures at one flow determine the friction at this flow only. A layer with a larger yield stress and a smaller
viscosity has the same friction there, but less friction at a larger flow and more friction at a smaller flow. Pressures
at two flows determine the yield stress, but with an error, which also makes the friction at other flows uncertain.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...geometry.pipe_line import Part, PipeLine
from ...theory.pipe import Concrete
from .fit_band import elasticity, layer_deviation
from .fittings import range_of, uncertain_kinds
from .line_fit import FittedConstant, LineFit
from .losses import GRAVITY, straight_friction
from .tap_model import TapModel, least_squares, metre_model

SHIPPED_YIELDS = (0.0, 251.0)
"""Range of the yield stress of a slip layer [Pa] if no mix states one. The upper end is the largest value among the
concretes of this package, that of the concrete no1."""
THINNEST = 100.0
"""Smallest viscosity of a slip layer [Pa s/m] that is considered possible. A layer with a larger yield stress than the
fitted layer has the same friction only if its viscosity is smaller, so this limit also limits the yield stress.
Measured layers have 100 to 10000 Pa s/m."""
THICKEST = 1e6
"""Largest viscosity of a slip layer [Pa s/m] that is considered possible. A layer with a smaller yield stress than the
fitted layer has the same friction only if its viscosity is larger. With this viscosity, concrete practically sticks to
the wall."""
OTHER_FLOWS = (0.5, 2.0)
"""Range of flows, divided by the measured flows, for which the stated uncertainty of a fitted layer holds when the
layer is used in another line."""
BISECTIONS = 60
"""Number of bisection steps with which the viscosity of a slip layer is found."""


def known_yields(concrete: Concrete, yields: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return the range of the yield stress of a slip layer before a measurement [Pa].

    `yields` is the range that the mix states [Pa], by default the range for the concretes of this package. The upper
    end is at most the yield stress of the concrete, because the layer is concrete without stones.
    """
    low, high = SHIPPED_YIELDS if yields is None else yields
    high = min(high, concrete.yield_stress)
    return min(low, high), high


def with_yields(fit: LineFit, line: PipeLine, concrete: Concrete, yields: tuple[float, float] | None = None) -> LineFit:
    """Add to a fit two slip layers that agree with the measured pressures as well as the fitted layer does.

    The two layers (`yield_layers`) have the smallest and the largest possible yield stress, and the same mean friction
    between the gauges and the end of the line as the fitted layer. If the pressures determine the yield stress, its
    range follows from `yield_deviation`. Otherwise it is the range from before the measurement (:func:`known_yields`).
    The viscosity of the two layers is at least `THINNEST`, unless the fitted viscosity is smaller.

    The function also adds `layer_ends`, the layers at both ends of the band of the friction. Their yield stresses
    follow from the friction, because the fitted friction and the fitted yield stress have correlated errors
    (`yield_slope`).

    If the yield stress was not fitted, the band of the fitted viscosity is widened to contain the viscosities of the
    two layers.
    """
    eta, tau = (each.value for each in fit.constants[:2])
    friction = _friction_behind_gauges(fit, line, concrete)
    wanted = friction(eta, tau)
    own = fit.constants[1]
    low, high = (own.low, own.high) if fit.knows_yield else known_yields(concrete, yields)
    if fit.yield_slope is not None:
        low, high = max(tau - fit.yield_deviation, 0.0), tau + fit.yield_deviation
    low, high = min(low, tau), max(min(high, concrete.yield_stress), tau)
    thinnest = min(eta, THINNEST)
    if friction(thinnest, high) > wanted:
        high = _root((tau, high), lambda stress: friction(thinnest, stress) < wanted)

    def layer(stress: float, pressure: float) -> tuple[float, float]:
        return _root((0.1 * thinnest, THICKEST), lambda x: friction(x, stress) < pressure), stress

    layers, ends = (layer(low, wanted), layer(high, wanted)), []
    for factor in (1 / (1 + fit.uncertainty), 1 + fit.uncertainty):
        pressure, stress = friction(factor * eta, factor * tau), factor * tau
        if fit.yield_slope is not None:
            stress = tau + fit.yield_slope * math.log(pressure / wanted)
            stress = min(max(stress, 0.0), max(concrete.yield_stress, tau))
            if friction(thinnest, stress) > pressure:
                stress = _root((0.0, stress), lambda x, goal=pressure: friction(thinnest, x) < goal)
        ends.append(layer(stress, pressure) if fit.yield_slope is not None else (factor * eta, stress))
    if not own.fitted:
        viscosity = _wider(fit.constants[0], *(each for each, _ in layers))
        fit = replace(fit, constants=(viscosity, *fit.constants[1:]))
    return replace(fit, yield_layers=layers, layer_ends=tuple(ends))


def with_later_use(fit: LineFit, line: PipeLine, concrete: Concrete) -> LineFit:
    """Add to a fit the uncertainty that its slip layer has in another line, which is larger than in the trial line.

    The uncertainty has two causes in addition to those in the trial line:

    - At the flows `OTHER_FLOWS`, the layers of :func:`with_yields` have another friction than the fitted layer.
    - The friction of the trial line's fittings is uncertain, which affects the fitted layer.

    The bands of the layer's constants are widened by the second cause only.
    """
    eta, tau = (each.value for each in fit.constants[:2])
    layers = _layers_by_fittings(fit, line, concrete)
    pipe = metre_model(line, concrete, fit.taps)

    def friction(*layer: float) -> float:
        return float(pipe.pressures(np.array([*layer, 1.0]))[0])

    fitted, power = friction(eta, tau), elasticity(friction, eta, tau)
    offs = [[math.log(friction(*end) / fitted) for end in ends] for ends in layers]
    sides = [math.hypot(*(max(0.0, *(sign * off for off in ends)) for ends in offs)) for sign in (-1, 1)]
    fittings = layer_deviation(max(sides), power)
    own = math.log1p(fit.uncertainty)
    width = sum(math.hypot(own, layer_deviation(side, power)) for side in sides)
    wide = math.hypot(own, fittings)
    for ratio in OTHER_FLOWS:
        there = _friction_behind_gauges(fit, line, concrete, ratio)
        # Convert deviations of the friction to deviations of the layer's resistance.
        power = elasticity(there, eta, tau)
        offs = [
            layer_deviation(max(abs(math.log(there(*end) / there(eta, tau))) for end in pair), power)
            for pair in (fit.layer_ends, fit.yield_layers)
        ]
        wide = max(wide, math.hypot(*offs, fittings))
    layer = list(fit.constants[:2])
    for ends in layers:
        layer = [_wider(each, *(end[place] for end in ends)) for place, each in enumerate(layer)]
    return replace(fit, constants=(*layer, *fit.constants[2:]), width=width,
                   later_uncertainty=math.expm1(wide))  # fmt: skip


def _wider(constant: FittedConstant, *values: float) -> FittedConstant:
    """Widen the band of a fitted constant by the effect of a further, independent cause of error.

    `values` holds the values of the constant at both ends of the band of this cause. The new width is the square root
    of the sum of the squares of the present width and of the width that this cause adds.
    """
    own = constant.value
    below, above = (max(0.0, *(sign * (each - own) for each in values)) for sign in (-1, 1))
    low = max(own - math.hypot(own - constant.low, below), 0.0)
    return replace(constant, low=low, high=own + math.hypot(constant.high - own, above))


def _layers_by_fittings(fit: LineFit, line: PipeLine, concrete: Concrete) -> list[list[tuple[float, float]]]:
    """Return the slip layers that fit the gauges if the friction of the line's fittings differs from the assumed one.

    Each kind of fitting, such as bends, gives two layers, as viscosity [Pa s/m] and yield stress [Pa]: one for the
    lower and one for the upper end of the friction of this kind. If bends have more friction than assumed, the layer
    has less, because the gauges show the sum. Both ends are needed, because the assumed friction of bends is close to
    the lower end of its range. Bends are left out if their factor was fitted, because the errors of the fit already
    contain their effect.
    """
    flow, layers = float(np.mean([tap.flow for tap in fit.taps])), []
    own = np.array([*(each.value for each in fit.constants[:2]), fit.bend_factor or 1.0])
    free = [0, 1] if fit.constants[1].fitted else [0]
    for kind in uncertain_kinds(line.parts):
        if kind == "bend" and fit.bend_factor is not None:
            continue
        ends = []
        for end in (0, 1):
            changed = [
                _at_end(part, end, straight_friction(part, fit.concrete(concrete), flow)) if part.kind == kind else part
                for part in line.parts
            ]
            model = TapModel(replace(line, parts=tuple(changed)), concrete, fit.taps, bends=fit.bend_factor is not None)
            eta, tau, _ = least_squares(model, np.array(fit.pressures), own, free)
            ends.append((float(eta), float(tau)))
        layers.append(ends)
    return layers


def _at_end(part: Part, end: int, straight: float) -> Part:
    """Return a copy of a part whose friction is at the lower (`end` = 0) or upper (`end` = 1) limit of its uncertainty.

    `straight` is the friction of a straight pipe with the length and bores of the part [Pa].
    """
    ends = range_of(part, straight)
    return part if ends is None else replace(part, factor=ends[end])


def _friction_behind_gauges(
    fit: LineFit, line: PipeLine, concrete: Concrete, ratio: float = 1.0
) -> Callable[[float, float], float]:
    """Return a function that gives the friction from a gauge to the end of the line [Pa], averaged over all readings.

    The arguments of the function are the viscosity [Pa s/m] and the yield stress [Pa] of a slip layer. The flow of each
    reading is multiplied by `ratio`. The friction of the whole line behind the gauges is used because the slip
    velocity, and therefore the effect of the yield stress, depends on the bore.
    """
    factor = fit.bend_factor
    taps = [replace(tap, flow=ratio * tap.flow) for tap in fit.taps]
    model = TapModel(line, concrete, taps, bends=factor is not None)
    weight = concrete.density * GRAVITY * float(np.mean(model.rises))
    return lambda eta, tau: float(np.mean(model.pressures(np.array([eta, tau, factor or 1.0])))) - weight


def _root(ends: tuple[float, float], is_below: Callable[[float], bool]) -> float:
    """Return the value between `ends` at which `is_below` changes from true to false, by bisection."""
    low, high = ends
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return 0.5 * (low + high)
