"""Fit of the slip layer and of the friction factor of bends to pressures measured along a trial line.

The pressures were measured at several places, at one or more flows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import SceneError, between, positive, refuse
from ...core.inputs.amounts import PSI, amount
from ...core.inputs.limits import check_limit, check_velocity
from ...core.inputs.text_files import read_columns
from ...core.units import quantity
from ...geometry.pipe_line import Part, PipeLine
from ...theory.fits import student_t
from ...theory.pipe import Concrete
from .answers import beside
from .fittings import MODEL_ERRORS, library_factor
from .losses import GRAVITY, straight_friction, with_layer_factor

NAMES = ("slip viscosity", "slip yield", "factor of bends")
UNITS = ("Pa s/m", "Pa", "")
COLUMNS = {"place": "m", "part": "1", "pressure": "Pa", "flow": "m3/s"}
"""Columns of a file of pressures that were measured along a pump line, with their SI units. One of two columns tells
where a gauge is: `place` is its distance from the pump along the line, and `part` is the number of the part of the line
before which it sits."""
SAME_FLOW = 0.02
"""Relative difference up to which two flows count as equal. Pressures that were all measured at the same flow do not
distinguish the yield stress of the slip layer from its viscosity."""
REVERSED = 1.1
"""Largest accepted ratio between the friction behind a tap and that behind a tap nearer to the pump, at the same flow.
The true ratio is below 1; the tolerance is for errors of gauges that are close to each other."""
DEPENDENT = 1e-3
"""Limit for the smallest singular value of the matrix of scaled sensitivities of the pressures to the fitted constants.
Below this limit, the measured pressures do not determine all constants, and one constant is removed from the fit."""
LEAST = (1e-2, -1.0, 0.0)
"""Limits that the fitted constants must exceed: slip viscosity [Pa s/m], yield stress of the slip layer [Pa], and
friction factor of bends. A fit in which a constant does not exceed its limit is refused as impossible."""
NOTHING = {1: 1e-3, 2: 0.0}
"""Limits below which a fitted constant cannot be distinguished from zero: yield stress of the slip layer [Pa] (index 1)
and friction factor of bends (index 2). Such a constant gets its default value."""
ITERATIONS = 50
"""Largest number of iterations of the least-squares fit."""


@dataclass(frozen=True)
class Tap:
    """Pressure that was measured at one place of a trial line."""

    place: float
    """Distance along the line from the pump to the place of the measurement [m]."""
    pressure: float
    """Measured pressure [Pa]."""
    flow: float
    """Volume flow in the line at which the pressure was measured [m3/s]."""
    row: int
    """Number of the text line from which the pressure was read in the file of measurements, for messages."""


@dataclass(frozen=True)
class FittedConstant:
    """Constant of the slip layer or the bends that was fitted to a trial line, with its 95 % confidence interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    fitted: bool
    """True if the measured pressures determine the constant. Otherwise the constant keeps the value that it had before
    the fit."""

    @property
    def text(self) -> str:
        """Name, value and confidence interval of the constant as text, or a remark that it was not determined."""
        unit = f" {self.unit}" if self.unit else ""
        if not self.fitted and not self.unit:
            return f"{self.name}: not determined by these points; each bend keeps the factor of the table"
        if not self.fitted:
            return f"{self.name} {self.value:.4g}{unit} (not determined by these points, kept)"
        return f"{self.name} {self.value:.4g}{unit} ({self.low:.4g} to {self.high:.4g})"


