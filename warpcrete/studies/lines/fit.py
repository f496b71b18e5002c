"""Fit of the slip layer and of the friction factor of bends to pressures measured along a trial line.

The pressures were measured at several places (taps), at one or more flows. The factor of bends is the friction of a
bend, divided by the friction of straight pipe of the same length.
"""

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from ...core.errors import SceneError, refuse
from ...geometry.line_entries import FACTORS
from ...geometry.pipe_line import PipeLine
from ...mps.common.mixes import LAW_DEFAULTS
from ...theory.fits import student_t
from ...theory.pipe import Concrete
from .fit_band import of_layer, with_expected, with_gauges, with_known
from .fit_flows import known_yields, with_later_use, with_yields
from .fittings import MODEL_ERRORS
from .line_fit import NO_YIELD, FittedConstant, LineFit
from .losses import GRAVITY
from .tap_model import TapModel, least_squares, metre_model
from .taps import SAME_FLOW, Tap, at_one_flow, is_free

NAMES = ("slip viscosity", "slip yield", "factor of bends")
UNITS = ("Pa s/m", "Pa", "")
REVERSED = 1.1
"""Largest accepted ratio of a gauge's friction to the friction of a gauge nearer to the pump, at the same flow. The
friction of a gauge is the pressure loss due to friction from the gauge to the end of the line. The true ratio is below
1; the measured one may be larger if the gauges have errors and are close to each other."""
DEPENDENT = 1e-3
"""Limit for the smallest singular value of the matrix of scaled sensitivities of the pressures to the fitted constants.
Below this limit, the measured pressures do not determine all constants, and one constant is removed from the fit."""
LEAST = (1e-2, -1.0, 0.0)
"""Limits that the fitted constants must exceed: slip viscosity [Pa s/m], yield stress of the slip layer [Pa], and
friction factor of bends. A fit in which a constant does not exceed its limit is refused as impossible."""
NO_SLIP = 1e6
"""Slip viscosity [Pa s/m] at which concrete practically sticks to the wall. Slip layers have 100 to 10000 Pa s/m. A
larger fitted value hardly changes the friction any more, so it means that no slip layer explains the pressures."""
NO_FACTOR = "not determined by these points, so left out of the fit; each bend keeps the factor of the table"
"""Reason why the friction factor of bends was left out of a fit."""
NOTHING = {1: 1e-3, 2: FACTORS[0]}
"""Limits below which a fitted constant counts as indistinguishable from zero, by the index of the constant: 1 is the
yield stress of the slip layer [Pa], and 2 is the factor of bends. A constant below its limit is left out of the fit."""
GAUGE = 0.04
"""Default error limit of a gauge, divided by the largest measured pressure. The largest permissible error of a gauge of
class 2.5 is 2.5 % of the end of its scale (EN 837-1), and this end is assumed at 1.6 times the largest pressure."""
READING = 0.25
"""Assumed standard deviation of single readings of a gauge, divided by the error limit of the gauge. It is the error
that differs from reading to reading, for example because the pressure pulsates. With the default limit of 4 %, it is
1 % of the largest pressure."""
ASSUMED_READINGS = 3
"""Weight of the assumed scatter (:data:`READING`) when it is averaged with the measured scatter of the readings, as an
equivalent number of readings. The assumed scatter is needed because a few readings may agree by chance."""


