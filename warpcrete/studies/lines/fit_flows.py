"""Range of the yield stress of a slip layer that pressures of a trial line do not determine.

Pressures at one flow determine the friction at this flow only. A layer with a larger yield stress and a smaller
viscosity has the same friction there, but less friction at a larger flow and more at a smaller one.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...geometry.pipe_line import PipeLine
from ...theory.pipe import Concrete
from .line_fit import LineFit
from .tap_model import metre_model
from .taps import Tap

SHIPPED_YIELDS = (0.0, 251.0)
"""Range of the yield stress of a slip layer [Pa] if no mix states one. The upper end is the largest value of the
concretes of this package, that of no1."""
THINNEST = 100.0
"""Smallest viscosity of a slip layer [Pa s/m] with which a larger yield stress is combined. Measured layers have 100 to
10000 Pa s/m."""
OTHER_FLOWS = (0.5, 2.0)
"""Ratios of other flows to the measured flow. The uncertainty of a layer for later use holds between these flows."""
BISECTIONS = 60
"""Number of bisection steps in the search for a viscosity of the slip layer."""


def with_open_yield(
    fit: LineFit, line: PipeLine, concrete: Concrete, yields: tuple[float, float] | None = None
) -> LineFit:
    """Return a fit with two further slip layers, which the measured pressures do not distinguish from the fitted one.

    The layers have the smallest and the largest possible yield stress, and the friction of the fitted layer at the mean
    flow of the taps. `yields` is the range of the yield stress that the mix states [Pa], by default that of the
    concretes of this package. The largest yield stress is at most that of the concrete, because the layer is concrete
    without stones, and the viscosity is at least `THINNEST`. A fit that determines the yield stress is returned
    unchanged.
    """
    eta, tau = (each.value for each in fit.constants[:2])
    pipe = metre_model(line, concrete, fit.taps)

    def friction(viscosity: float, stress: float) -> float:
        return float(pipe.pressures(np.array([viscosity, stress, 1.0]))[0])

    wanted = friction(eta, tau)
    low, high = SHIPPED_YIELDS if yields is None else yields
    low, high = min(low, tau), max(min(high, concrete.yield_stress), tau)
    thinnest = min(eta, THINNEST)
    if friction(thinnest, high) > wanted:
        high = _root((tau, high), lambda stress: friction(thinnest, stress) < wanted)

    def layer(stress: float) -> tuple[float, float]:
        return _root((0.1 * thinnest, 1e3 * eta), lambda x: friction(x, stress) < wanted), stress

    fit = replace(fit, open_yield=(layer(low), layer(high)))
    own, wide = fit.concrete(concrete), math.log1p(fit.uncertainty)
    flow = float(np.mean([tap.flow for tap in fit.taps]))
    for ratio in OTHER_FLOWS:
        there = metre_model(line, concrete, [Tap(0.0, 1.0, ratio * flow, 0)])
        middle, *ends = (
            float(there.pressures(np.array([*each, 1.0]))[0])
            for each in ((own.slip_viscosity, own.slip_yield), *fit.open_layers)
        )
        off = max(abs(math.log(end / middle)) for end in ends)
        wide = max(wide, math.hypot(math.log1p(fit.uncertainty), off))
    return replace(fit, later_uncertainty=math.expm1(wide))


def _root(ends: tuple[float, float], is_below: Callable[[float], bool]) -> float:
    """Return the value between `ends` at which `is_below` changes from true to false, by bisection."""
    low, high = ends
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return 0.5 * (low + high)