@dataclass(frozen=True)
class LineFit:
    """Slip layer and factor of bends that were fitted to pressures at taps, the places of gauges on a pump line."""

    taps: tuple[Tap, ...]
    constants: tuple[FittedConstant, ...]
    """Fitted constants in this order: the viscosity of the slip layer, its yield stress and, if the line has bends, the
    friction of bends divided by that of straight pipe."""
    pressures: tuple[float, ...]
    """Pressures at the taps (places of gauges) according to the fit [Pa], in the order of the taps."""
    uncertainty: float
    """Uncertainty of the friction of straight pipe: half the width of its 95 % confidence interval, divided by the
    friction."""

    @property
    def scatter(self) -> float:
        """Standard deviation of the measured pressures from the fitted pressures [Pa]."""
        off = self.deviations()
        return math.sqrt(float(off @ off) / (len(off) - sum(each.fitted for each in self.constants)))

    def deviations(self) -> np.ndarray:
        """Return the pressures of the fit minus the measured ones [Pa], shape (taps,)."""
        return np.array(self.pressures) - [tap.pressure for tap in self.taps]

    def concrete(self, concrete: Concrete) -> Concrete:
        """Return a copy of a concrete that has the fitted slip layer."""
        return replace(concrete, slip_viscosity=self.constants[0].value, slip_yield=self.constants[1].value)

    def variants(self, concrete: Concrete) -> dict[str, tuple[Concrete, Concrete]]:
        """Return two concretes, with the fitted slip layer at the lower and at the upper end of its uncertainty band.

        The result maps the cause of uncertainty, 'slip layer', to this pair. After a fit there is no other cause.
        """
        own = self.concrete(concrete)
        low, high = (with_layer_factor(own, x) for x in (1 / (1 + self.uncertainty), 1 + self.uncertainty))
        return {"slip layer": (low, high)}

    def line(self, line: PipeLine) -> PipeLine:
        """Return the line whose bends have the fitted factor.

        Bends whose factor the line's file states keep that factor.
        """
        bends = self.constants[2] if len(self.constants) > 2 else None
        if bends is None or not bends.fitted:
            return line

        def own(part: Part) -> Part:
            return replace(part, factor=bends.value, factor_range=(bends.low, bends.high)) if _is_free(part) else part

        return replace(line, parts=tuple(own(part) for part in line.parts))

    def record(self) -> dict[str, Any]:
        """Return the fit to the trial line as an entry of the file line.json."""
        return {
            "constants": {x.name: {"value": x.value, "low": x.low, "high": x.high, "unit": x.unit, "fitted": x.fitted}
                          for x in self.constants},
            "uncertainty": self.uncertainty,
            "scatter": quantity(self.scatter, "Pa"),
            "taps": [{"place": quantity(tap.place, "m"), "flow": quantity(tap.flow, "m3/s"),
                      "measured": quantity(tap.pressure, "Pa"), "fitted": quantity(fitted, "Pa")}
                     for tap, fitted in zip(self.taps, self.pressures, strict=True)],
        }  # fmt: skip


def read_taps(path: Path, line: PipeLine, flow: float | None = None) -> tuple[Tap, ...]:
    """Read pressures measured along a pump line from a CSV file.

    The header names columns with their units, such as `place [m],pressure [bar],flow [m3/h]`. Instead of the place of a
    gauge, the column `part` may give the number of the part before which the gauge sits. Without a column of flows, all
    pressures belong to the flow rate `flow` [m3/s]. Raises :class:`SceneError` for a missing column or an impossible
    number.
    """
    example = "write the first line in the form 'place [m],pressure [bar],flow [m3/h]'"
    columns, rows = read_columns(path, "fit")
    for name in columns:
        if name not in COLUMNS:
            refuse("fit", str(path), f"has an unknown column {name!r}", example)
    if ("place" in columns) == ("part" in columns):
        refuse("fit", str(path), "must have one of the columns 'place' and 'part'", example)
    for name in ("pressure", *(() if flow is not None else ("flow",))):
        if name not in columns:
            refuse("fit", str(path), f"has no column {name!r}", example)
    starts = np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])
    narrow = min(part.narrow for part in line.parts)
    found = []
    for row, cells in rows:
        values = {"flow": flow or 0.0}
        for name, (place, unit) in columns.items():
            field = f"{path.name}, line {row}: {name}"
            values[name] = amount(field, f"{cells[place].strip()} {unit}".strip(), COLUMNS[name])
            if name in ("pressure", "flow"):
                positive(field, values[name], COLUMNS[name], "leave out rows without pressure")
                check_limit(field, values[name], COLUMNS[name], name)
        if "part" in values:
            field, last = f"{path.name}, line {row}: part", len(line.parts)
            if values["part"] != int(values["part"]) or not 1 <= values["part"] <= last:
                refuse(field, values["part"], f"must be the number of a part, 1 to {last}")
            values["place"] = float(starts[int(values["part"]) - 1])
        field = f"{path.name}, line {row}: place"
        between(field, values["place"], 0.0, float(np.nextafter(starts[-1], 0.0)), "m",
                "'place' is the distance from the pump along the line, and must lie before the open end")  # fmt: skip
        check_velocity(f"{path.name}, line {row}: flow", values["flow"], 4 * values["flow"] / (math.pi * narrow**2))
        found.append(Tap(values["place"], values["pressure"], values["flow"], row))
    return tuple(found)


def _is_free(part: Part) -> bool:
    """Return True for a bend whose friction factor is fitted because the line's file states none."""
    return part.kind == "bend" and part.factor is None