def fit_line(
    line: PipeLine,
    concrete: Concrete,
    taps: Sequence[Tap],
    prior: tuple[Concrete, Concrete] | None = None,
    gauge: float | None = None,
    yields: tuple[float, float] | None = None,
) -> LineFit:
    """Fit the slip layer and the factor of bends to pressures along a pump line, by least squares.

    All pressures have the same weight. `concrete` supplies the density, the viscosity and the yield stress of the bulk.
    A constant that the pressures do not determine is left out of the fit:

    - The yield stress of the layer keeps its value in `concrete` if all pressures were measured at a single flow, or if
      there are only two pressures, because these do not distinguish it from the layer's viscosity. It also keeps its
      value if its error would exceed half the range of :func:`.known_yields`.
    - The friction factor of bends is left out in three cases: the points are too few; its band would be as wide as the
      band of published measurements (unless only a fitted factor makes the gauges agree with each other); or the band
      of the layer is narrower without it, because the gauges hardly distinguish bends from the layer. Each bend then
      keeps its factor from the table of simulated bends, and the band of the layer contains the effect of published
      factors. If a fit without this factor is impossible, the factor is fitted.

    `prior` describes the slip layer that was expected before the measurement: two concretes, whose layers are at the
    lower and at the upper end of the layer's uncertainty band. :func:`.with_known` combines it with the fit. If no slip
    layer explains all gauges, the band is widened until it contains their readings (:func:`.with_gauges`).

    `gauge` is the error limit of a gauge [Pa], by default 4 % of the largest pressure. All readings of a gauge have the
    same error, and each reading has a further error, which follows from the scatter (:func:`_squares`). If `gauge` is
    0, all deviations from the fit count as scatter.

    `yields` is the range of the layer's yield stress that the mix states [Pa]. The band at other flows follows from the
    error of the fitted yield stress, or from this range if the yield stress was not fitted (:func:`.with_yields`).

    Points with the same place, flow and pressure count once, because a row that occurs twice in the file is not a
    second measurement.

    Raises :class:`SceneError` for too few measured points or an impossible result.
    """
    different: dict[tuple[float, float, float], Tap] = {}
    for tap in taps:
        different.setdefault((tap.place, tap.flow, tap.pressure), tap)
    taps = tuple(different.values())
    _check_pressures(line, concrete, taps)
    if gauge is None:
        gauge = GAUGE * max(tap.pressure for tap in taps)
    low, high = known_yields(concrete)
    widest = 0.5 * (high - low)

    def finished(fit: LineFit) -> LineFit:
        if prior is not None:
            fit = with_known(fit, line, concrete, prior)
        fit = with_expected(with_gauges(fit, line, concrete), line, concrete, prior)
        return with_later_use(with_yields(fit, line, concrete, yields), line, concrete)

    with_bends = None
    if any(is_free(part) for part in line.parts):
        # Errors of the gauges may lead to an impossible factor of bends, which raises an error. Ignore this error, and
        # keep the fit without this factor.
        with suppress(SceneError):
            with_bends = _fitted(line, concrete, taps, True, gauge, widest)
    if with_bends is not None and not with_bends.constants[2].fitted:
        with_bends = None
    try:
        by_table = finished(_fitted(line, concrete, taps, False, gauge, widest))
    except SceneError:
        # The friction of bends may exceed the value in the table so much that no slip layer explains the readings.
        if with_bends is None:
            raise
        return finished(with_bends)
    if with_bends is None:
        return by_table
    better = _is_better_than_published(with_bends.constants[2])
    if not better and by_table.contradiction is None:
        return by_table
    with_bends = finished(with_bends)
    if not better and with_bends.contradiction is not None:
        return by_table
    return min(by_table, with_bends, key=lambda fit: fit.width)


def _is_better_than_published(factor: FittedConstant) -> bool:
    """Return whether the band of a fitted factor of bends is narrower than the band of published measurements."""
    published = MODEL_ERRORS["bend"]
    return factor.high - factor.low < published.high - published.low


def _check_pressures(line: PipeLine, concrete: Concrete, taps: Sequence[Tap]) -> None:
    """Refuse measured pressures if they are too few, below the weight of the concrete, or grow along the line."""
    if len(taps) < 2:
        counted = f"{len(taps)} different point{'s' if len(taps) != 1 else ''}"
        refuse(
            "fit",
            counted,
            "is too few: the viscosity of the slip layer needs 2 points, its yield stress needs 3 points at two or "
            "more flows, and the friction of bends needs 4 points at two or more places",
            "measure at more places, or at other flows",
        )
    rises = TapModel(line, concrete, taps).rises
    for tap, rise in zip(taps, rises, strict=True):
        if tap.pressure <= (weight := concrete.density * GRAVITY * rise):
            problem = f"must exceed the weight of the concrete above the tap, {weight:.5g} Pa"
            hint = "check the place of the gauge, its unit and zero point, and the density of the concrete"
            refuse(f"fit, line {tap.row}: pressure", tap.pressure, problem, hint)
    _check_course(taps, np.array([tap.pressure for tap in taps]) - concrete.density * GRAVITY * np.array(rises))


