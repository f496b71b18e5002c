"""Answers to a site engineer: what makes the pressure uncertain, motor power, and whether the pump is strong enough."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from ...core.inputs.amounts import PSI
from ...core.inputs.customary import beside
from ...core.records import Record
from ...core.units import quantity
from ...geometry.pumps import Pump
from ...mix.layer import PIPE_UNCERTAINTY, TRIBOMETER_RATIO
from ...mix.mix import WEIGHING
from ...mix.rheology import RHEOMETER, RHEOMETER_OVER_HEAP
from ...theory.bands import Band

EFFICIENCY = 25 / 36
"""Efficiency of a pump: hydraulic power divided by the power of the motor. The rule of practice for the motor is power
[kW] = pressure [bar] * flow [m3/h] / 25 (bestsupportunderground.com, "Long distance concrete pumping"). The hydraulic
power in the same units is pressure * flow / 36."""
MARGIN = 1.25
"""Recommended ratio of the pump's largest pressure to the pressure that the line needs (AIJ,
http://pmkujira.sakura.ne.jp/Exsokuryo/Free/Kentiku/KcheckL3/02-04-KC-017.htm)."""
LEAST_SHARE = 0.1
"""A cause of uncertainty is mentioned if its share in the squared width of the pressure's uncertainty band is at least
this number. The largest cause is always mentioned."""
ADVICE = {
    "bends": "fit their factor to pressures of a trial line with --fit, or state it with 'factor'",
    "reducers": "measure the pressure on both sides of one, and state its 'factor'",
    "hoses": "measure the pressure on both sides of one, and state its 'factor'",
    "valves": "ask the manufacturer for their loss, and state it as 'equivalent'",
    "bores": "measure the pressure on both sides of one, and state its 'factor'",
    "unknown yield stress of the slip layer": "read more gauges of the trial line, at flows that differ clearly",
    "yield stress of the slip layer": "read the gauges of the trial line at flows that differ more",
    "thixotropy": "measure how the yield stress grows at rest, and state --thixotropy; published "
    "rates are 0.1 to 1.7 Pa/s (notebooks/theory/restarts.md)",
}
"""Advice for the user on how to reduce the uncertainty that comes from a fitting or from thixotropy."""
STATED_BENDS = (
    "their range is that of 'bend_factor' in the file of the line; leave this entry out to fit the factor to more "
    "pressures with --fit"
)
"""Advice for the user if the uncertainty comes from bends whose factor the file of the line states with a range. A fit
does not change a stated factor."""
SHORTEST_STOP = 60.0
"""Shortest interval [s] at which the program recommends moving the concrete in a stopped line. If the concrete must
move more often, the program advises against a stop."""
LONGEST_STOP = 3600.0
"""Longest stop for which the program examines whether a pump restarts the line [s], because the linear growth of the
yield stress at rest holds for some tens of minutes only."""
WORTHWHILE = 0.95
"""Limit for recommending a measurement: width of the pressure's band after the measurement, divided by its present
width. A measurement that narrows the band less is not recommended."""


@dataclass(frozen=True)
class Measurement:
    """Measurement of the properties of the concrete that belong to one cause of uncertainty."""

    advice: str
    """Sentence that tells the user how to make this measurement."""
    factors: tuple[float, float]
    """Lower and upper end of the property's uncertainty band after the measurement, each divided by the measured value.
    The first number is below 1, and the second above 1."""


MEASUREMENTS = {
    "slip layer": (
        Measurement(
            "fit it to pressures of a trial line with --fit", (1 / (1 + PIPE_UNCERTAINTY), 1 + PIPE_UNCERTAINTY)
        ),
        Measurement("measure it with a tribometer", TRIBOMETER_RATIO),
    ),
    "viscosity of the bulk": (Measurement("measure it with a rheometer", (1 - RHEOMETER, 1 + RHEOMETER)),),
    "yield stress of the bulk": (Measurement("measure it with a rheometer", (1 / RHEOMETER_OVER_HEAP, 1 + RHEOMETER)),),
    "density": (Measurement("weigh a known volume", (1 - WEIGHING, 1 + WEIGHING)),),
}
"""Measurements that may narrow the band of a pressure, by the cause of uncertainty that they measure."""


def pressure_text(pressure: float) -> str:
    """Return a pressure [Pa] as text in bar, MPa and psi."""
    return f"{pressure / 1e5:.4g} bar ({pressure / 1e6:.3g} MPa, {pressure / PSI:.4g} psi)"


def time_text(seconds: float) -> str:
    """Return a time [s] as text: in seconds, in minutes from 2 min on, and in hours from 3 h on."""
    if seconds < 10:
        return f"{seconds:.2g} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.3g} min" if seconds < 3 * 3600 else f"{seconds / 3600:.3g} h"