class _Model:
    """Pressures at the taps (places of gauges) as functions of slip viscosity, slip yield stress and bend factor."""

    def __init__(self, line: PipeLine, concrete: Concrete, taps: Sequence[Tap], bends: bool = True) -> None:
        self.concrete, self.taps = concrete, taps
        starts = np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])
        self.kinds: dict[tuple[Any, ...], Part] = {}
        """For each kind of part, the first part of the pump line that is of this kind. A kind is a combination of bore,
        outlet and slip layer. The friction per metre of the first part is calculated once and holds for all parts of
        the kind."""
        self.metres: list[dict[tuple[Any, ...], list[float]]] = []
        """Two lengths of pipe between each tap and the end of the line [m], by the keys of `kinds`. A tap is the place
        of a gauge.

        The first length is that of straight pipe with the same friction as all parts whose factor is known. The second
        length is that of the bends whose factor is fitted.
        """
        self.rises: list[float] = []
        for tap in taps:
            own: dict[tuple[Any, ...], list[float]] = {}
            rise = 0.0
            for part, start in zip(line.parts, starts, strict=False):
                share = float(np.clip((start + part.length - tap.place) / part.length, 0.0, 1.0))
                kind = (part.diameter, part.outlet, part.layer)
                self.kinds.setdefault(kind, part)
                metres = own.setdefault(kind, [0.0, 0.0])
                # A bend whose factor is fitted counts as straight pipe here, because the fit later multiplies its
                # friction by the factor. All other parts have the same friction as in the calculation of a line without
                # a fit.
                weight = 1.0 if bends and _is_free(part) else library_factor(part)
                metres[bends and _is_free(part)] += share * part.length * part.relative * weight
                rise += share * part.rise
            self.metres.append(own)
            self.rises.append(rise)

    def pressures(self, constants: np.ndarray) -> np.ndarray:
        """Return the pressures at the taps (places of gauges) [Pa] for given constants, shape (taps,).

        The constants are the slip viscosity [Pa s/m], the slip yield stress [Pa] and the factor of bends.
        """
        concrete = replace(self.concrete, slip_viscosity=float(constants[0]), slip_yield=float(constants[1]))
        found = []
        for tap, metres, rise in zip(self.taps, self.metres, self.rises, strict=True):
            total = concrete.density * GRAVITY * rise
            for kind, (plain, bends) in metres.items():
                part = self.kinds[kind]
                total += straight_friction(part, concrete, tap.flow) / part.length * (plain + constants[2] * bends)
            found.append(total)
        return np.array(found)

    def sensitivities(self, constants: np.ndarray, free: Sequence[int]) -> np.ndarray:
        """Return the derivatives of the pressures at the taps (places of gauges) with respect to some constants.

        `free` holds the indices of these constants in `constants`. The result has the shape (taps, free).
        """
        here, steps = self.pressures(constants), (1e-4 * constants[0], max(1e-4 * constants[1], 1e-3), 1e-3)
        columns = []
        for place in free:
            moved = constants.copy()
            moved[place] += steps[place]
            columns.append((self.pressures(moved) - here) / steps[place])
        return np.array(columns).T


