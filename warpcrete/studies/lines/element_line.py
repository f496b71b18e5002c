"""Pressure along a pump line, calculated from discrete element simulations of the line's parts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.inputs.amounts import PSI
from ...core.inputs.customary import beside, both
from ...core.records import Record
from ...core.units import quantity
from ...geometry.pipe_line import Part, PipeLine
from .losses import GRAVITY, course_of

STEPS = 50
"""Number of intervals into which a part of the pump line is divided to integrate the pressure along it."""


@dataclass(frozen=True)
class WallLaw:
    """Linear law of the shear stress on a straight pipe's wall: stress = start + slope * pressure.

    The slope is due to Coulomb friction of the aggregates, and the constant term to the lubrication layer.
    """

    diameter: float
    """Inner diameter of the pipe [m]."""
    start: float
    """Wall stress at zero pressure [Pa], which is the share of the lubrication layer in the friction."""
    slope: float
    """Slope of the law: increase of the wall stress [Pa] per increase of the pressure [Pa]."""
    measured: float
    """Largest pressure at which the wall stress was measured for the fit of this law [Pa]."""
    largest: float
    """Pressure above which the wall stress is assumed constant [Pa]. At such pressures the overlaps of the elements are
    so large that the linear law is not valid."""

    @classmethod
    def of(cls, diameter: float, columns: Mapping[str, np.ndarray], largest: float) -> WallLaw:
        """Fit the law to the stresses measured in slices of a straight pipe of the given `diameter` [m].

        The law is a straight line, fitted to the wall stress as a function of the pressure. `columns` holds the arrays
        `axial_stress`, which serves as the pressure, and `wall_stress` [Pa]. `largest` is the pressure above which the
        wall stress is assumed constant [Pa].
        """
        pressure, shear = columns["axial_stress"], columns["wall_stress"]
        here = np.isfinite(pressure)
        slope, start = (float(x) for x in np.polyfit(pressure[here], shear[here], 1))
        return cls(diameter, start, slope, float(pressure[here].max()), largest)

    def gradient(self, pressure: float) -> float:
        """Return the pressure loss by friction per metre of pipe [Pa/m] at a local `pressure` [Pa]."""
        return 4 / self.diameter * max(self.start + self.slope * min(pressure, self.largest), 0.0)


@dataclass(frozen=True)
class SeedResult:
    """Results of the discrete element simulations of all parts of a line with one random seed."""

    laws: Mapping[float, WallLaw]
    """Laws for the wall friction of straight pipe; the keys are the pipe's diameters [m]."""
    ratios: Mapping[tuple[Any, ...], float]
    """Friction of each kind of bend or reducer, divided by the friction of straight pipe of the same length."""
    density: float
    """Bulk density of the elements that fill the pipe [kg/m3]."""
    blocked: Mapping[tuple[Any, ...], bool] = field(default_factory=dict)
    """Result of the check for blockage, by kind of part: True if the simulation of such a part was blocked."""

    def is_blocked(self, part: Part) -> bool:
        """Return whether the simulation of the part was blocked.

        A straight part counts as blocked if one of the two simulations of straight pipe of its diameter was blocked.
        """
        return any(found for key, found in self.blocked.items() if key[: len(part.loss_key)] == part.loss_key)

    def ratio(self, part: Part) -> float:
        """Return a part's friction divided by the friction of straight pipe of the same length."""
        return part.factor if part.factor is not None else self.ratios.get(part.loss_key, part.relative_loss)

    def course(self, line: PipeLine) -> list[tuple[float, float]]:
        """Return the friction and the weight of each part [Pa], as pairs in the order of the parts in the line.

        The friction depends on the local pressure, which is zero where concrete runs down faster than it is pumped,
        because the concrete column transmits no tension (:func:`.course_of`). If the line has such a stretch, the
        pressure at its start is larger than the sum of all friction and weight.
        """
        pressure, losses = 0.0, []
        for part in reversed(line.parts):
            friction = 0.0
            weight = self.density * GRAVITY * part.rise
            ratio = self.ratio(part)
            step = part.length / STEPS
            for place in range(STEPS):
                # Integrate from the part's outlet, where the pressure is known, towards its inlet. Each step uses the
                # midpoint rule.
                along = 1 - (place + 0.5) / STEPS
                there = pressure + friction + weight * (1 - along)
                ahead = there + 0.5 * step * ratio * self._gradient(part, along, max(there, 0.0))
                friction += step * ratio * self._gradient(part, along, max(ahead, 0.0))
            pressure = max(pressure + friction + weight, 0.0)
            losses.append((friction, weight))
        return losses[::-1]

    def pressure(self, line: PipeLine) -> float:
        """Return the pressure at the start of the line [Pa]."""
        return course_of([friction + weight for friction, weight in self.course(line)])[0]

    def _gradient(self, part: Part, along: float, pressure: float) -> float:
        """Return the friction of straight pipe [Pa/m] at a local `pressure` [Pa], interpolated along a part.

        `along` is the place in the part, as a fraction of its length. The friction is interpolated between the values
        for the diameters at both ends of the part.
        """
        begin, end = (self.laws[diameter].gradient(pressure) for diameter in (part.diameter, part.outlet))
        return along * end + (1 - along) * begin