def _fitted(
    line: PipeLine, concrete: Concrete, taps: Sequence[Tap], factor: bool, gauge: float, widest: float
) -> LineFit:
    """Return a fit of the constants that the measured pressures determine.

    The friction factor of bends is fitted only if `factor` is True, and the yield stress of the slip layer only if its
    error is at most `widest` [Pa]. `gauge` is the error limit of a gauge [Pa].
    """
    model = TapModel(line, concrete, taps, bends=factor)
    measured = np.array([tap.pressure for tap in taps])
    start = np.array([concrete.slip_viscosity, concrete.slip_yield, 1.0])
    free = [0]
    if len(taps) > 2 and not at_one_flow(taps):
        free.append(1)
    if factor and len(taps) > len(free) + 1:
        free.append(2)
    free = _determined(model.sensitivities(start, free), free)
    if 2 not in free:
        model = TapModel(line, concrete, taps, bends=False)
    error = 0.0
    if 1 in free:
        error = _yield_error(model, measured, start, free, gauge)
        if error > widest:
            free.remove(1)
    solution = least_squares(model, measured, start, free)
    reasons = {2: NO_FACTOR}
    for place, value in ((2, 1.0), (1, 0.0), (2, 1.0)):
        if place in free and solution[place] < NOTHING[place]:
            # The measured pressures cannot distinguish this constant from zero. Fit the other constants again, with a
            # yield stress of zero, or with the factors of bends from the table.
            free.remove(place)
            start[place] = value
            if place == 2:
                model = TapModel(line, concrete, taps, bends=False)
            else:
                reasons[1] = NO_YIELD
            solution = least_squares(model, measured, start, free)
    _check_result(solution, free, concrete)
    fitted = model.pressures(solution)
    slopes = model.sensitivities(solution, free)
    squares = _squares(fitted - measured, slopes, taps, gauge)
    covariance = _covariance(slopes, squares)
    widths = dict(zip(free, np.sqrt(np.diag(covariance)), strict=True))
    constants = []
    for place in range(3 if any(is_free(part) for part in line.parts) else 2):
        value, wide = float(solution[place]), float(widths.get(place, error if reasons.get(place) == NO_YIELD else 0.0))
        reason = {"reason": reasons[place]} if place in reasons else {}
        constants.append(FittedConstant(NAMES[place], value, max(value - wide, 0.0), value + wide, UNITS[place],
                                        place in widths, **reason))  # fmt: skip
    # The errors of the slip layer's two constants are correlated. Therefore, calculate the error of the friction in
    # straight pipe from their covariance matrix.
    layer = [k for k, place in enumerate(free) if place < 2]
    pipe = metre_model(line, concrete, taps)
    weights = pipe.sensitivities(solution, [free[k] for k in layer])[0]
    with_friction = covariance[np.ix_(layer, layer)] @ weights
    square, friction = float(weights @ with_friction), float(pipe.pressures(solution)[0])
    wide = math.sqrt(square) / friction
    slope, deviation = None, 0.0
    if 1 in free and square > 0:
        slope = friction * float(with_friction[1]) / square
        deviation = math.sqrt(max(float(covariance[1, 1]) - float(with_friction[1]) ** 2 / square, 0.0))
    slip = {key: getattr(concrete, f"slip_{key}") for key in ("flow_index", "quadratic_viscosity")}
    laws = {key: value for key, value in slip.items() if value != LAW_DEFAULTS[key]}
    fit = LineFit(tuple(taps), tuple(constants), tuple(fitted.tolist()), wide, wide, gauge, laws=laws,
                  yield_slope=slope, yield_deviation=deviation)  # fmt: skip
    return of_layer(fit, line, concrete)


def _squares(off: np.ndarray, slopes: np.ndarray, taps: Sequence[Tap], gauge: float) -> np.ndarray:
    """Return the covariance matrix of the errors of measured pressures [Pa2], shape (taps, taps).

    The entries contain 95 % error limits in place of standard deviations, so that the fitted constants also get 95 %
    limits. `off` holds the deviations of the pressures from the fit [Pa], shape (taps,), and `slopes` the derivatives
    of the pressures with respect to the fitted constants, shape (taps, constants).

    There are two errors. The error `gauge` [Pa] is the same for all readings at one place. The second error is
    independent for each reading. It follows from the scatter of the readings about a fit in which the error of each
    gauge is fitted as well, so that the first error does not count twice. The assumed scatter :data:`READING` counts as
    :data:`ASSUMED_READINGS` additional readings.
    """
    places = np.array([tap.place for tap in taps])
    same = (places[:, None] == places).astype(float)
    known = ASSUMED_READINGS if gauge > 0 else 0
    explained = np.hstack([slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300), same]) if gauge > 0 else slopes
    count = len(taps) - int(np.linalg.matrix_rank(explained, tol=DEPENDENT * np.sqrt(len(taps))))
    rest = off - explained @ np.linalg.pinv(explained, rcond=DEPENDENT) @ off
    variance = (known * (READING * gauge) ** 2 + float(rest @ rest)) / (known + count)
    return gauge**2 * same + student_t(known + count) ** 2 * variance * np.eye(len(taps))


