"""Fit of the slip layer and of the friction factor of bends to pressures measured along a trial line.

The pressures were measured at several places, at one or more flows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.errors import SceneError, refuse
from ...core.units import quantity
from ...geometry.pipe_line import Part, PipeLine
from ...theory.fits import student_t
from ...theory.pipe import Concrete
from .fittings import MODEL_ERRORS, library_factor
from .losses import GRAVITY, straight_friction, with_layer_factor
from .taps import Tap

NAMES = ("slip viscosity", "slip yield", "factor of bends")
UNITS = ("Pa s/m", "Pa", "")
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
NO_YIELD = "fitted without it, because the points would give a negative one"
NO_FACTOR = "not determined by these points, so fitted without it; each bend keeps the factor of the table"
"""Texts that tell why a fit left out a constant: NO_YIELD for a slip yield of zero, NO_FACTOR for the factor of
bends."""
SCALED = "not determined by these points; what was known before of the layer changes it like the viscosity"
"""Text on a slip yield that the measured pressures do not determine. What was known of the slip layer before the
measurement changes it in proportion to the slip viscosity."""
NOTHING = {1: 1e-3, 2: 0.0}
"""Limits below which a fitted constant cannot be distinguished from zero: yield stress of the slip layer [Pa] (index 1)
and friction factor of bends (index 2). Such a constant gets its default value."""
LAYER_FACTORS, BISECTIONS = (1e-6, 1e6), 60
"""Range of factors, and number of bisection steps, in the search for the factor by which a fitted slip layer is
multiplied to include what was known before the measurement."""
ITERATIONS = 50
"""Largest number of iterations of the least-squares fit."""


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
    reason: str = "not determined by these points, kept"
    """Explanation of the value of a constant that the measured pressures do not determine."""

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
    prior_share: float = 0.0
    """Weight in the slip layer of what was known of it before the measurement, between 0 and 1."""

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
            "prior_share": self.prior_share,
            "scatter": quantity(self.scatter, "Pa"),
            "taps": [{"place": quantity(tap.place, "m"), "flow": quantity(tap.flow, "m3/s"),
                      "measured": quantity(tap.pressure, "Pa"), "fitted": quantity(fitted, "Pa")}
                     for tap, fitted in zip(self.taps, self.pressures, strict=True)],
        }  # fmt: skip


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


def fit_line(
    line: PipeLine, concrete: Concrete, taps: Sequence[Tap], prior: tuple[Concrete, Concrete] | None = None
) -> LineFit:
    """Fit the slip layer and the factor of bends to pressures along a pump line, by least squares.

    All pressures have the same weight. `concrete` supplies the density, the viscosity and the yield stress of the bulk.
    It also supplies the fitted constants that the pressures do not determine:

    - The yield stress of the layer, if all pressures were measured at a single flow, or if there are only two. Such
      pressures do not distinguish it from the layer's viscosity.
    - The factor of bends, if its band is as wide as that of published measurements, or if the points are too few. It is
      then left out of the fit, and each bend has its factor of the table.

    `prior` holds the concrete with the slip layer at the lower and at the upper end of the band that it had before the
    measurement. With it, the friction of straight pipe becomes the mean of the fitted friction and that of `concrete`,
    weighted by the inverse squares of their bands, so that the band of a fit is narrower than both.

    Points with the same place, flow and pressure count once, because a repeated row makes the band narrower without a
    further measurement.

    Raises :class:`SceneError` for too few measured points or an impossible result.
    """
    different: dict[tuple[float, float, float], Tap] = {}
    for tap in taps:
        different.setdefault((tap.place, tap.flow, tap.pressure), tap)
    taps = tuple(different.values())
    _check_pressures(line, concrete, taps)
    fit = None
    if any(_is_free(part) for part in line.parts):
        # Errors of the gauges may give an impossible factor of bends, which raises an error. A fit without this factor
        # may still be possible.
        with suppress(SceneError):
            fit = _fitted(line, concrete, taps, factor=True)
    if fit is None or not _is_better_than_published(fit.constants[2]):
        fit = _fitted(line, concrete, taps, factor=False)
    return fit if prior is None else _combined(fit, line, concrete, prior)


def _is_better_than_published(factor: FittedConstant) -> bool:
    """Return whether a factor of bends was fitted with a narrower band than that of published measurements."""
    published = MODEL_ERRORS["bend"]
    return factor.fitted and factor.high - factor.low < published.high - published.low


def _check_pressures(line: PipeLine, concrete: Concrete, taps: Sequence[Tap]) -> None:
    """Refuse pressures that are too few, below the weight of the concrete, or that grow along the line."""
    if len(taps) < 2:
        counted = f"{len(taps)} different point{'s' if len(taps) != 1 else ''}"
        refuse(
            "fit",
            counted,
            "must be at least 2 to determine the slip viscosity with a band, 3 at two flows for the slip yield, and 4 "
            "at two places for the bends",
            "measure at more places, or at other flows",
        )
    rises = _Model(line, concrete, taps).rises
    for tap, rise in zip(taps, rises, strict=True):
        if tap.pressure <= (weight := concrete.density * GRAVITY * rise):
            refuse(
                f"fit, line {tap.row}: pressure", tap.pressure,
                f"must exceed the weight of the concrete above the tap, {weight:.5g} Pa",
                "check the place of the gauge, its unit and zero point, and the density of the concrete",
            )  # fmt: skip
    _check_course(taps, np.array([tap.pressure for tap in taps]) - concrete.density * GRAVITY * np.array(rises))


def _fitted(line: PipeLine, concrete: Concrete, taps: Sequence[Tap], factor: bool) -> LineFit:
    """Return the fit of those constants that the measured pressures determine.

    The friction factor of bends is among them only if `factor` is True.
    """
    model = _Model(line, concrete, taps, bends=factor)
    measured = np.array([tap.pressure for tap in taps])
    flows = np.array([tap.flow for tap in taps])
    start = np.array([concrete.slip_viscosity, concrete.slip_yield, 1.0])
    free = [0]
    if len(taps) > 2 and np.ptp(flows) > SAME_FLOW * flows.mean():
        free.append(1)
    if factor and len(taps) > len(free) + 1:
        free.append(2)
    free = _determined(model.sensitivities(start, free), free)
    if 2 not in free:
        model = _Model(line, concrete, taps, bends=False)
    found = _least_squares(model, measured, start, free)
    reasons = {2: NO_FACTOR}
    for place, value in ((2, 1.0), (1, 0.0), (2, 1.0)):
        if place in free and found[place] < NOTHING[place]:
            # The measured pressures cannot distinguish this constant from zero. Give it its default value, and fit the
            # other constants again.
            free.remove(place)
            start[place] = value
            if place == 2:
                model = _Model(line, concrete, taps, bends=False)
            else:
                reasons[1] = NO_YIELD
            found = _least_squares(model, measured, start, free)
    _check_result(found, free)
    fitted = model.pressures(found)
    slopes = model.sensitivities(found, free)
    off = fitted - measured
    count = len(taps) - len(free)
    covariance = float(off @ off) / count * np.linalg.inv(slopes.T @ slopes)
    student = student_t(count)
    widths = dict(zip(free, student * np.sqrt(np.diag(covariance)), strict=True))
    constants = []
    for place in range(3 if any(_is_free(part) for part in line.parts) else 2):
        value, wide = float(found[place]), float(widths.get(place, 0.0))
        reason = {"reason": reasons[place]} if place in reasons else {}
        constants.append(FittedConstant(NAMES[place], value, max(value - wide, 0.0), value + wide, UNITS[place],
                                        place in widths, **reason))  # fmt: skip
    # The errors of the slip layer's two constants are correlated. Therefore, calculate the error of the friction in
    # straight pipe from their covariance matrix.
    layer = [k for k, place in enumerate(free) if place < 2]
    pipe = _metre_model(line, concrete, taps)
    weights = pipe.sensitivities(found, [free[k] for k in layer])[0]
    wide = student * math.sqrt(float(weights @ covariance[np.ix_(layer, layer)] @ weights))
    wide /= float(pipe.pressures(found)[0])
    return LineFit(tuple(taps), tuple(constants), tuple(fitted.tolist()), wide)


def _combined(fit: LineFit, line: PipeLine, concrete: Concrete, prior: tuple[Concrete, Concrete]) -> LineFit:
    """Return a fit whose slip layer also counts what was known of it before the measurement.

    Both pieces of knowledge are bands of the logarithm of the friction in straight pipe at the mean flow. The fitted
    constants of the layer are multiplied by one factor such that this friction is the weighted mean.
    """
    pipe = _metre_model(line, concrete, fit.taps)
    own = np.array([fit.constants[0].value, fit.constants[1].value, 1.0])

    def friction(constants: np.ndarray) -> float:
        return float(pipe.pressures(constants)[0])

    def constants_of(each: Concrete) -> np.ndarray:
        return np.array([each.slip_viscosity, each.slip_yield, 1.0])

    before = friction(constants_of(concrete))
    wide_before = 0.5 * math.log(friction(constants_of(prior[1])) / friction(constants_of(prior[0])))
    wide = math.log1p(fit.uncertainty)
    share = wide**2 / (wide**2 + wide_before**2) if wide_before > 0 else 0.0
    wanted = friction(own) * (before / friction(own)) ** share
    low, high = LAYER_FACTORS
    for _ in range(BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if friction(own * [middle, middle, 1.0]) < wanted else (low, middle)
    factor = math.sqrt(low * high)
    narrower = math.sqrt(1 - share)
    layer = [replace(each, value=factor * each.value,
                     low=factor * (each.value + narrower * (each.low - each.value)),
                     high=factor * (each.value + narrower * (each.high - each.value)),
                     reason=each.reason if each.fitted or share == 0 or each.value == 0 else SCALED)
             for each in fit.constants[:2]]  # fmt: skip
    constants = (*layer, *fit.constants[2:])
    bends = constants[2] if len(constants) > 2 else None
    model = _Model(line, concrete, fit.taps, bends=bends is not None and bends.fitted)
    at = np.array([layer[0].value, layer[1].value, 1.0 if bends is None else bends.value])
    return replace(fit, constants=constants, pressures=tuple(model.pressures(at).tolist()),
                   uncertainty=math.expm1(wide * narrower), prior_share=share)  # fmt: skip


def _metre_model(line: PipeLine, concrete: Concrete, taps: Sequence[Tap]) -> _Model:
    """Return a model of one metre of level pipe with the line's first diameter, at the mean flow of the taps."""
    first = line.parts[0].diameter
    metre = replace(line, parts=(Part(1, "straight", first, 1.0, 0.0, first),))
    return _Model(metre, concrete, [Tap(0.0, 1.0, float(np.mean([tap.flow for tap in taps])), 0)])


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
