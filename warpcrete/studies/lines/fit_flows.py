"""Range of the yield stress of a slip layer within which pressures of a trial line do not determine it.

Pressures at one flow determine the friction at this flow only. A layer with a larger yield stress and a smaller
viscosity has the same friction there, but less friction at a larger flow and more at a smaller one. Pressures at
several flows determine the yield stress with an error, which has the same effect.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.pipe_line import PipeLine
from ...theory.pipe import Concrete, Line, steady
from .fit_band import elasticity
from .line_fit import LineFit
from .tap_model import TapModel, metre_model

SHIPPED_YIELDS = (0.0, 251.0)
"""Range of the yield stress of a slip layer [Pa] if no mix states one. The upper end is the largest value of the
concretes of this package, that of no1."""
THINNEST = 100.0
"""Smallest viscosity of a slip layer [Pa s/m] with which a larger yield stress is combined. Measured layers have 100 to
10000 Pa s/m."""
OTHER_FLOWS = (0.5, 2.0)
"""Ratios of other flows to the measured flow. The uncertainty of a layer for later use holds between these flows."""
BISECTIONS = 20
"""Number of bisection steps in the search for a yield stress of the slip layer. They find it to a millionth."""


@dataclass(frozen=True)
class _Exchange:
    """Slip layers with the same friction of straight pipe at the mean flow of a fit, by their yield stress."""

    fit: LineFit
    line: PipeLine
    concrete: Concrete

    def pipe(self, ratio: float) -> TapModel:
        """Return a model of a metre of straight pipe at `ratio` times the mean flow."""
        return metre_model(self.line, self.concrete, self.fit.taps, ratio)

    def friction(self, viscosity: float, stress: float, ratio: float = 1.0) -> float:
        """Return the friction of a metre of straight pipe [Pa] for a layer, at `ratio` times the mean flow."""
        return float(self.pipe(ratio).pressures(np.array([viscosity, stress, 1.0]))[0])

    @property
    def layer(self) -> tuple[float, float]:
        """Viscosity [Pa s/m] and yield stress [Pa] of the fitted layer."""
        return self.fit.constants[0].value, self.fit.constants[1].value

    @functools.cached_property
    def rate(self) -> float:
        """Slip velocity at the mean flow [m/s], to the power of the layer's flow index.

        The layer's viscosity times this number is its viscous stress.
        """
        own = self.fit.concrete(self.concrete)
        flow = float(np.mean([tap.flow for tap in self.fit.taps]))
        pipe = Line(radius=self.line.parts[0].diameter / 2, length=1.0, rise=0.0)
        stress = steady(own, pipe, flow).wall_stress
        return float(own.layer_law.rate(stress)) ** own.slip_flow_index

    def at(self, stress: float) -> tuple[float, float]:
        """Return viscosity [Pa s/m] and yield stress [Pa] of the layer that has the yield stress `stress`.

        The stress on the wall and the slip velocity at the mean flow are those of the fitted layer.
        """
        eta, tau = self.layer
        return eta + (tau - stress) / self.rate, stress

    def highest(self, limit: float) -> float:
        """Return the largest yield stress of a layer up to `limit` [Pa] whose viscosity is at least `THINNEST`."""
        eta, tau = self.layer
        return min(limit, tau + max(eta - THINNEST, 0.0) * self.rate)

    def deviation(self, layers: Sequence[tuple[float, float]], ratio: float) -> float:
        """Return the largest deviation of the friction with `layers`, at `ratio` times the mean flow.

        It is the logarithm of the ratio to the friction with the fitted layer.
        """
        own = self.friction(*self.layer, ratio)
        return max(abs(math.log(self.friction(*each, ratio) / own)) for each in layers)

    def result(self, layers: tuple[tuple[float, float], tuple[float, float]]) -> LineFit:
        """Return the fit with two further layers, and with the uncertainty of the layer that holds at other flows."""
        alone = math.log1p(self.fit.uncertainty)
        wide = alone
        for ratio in OTHER_FLOWS:
            # Express the deviation of the friction as one of the layer's resistance, which the stored uncertainty is.
            off = self.deviation(layers, ratio) / elasticity(self.pipe(ratio), *self.layer)
            wide = max(wide, math.hypot(alone, off))
        return replace(self.fit, open_yield=layers, later_uncertainty=math.expm1(wide))


def with_open_yield(
    fit: LineFit, line: PipeLine, concrete: Concrete, yields: tuple[float, float] | None = None
) -> LineFit:
    """Return a fit with two further slip layers, which the measured pressures do not distinguish from the fitted one.

    The layers have the smallest and the largest possible yield stress, and the friction of the fitted layer at the mean
    flow of the taps. `yields` is the range of the yield stress that the mix states [Pa]. By default, it is that of the
    concretes of this package, up to the yield stress of the concrete at most, because the layer is concrete without
    stones. The viscosity is at least `THINNEST`. If the layer does not slip, the fit is returned unchanged.
    """
    exchange = _Exchange(fit, line, concrete)
    _, tau = exchange.layer
    if exchange.rate <= 0:
        return fit
    low, high = (SHIPPED_YIELDS[0], min(SHIPPED_YIELDS[1], concrete.yield_stress)) if yields is None else yields
    return exchange.result((exchange.at(min(low, tau)), exchange.at(exchange.highest(max(high, tau)))))


def with_fitted_yield(fit: LineFit, line: PipeLine, concrete: Concrete) -> LineFit:
    """Return a fit with two further slip layers, whose yield stresses differ from the fitted one by its error.

    The layers have the friction of the fitted layer at the mean flow of the taps. Their yield stresses lie as far apart
    as the errors of the fitted constants require at half and at twice this flow (:attr:`.LineFit.other_uncertainties`).
    If the uncertainty of the layer suffices there, the fit is returned unchanged.
    """
    exchange = _Exchange(fit, line, concrete)
    _, tau = exchange.layer
    missing = {}
    for ratio, uncertainty in zip(OTHER_FLOWS, fit.other_uncertainties, strict=True):
        layer = elasticity(exchange.pipe(ratio), *exchange.layer) * math.log1p(fit.uncertainty)
        missing[ratio] = math.sqrt(max(math.log1p(uncertainty) ** 2 - layer**2, 0.0))
    if exchange.rate <= 0 or not any(missing.values()):
        return fit
    largest = exchange.highest(tau + SHIPPED_YIELDS[1]) - tau

    def layers(change: float) -> tuple[tuple[float, float], tuple[float, float]]:
        return exchange.at(max(tau - change, 0.0)), exchange.at(tau + change)

    def is_too_small(change: float) -> bool:
        return any(exchange.deviation(layers(change), ratio) < wide for ratio, wide in missing.items() if wide > 0)

    low, high = 0.0, largest
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_too_small(middle) else (low, middle)
    return exchange.result(layers(high))