def band_text(band: Band, customary: bool) -> str:
    """Return both ends of a band of pressures [Pa] as text in bar, and also in psi if `customary` is true."""
    return f"{band.low / 1e5:.3g} to {band.high / 1e5:.3g} bar{beside(customary, 'psi', band.low, band.high)}"


def band_sentences(
    band: Band, advise: Callable[[str], str] = lambda cause: ADVICE.get(cause, ""), customary: bool = False
) -> list[str]:
    """Return sentences on how much each cause contributes to a pressure's uncertainty band, the largest cause first.

    The band is in Pa. `advise` returns advice on how to reduce the uncertainty from a cause, or an empty text. If
    `customary` is true, the band is also given in psi.
    """
    shares = sorted(band.shares.items(), key=lambda item: -item[1])
    sentences = []
    for place, (cause, share) in enumerate(shares):
        if place and share < LEAST_SHARE:
            break
        span = " of this band" if place else f" of the band of {band_text(band, customary)}"
        advice = advise(cause)
        sentences.append(f"{100 * share:.0f} %{span} comes from the {cause}" + (f"; {advice}" if advice else ""))
    return sentences


def motor_power(pressure: float, flow: float) -> float:
    """Return the power of the pump's motor [W] for a pressure [Pa] and a flow [m3/s]."""
    return pressure * flow / EFFICIENCY


ON_CONCRETE = (
    "all pressures act on the concrete; the oil pressure on the pump's own gauge is this pressure times the ratio of "
    "the areas of concrete piston and oil piston (data sheet)"
)
"""Sentence that explains why the gauge of a pump does not show the pressure of the concrete: it measures the pressure
of the hydraulic oil. The sentence is printed for lines with a pump."""


@dataclass(frozen=True)
class FastGrowth:
    """Restart after a stop in which the yield stress grows faster than the line's uncertainty band assumes."""

    growth: float
    """Growth rate of the yield stress at rest [Pa/s]."""
    high: float
    """Upper end of the band of the pressure [Pa] that restarts the line at full flow after the stop of this line."""
    longest: float | None
    """Longest stop [s] after which the pump still restarts the line if the yield stress grows at the rate `growth`.
    The value is None if the pump cannot restart the line even after a short stop."""
    bearable: float
    """Largest growth rate [Pa/s] at which the pump still restarts the line after the stop of this line. Rates above
    `growth` are not considered."""

    def record(self) -> Record:
        """Return this restart as an entry of the file line.json."""
        return {
            "growth": quantity(self.growth, "Pa/s"),
            "pressure_high": quantity(self.high, "Pa"),
            "longest_stop": None if self.longest is None else quantity(self.longest, "s"),
            "bearable_growth": quantity(self.bearable, "Pa/s"),
        }


@dataclass(frozen=True)
class RestartMargin:
    """Comparison of the pressure that restarts a line after a stop with the largest pressure of the pump."""

    pump: Pump
    band: Band
    """Pressure that restarts the line at full flow [Pa], with its uncertainty band."""
    begins: Band
    """Pressure at which the concrete begins to move [Pa], with its uncertainty band."""
    longest: float | None
    """Longest stop [s] after which the pump restarts the line even at the upper end of the uncertainty band. Stops
    above `LONGEST_STOP` are not considered. The value is None if the pump cannot restart the line even after a short
    stop."""
    fast: FastGrowth | None = None
    """Restart at the highest published growth rate of the yield stress; None if the user stated the rate."""
    customary: bool = False
    """True if the text for the user gives customary US units beside metric units."""

    @property
    def verdict(self) -> str:
        """Judgement on whether the pump can restart the line: 'restarts', 'may fail' or 'is too weak'."""
        if self.begins.value > self.pump.pressure:
            return "is too weak"
        return "may fail" if self.band.high > self.pump.pressure else "restarts"

    def sentence(self) -> str:
        """Return a sentence that tells the user whether the pump restarts the line."""
        needed = f"{self.band.value / 1e5:.4g} ({self.band.low / 1e5:.3g} to {self.band.high / 1e5:.3g}) bar"
        needed += beside(self.customary, "psi", self.band.low, self.band.high)
        text = f"it delivers {self._bar(self.pump.pressure)}, and a restart at full flow needs {needed}"
        fast = self.fast
        if self.verdict == "restarts":
            if fast is None:
                return f"the pump restarts the line: {text}"
            then = f"{fast.growth:g} Pa/s, the highest published rate, up to {self._bar(fast.high)}"
            if fast.high <= self.pump.pressure:
                return f"the pump restarts the line: {text}; at {then}"
            return (
                f"the pump restarts the line if the yield stress grows by at most {_down(fast.bearable)} Pa/s: {text}; "
                f"at {then}; in that case {_movements(fast.longest)} (notebooks/theory/restarts.md)"
            )
        text = f"the pump {self.verdict} to restart the line: {text}; {_movements(self.longest)}"
        return f"{text} (notebooks/theory/restarts.md)"

    def longest_sentence(self) -> str:
        """Return a sentence that tells the user after how long a stop the pump still restarts the line."""
        text = f"longest stop after which the pump restarts the line: {_stop_text(self.longest)}"
        if self.fast is None:
            return text
        return f"{text} (at {self.fast.growth:g} Pa/s: {_stop_text(self.fast.longest)})"

    def _bar(self, pressure: float) -> str:
        return f"{pressure / 1e5:.4g} bar{beside(self.customary, 'psi', pressure)}"


