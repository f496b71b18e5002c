"""Pressure that a pump line needs, summed over its parts: numbers, text and figure."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.drawing.html import html_table
from ...core.drawing.style import BEND, MEASURED, NOT_STRAIGHT, RUN, SECOND, THEORY, legend_beside, open_frame, rgb
from ...core.run.tables import dataframe, dataset
from ...core.units import quantity
from ...geometry.pipe_line import Part, PipeLine
from ...mps.common.mixes import CONCRETE_CONSTANTS
from ...theory.bands import Band, combined
from ...theory.pipe import Concrete, after_rest
from .answers import EFFICIENCY, PumpMargin, band_sentences, motor_power, pressure_text
from .fit import LineFit
from .fittings import METHODS_ON_BENDS, MODEL_ERRORS, is_in_library, range_of, uncertain_kinds
from .losses import GRAVITY, friction, straight_friction, with_layer_factor
from .practice import PracticeRow, practice_lines, practice_rows

HIGHEST_PUMP = 500e5
"""Highest pressure of concrete that a pump is known to deliver [Pa]: the Sany HBT90CH2150D of Shanghai Tower
(https://meconstructionnews.com/6212/sany-pumps-to-586m-in-shanghai)."""


@dataclass(frozen=True)
class Loss:
    """Pressure losses of one part of a line, by friction and by weight."""

    part: Part
    friction: float
    """Pressure loss by friction [Pa]."""
    theory: float
    """Friction of the part by the closed form [Pa]: the friction of straight pipe of the same bore and length,
    multiplied by a factor. The factor is the one that the line's file states. If the file states none, a hose gets the
    factor of its model, and other parts get 1."""
    weight: float
    """Pressure due to the weight of the concrete over the part's rise [Pa]."""

    @property
    def straight(self) -> float:
        """Friction of a straight pipe of the same bore and length by the closed form [Pa]."""
        return self.theory / self.part.relative

    @property
    def range(self) -> tuple[float, float] | None:
        """Range of the friction of a part due to the error of the part's model, divided by that of straight pipe.

        The value is None for parts without such an error, such as straight pipe.
        """
        return range_of(self.part, self.straight)

    def at(self, end: int) -> float:
        """Return the lower (`end` = 0) or upper (`end` = 1) limit of the friction in this part of the pump line [Pa].

        The limits are the ends of `range`, multiplied by the friction of straight pipe. If the computed friction lies
        outside these limits, it replaces the nearer one. Without a range, both limits equal the computed friction.
        """
        if self.range is None:
            return self.friction
        return (min, max)[end](self.range[end] * self.straight, self.friction)


@dataclass(frozen=True)
class Stop:
    """Time for which a full line stands still, and the growth of the concrete's yield stresses meanwhile."""

    rest: float
    """Duration of the pump's stop [s]."""
    growth: float
    """Growth rate of the concrete's yield stresses at rest [Pa/s]."""
    band: tuple[float, float] | None = None
    """Lowest and highest growth rate of the yield stresses [Pa/s]; None if `growth` has no uncertainty."""


@dataclass(repr=False)
class LineResult:
    """Pressure that a line needs at its start, with the losses of its parts."""

    line: PipeLine
    concrete: Concrete
    flow: float
    """Flow rate for which the pressure of the line is calculated [m3/s]."""
    losses: list[Loss]
    """Pressure losses of each part, in the order from the start of the line to its end."""
    layer_factor: float
    """Uncertainty of the slip layer: its true resistance may be larger or smaller by this factor."""
    simulated: bool
    """True if friction comes from simulations and not from the closed form."""
    folder: Path | None = None
    took: dict[str, float] = field(default_factory=dict)
    """Wall times of the new simulations [s]; the keys are the names of their folders."""
    failed: dict[str, list[str]] = field(default_factory=dict)
    """Failed checks of the simulations with their findings, by folder name."""
    variants: Mapping[str, tuple[Concrete, Concrete]] | None = None
    """Pairs of concretes; the keys are the causes of uncertainty. In each pair, the properties of one cause are at the
    lower and at the upper end of their band. None means that only the resistance of the slip layer is uncertain, by the
    factor `layer_factor`."""
    stop: Stop | None = None
    """Stop of the pump, after which the line must start again; None for no stop."""
    fit: LineFit | None = None
    """Constants of the slip layer and friction of the bends, fitted to pressures measured on a trial line. The value is
    None if no trial line was given."""

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
        `place`, the distance of the parts' ends from the start of the line [m]. Each variable has its unit in
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
        """Return a Matplotlib figure of the pressure along the line, with its band and the closed form."""
        return draw(self)

    @property
    def pressure(self) -> float:
        """Pressure at the start of the line [Pa]."""
        return float(self.course(lambda loss: loss.friction + loss.weight)[1][0])

    @property
    def theory(self) -> float:
        """Pressure at the start by the closed form, which treats bends and reducers as straight pipe [Pa]."""
        return float(self.course(lambda loss: loss.theory + loss.weight)[1][0])

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
        """Volume of the concrete that fills the line [m3]."""
        return self.line.bores.volume(0.0, self.line.length)

    @property
    def residence_time(self) -> float:
        """Time that the concrete spends in the line [s]."""
        return self.volume / self.flow

    @property
    def margin(self) -> PumpMargin | None:
        """Comparison of the line's needs with the data sheet of its pump; None if the line names no pump."""
        return None if self.line.pump is None else PumpMargin(self.line.pump, self.band(), self.flow)

    def band(self) -> Band:
        """Return the pressure at the start of the line [Pa], its uncertainty band, and each cause's share of it."""
        return self.bands()[1][0]

    def bands(self) -> tuple[np.ndarray, list[Band]]:
        """Return positions along the pump line [m], and the pressure there with its uncertainty band [Pa].

        The positions are the start of the line and the end of each part, and both results have parts + 1 entries. The
        uncertain inputs are the constants of the concrete and, for each kind of fitting, the error of the model of its
        friction. Each input in turn is set to the lower and to the upper end of its own band, and the pressure is
        calculated again; the deviations are then combined in squares. All fittings of a kind, such as all bends, are
        changed together. The friction of a simulated part was found with one concrete only. For changed constants, it
        is multiplied by a ratio: the closed form's friction with the changed constants over that with the original
        ones.
        """
        return self._bands

    @functools.cached_property
    def _bands(self) -> tuple[np.ndarray, list[Band]]:
        """Result of :meth:`bands`, calculated at the first use and then stored."""
        places, ours = self.course(lambda loss: loss.friction + loss.weight)
        ends = {cause: [self._course_of(each) for each in pair] for cause, pair in self._variants().items()}
        for kind in uncertain_kinds(self.line.parts):
            ends[MODEL_ERRORS[kind].cause] = [
                self.course(lambda x, k=kind, e=end: (x.at(e) if x.part.kind == k else x.friction) + x.weight)[1]
                .tolist()
                for end in (0, 1)
            ]  # fmt: skip
        found = [
            combined(value, {cause: (low[k], high[k]) for cause, (low, high) in ends.items()})
            for k, value in enumerate(ours.tolist())
        ]
        return places, found

    def restart(self, flow: float = 0.0) -> Band:
        """Return the pressure at the pump that restarts the line after a stop [Pa], with its uncertainty band.

        With a `flow` of 0 [m3/s], the result is the pressure at which the concrete begins to move. With a larger
        `flow`, it is the pressure for restarting at that flow at once. Straight pipe follows from the closed form, and
        fittings keep the ratio of their friction to that of straight pipe.
        """
        stop = self.stop
        assert stop is not None, "the line does not stop"

        def pressure(concrete: Concrete, growth: float, of: Callable[[Loss], float]) -> float:
            grown = after_rest(concrete, stop.rest, growth)
            ratio = concrete.density / self.concrete.density
            course = self.course(
                lambda x: straight_friction(x.part, grown, flow) * of(x) / x.straight + x.weight * ratio
            )[1]
            return float(course[0])

        def own(x: Loss) -> float:
            return x.friction

        value = pressure(self.concrete, stop.growth, own)
        ends = {cause: (pressure(low, stop.growth, own), pressure(high, stop.growth, own))
                for cause, (low, high) in self._variants().items()}  # fmt: skip
        for kind in uncertain_kinds(self.line.parts):
            low, high = (
                pressure(self.concrete, stop.growth, lambda x, k=kind, e=e: x.at(e) if x.part.kind == k else x.friction)
                for e in (0, 1)
            )
            ends[MODEL_ERRORS[kind].cause] = (low, high)
        if stop.band is not None:
            low, high = (pressure(self.concrete, each, own) for each in stop.band)
            ends["thixotropy"] = (low, high)
        return combined(value, ends)

    def practice(self) -> tuple[PracticeRow, list[PracticeRow]]:
        """Return the pressure of the line by this result, and by each rule of practice, both split by kind of part."""
        ours: dict[str, float] = {}
        for x in self.losses:
            ours[x.part.kind] = ours.get(x.part.kind, 0.0) + x.friction + x.weight
        straight = {x.part.number: x.straight for x in self.losses}
        rows = practice_rows(self.line.parts, straight, self.concrete.density * GRAVITY)
        return PracticeRow("this result", ours, ""), rows

    def _restart_record(self) -> dict[str, Any] | None:
        """Return the pressures that restart the line after a stop, as an entry of line.json; None without a stop."""
        if self.stop is None:
            return None
        record: dict[str, Any] = {"rest": quantity(self.stop.rest, "s"), "growth": quantity(self.stop.growth, "Pa/s")}
        for name, band in (("begins", self.restart()), ("at_full_flow", self.restart(self.flow))):
            record[name] = {"pressure": quantity(band.value, "Pa"), "pressure_low": quantity(band.low, "Pa"),
                            "pressure_high": quantity(band.high, "Pa"), "band_shares": dict(band.shares)}  # fmt: skip
        return record

    def _variants(self) -> Mapping[str, tuple[Concrete, Concrete]]:
        if self.variants is not None:
            return self.variants
        low, high = (with_layer_factor(self.concrete, x) for x in (1 / self.layer_factor, self.layer_factor))
        return {"slip layer": (low, high)} if self.layer_factor > 1 else {}

    def _course_of(self, concrete: Concrete) -> list[float]:
        """Return the pressures at the line's start and its parts' ends [Pa], if `concrete` fills the line."""

        def loss(x: Loss) -> float:
            own = x.friction * friction(x.part, concrete, self.flow) / x.theory
            return own + x.weight * concrete.density / self.concrete.density

        return self.course(loss)[1].tolist()

    @property
    def band_text(self) -> str:
        """Sentences for the user that split the uncertainty of the line's pressure by its causes."""
        return "; ".join(band_sentences(self.band())) or "no uncertainty is stated"

    def course(self, of: Callable[[Loss], float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of all parts along the pump line [m] and the pressures there [Pa], shape (parts + 1,).

        The function `of` gives the pressure loss of a part from its :class:`Loss`. The pressure never falls below zero:
        where concrete runs down faster than it is pumped, the column breaks and transmits no tension.
        """
        places = np.concatenate([[0.0], np.cumsum([loss.part.length for loss in self.losses])])
        found = [0.0]
        for loss in reversed(self.losses):
            found.append(max(found[-1] + of(loss), 0.0))
        return places, np.array(found[::-1])

    def remarks(self) -> list[str]:
        """Return remarks for the user about the line, failed checks, and places where the concrete column breaks."""
        found = self.line.remarks()
        found += [f"check FAILED in {name}: {what}" for name, bad in self.failed.items() for what in bad]
        found += [f"part {x.part.number}, {x.part.label}, is sharper than all parts of the library of simulated parts; "
                  "--simulate computes it" for x in self.losses
                  if not self.simulated and not is_in_library(x.part)]  # fmt: skip
        if self.pressure > HIGHEST_PUMP:
            found.append(f"no concrete pump is known to deliver more than {HIGHEST_PUMP / 1e5:.0f} bar; use a wider "
                         "pipe, a smaller flow, concrete with less friction, or a second pump on the way")  # fmt: skip
        course = self.course(lambda loss: loss.friction + loss.weight)[1]
        for number, loss in enumerate(self.losses):
            if course[number + 1] + loss.friction + loss.weight < 0:
                found.append(f"concrete flows down part {loss.part.number} faster than it is pumped, so it "
                             "separates there, and the pressure before this part counts from 0")  # fmt: skip
        return found

    def record(self) -> dict[str, Any]:
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
    band = result.band()
    fitted = () if result.fit is None else ("slip layer", "bends")
    found = [
        f"**{result.line.name}**: {result.line.length:.4g} m, {result.line.rise:.4g} m up, {result.concrete.name} at "
        f"{3600 * result.flow:.4g} m3/h",
        "",
        f"- pressure at the pump {pressure_text(result.pressure)}; {band.low / 1e5:.4g} to {band.high / 1e5:.4g} bar",
        *(f"- {sentence}" for sentence in band_sentences(band, fitted)),
        *(
            [f"- with bends and reducers as straight pipe, {pressure_text(result.theory)} (theory)"]
            if result.simulated or result.theory != result.pressure
            else []
        ),
        f"- power into the concrete {result.power / 1e3:.3g} kW, of the pump's motor {result.motor_power / 1e3:.3g} kW "
        f"(efficiency {EFFICIENCY:.2f}: bar times m3/h over 25)",
        f"- the line holds {result.volume:.3g} m3, and concrete passes it in {_time(result.residence_time)}",
    ]
    if result.margin is not None:
        found.append(f"- {result.margin.sentence()}")
    if result.stop is not None:
        begins, full = result.restart(), result.restart(result.flow)
        found += [
            f"- after {_time(result.stop.rest)} of rest, with a yield stress that grows by {result.stop.growth:g} Pa/s "
            f"(theory), it starts to move at {_span(begins)} bar, and at full flow with {_span(full)} bar",
            *(f"- restart: {sentence}" for sentence in band_sentences(full)[:1]),
        ]
    if result.line.recorded is not None:
        found.append(f"- recorded {pressure_text(result.line.recorded)} ({result.line.source})")
    found += [f"- {remark}" for remark in result.remarks()]
    columns = ("part", "", "diameter [mm]", "length [m]", "rise [m]", "friction [kPa]", "times straight pipe",
               "weight [kPa]")  # fmt: skip
    found += ["", f"| {' | '.join(columns)} |".replace("|  |", "| |"), "|" + "---|" * len(columns)]
    for x in result.losses:
        part, span = x.part, x.range
        cells = [f"{part.number}", part.label, f"{1e3 * part.diameter:.4g}", f"{part.length:.4g}", f"{part.rise:.4g}"]
        ratio = f"{x.friction / x.straight:.3g}" + ("" if span is None else f" ({span[0]:.3g} to {span[1]:.3g})")
        cells += [f"{x.friction / 1e3:.4g}", ratio, f"{x.weight / 1e3:.4g}"]
        found.append(f"| {' | '.join(cells)} |")
    if practice:
        found += ["", *practice_lines(*result.practice()), "", METHODS_ON_BENDS]
    return found


def _span(band: Band) -> str:
    """Return a pressure with its band in bar."""
    return f"{band.value / 1e5:.4g} ({band.low / 1e5:.3g} to {band.high / 1e5:.3g})"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.3g} min"


MIN_STRIPE = 0.004
"""Smallest width of the stripe that marks a bend in the figure, relative to the length of the line."""


def draw(result: LineResult) -> Any:
    """Return a Matplotlib figure of the pressure along a line, with its band and the closed form."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2), layout="constrained")
    axes = figure.add_subplot()
    places, bands = result.bands()
    low, ours, high = (np.array([getattr(each, end) for each in bands]) for end in ("low", "value", "high"))
    low, high = low / 1e5, high / 1e5
    main = RUN if result.simulated else SECOND
    axes.fill_between(places, low, high, color=rgb(main), alpha=0.15, linewidth=0, label="likely range")
    axes.plot(
        places,
        ours / 1e5,
        color=rgb(main),
        linewidth=1.8,
        label="simulated" if result.simulated else "by theory",
    )
    if result.simulated:
        theory = _scaled(result.course(lambda x: x.theory + x.weight))
        axes.plot(*theory, "--", color=rgb(THEORY), linewidth=1.4, label="theory, as straight pipe")
    axes.plot(
        *_scaled(result.course(lambda x: x.weight)),
        color=rgb(MEASURED),
        linestyle=":",
        linewidth=1.2,
        label="weight alone",
    )
    begin = 0.0
    for x in result.losses:
        if not x.part.is_by_length:
            name = x.part.kind
            first = name not in axes.get_legend_handles_labels()[1]
            # A bend is short beside a line of hundreds of metres, so draw at least a visible stripe.
            middle, half = begin + 0.5 * x.part.length, 0.5 * max(x.part.length, MIN_STRIPE * places[-1])
            axes.axvspan(middle - half, middle + half, color=rgb(BEND if name == "bend" else NOT_STRAIGHT), linewidth=0,
                         zorder=0, label=name if first else "")  # fmt: skip
        begin += x.part.length
    if result.line.recorded is not None:
        axes.plot(
            0,
            result.line.recorded / 1e5,
            "+",
            color=rgb(MEASURED),
            markersize=12,
            markeredgewidth=2,
            clip_on=False,
            label="recorded",
        )
    axes.set(xlabel="position along the line [m]", ylabel="pressure [bar]", xlim=(0, places[-1]), ylim=(0, None))
    widths = sorted({1e3 * x.part.diameter for x in result.losses})
    diameter = "diameter " + (f"{widths[0]:.4g} mm" if len(widths) == 1 else f"{widths[0]:.4g} to {widths[-1]:.4g} mm")
    axes.set_title(
        f"{result.line.name}, {diameter}, concrete {result.concrete.name}, {3600 * result.flow:.3g} m3/h", fontsize=10
    )
    legend_beside(axes, 9)
    open_frame(axes)
    return figure


def _scaled(course: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return course[0], course[1] / 1e5
