"""Slip layer of a mix: measured, or estimated from the composition, the viscosity or the slump of the concrete.

Pumped concrete slips on a thin layer of paste and fine mortar at the wall. The wall stress is the layer's yield stress
plus its viscosity times the slip velocity. This viscosity, in Pa s/m, is the viscosity of the layer's material divided
by the layer's thickness. The estimates hold for pipes of 100 to 150 mm. The uncertainty band of an estimate includes
the error of the relation from which it follows.
"""

from collections.abc import Iterator

from ..core.inputs.customary import both
from ..theory.fits import StraightLine, straight_line
from ..theory.laws import BINGHAM
from ..theory.pipe import Concrete, Line, measured_layer
from .entries import MixEntries
from .figures import Figure, line_uncertainty, of_line

TRIBOMETER_RATIO = (0.3, 2.0)
"""Smallest and largest ratio of a slip layer's constant from pipe pressures to the same constant from a tribometer.
They were found in 404 pipe flows of 22 concretes (Tavangar 2022)."""
PIPE_UNCERTAINTY = 0.3
"""Relative uncertainty of a slip layer's constants that were fitted to pipe pressures of an earlier delivery of the
same recipe. Deliveries differ by 15 % on a single site (Mai et al. 2014), and by -38 to +31 % in general (Deng et al.
2024)."""
PASTE_CONSTANT, PASTE_DENSEST = 128.0, 0.85
"""Constants of :func:`paste_layer`: the layer's viscosity without powder [Pa s/m], and the powder's densest packing.

The constants were chosen with frictions in level pump lines of 325 to 1,044 m for concretes of nine families
(water-binder ratios of 0.17 to 0.44), which a published statistical model of pumped concretes gives. Other families
were reserved for tests. The predicted frictions differ from these values by a factor of 1.33 (root mean square). The
best fit, about 150 Pa s/m and 0.95, would reduce this factor only to 1.31; many pairs of constants fit almost equally
well.
"""
PASTE_ERROR_FACTOR = 1.7
"""Factor by which the true viscosity of a slip layer may be smaller or larger than the result of :func:`paste_layer`.
For 90 % of the concretes to which this function was fitted, the difference is smaller."""
PASTE_YIELD = (10.0, 0.0, 50.0)
"""Yield stress of a slip layer that is estimated from the paste, and the lower and upper limit of its band [Pa]."""
THICKENER_FACTOR, THICKENER_ERROR = 3.0, 1.25
"""Factors for concrete with a viscosity-modifying admixture. THICKENER_FACTOR multiplies the viscosity of the slip
layer. THICKENER_ERROR widens its uncertainty band to both sides.

The first factor comes from the three concretes of Xu, Li & Jiang (2021), which contain such an admixture. Their wall
stress at 0.5 m/s is 2.9 to 3.1 times the wall stress by :func:`paste_layer`.
"""
AGGREGATE_DENSEST, FILM = 0.80, 3e-3
"""Constants of :func:`film_layer`: densest packing of sand and stones together, and thickness of the layer [m].
Measured thicknesses are 1 to 3 mm (Deng et al. 2024; Zhao et al. 2024). The layers of Xu, Li & Jiang (2021) correspond
to 6 mm."""
FILM_ERROR_FACTOR = 3.0
"""Factor by which the true viscosity of a slip layer may be larger or smaller than the result of :func:`film_layer`."""
SLUMP_ERROR_FACTOR = 2.0
"""Factor by which the true viscosity of a slip layer may be larger or smaller than the result of :func:`slump_layer`.
"""
ASSUMED = (850.0, 10.0)
"""Slip layer assumed if the mix contains no information on it: viscosity [Pa s/m] and yield stress [Pa]. The function
:func:`paste_layer` gives these values for a self-compacting concrete with 500 kg of powder in a cubic metre."""
ASSUMED_ERROR_FACTOR = 3.0
"""Factor by which the true viscosity of a slip layer may be larger or smaller than the value in :data:`ASSUMED`."""
ASSUMPTION, ESTIMATE = "assumption", "estimate from"
"""First words of the text that states the origin of a property that was not measured. ASSUMPTION means that the mix
contains no information on it. ESTIMATE means that it was estimated from the paste alone."""
OF_PASTE = "% of powder in the paste"
"""Last words of the text that states the origin of a slip layer that follows from the paste."""
Pair = tuple[Figure, Figure]


