"""Result of a fit of the slip layer and of the friction factor of bends to pressures along a trial line."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ...core.records import Record
from ...core.units import quantity
from ...geometry.pipe_line import Part, PipeLine
from ...mix.measurements import CONTRADICTORY
from ...theory.pipe import Concrete
from .losses import with_layer_factor
from .taps import Tap, is_free

OPEN_YIELD, FITTED_YIELD = "unknown yield stress of the slip layer", "yield stress of the slip layer"
"""Two causes of uncertainty at flows that were not measured, as reports name them. OPEN_YIELD: the measured pressures
do not determine the yield stress. FITTED_YIELD: they determine it, but with an error."""
NO_YIELD = "left out of the fit, because the points would give a negative value"
"""Reason why the yield stress of the slip layer was left out of a fit. It is then zero."""


@dataclass(frozen=True)
class FittedConstant:
    """Constant of the slip layer or the bends that was fitted to a trial line, with its 95 % confidence interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    fitted: bool
    """True if the measured pressures determine the constant. Otherwise `reason` states how it got its value."""
    reason: str = "not determined by these points, so left at its expected value"
    """Reason for the value of the constant if the measured pressures do not determine it."""

    @property
    def text(self) -> str:
        """Name, value and confidence interval of the constant as text, or a remark that it was not determined."""
        unit = f" {self.unit}" if self.unit else ""
        if not self.fitted and not self.unit:
            return f"{self.name}: {self.reason}"
        if not self.fitted:
            return f"{self.name} {self.value:.4g}{unit} ({self.reason})"
        return f"{self.name} {self.value:.4g}{unit} ({self.low:.4g} to {self.high:.4g})"


@dataclass(frozen=True)
class Stretch:
    """Stretch of a trial line between two gauges, or from the last gauge to the line's end, and its friction."""

    begin: float
    """Distance along the line from the pump to the gauge at the start of the stretch [m]."""
    end: float | None
    """Distance along the line from the pump to the gauge at the end of the stretch [m]; None for the end of the
    line."""
    measured: float
    """Friction loss per length in the stretch according to the readings of its gauges [Pa/m]."""
    fitted: float
    """Friction loss per length in the stretch according to the fit [Pa/m]."""


@dataclass(frozen=True)
class Contradiction:
    """The two stretches of a line whose readings contradict each other most, if no slip layer explains all gauges."""

    low: Stretch
    """Stretch with the smallest ratio of measured friction to friction by the fit."""
    high: Stretch
    """Stretch with the largest ratio of measured friction to friction by the fit."""