def _down(rate: float) -> str:
    """Return a growth rate [Pa/s] as text, rounded down to two decimals."""
    return f"{math.floor(100 * rate) / 100:g}"


def _movements(longest: float | None) -> str:
    """Return advice on how often the concrete must be moved during an interruption of the flow.

    `longest` is the longest stop [s] after which the pump can still restart the line, or None if there is none.
    """
    if longest is None or longest < SHORTEST_STOP:
        return "do not interrupt the flow, or use a stronger pump"
    return f"move the concrete at least every {longest // 60:.0f} min"


def _stop_text(longest: float | None) -> str:
    """Return the longest stop [s] as text in whole minutes, rounded down.

    The result is "less than 1 min" for a stop below :data:`SHORTEST_STOP`, and for None.
    """
    if longest is None or longest < SHORTEST_STOP:
        return "less than 1 min"
    return f"{'at least ' if longest >= LONGEST_STOP else ''}{longest // 60:.0f} min"


@dataclass(frozen=True)
class PumpMargin:
    """Comparison of the pressure, flow and power that a line needs with the data sheet of a pump."""

    pump: Pump
    band: Band
    """Pressure that the line needs at its start [Pa], with its uncertainty band."""
    flow: float
    """Flow that the pump must deliver into the line [m3/s]."""
    customary: bool = False
    """True if the text for the user gives customary US units beside metric units."""

    @property
    def factor(self) -> float:
        """Largest pressure of the pump, divided by the pressure that the line needs.

        The value is infinity if the line needs no pressure.
        """
        return self.pump.pressure / self.band.value if self.band.value > 0 else float("inf")

    @property
    def verdict(self) -> str:
        """Judgement on whether the pump suffices for the line: 'strong enough', 'perhaps too weak' or 'too weak'."""
        value, high = ((x, x * self.flow / EFFICIENCY) for x in (self.band.value, self.band.high))
        limits = (self.pump.pressure, self.pump.power)

        def over(needs: tuple[float, float]) -> bool:
            return any(limit is not None and need > limit for need, limit in zip(needs, limits, strict=True))

        if over(value) or (self.pump.flow is not None and self.flow > self.pump.flow):
            return "too weak"
        return "perhaps too weak" if over(high) else "strong enough"

    def sentence(self) -> str:
        """Return a sentence that tells the user whether the pump suffices, with its pressure, power and flow."""
        us = self.customary
        if self.pump.flow is not None and self.flow > self.pump.flow:
            most, wanted = (f"{3600 * x:.4g} m3/h{beside(us, 'yd3/h', x)}" for x in (self.pump.flow, self.flow))
            return f"the pump is too weak: it delivers {most} at most, and {wanted} are wanted"
        limit = self.pump.pressure
        text = f"the pump is {self.verdict}: it delivers {limit / 1e5:.4g} bar{beside(us, 'psi', limit)}"
        if self.band.value <= 0:
            return f"{text}, and the line needs no pressure"
        text += f", {self.factor:.2f} times the pressure needed (AIJ asks for {MARGIN:g} times)"
        if self.band.high > self.band.value:
            text += f", and {self.pump.pressure / self.band.high:.2f} times the upper end of the band"
        if self.pump.power is not None:
            own, needed = (
                f"{each / 1e3:.3g} kW{beside(us, 'hp', each)}"
                for each in (self.pump.power, motor_power(self.band.value, self.flow))
            )
            text += f"; the motor has {own}, and the line needs {needed}"
        if self.pump.flow is not None:
            most = f"{3600 * self.pump.flow:.4g} m3/h{beside(us, 'yd3/h', self.pump.flow)}"
            text += f"; its flow of up to {most} is enough"
        return text

    def record(self) -> Record:
        """Return the comparison of the line with its pump as an entry of the file line.json."""
        return {
            "pressure_limit": quantity(self.pump.pressure, "Pa"),
            "flow_limit": None if self.pump.flow is None else quantity(self.pump.flow, "m3/s"),
            "motor_power_limit": None if self.pump.power is None else quantity(self.pump.power, "W"),
            "margin": self.factor,
            "margin_at_upper_end": self.pump.pressure / self.band.high if self.band.high > 0 else None,
            "verdict": self.verdict,
        }
