"""Range of the yield stress of a slip layer that was fitted to a trial line, and its effect at other flows.

Pressures at one flow determine the friction at this flow only. A layer with a larger yield stress and a smaller
viscosity has the same friction there, but less friction at a larger flow and more at a smaller one. Pressures at two
flows determine the yield stress with an error, which has the same effect.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...geometry.pipe_line import PipeLine
from ...theory.pipe import Concrete
from .fit_band import elasticity, layer_deviation
from .line_fit import LineFit
from .losses import GRAVITY
from .tap_model import TapModel

SHIPPED_YIELDS = (0.0, 251.0)
"""Range of the yield stress of a slip layer [Pa] if no mix states one. The upper end is the largest value of the
concretes of this package, that of no1."""
THINNEST = 100.0
"""Smallest viscosity of a slip layer [Pa s/m] with which a larger yield stress is combined. Measured layers have 100 to
10000 Pa s/m."""
THICKEST = 1e6
"""Largest viscosity of a slip layer [Pa s/m] with which a smaller yield stress is combined. With it, concrete
practically sticks to the wall."""
OTHER_FLOWS = (0.5, 2.0)
"""Ratios of other flows to the measured flow. The uncertainty of a layer for later use holds between these flows."""
BISECTIONS = 60
"""Number of bisection steps in the search for a viscosity of the slip layer."""


def known_yields(concrete: Concrete, yields: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return the range of the yield stress of a slip layer before a measurement [Pa].

    `yields` is the range that the mix states [Pa], by default that of the concretes of this package. The upper end is
    at most the yield stress of the concrete, because the layer is concrete without stones.
    """
    low, high = SHIPPED_YIELDS if yields is None else yields
    high = min(high, concrete.yield_stress)
    return min(low, high), high


def with_yields(fit: LineFit, line: PipeLine, concrete: Concrete, yields: tuple[float, float] | None = None) -> LineFit:
    """Return a fit with two further slip layers, which the measured pressures do not distinguish from the fitted one.

    The layers have the smallest and the largest possible yield stress, and the same mean friction behind the gauges as
    the fitted layer. The range of the yield stress is its error band if the pressures determine it, and otherwise the
    range from before the measurement, of :func:`known_yields`. The viscosity of the layers is at least `THINNEST`.

    The uncertainty of the layer for later use contains the friction of these layers at the flows `OTHER_FLOWS`.
    """
    eta, tau = (each.value for each in fit.constants[:2])
    friction = _friction_behind_gauges(fit, line, concrete)
    wanted = friction(eta, tau)
    own = fit.constants[1]
    low, high = (own.low, own.high) if fit.knows_yield else known_yields(concrete, yields)
    low, high = min(low, tau), max(min(high, concrete.yield_stress), tau)
    thinnest = min(eta, THINNEST)
    if friction(thinnest, high) > wanted:
        high = _root((tau, high), lambda stress: friction(thinnest, stress) < wanted)

    def layer(stress: float) -> tuple[float, float]:
        return _root((0.1 * thinnest, THICKEST), lambda x: friction(x, stress) < wanted), stress

    fit = replace(fit, yield_layers=(layer(low), layer(high)))
    alone = math.log1p(fit.uncertainty)
    wide = alone
    for ratio in OTHER_FLOWS:
        there = _friction_behind_gauges(fit, line, concrete, ratio)
        off = max(abs(math.log(there(*end) / there(eta, tau))) for end in fit.yield_layers)
        # The later uncertainty is one of the layer, so express the deviation of the friction as one of the layer.
        wide = max(wide, math.hypot(alone, layer_deviation(off, elasticity(there, eta, tau))))
    return replace(fit, later_uncertainty=math.expm1(wide))


def _friction_behind_gauges(
    fit: LineFit, line: PipeLine, concrete: Concrete, ratio: float = 1.0
) -> Callable[[float, float], float]:
    """Return a function that gives the mean friction from the places of the gauges to the end of the line [Pa].

    The arguments of the function are the viscosity [Pa s/m] and the yield stress [Pa] of a slip layer. The flow of each
    reading is multiplied by `ratio`. The whole line counts and not only its first bore, because concrete slips faster
    in a narrow bore than in a wide one.
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