@dataclass(repr=False)
class ElementLine:
    """Pressure losses of a pump line, computed by the discrete element method."""

    line: PipeLine
    concrete: str
    flow: float
    """Flow rate for which the pressure of the line is calculated [m3/s]."""
    packed: list[SeedResult]
    """Results of the simulated parts, one entry for each random seed."""
    remarks: list[str]
    took: dict[str, float] = field(default_factory=dict)
    """Wall time of each new simulation [s]; the keys are the names of the simulations' folders. If simulations run on
    the device at the same time, their wall times overlap."""
    elapsed: float = 0.0
    """Total wall time for packing and running all new simulations [s]."""
    failed: dict[str, list[str]] = field(default_factory=dict)
    """Texts on failed plausibility checks, with the values that the checks found; the keys are names of run folders."""

    def __repr__(self) -> str:
        return f"<ElementLine of '{self.line.name}': {self.pressure / 1e5:.4g} bar at {3600 * self.flow:.4g} m3/h>"

    @property
    def pressures(self) -> list[float]:
        """Pressures at the start of the line, one for each seed [Pa]."""
        return [each.pressure(self.line) for each in self.packed]

    @property
    def pressure(self) -> float:
        """Pressure at the start of the line, averaged over the seeds [Pa]."""
        return float(np.mean(self.pressures))

    def frictions(self) -> np.ndarray:
        """Return the pressure loss of each part due to friction, averaged over the seeds [Pa], shape (parts,)."""
        return np.mean([[friction for friction, _ in each.course(self.line)] for each in self.packed], axis=0)

    def weights(self) -> np.ndarray:
        """Return the pressure loss of each part due to weight, averaged over the seeds [Pa], shape (parts,)."""
        return np.mean([[weight for _, weight in each.course(self.line)] for each in self.packed], axis=0)

    def blocked(self) -> list[int]:
        """Return, for each part of the line, the number of seeds for which the simulation of the part was blocked."""
        return [sum(each.is_blocked(part) for each in self.packed) for part in self.line.parts]

    def record(self) -> Record:
        """Return the contents of the file line-dem.json: the pressure of the line and the results for its parts."""
        return {
            "line": self.line.name,
            "concrete": self.concrete,
            "flow": quantity(self.flow, "m3/s"),
            "pressure": quantity(self.pressure, "Pa"),
            "pressures": {f"seed {k}": quantity(p, "Pa") for k, p in enumerate(self.pressures)},
            "remarks": self.remarks,
            "failed_checks": self.failed,
            "parts": [
                {"number": part.number, "what": part.label, "friction": quantity(friction, "Pa"),
                 "weight": quantity(weight, "Pa"), "ratios": [each.ratio(part) for each in self.packed],
                 "blocked_seeds": blocked}
                for part, friction, weight, blocked in zip(
                    self.line.parts, self.frictions(), self.weights(), self.blocked(), strict=True
                )
            ],
            "wall_time": {name: quantity(time, "s") for name, time in self.took.items()},
            "elapsed": quantity(self.elapsed, "s"),
        }  # fmt: skip


def element_table_lines(found: ElementLine, others: Mapping[str, Sequence[float]]) -> list[str]:
    """Return the results of the discrete element simulations of a pump line as lines of Markdown.

    A table shows the friction of each part, with a further column for each of the `others`. This mapping holds, by the
    name of another method such as "theory", the friction [Pa] that this method predicts for each part.
    """
    low, high = min(found.pressures), max(found.pressures)
    us = found.line.customary
    span = f"; {both(us, 'bar', low, high)} over {len(found.packed)} seeds" if len(found.packed) > 1 else ""
    unit, size = ("psi", PSI) if us else ("kPa", 1e3)
    text = [
        f"**{found.line.name}** by discrete elements: {found.concrete} at {3600 * found.flow:.4g} m3/h"
        f"{beside(us, 'yd3/h', found.flow)}",
        "",
        f"- pressure at the pump {both(us, 'bar', found.pressure)}{span}",
        *(f"- {remark}" for remark in found.remarks),
        "",
        f"| part | | friction, elements [{unit}] | "
        + "".join(f"{name} [{unit}] | " for name in others)
        + f"relative to straight pipe | weight [{unit}] | blocked |",
        "|" + "---|" * (6 + len(others)),
    ]
    rows = zip(found.line.parts, found.frictions(), found.weights(), found.blocked(), strict=True)
    for place, (part, friction, weight, blocked) in enumerate(rows):
        ratios = [
            each.ratios[part.loss_key] for each in found.packed if part.loss_key in each.ratios and part.factor is None
        ]
        shown = f"{np.mean(ratios):.2f}" if ratios else ""
        if len(ratios) > 1:
            shown += f" ± {np.std(ratios, ddof=1) / math.sqrt(len(ratios)):.2f}"
        cells = [f"{part.number}", part.label, f"{friction / size:.4g}"]
        cells += [f"{each[place] / size:.4g}" for each in others.values()]
        stuck = f"{blocked} of {len(found.packed)} seeds" if blocked else "no"
        text.append(f"| {' | '.join([*cells, shown, f'{weight / size:.4g}', stuck])} |")
    return text
