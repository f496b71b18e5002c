"""Pressure that a pump line needs, summed over its parts: numbers, text and figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.drawing.html import html_table
from ...core.run.run import dataframe
from ...core.units import quantity
from ...mps.mixes import CONCRETE_CONSTANTS
from ...theory.bands import Band, combined
from ...theory.pipe import Concrete
from .losses import Part, PipeLine, friction, with_layer_factor


@dataclass(frozen=True)
class Loss:
    """Pressure losses of one part of a line."""

    part: Part
    friction: float
    """Pressure loss by friction [Pa]."""
    theory: float
    """Friction by the closed form, which treats the part as a straight pipe of the same bore and length [Pa]."""
    weight: float
    """Pressure due to the weight of the concrete over the part's rise [Pa]."""


@dataclass(repr=False)
class LineResult:
    """Pressure that a line needs at its start, with the losses of its parts."""

    line: PipeLine
    concrete: Concrete
    flow: float
    """Flow rate [m3/s]."""
    losses: list[Loss]
    """Losses of the parts, from the start of the line to its end."""
    layer_factor: float
    """Factor by which the resistance of the slip layer may be wrong, in both directions."""
    simulated: bool
    """True if friction comes from simulations and not from the closed form."""
    folder: Path | None = None
    took: dict[str, float] = field(default_factory=dict)
    """Wall time of each new simulation [s], by its folder's name."""
    failed: dict[str, list[str]] = field(default_factory=dict)
    """Failed checks of the simulations with their findings, by folder name."""
    variants: Mapping[str, tuple[Concrete, Concrete]] | None = None
    """Pairs of concretes by the cause of their uncertainty; None if `layer_factor` is the only cause."""

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
        parts = self.record()["parts"]
        units = {name: entry["unit"] for name, entry in parts[0].items() if isinstance(entry, dict)}
        columns = {name: [x[name]["value"] if name in units else x[name] for x in parts] for name in parts[0]}
        return dataframe(columns, units, "number")

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

    def band(self) -> Band:
        """Return the pressure at the start of the line [Pa] with its band and the share of each cause of the band."""
        return self.bands()[1][0]

    def bands(self) -> tuple[np.ndarray, list[Band]]:
        """Return places along the line between its parts [m], and the pressure there with its band [Pa].

        For each cause, the pressure is calculated with the two concretes at the ends of this cause's band. Simulated
        friction is scaled in proportion to the closed form.
        """
        places, ours = self.course(lambda loss: loss.friction + loss.weight)
        ends = {cause: [self._course_of(each) for each in pair] for cause, pair in self._variants().items()}
        found = [
            combined(value, {cause: (low[k], high[k]) for cause, (low, high) in ends.items()})
            for k, value in enumerate(ours.tolist())
        ]
        return places, found

    def _variants(self) -> Mapping[str, tuple[Concrete, Concrete]]:
        if self.variants is not None:
            return self.variants
        low, high = (with_layer_factor(self.concrete, x) for x in (1 / self.layer_factor, self.layer_factor))
        return {"slip layer": (low, high)} if self.layer_factor > 1 else {}

    def _course_of(self, concrete: Concrete) -> list[float]:
        """Return the pressure between the parts [Pa] if the line is filled with another concrete."""

        def loss(x: Loss) -> float:
            own = x.friction * friction(x.part, concrete, self.flow) / x.theory
            return own + x.weight * concrete.density / self.concrete.density

        return self.course(loss)[1].tolist()

    @property
    def band_text(self) -> str:
        """Description of the uncertainty band of the pressure, for the user."""
        if self.variants is None:
            return f"{self.layer_factor:g} times less or more resistance of the slip layer"
        shares = sorted(self.band().shares.items(), key=lambda item: -item[1])
        if not shares:
            return "no uncertainty of the mix"
        return f"the bands of the mix, of which the {shares[0][0]} makes {100 * shares[0][1]:.0f} %"

    def course(self, of: Callable[[Loss], float]) -> tuple[np.ndarray, np.ndarray]:
        """Return places along the line between its parts [m] and the pressure there [Pa], both of shape (parts + 1,).

        `of` gives the pressure loss of a part. The pressure never falls below zero: where concrete runs down faster
        than it is pumped, the column breaks and transmits no tension.
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
        course = self.course(lambda loss: loss.friction + loss.weight)[1]
        for number, loss in enumerate(self.losses):
            if course[number + 1] + loss.friction + loss.weight < 0:
                found.append(f"concrete flows down part {loss.part.number} faster than it is pumped, so it "
                             "separates there, and the pressure before this part counts from 0")  # fmt: skip
        return found

    def record(self) -> dict[str, Any]:
        """Return the contents of line.json."""
        band = self.band()
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
            "recorded": None if self.line.recorded is None else quantity(self.line.recorded, "Pa"),
            "simulated": self.simulated,
            "remarks": self.remarks(),
            "failed_checks": self.failed,
            "parts": [
                {"number": x.part.number, "kind": x.part.kind, "what": x.part.label,
                 "diameter": quantity(x.part.diameter, "m"), "length": quantity(x.part.length, "m"),
                 "rise": quantity(x.part.rise, "m"), "friction": quantity(x.friction, "Pa"),
                 "friction_theory": quantity(x.theory, "Pa"), "weight": quantity(x.weight, "Pa")}
                for x in self.losses
            ],
            "wall_time": {name: quantity(time, "s") for name, time in self.took.items()},
        }  # fmt: skip


def lines_of(result: LineResult) -> list[str]:
    """Return a headline and a table of the parts as lines of Markdown."""
    band = result.band()
    found = [
        f"**{result.line.name}**: {result.line.length:.4g} m, {result.line.rise:.4g} m up, {result.concrete.name} at "
        f"{3600 * result.flow:.4g} m3/h",
        "",
        f"- pressure at the pump {_bar(result.pressure)}; {_bar(band.low)} to {_bar(band.high)} with "
        f"{result.band_text}",
        f"- by theory, with bends and reducers as straight pipe, {_bar(result.theory)}",
        f"- power into the concrete {result.power / 1e3:.3g} kW",
    ]
    if result.line.recorded is not None:
        found.append(f"- recorded {_bar(result.line.recorded)} ({result.line.source})")
    found += [f"- {remark}" for remark in result.remarks()]
    found += ["", "| part | | diameter [mm] | length [m] | rise [m] | friction [kPa] | theory [kPa] | weight [kPa] |",
              "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for x in result.losses:
        part = x.part
        cells = [f"{part.number}", part.label, f"{1e3 * part.diameter:g}", f"{part.length:.4g}", f"{part.rise:.4g}"]
        cells += [f"{each / 1e3:.4g}" for each in (x.friction, x.theory, x.weight)]
        found.append(f"| {' | '.join(cells)} |")
    return found


def _bar(pressure: float) -> str:
    return f"{pressure / 1e5:.4g} bar ({pressure / 1e6:.3g} MPa)"


def draw(result: LineResult) -> Any:
    """Return a Matplotlib figure of the pressure along a line, with its band and the closed form."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.add_subplot()
    places, bands = result.bands()
    low, ours, high = (np.array([getattr(each, end) for each in bands]) for end in ("low", "value", "high"))
    low, high = low / 1e5, high / 1e5
    words = (
        "band of the mix"
        if result.variants is not None
        else (f"resistance of the slip layer {result.layer_factor:g} times less or more")
    )
    axes.fill_between(places, low, high, color="C0", alpha=0.15, linewidth=0, label=words)
    if result.simulated:
        axes.plot(places, ours / 1e5, color="C0", linewidth=1.8, label="simulated")
    axes.plot(*_scaled(result.course(lambda x: x.theory + x.weight)), "k--", linewidth=1.0, label="theory")
    axes.plot(*_scaled(result.course(lambda x: x.weight)), color="0.6", linewidth=1.0, label="weight alone")
    begin = 0.0
    for x in result.losses:
        if not x.part.is_by_length:
            axes.axvspan(begin, begin + x.part.length, color="C1" if x.part.kind == "bend" else "C2", alpha=0.35,
                         linewidth=0)  # fmt: skip
        begin += x.part.length
    if result.line.recorded is not None:
        axes.plot(0, result.line.recorded / 1e5, "k+", markersize=11, clip_on=False, label="recorded")
    axes.set(xlabel="position along the line [m]", ylabel="pressure [bar]", xlim=(0, places[-1]), ylim=(0, None))
    axes.set_title(f"{result.line.name}, {result.concrete.name}, {3600 * result.flow:.3g} m3/h", fontsize=10)
    axes.legend(frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _scaled(course: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return course[0], course[1] / 1e5
