"""Result for a pump line, as an object, a record for line.json, a table and text."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...core.drawing.html import html_table
from ...core.inputs.customary import CUSTOMARY_SIZES, beside, both
from ...core.records import Record
from ...core.run.tables import dataframe, dataset
from ...core.units import quantity
from ...mps.common.mixes import CONCRETE_CONSTANTS
from ...theory.bands import Band
from .answers import (
    ADVICE,
    EFFICIENCY,
    LONGEST_STOP,
    MEASUREMENTS,
    ON_CONCRETE,
    STATED_BENDS,
    WORTHWHILE,
    FastGrowth,
    PumpMargin,
    RestartMargin,
    band_sentences,
    band_text,
    motor_power,
    pressure_text,
    time_text,
)
from .figure import draw
from .fittings import is_in_library, methods_on_bends
from .line_fit import FITTED_YIELD
from .losses import GRAVITY
from .practice import PracticeRow, practice_lines, practice_rows
from .pressures import LinePressures, Stop
from .taps import is_free

COVERAGE = {"paste": " in about nine of ten cases", "fit": " in about 95 % of cases",
            "other": ", a range without a known probability",
            "contradicted": ", a range without a known probability: the gauges of the trial line contradict each other",
            }  # fmt: skip
"""Remarks on how often the uncertainty band of a line's pressure contains the true pressure, by the origin of the slip
layer:

- 'paste': the composition of the paste. `warpcrete validate` finds that the band contains 93 % of the frictions of
  straight pipe that a statistical model of measured concretes gives, and the pressure of two of three measured lines.