def paste_layer(solids: float) -> float:
    """Return the viscosity [Pa s/m] of a slip layer that consists of paste with a volume fraction `solids` of powder.

    The relation has the form of Krieger & Dougherty (1959) for spheres: 128 times (1 - solids / 0.85) to the power
    -2.125, which is -2.5 times 0.85.
    """
    return PASTE_CONSTANT * (1 - solids / PASTE_DENSEST) ** (-2.5 * PASTE_DENSEST)


def film_layer(viscosity: float, aggregate: float) -> float:
    """Return the viscosity [Pa s/m] of a slip layer that consists of the concrete's paste, without sand and stones.

    `viscosity` is the viscosity of the concrete [Pa s], and `aggregate` the volume fraction of sand and stones.
    Sand and stones raise the viscosity of the paste by the factor f = (1 - aggregate / 0.80)^(-2.5 0.80) (Krieger &
    Dougherty 1959). The result is viscosity / (f 3 mm), for a layer 3 mm thick.
    """
    return viscosity / (aggregate_factor(aggregate) * FILM)


def aggregate_factor(aggregate: float) -> float:
    """Return the factor by which a volume fraction `aggregate` of sand and stones raises the viscosity of paste.

    The relation was found by Krieger & Dougherty (1959).
    """
    return (1 - aggregate / AGGREGATE_DENSEST) ** (-2.5 * AGGREGATE_DENSEST)


def slump_layer(slump: float) -> tuple[float, float]:
    """Return the viscosity [Pa s/m] and the yield stress [Pa] of the slip layer from the `slump` [m].

    Both constants follow from the Chinese rule JGJ/T 10, which goes back to Morinaga (1973). For a pipe of radius r and
    the velocity v, the pressure loss by this rule is 2 / r (K1 + 1.3 K2 v) 0.9. Here K1 = 300 - slump [Pa] and K2 = 400
    - slump [Pa s/m], with the slump in millimetres. The yield stress of the layer is therefore 0.9 K1, and its
    viscosity is 0.9 times 1.3 K2.
    """
    return 0.9 * 1.3 * (400 - 1e3 * slump), 0.9 * max(300 - 1e3 * slump, 0.0)


def layers(given: MixEntries, concrete: Concrete, viscosity: Figure) -> Iterator[Pair]:
    """Generate estimates of the slip layer, each a pair of viscosity and yield stress, the most reliable one first.

    Estimates follow, in this order, from measurements of the layer, the composition of the paste, the viscosity of the
    concrete and its aggregate, the slump, and finally an assumption. If the mix lacks the data for an estimate, the
    estimate is left out. `concrete` supplies density, yield stress and viscosity of the bulk, and `viscosity` is the
    bulk's viscosity with its uncertainty band and origin.
    """
    yield from _measured(given, concrete)
    thick, blur = (THICKENER_FACTOR, THICKENER_ERROR) if given.thickener else (1.0, 1.0)
    more = f", times {thick:g} for a viscosity-modifying admixture (Xu, Li & Jiang 2021)" if given.thickener else ""
    if given.paste_solids is not None:
        value, error = thick * paste_layer(given.paste_solids), blur * PASTE_ERROR_FACTOR
        yield _pair(value, (value / error, value * error), PASTE_YIELD, concrete,
                    f"{100 * given.paste_solids:.3g} {OF_PASTE}",
                    f"128 (1 - solids / 0.85)^-2.125, fitted to level lines{more}")  # fmt: skip
    if (
        given.sand_and_stone is not None
        and given.sand_and_stone < 0.95 * AGGREGATE_DENSEST
        and not viscosity.way.startswith((ASSUMPTION, ESTIMATE))
        and concrete.bulk_law.name == BINGHAM
    ):
        ends = [film_layer(x, given.sand_and_stone) for x in (viscosity.value, viscosity.low, viscosity.high)]
        yield _pair(ends[0], (ends[1] / FILM_ERROR_FACTOR, ends[2] * FILM_ERROR_FACTOR), PASTE_YIELD, concrete,
                    f"viscosity, {100 * given.sand_and_stone:.3g} % of aggregate",
                    "paste between the aggregates, in a film of 3 mm")  # fmt: skip
    if given.slump is not None:
        value, stress = slump_layer(given.slump)
        error = SLUMP_ERROR_FACTOR * blur
        yield _pair(thick * value, (thick * value / error, thick * value * error),
                    (stress, stress / error, stress * error), concrete,
                    f"slump of {both(given.customary, 'mm', given.slump)}",
                    f"JGJ/T 10, after Morinaga 1973{more}")  # fmt: skip
    value, stress = ASSUMED
    error = ASSUMED_ERROR_FACTOR * blur
    yield _pair(
        thick * value, (thick * value / error, thick * value * error), (stress, 0.0, 5 * stress), concrete, ASSUMPTION,
        f"uncertain by a factor of {error:.3g}: state the parts of the mix, or measure the layer",
    )  # fmt: skip