@dataclass(frozen=True)
class LineFit:
    """Slip layer and factor of bends that were fitted to pressures at the taps (places of gauges) of a pump line.

    The factor of bends is the friction of a bend, divided by the friction of straight pipe of the same length.
    """

    taps: tuple[Tap, ...]
    constants: tuple[FittedConstant, ...]
    """Fitted constants in this order: the viscosity of the slip layer, its yield stress and, if the line has bends, the
    friction of bends divided by the friction of straight pipe."""
    pressures: tuple[float, ...]
    """Pressures at the taps (places of gauges) according to the fit [Pa], in the order of the taps."""
    uncertainty: float
    """Uncertainty u of the slip layer's resistance. The band of the layer extends from 1 / (1 + u) to 1 + u times both
    constants."""
    friction_uncertainty: float
    """Uncertainty u of the friction of straight pipe at the mean flow, from the errors of the gauges and from the slip
    layer expected before the measurement. The band extends from 1 / (1 + u) to 1 + u times the friction."""
    gauge: float
    """Largest error that a reading of a gauge is assumed to have [Pa]."""
    prior_share: float = 0.0
    """Weight, between 0 and 1, of the slip layer that was expected before the measurement. The weight of the
    measurement is 1 minus this number."""
    surprise: float | None = None
    """Fitted friction of straight pipe, divided by the friction that was expected before the measurement, if the fit
    lies outside the band of the expected friction; None otherwise."""
    contradiction: Contradiction | None = None
    """Contradiction between the gauges; None if one slip layer explains them all."""

    yield_slope: float | None = None
    """Regression slope [Pa] of the error of the fitted yield stress on the error of the logarithm of the friction. The
    two errors are correlated, because both come from the errors of the gauges. The value is None if the yield stress
    was not fitted; both constants of the layer are then assumed to change by the same factor."""
    yield_deviation: float = 0.0
    """Error limit [Pa] of the fitted yield stress of the slip layer that remains if the friction at the mean flow is
    known exactly."""
    layer_ends: tuple[tuple[float, float], ...] = ()
    """Viscosity [Pa s/m] and yield stress [Pa] of the two slip layers at the lower and the upper end of the band of the
    friction."""
    yield_layers: tuple[tuple[float, float], ...] = ()
    """Viscosity [Pa s/m] and yield stress [Pa] of the two slip layers with the smallest and the largest yield stress
    that the measured pressures do not distinguish from the fitted layer."""
    later_uncertainty: float = 0.0
    """Relative uncertainty of the slip layer's resistance if the layer is used in another line, at 0.5 to 2 times the
    measured flows: 0.3 means a resistance between 1 / 1.3 and 1.3 times the fitted one. It includes the error of the
    fitted layer that is due to the uncertain friction of the trial line's fittings."""
    width: float = 0.0
    """Logarithm of the ratio of the ends of the band of the slip layer's resistance, in another line at the measured
    flows. The two sides of this band may differ, because the range of the friction of bends is not symmetrical."""
    expected: float = 1.0
    """Fitted friction of straight pipe, divided by the friction that was expected before the measurement."""
    laws: Mapping[str, float] = field(default_factory=dict)
    """Flow index and quadratic viscosity [Pa s2/m2] of the slip layer, as `flow_index` and `quadratic_viscosity`. A
    constant that the layer's flow law does not have is left out. A fit does not change these constants."""
    outside: tuple[str, ...] = ()
    """Names of the fitted constants that lie outside the bands expected before the measurement."""

    @property
    def knows_yield(self) -> bool:
        """True if the measured pressures determine the yield stress of the slip layer."""
        own = self.constants[1]
        return own.fitted or own.reason == NO_YIELD

    @property
    def bend_factor(self) -> float | None:
        """Fitted friction of bends relative to straight pipe; None if the measured pressures do not determine it."""
        bends = self.constants[2] if len(self.constants) > 2 else None
        return bends.value if bends is not None and bends.fitted else None

    @property
    def scatter(self) -> float:
        """Standard deviation of the differences between measured and fitted pressures [Pa]."""
        off = self.deviations()
        return math.sqrt(float(off @ off) / (len(off) - sum(each.fitted for each in self.constants)))

    def deviations(self) -> np.ndarray:
        """Return the pressures of the fit minus the measured ones [Pa], shape (taps,)."""
        return np.array(self.pressures) - [tap.pressure for tap in self.taps]

    def concrete(self, concrete: Concrete) -> Concrete:
        """Return a copy of a concrete that has the fitted slip layer."""
        return replace(concrete, slip_viscosity=self.constants[0].value, slip_yield=self.constants[1].value)

    def layer_entry(self, factors: tuple[float, float] = (1.0, 1.0)) -> Record:
        """Return the fitted slip layer as the entry `layer` in the section `mix` of a concrete's file.

        `factors` are the factors on yield stresses and on viscosities in this file. They multiply the entries when the
        file is read, so the entries are divided by them here.
        """
        yields, viscous = factors
        entry: Record = {
            "viscosity": f"{self.constants[0].value / viscous:.6g} Pa s/m",
            "yield_stress": f"{self.constants[1].value / yields:.6g} Pa",
            **self.law_entries(viscous),
            "uncertainty": f"{max(100 * self.later_uncertainty, 0.1):.4g} %",
            "from": "pipe",
        }
        return entry if self.contradiction is None else entry | {"gauges": CONTRADICTORY}

    def law_entries(self, viscous: float) -> dict[str, float]:
        """Return the constants in :attr:`laws` as entries for a concrete's file.

        Viscosities are divided by the factor `viscous` here, because they are multiplied by it when the file is read.
        """
        divisors = {"quadratic_viscosity": viscous}
        return {key: float(f"{value / divisors.get(key, 1.0):.9g}") for key, value in self.laws.items()}

    def variants(
        self, concrete: Concrete, before: Mapping[str, tuple[Concrete, Concrete]] | None = None
    ) -> dict[str, tuple[Concrete, Concrete]]:
        """Return two concretes for each cause of uncertainty, at the lower and at the upper end of the cause's band.

        There are up to three causes:

        - 'slip layer': the band of the fit.
        - 'density': the band from before the measurement, if `before` holds concretes for this cause.
        - `FITTED_YIELD`, or `OPEN_YIELD` if the pressures do not determine the yield stress of the layer: the layers of
          `yield_layers`. This cause has hardly any effect at the measured flows.

        Viscosity and yield stress of the bulk are no causes, because the fitted slip layer compensates their errors:
        bulk and slip layer together give the measured pressures.
        """
        own = self.concrete(concrete)
        if self.layer_ends:
            low, high = (replace(own, slip_viscosity=eta, slip_yield=tau) for eta, tau in self.layer_ends)
        else:
            low, high = (with_layer_factor(own, x) for x in (1 / (1 + self.uncertainty), 1 + self.uncertainty))
        pairs = {"slip layer": (low, high)}
        if self.yield_layers:
            thick, thin = (replace(own, slip_viscosity=eta, slip_yield=tau) for eta, tau in self.yield_layers)
            pairs[FITTED_YIELD if self.knows_yield else OPEN_YIELD] = (thick, thin)
        if before is not None and "density" in before:
            pairs["density"] = (self.concrete(before["density"][0]), self.concrete(before["density"][1]))
        return pairs

    def line(self, line: PipeLine) -> PipeLine:
        """Return a copy of a line in which all bends have the fitted factor, except those whose factor is stated."""
        bends = self.constants[2] if len(self.constants) > 2 else None
        if bends is None or not bends.fitted:
            return line

        def own(part: Part) -> Part:
            return replace(part, factor=bends.value, factor_range=(bends.low, bends.high)) if is_free(part) else part

        return replace(line, parts=tuple(own(part) for part in line.parts))

    def record(self) -> Record:
        """Return the fit to the trial line as an entry of the file line.json."""
        return {
            "constants": {x.name: {"value": x.value, "low": x.low, "high": x.high, "unit": x.unit, "fitted": x.fitted}
                          for x in self.constants},
            "laws": dict(self.laws),
            "uncertainty": self.uncertainty,
            "later_uncertainty": self.later_uncertainty,
            "open_yield": None if self.knows_yield else [quantity(tau, "Pa") for _, tau in self.yield_layers],
            "over_expected": self.expected,
            "prior_share": self.prior_share,
            "surprise": self.surprise,
            "gauge_error": quantity(self.gauge, "Pa"),
            "contradiction": None if self.contradiction is None else asdict(self.contradiction),
            "scatter": quantity(self.scatter, "Pa"),
            "taps": [{"place": quantity(tap.place, "m"), "flow": quantity(tap.flow, "m3/s"),
                      "measured": quantity(tap.pressure, "Pa"), "fitted": quantity(fitted, "Pa")}
                     for tap, fitted in zip(self.taps, self.pressures, strict=True)],
        }  # fmt: skip