def fit_line(line: PipeLine, concrete: Concrete, taps: Sequence[Tap]) -> LineFit:
    """Fit the slip layer and the factor of bends to pressures along a pump line, by least squares.

    All pressures have the same weight. `concrete` supplies the density, the viscosity and the yield stress of the bulk.
    It also supplies the fitted constants that the pressures do not determine:

    - The yield stress of the layer, if all pressures were measured at a single flow. Such pressures do not distinguish
      it from the layer's viscosity.
    - The factor of bends, if the fraction of pipe behind the gauge that consists of bends is the same for all gauges.

    Raises :class:`SceneError` for too few measured points or an impossible result.
    """
    model = _Model(line, concrete, taps)
    measured = np.array([tap.pressure for tap in taps])
    flows = np.array([tap.flow for tap in taps])
    for tap, rise in zip(taps, model.rises, strict=True):
        if tap.pressure <= (weight := concrete.density * GRAVITY * rise):
            refuse(
                f"fit, line {tap.row}: pressure", tap.pressure,
                f"must exceed the weight of the concrete above the tap, {weight:.5g} Pa",
                "check the place of the gauge, its unit and zero point, and the density of the concrete",
            )  # fmt: skip
    _check_course(taps, measured - concrete.density * GRAVITY * np.array(model.rises))
    start = np.array([concrete.slip_viscosity, concrete.slip_yield, 1.0])
    bends = any(_is_free(part) for part in line.parts)
    free = [0]
    if len(taps) > 1 and np.ptp(flows) > SAME_FLOW * flows.mean():
        free.append(1)
    if bends and len(taps) > 1:
        free.append(2)
    free = _determined(model.sensitivities(start, free), free)
    if bends and 2 not in free:
        model = _Model(line, concrete, taps, bends=False)
    _check_count(taps, free)
    found = _least_squares(model, measured, start, free)
    for place, value in ((2, 1.0), (1, 0.0)):
        if place in free and found[place] < NOTHING[place]:
            # The measured pressures cannot distinguish this constant from zero. Give it its default value, and fit the
            # other constants again.
            free.remove(place)
            start[place] = value
            if place == 2:
                model = _Model(line, concrete, taps, bends=False)
            found = _least_squares(model, measured, start, free)
    _check_result(found, free)
    fitted = model.pressures(found)
    slopes = model.sensitivities(found, free)
    off = fitted - measured
    count = len(taps) - len(free)
    covariance = float(off @ off) / count * np.linalg.inv(slopes.T @ slopes)
    factor = student_t(count)
    widths = dict(zip(free, factor * np.sqrt(np.diag(covariance)), strict=True))
    constants = []
    for place in range(3 if bends else 2):
        value, wide = float(found[place]), float(widths.get(place, 0.0))
        constants.append(FittedConstant(NAMES[place], value, max(value - wide, 0.0), value + wide, UNITS[place],
                                        place in widths))  # fmt: skip
    # The errors of the slip layer's two constants are correlated. Therefore, calculate the error of the friction in
    # straight pipe from their covariance matrix.
    layer = [k for k, place in enumerate(free) if place < 2]
    pipe = _Model(_metre(line), concrete, [Tap(0.0, 1.0, float(flows.mean()), 0)])
    weights = pipe.sensitivities(found, [free[k] for k in layer])[0]
    wide = factor * math.sqrt(float(weights @ covariance[np.ix_(layer, layer)] @ weights))
    wide /= float(pipe.pressures(found)[0])
    return LineFit(tuple(taps), tuple(constants), tuple(fitted.tolist()), wide)


def _metre(line: PipeLine) -> PipeLine:
    """Return a line that consists of one metre of level pipe with the first diameter of the given line."""
    first = line.parts[0].diameter
    return replace(line, parts=(Part(1, "straight", first, 1.0, 0.0, first),))


def _determined(slopes: np.ndarray, free: list[int]) -> list[int]:
    """Return the first constants of `free`, as many as the measured pressures determine.

    `slopes` holds the derivatives of the pressures at the taps (places of gauges) with respect to these constants,
    shape (taps, free). As long as the columns of `slopes` are linearly dependent, the last constant is dropped together
    with its column.
    """
    while len(free) > 1:
        scaled = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
        if np.linalg.matrix_rank(scaled, tol=DEPENDENT) == len(free):
            break
        slopes, free = slopes[:, :-1], free[:-1]
    return free


def _check_count(taps: Sequence[Tap], free: Sequence[int]) -> None:
    """Refuse measured points that are too few to determine the fitted constants and their uncertainty."""
    if len(taps) <= len(free):
        names = " and ".join(filter(None, (", ".join(NAMES[k] for k in free[:-1]), NAMES[free[-1]])))
        counted = f"{len(taps)} point{'s' if len(taps) != 1 else ''}"
        refuse("fit", counted, f"must be at least {len(free) + 1} to determine {names} with a band",
               "measure at more places, or at other flows")  # fmt: skip


def _check_result(found: np.ndarray, free: Sequence[int]) -> None:
    """Refuse a fit that gave an impossible slip viscosity, slip yield or factor of bends."""
    for place in free:
        if not math.isfinite(found[place]) or found[place] <= LEAST[place]:
            unit = f" {UNITS[place]}" if UNITS[place] else ""
            raise SceneError(
                f"fit: the points give a {NAMES[place]} of {found[place]:.4g}{unit}, which is impossible; check "
                "places, flows, rise and diameters, the density, and the viscosity and yield stress of the concrete"
            )