- 'fit': a fit to a trial line with this concrete, now or earlier.
- 'contradicted': an earlier fit, in which the gauges of the trial line contradict each other.
- 'other': any other origin.
"""
HALVINGS = 12
"""Number of bisection steps in the search for the longest stop, or the largest growth rate of the yield stress, for
which a pump still restarts the line."""
WIDENED = ", widened to contain all gauges, which contradict each other"
"""Remark behind the uncertainty band of a line's pressure, if the band was widened because the gauges of the trial line
contradict each other."""
HIGHEST_PUMP = 500e5
"""Highest pressure of concrete that a pump is known to deliver [Pa]: the Sany HBT90CH2150D of Shanghai Tower
(https://meconstructionnews.com/6212/sany-pumps-to-586m-in-shanghai)."""


@dataclass(repr=False)
class LineResult(LinePressures):
    """Result for a pump line: its pressures, and what was simulated or fitted for them."""

    folder: Path | None = None
    took: dict[str, float] = field(default_factory=dict)
    """Wall times of the new simulations [s]; the keys are the names of their folders."""
    failed: dict[str, list[str]] = field(default_factory=dict)
    """Texts on failed plausibility checks, with the values that the checks found; the keys are names of run folders."""
    band_origin: str = ""
    """Origin of the uncertainty band of the slip layer, a key of :data:`COVERAGE`. The text is empty if the user chose
    the width of the band."""

    def __repr__(self) -> str:
        return f"<LineResult of '{self.line.name}': {self.pressure / 1e5:.4g} bar at {3600 * self.flow:.4g} m3/h>"

    def _repr_html_(self) -> str:
        """Return the table of the parts as HTML for notebooks."""
        rows = [line.strip("| ").split(" | ") for line in lines_of(self) if line.startswith("| ")]
        return html_table(rows[1:], ["part", "", *rows[0][2:]], repr(self))

    def table(self) -> Any:
        """Return the parts as a pandas DataFrame in SI units, with the part numbers as index.

        `attrs["units"]` holds the units of the columns. Raises :class:`WarpcreteError` if pandas is not installed.
        """
        return dataframe(*self._columns(), "number", "line.record()")

    def to_xarray(self) -> Any:
        """Return the parts and the pressure along the line as an xarray Dataset in SI units.

        The losses of the parts have the dimension `number`. The pressure and the ends of its band have the dimension
        `place`, the distance of the parts' ends from the start of the line [m]. Variables with a unit have it in
        `attrs["units"]`; the attributes of the Dataset are the line's name and, as JSON texts, the constants of the
        concrete and the quantities of the whole line. Raises :class:`WarpcreteError` if xarray is not installed.
        """
        record, (columns, units) = self.record(), self._columns()
        ranges = columns.pop("over_straight_range")
        for end, name in enumerate(("over_straight_low", "over_straight_high")):
            columns[name] = [None if each is None else each[end] for each in ranges]
        attributes = {
            "line": self.line.name,
            "concrete": json.dumps(record["concrete"]),
            "quantities": json.dumps({name: entry["value"] for name, entry in record.items()
                                      if isinstance(entry, dict) and "value" in entry}),
        }  # fmt: skip
        along = {name: entry["values"] for name, entry in record["along"].items()}
        units_along = {name: entry["unit"] for name, entry in record["along"].items()}
        parts = dataset(columns, units, "number", attributes, "line.record()")
        return parts.merge(dataset(along, units_along, "place", {}))

    def _columns(self) -> tuple[dict[str, list[Any]], dict[str, str]]:
        """Return the parts as columns of a table, and the units of those columns that have one."""
        parts = self.record()["parts"]
        units = {name: entry["unit"] for name, entry in parts[0].items() if isinstance(entry, dict)}
        columns = {name: [x[name]["value"] if name in units else x[name] for x in parts] for name in parts[0]}
        return columns, units

    def plot(self) -> Any:
        """Return a Matplotlib figure of the pressure along the line, with its uncertainty band and the closed form."""
        return draw(self)

    @property
    def power(self) -> float:
        """Hydraulic power transferred to the concrete [W]; the pump itself consumes more."""
        return self.pressure * self.flow

    @property
    def motor_power(self) -> float:
        """Power of the pump's motor [W], with the efficiency that a rule of practice assumes."""
        return motor_power(self.pressure, self.flow)

    @property
    def volume(self) -> float:
        """Volume of the concrete in the full line [m3]."""
        return self.line.bores.volume(0.0, self.line.length)

    @property
    def residence_time(self) -> float:
        """Time that concrete needs from the start of the line to its end [s]."""
        return self.volume / self.flow

    @property
    def margin(self) -> PumpMargin | None:
        """Comparison of the line's pressure, flow and power with the data sheet of its pump; None without a pump."""
        return (
            None if self.line.pump is None else PumpMargin(self.line.pump, self.band(), self.flow, self.line.customary)
        )

    @functools.cached_property
    def restart_margin(self) -> RestartMargin | None:
        """Comparison of the pressure for a restart at full flow with the pressure of the pump.

        The value is None if the line has no pump or does not stop.
        """
        pump, stop = self.line.pump, self.stop
        if pump is None or stop is None:
            return None

        def suffices(other: Stop) -> bool:
            return replace(self, stop=other).restart(self.flow).high <= pump.pressure

        def longest(of: Stop) -> float | None:
            return _largest(lambda rest: suffices(replace(of, rest=rest)), LONGEST_STOP) or None

        fast = None
        if stop.highest is not None:
            worst, high = Stop(stop.rest, stop.highest), self._fast_restart
            bearable = _largest(lambda growth: suffices(replace(worst, growth=growth)), stop.highest)
            fast = FastGrowth(stop.highest, high, longest(worst), bearable)
        return RestartMargin(pump, self.restart(self.flow), self.restart(), longest(stop), fast, self.line.customary)

    @property
    def _fast_restart(self) -> float:
        """Upper end of the band of the restart pressure [Pa] for the highest published growth of the yield stress."""
        assert self.stop is not None
        assert self.stop.highest is not None
        return replace(self, stop=Stop(self.stop.rest, self.stop.highest)).restart(self.flow).high

    def _needed_pump(self) -> str:
        """Return a sentence on the pressure that a pump must deliver to restart the line, if no pump is described."""
        assert self.stop is not None
        us, high = self.line.customary, self.restart(self.flow).high
        text = "to restart the line at full flow even at the upper end of its band, a pump must deliver "
        text += both(us, "bar", high, digits=3)
        if self.stop.highest is not None:
            fastest = both(us, "bar", self._fast_restart, digits=3)
            text += f", and {fastest} at {self.stop.highest:g} Pa/s, the highest published rate"
        text += "; state the pressure of the pump (--pump-pressure) to see after how long a stop it restarts the line"
        return text

    def practice(self) -> tuple[PracticeRow, list[PracticeRow]]:
        """Return the pressure of the line by this program and by each rule of practice, each split by kind of part."""
        ours: dict[str, float] = {}
        for x in self.losses:
            ours[x.part.kind] = ours.get(x.part.kind, 0.0) + x.friction + x.weight
        straight = {x.part.number: x.straight for x in self.losses}
        rows = practice_rows(self.line.parts, straight, self.concrete.density * GRAVITY, self.line.customary)
        return PracticeRow("this result", ours, self.pressure, ""), rows

    def _restart_record(self) -> Record | None:
        """Return the pressures that restart the line after a stop, as an entry of line.json; None without a stop."""
        if self.stop is None:
            return None
        record: Record = {"rest": quantity(self.stop.rest, "s"), "growth": quantity(self.stop.growth, "Pa/s")}
        for name, band in (("begins", self.restart()), ("at_full_flow", self.restart(self.flow))):
            record[name] = {"pressure": quantity(band.value, "Pa"), "pressure_low": quantity(band.low, "Pa"),
                            "pressure_high": quantity(band.high, "Pa"), "band_shares": dict(band.shares)}  # fmt: skip
        margin = self.restart_margin
        if margin is not None:
            record["verdict"] = margin.verdict
            record["longest_stop"] = None if margin.longest is None else quantity(margin.longest, "s")
            record["fast_growth"] = None if margin.fast is None else margin.fast.record()
        return record

    @property
    def band_text(self) -> str:
        """Sentences for the user on how much each cause contributes to the uncertainty of the line's pressure."""
        return "; ".join(self.band_sentences()) or "no uncertainty is stated"

    @property
    def coverage(self) -> str:
        """Remark on how often the uncertainty band contains the true pressure; empty if the user chose its width."""
        if self.fit is not None:
            return WIDENED if self.fit.contradiction is not None else COVERAGE["fit"]
        return COVERAGE.get(self.band_origin, "")

    def band_sentences(self) -> list[str]:
        """Return sentences on the causes of the pressure's uncertainty, with advice on how to reduce it."""
        customary = self.line.customary
        return band_sentences(self.band(), lambda cause: self._advice(cause, lambda each: each.band()), customary)

    def restart_sentences(self) -> list[str]:
        """Return sentences on the causes of the uncertainty of the pressure that restarts the line at full flow."""

        def full(each: LineResult) -> Band:
            return each.restart(each.flow)

        return band_sentences(full(self), lambda cause: self._advice(cause, full), self.line.customary)

    def _advice(self, cause: str, band_of: Callable[[LineResult], Band]) -> str:
        """Return advice on how to reduce the uncertainty of a pressure that comes from one cause.

        `band_of` returns the band of this pressure [Pa] for a result. A measurement is recommended only if it makes the
        band clearly narrower; the advice then states the new band. A cause that was fitted to a trial line needs no
        further measurement. If the layer comes from an earlier fit, another fit helps only with more flows.
        """
        if self.fit is not None and cause in ("slip layer", "bends"):
            return ""
        if self.band_origin == "contradicted" and cause == "slip layer":
            return "find out why the gauges of the trial line contradict each other, and fit the layer again"
        if self.band_origin == "fit" and cause == "slip layer":
            return ADVICE[FITTED_YIELD]
        if cause == "bends" and not any(is_free(part) for part in self.line.parts):
            return STATED_BENDS
        if cause not in MEASUREMENTS:
            return ADVICE.get(cause, "")
        now, texts = band_of(self), []
        for each in MEASUREMENTS[cause]:
            then = band_of(self.measured(cause, each.factors))
            if then.high - then.low < WORTHWHILE * (now.high - now.low):
                texts.append(f"{each.advice}, which would give {band_text(then, self.line.customary)}")
        return ", or ".join(texts)

    def remarks(self) -> list[str]:
        """Return remarks for the user about the line, failed checks, and places where the concrete column breaks."""
        texts = self.line.remarks()
        texts += [f"check FAILED in {name}: {what}" for name, bad in self.failed.items() for what in bad]
        texts += [f"part {x.part.number}, {x.part.label}, is sharper than all parts in the table of simulated parts; "
                  "--simulate computes it" for x in self.losses
                  if not self.simulated and not is_in_library(x.part)]  # fmt: skip
        texts += [f"part {x.part.number} was simulated as a fluid without stones; stones may add to its friction, so "
                  "the range of its friction is kept; a measured 'factor' would narrow it"
                  for x in self.losses  # Only a simulated bore has a friction that differs from the closed form.
                  if self.simulated and x.part.mesh and x.part.factor is None and x.friction != x.theory]  # fmt: skip
        if self.pressure > HIGHEST_PUMP:
            texts.append("no concrete pump is known to deliver more than "
                         f"{both(self.line.customary, 'bar', HIGHEST_PUMP)}; use a wider pipe, a smaller flow, "
                         "concrete with less friction, or a second pump on the way")  # fmt: skip
        course = self.course(lambda loss: loss.friction + loss.weight)[1]
        for number, loss in enumerate(self.losses):
            if course[number + 1] + loss.friction + loss.weight < 0:
                texts.append(f"concrete flows down part {loss.part.number} faster than it is pumped, so it "
                             "separates there, and the pressure before this part counts from 0")  # fmt: skip
        return texts

    def record(self) -> Record:
        """Return the results of the line as the contents of the file line.json."""
        places, bands = self.bands()
        band, margin = bands[0], self.margin
        return {
            "line": self.line.name,
            "source": self.line.source,
            "concrete": {name: getattr(self.concrete, name) for name in ("name", *CONCRETE_CONSTANTS)},
            "flow": quantity(self.flow, "m3/s"),
            "length": quantity(self.line.length, "m"),
            "rise": quantity(self.line.rise, "m"),
            "pressure": quantity(self.pressure, "Pa"),
            "pressure_theory": quantity(self.theory, "Pa"),
            "pressure_low": quantity(band.low, "Pa"),
            "pressure_high": quantity(band.high, "Pa"),
            "band_shares": dict(band.shares),
            "layer_factor": None if self.variants is not None else self.layer_factor,
            "band": self.band_text,
            "power": quantity(self.power, "W"),
            "motor_power": quantity(self.motor_power, "W"),
            "efficiency": EFFICIENCY,
            "pump": None if margin is None else margin.record(),
            "volume": quantity(self.volume, "m3"),
            "residence_time": quantity(self.residence_time, "s"),
            "restart": self._restart_record(),
            "fit": None if self.fit is None else self.fit.record(),
            "practice": {row.rule: quantity(row.pressure, "Pa") for row in self.practice()[1]},
            "along": {
                "place": {"values": places.tolist(), "unit": "m"},
                **{name: {"values": [getattr(each, end) for each in bands], "unit": "Pa"}
                   for name, end in (("pressure", "value"), ("pressure_low", "low"), ("pressure_high", "high"))},
            },
            "recorded": None if self.line.recorded is None else quantity(self.line.recorded, "Pa"),
            "simulated": self.simulated,
            "remarks": self.remarks(),
            "failed_checks": self.failed,
            "parts": [
                {"number": x.part.number, "kind": x.part.kind, "what": x.part.label,
                 "diameter": quantity(x.part.diameter, "m"), "length": quantity(x.part.length, "m"),
                 "rise": quantity(x.part.rise, "m"), "friction": quantity(x.friction, "Pa"),
                 "friction_theory": quantity(x.theory, "Pa"), "weight": quantity(x.weight, "Pa"),
                 "over_straight": x.friction / x.straight, "over_straight_range": x.range}
                for x in self.losses
            ],
            "wall_time": {name: quantity(time, "s") for name, time in self.took.items()},
        }  # fmt: skip


def lines_of(result: LineResult, practice: bool = False) -> list[str]:
    """Return the result of a pump line as lines of Markdown: a headline, answers, and a table of the line's parts.

    With `practice`, a further table compares the result with rules of practice.
    """
    band, us = result.band(), result.line.customary
    texts = [
        f"**{result.line.name}**: {result.line.length:.4g} m{beside(us, 'ft', result.line.length)}, "
        f"{_height(result.line.rise, us)}, {result.concrete.name} at "
        f"{3600 * result.flow:.4g} m3/h{beside(us, 'yd3/h', result.flow)}",
        "",
        f"- pressure at the pump {pressure_text(result.pressure)}; {band.low / 1e5:.4g} to {band.high / 1e5:.4g} bar"
        f"{beside(us, 'psi', band.low, band.high)}{result.coverage}",
        *(f"- {sentence}" for sentence in result.band_sentences()),
        *(
            [f"- with bends and reducers as straight pipe, {pressure_text(result.theory)} (theory)"]
            if result.simulated or result.theory != result.pressure
            else []
        ),
        f"- power into the concrete {result.power / 1e3:.3g} kW{beside(us, 'hp', result.power)}, of the pump's motor "
        f"{result.motor_power / 1e3:.3g} kW{beside(us, 'hp', result.motor_power)} "
        f"(efficiency {EFFICIENCY:.2f}: bar times m3/h over 25)",
        f"- the line holds {result.volume:.3g} m3{beside(us, 'yd3', result.volume)}, and concrete passes it in "
        f"{time_text(result.residence_time)}",
    ]
    if result.margin is not None:
        texts.append(f"- {result.margin.sentence()}")
    if result.stop is not None:
        begins, full = result.restart(), result.restart(result.flow)
        texts += [
            f"- after {time_text(result.stop.rest)} of rest, with a yield stress that grows by "
            f"{result.stop.growth:g} Pa/s (theory), the concrete starts to move at {_span(begins, us)}, and a restart "
            f"at full flow needs {_span(full, us)}{_assumed_growth(result.stop)}",
            *(f"- restart: {sentence}" for sentence in result.restart_sentences()[:1]),
        ]
    if result.stop is not None and result.line.pump is None:
        texts.append(f"- {result._needed_pump()}")
    if result.restart_margin is not None:
        texts += [f"- {result.restart_margin.sentence()}", f"- {result.restart_margin.longest_sentence()}"]
    if result.line.pump is not None:
        texts.append(f"- {ON_CONCRETE}")
    if result.line.recorded is not None:
        texts.append(f"- recorded {pressure_text(result.line.recorded)} ({result.line.source})")
    texts += [f"- {remark}" for remark in result.remarks()]
    texts += ["", *_table(result)]
    if practice:
        texts += ["", *practice_lines(*result.practice(), us), "", methods_on_bends(us)]
    return texts


def _table(result: LineResult) -> list[str]:
    """Return a table of a line's parts, in customary US units if the line is described in them."""
    us = result.line.customary
    wide, long, pressure = ("in", "ft", "psi") if us else ("mm", "m", "kPa")
    sizes = CUSTOMARY_SIZES if us else {"mm": 1e-3, "m": 1.0, "kPa": 1e3}

    def cell(value: float, unit: str) -> str:
        return f"{value / sizes[unit]:.4g}"

    columns = ("part", "", f"diameter [{wide}]", f"length [{long}]", f"rise [{long}]", f"friction [{pressure}]",
               "times straight pipe", f"weight [{pressure}]")  # fmt: skip
    rows = [f"| {' | '.join(columns)} |".replace("|  |", "| |"), "|" + "---|" * len(columns)]
    for x in result.losses:
        part, span = x.part, x.range
        ratio = f"{x.friction / x.straight:.3g}" + ("" if span is None else f" ({span[0]:.3g} to {span[1]:.3g})")
        cells = [f"{part.number}", part.label, cell(part.diameter, wide), cell(part.length, long),
                 cell(part.rise, long), cell(x.friction, pressure), ratio, cell(x.weight, pressure)]  # fmt: skip
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def _largest(suffices: Callable[[float], bool], limit: float) -> float:
    """Return the largest number between 0 and `limit` for which `suffices` is true, by bisection.

    If `suffices` is true for a number, it must be true for all smaller numbers.
    """
    low, high = 0.0, limit
    if suffices(limit):
        return limit
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if suffices(middle) else (low, middle)
    return low


def _assumed_growth(stop: Stop) -> str:
    """Return a remark on the range of growth rates that the bands of a restart assume; empty if the rate was stated."""
    if stop.band is None:
        return ""
    low, high = stop.band
    return (f"; these bands assume a growth of {low:g} to {high:g} Pa/s, and combine this error with the others as "
            "independent errors, so they are narrower than with all errors at their worst")  # fmt: skip


def _span(band: Band, us: bool) -> str:
    """Return a text with a pressure and its uncertainty band in bar; if `us` is true, also in psi."""
    text = f"{band.value / 1e5:.4g} ({band.low / 1e5:.3g} to {band.high / 1e5:.3g}) bar"
    if not us:
        return text
    value, low, high = (f"{x / CUSTOMARY_SIZES['psi']:.4g}" for x in (band.value, band.low, band.high))
    return f"{text}, or {value} ({low} to {high}) psi"


def _height(rise: float, us: bool) -> str:
    """Return the height of a line's end above its start [m] as text; if `us` is true, also in feet."""
    way = "down" if round(rise, 9) < 0 else "up"
    return f"{abs(rise):.4g} m{beside(us, 'ft', abs(rise))} {way}"