def _measured(given: MixEntries, concrete: Concrete) -> Iterator[Pair]:
    """Generate the slip layers for which the mix states measurements.

    The measurements are constants of the layer, pressures of a pipe, or points of a tribometer.
    """
    own = given.layer
    if own.constants is not None:
        eta, tau = (own.constants.values[key] for key in ("viscosity", "yield_stress"))
        yield _pair_of(eta, tau, *_factors(own.constants.uncertainty, own.pipe), "layer",
                       "as given" + ("" if own.constants.uncertainty is not None else _SOURCES[own.pipe]))  # fmt: skip
    if own.pipe_points is not None:
        flows, pressures = own.pipe_points
        line = Line(radius=own.diameter / 2, length=own.length, rise=own.rise / own.length)
        way = f"{len(flows)} points of a pipe of {1e3 * own.diameter:g} mm"
        yield _fitted(measured_layer(concrete, line, flows, pressures), len(flows), way, True)
    if own.tribometer_points is not None:
        speeds, stresses = own.tribometer_points
        yield _fitted(straight_line(speeds, stresses), len(speeds), f"{len(speeds)} points of a tribometer", False)


_SOURCES = {
    True: "; 30 % for differences between deliveries",
    False: "; values from pipes are 0.3 to 2 times those from tribometers (Tavangar 2022)",
}
"""Explanations of the uncertainty band of a measured slip layer whose measurement states no uncertainty, for a layer
fitted to pipe pressures (key True) and one measured with a tribometer (key False)."""


def _factors(uncertainty: float | None, pipe: bool) -> tuple[float, float]:
    """Return the factors from a measured constant of the slip layer to the lower and the upper end of its band.

    The factors follow from the stated relative `uncertainty`. If it is None, they follow from the kind of the
    measurement, in a `pipe` or with a tribometer. For a pipe, the two factors are 1 / f and f, as for the band of a fit
    to a trial line.
    """
    if pipe:
        factor = 1 + (PIPE_UNCERTAINTY if uncertainty is None else uncertainty)
        return 1 / factor, factor
    return TRIBOMETER_RATIO if uncertainty is None else (1 - uncertainty, 1 + uncertainty)


def _pair_of(eta: float, tau: float, low: float, high: float, way: str, source: str) -> Pair:
    return (
        Figure("slip viscosity", eta, low * eta, high * eta, "Pa s/m", way, source),
        Figure("slip yield", tau, low * tau, high * tau, "Pa", way, source),
    )


def _pair(
    value: float,
    ends: tuple[float, float],
    stress: tuple[float, float, float],
    concrete: Concrete,
    way: str,
    source: str,
) -> Pair:
    """Return an estimated slip layer, a pair of viscosity and yield stress.

    `value` is the viscosity and `ends` its band [Pa s/m]. `stress` holds the yield stress and the lower and upper end
    of its band [Pa]. These three stresses are limited to the yield stress of the concrete, because the layer is
    concrete without stones. `way` names the entry of the mix from which the layer follows, and `source` the publication
    of the relation.
    """
    tau, low, high = (min(each, concrete.yield_stress) for each in stress)
    return (
        Figure("slip viscosity", value, *ends, "Pa s/m", way, source),
        Figure("slip yield", tau, low, high, "Pa", way, source),
    )


def _fitted(fit: StraightLine, count: int, way: str, pipe: bool) -> Pair:
    """Return a slip layer fitted to `count` points of a pipe or a tribometer.

    The uncertainty band of the layer covers both the error of the fit and the usual error of this kind of measurement.
    `way` describes the points in messages, and `pipe` is True for points of a pipe.
    """
    figures = []
    for name, value, error, unit in (
        ("slip viscosity", fit.slope, fit.slope_error, "Pa s/m"),
        ("slip yield", fit.offset, fit.offset_error, "Pa"),
    ):
        line = of_line(name, value, line_uncertainty(error, count, value, 0.0), unit, way, count)
        low, high = _factors(None, pipe)
        figures.append(Figure(name, value, min(line.low, low * value), max(line.high, high * value), unit, way,
                            f"straight line{_SOURCES[pipe]}"))  # fmt: skip
    return figures[0], figures[1]