def _check_course(taps: Sequence[Tap], friction: np.ndarray) -> None:
    """Refuse pressures that grow along the line at one flow; `friction` is that behind each tap [Pa]."""
    for near, before in zip(taps, friction, strict=True):
        for far, behind in zip(taps, friction, strict=True):
            same = abs(far.flow - near.flow) <= SAME_FLOW * near.flow
            if same and far.place > near.place and behind > REVERSED * before:
                refuse(f"fit, line {far.row}: pressure", far.pressure,
                       f"must be below that of line {near.row}, whose tap is nearer to the pump, by the weight and the "
                       "friction between both", "check the places of the gauges; they count from the pump")  # fmt: skip


def _least_squares(model: _Model, measured: np.ndarray, start: np.ndarray, free: Sequence[int]) -> np.ndarray:
    """Return the constants that minimise the sum of the squared pressure deviations, by damped Gauss-Newton steps."""
    own, places = start.copy(), list(free)
    off = model.pressures(own) - measured
    for _ in range(ITERATIONS):
        slopes = model.sensitivities(own, places)
        step = np.linalg.lstsq(slopes, -off, rcond=None)[0]
        size = 1.0
        while size > 1e-6:
            trial = own.copy()
            trial[places] += size * step
            if trial[0] > 0 and (trial[1] >= 0 or 1 not in places):
                moved = model.pressures(trial) - measured
                if moved @ moved <= off @ off:
                    break
            size /= 2
        else:
            break
        change = np.abs(trial - own) / np.maximum(np.abs(own), 1.0)
        own, off = trial, moved
        if change.max() < 1e-9:
            break
    return own


def fit_lines(fit: LineFit, line: PipeLine) -> list[str]:
    """Return a report on the fit as lines of Markdown.

    The report contains the fitted constants, the deviations from the measurements, entries that the user can copy into
    the files of the concrete and of the line, and a table of all measured pressures.
    """
    eta, tau, *bends = fit.constants
    off = fit.deviations()
    worst = int(np.argmax(np.abs(off)))
    measured = [tap.pressure for tap in fit.taps]
    found = [
        f"**Fit to {len(fit.taps)} taps of {line.name}** (least squares; bands of 95 %, Student's t)",
        "",
        *(f"- {each.text}" for each in fit.constants),
        f"- measured pressures scatter by {fit.scatter / 1e5:.2g} bar about the fit; the largest deviation is "
        f"{off[worst] / 1e5:+.2g} bar of {measured[worst] / 1e5:.4g} bar"
        f"{beside(line.customary, 'psi', measured[worst])} "
        f"(line {fit.taps[worst].row})",
        "",
        "Write into the section `mix` of the concrete's file (for this delivery; without `uncertainty`, the band is "
        "30 %, that of other deliveries):",
        "",
        f"    layer: {{viscosity: {eta.value:.4g} Pa s/m, yield_stress: {tau.value:.4g} Pa, "
        f"uncertainty: {min(max(100 * fit.uncertainty, 0.1), 90):.2g} %, from: pipe}}",
        "",
    ]
    low, high = MODEL_ERRORS["bend"].low, MODEL_ERRORS["bend"].high
    if bends and bends[0].fitted and bends[0].low <= low and bends[0].high >= high:
        found += [f"Leave out the factor of the bends: its band of {bends[0].low:.3g} to {bends[0].high:.3g} is wider "
                  f"than the {low:g} to {high:g} that published measurements found. Gauges close to both sides of many "
                  "bends would determine it.", ""]  # fmt: skip
    elif bends and bends[0].fitted:
        found += ["and for every bend of the line's file:", "", f"    factor: {bends[0].value:.3g}", ""]
        if not low <= bends[0].value <= high:
            share = sum(part.length for part in line.parts if part.kind == "bend") / line.length
            found += [f"The factor lies outside the {low:g} to {high:g} that published measurements found. Bends make "
                      f"{100 * share:.2g} % of the length of this line, so one wrong gauge or place explains such a "
                      "factor: check the taps before you use it.", ""]  # fmt: skip
    size, unit = (PSI, "psi") if line.customary else (1e5, "bar")
    found += [f"| place [m] | flow [m3/h] | measured [{unit}] | fitted [{unit}] | deviation [{unit}] |",
              "|---|---|---|---|---|"]  # fmt: skip
    for tap, fitted, each in zip(fit.taps, fit.pressures, off, strict=True):
        cells = (f"{tap.place:.4g}", f"{3600 * tap.flow:.4g}", f"{tap.pressure / size:.4g}", f"{fitted / size:.4g}",
                 f"{each / size:+.2g}")  # fmt: skip
        found.append(f"| {' | '.join(cells)} |")
    return found