def _covariance(slopes: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Return the covariance matrix of the fitted constants, shape (constants, constants).

    `slopes` holds the derivatives of the pressures with respect to the constants, shape (taps, constants), and
    `squares` the covariance matrix of the pressures [Pa2], shape (taps, taps).
    """
    inverse = np.linalg.pinv(slopes)
    return inverse @ squares @ inverse.T


def _yield_error(model: TapModel, measured: np.ndarray, start: np.ndarray, free: Sequence[int], gauge: float) -> float:
    """Return the 95 % error limit [Pa] that the yield stress of the slip layer would have after a fit.

    `free` holds the indices of the fitted constants, among them the yield stress. The other constants are fitted first
    to the `measured` pressures [Pa], with `start` as initial values. The error is then estimated from the linearised
    model at this fit. A fit of the yield stress itself could fail if the flows hardly differ. `gauge` is the error
    limit of a gauge [Pa].
    """
    constants = least_squares(model, measured, start, [place for place in free if place != 1])
    slopes = model.sensitivities(constants, free)
    off = model.pressures(constants) - measured
    off -= slopes @ np.linalg.lstsq(slopes, off, rcond=None)[0]
    own = list(free).index(1)
    return math.sqrt(float(_covariance(slopes, _squares(off, slopes, model.taps, gauge))[own, own]))


def _determined(slopes: np.ndarray, free: list[int]) -> list[int]:
    """Return those constants that the measured pressures determine, as a list of indices.

    `free` holds the indices of all constants that could be fitted, and `slopes` the derivatives of the pressures at the
    taps (places of gauges) with respect to these constants, shape (taps, free). The last constant is dropped until the
    columns of `slopes` are linearly independent.
    """
    while len(free) > 1:
        scaled = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
        if np.linalg.matrix_rank(scaled, tol=DEPENDENT) == len(free):
            break
        slopes, free = slopes[:, :-1], free[:-1]
    return free


def _check_result(constants: np.ndarray, free: Sequence[int], concrete: Concrete) -> None:
    """Raise :class:`SceneError` if a fitted constant is impossible.

    `constants` holds the slip viscosity, the slip yield stress and the factor of bends, and `free` the indices of those
    that were fitted. A slip viscosity above :data:`NO_SLIP` is impossible, as is a fitted constant at or below its
    limit in :data:`LEAST`.
    """
    if constants[0] > NO_SLIP:
        raise SceneError(
            "fit: the measured friction is larger than that of a concrete without slip at the wall that has a "
            f"viscosity of {concrete.viscosity:.4g} Pa s and a yield stress of {concrete.yield_stress:.4g} Pa; check "
            "that the gauges show the pressure of the concrete and not of the oil, and check their unit and places, "
            "the flows, and the viscosity of the concrete"
        )
    for place in free:
        if not math.isfinite(constants[place]) or constants[place] <= LEAST[place]:
            unit = f" {UNITS[place]}" if UNITS[place] else ""
            raise SceneError(
                f"fit: the measured pressures give a {NAMES[place]} of {constants[place]:.4g}{unit}, which is "
                "impossible; check the places of the gauges, the flows, the rise and diameters of the line, and the "
                "density, viscosity and yield stress of the concrete"
            )


def _check_course(taps: Sequence[Tap], friction: np.ndarray) -> None:
    """Refuse pressures that grow along the line at one flow.

    `friction` is the friction between the place of each gauge and the end of the line [Pa].
    """
    for near, before in zip(taps, friction, strict=True):
        for far, behind in zip(taps, friction, strict=True):
            same = abs(far.flow - near.flow) <= SAME_FLOW * near.flow
            if same and far.place > near.place and behind > REVERSED * before:
                refuse(f"fit, line {far.row}: pressure", far.pressure,
                       f"is too high compared with line {near.row} of the file, whose tap is nearer to the pump: "
                       "between the two taps, the pressure must fall by the weight and the friction of the concrete",
                       "check the places of the gauges; they count from the pump")  # fmt: skip
