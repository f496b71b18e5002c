"""Slip layer of a mix: measured, or estimated from the composition, the viscosity or the slump of the concrete.

Pumped concrete slips on a thin layer of paste and fine mortar at the wall. The wall stress is the layer's yield stress
plus its viscosity times the slip velocity. This viscosity is that of the material divided by the thickness of the
layer, in Pa s/m. The estimates hold for pipes of 100 to 150 mm. The uncertainty band of an estimate includes the error
of the relation from which it follows.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..theory.fits import StraightLine, straight_line
from ..theory.laws import BINGHAM
from ..theory.pipe import Concrete, Line, measured_layer
from .figures import Figure, line_uncertainty, of_line
from .given import MixEntries

TRIBOMETER_RATIO = (0.3, 2.0)
"""Range of the ratio between two values of the slip layer's constants. The first value follows from pipe pressures, and
is divided by the second value, which was measured with a tribometer. The range covers 404 pipe flows of 22 concretes
(Tavangar 2022)."""
PIPE_UNCERTAINTY = 0.3
"""Relative uncertainty of a slip layer that was fitted to pipe pressures of an earlier delivery of the same recipe. Mai
et al. (2014) found that deliveries differ by 15 % on a single site. Over all, the difference is larger: Deng et al.
(2024) found -38 to +31 %."""
PASTE_CONSTANT, PASTE_DENSEST = 128.0, 0.85
"""Constants of the relation in :func:`paste_layer`: the layer's viscosity without powder [Pa s/m], and the densest
packing of the powder. Both come from the pressures of the nine families of concretes in level lines that are not held
out of fits (325 to 1,044 m, water-binder ratios of 0.17 to 0.44). The root mean square of the factor between predicted
and measured friction is 1.33 there. The best constants, about 150 Pa s/m and 0.95, would give 1.31; they fit hardly
better, because powder-poor and powder-rich families leave a narrow valley of equally good pairs."""
PASTE_ERROR_FACTOR = 1.7
"""Factor by which the layer of a mix may be weaker or stronger than :func:`paste_layer` predicts. For 90 % of the
concretes in the fitted families, the difference is smaller."""
PASTE_YIELD = (10.0, 0.0, 50.0)
"""Yield stress of a slip layer that is estimated from the composition of the paste, with the lower and the upper limit
of its band [Pa]."""
THICKENER_FACTOR, THICKENER_ERROR = 3.0, 1.25
"""Factors for a viscosity-modifying admixture: on the resistance of the slip layer, and on the ends of its band.

The uncertainty band becomes wider in both directions by the second factor. The first factor comes from the three
concretes of Xu, Li & Jiang (2021), which contain such an admixture. Their wall stress at 0.5 m/s is 2.9 to 3.1 times
that of :func:`paste_layer`.
"""
AGGREGATE_DENSEST, FILM = 0.80, 3e-3
"""Constants of :func:`film_layer`: densest packing of sand and stones together, and thickness of the layer [m].
Measured thicknesses are 1 to 3 mm (Deng et al. 2024; Zhao et al. 2024). The layers of Xu, Li & Jiang (2021) correspond
to 6 mm."""
FILM_ERROR_FACTOR = 3.0
"""Factor by which the true viscosity of a layer may be larger or smaller than that of :func:`film_layer`."""
SLUMP_ERROR_FACTOR = 2.0
"""Factor by which the viscosity of the true slip layer may be higher or lower than the one that :func:`slump_layer`
returns."""
ASSUMED = (850.0, 10.0)
"""Layer assumed if the mix determines none: viscosity [Pa s/m] and yield stress [Pa] of a self-compacting concrete with
500 kg of powder in a cubic metre, by :func:`paste_layer`."""
ASSUMED_ERROR_FACTOR = 3.0
"""Factor by which the viscosity of the true slip layer may be higher or lower than that of :data:`ASSUMED`."""
ASSUMPTION, ESTIMATE = "assumption", "estimate from"
"""First words of the text that states the origin of a property without a measurement. The first text is for a property
that is assumed, because the mix contains no information on it. The second text is for a property that was estimated
from the paste alone."""
Pair = tuple[Figure, Figure]


def paste_layer(solids: float) -> float:
    """Return the viscosity [Pa s/m] of a slip layer that consists of paste with a volume fraction `solids` of powder.

    The relation has the form of Krieger & Dougherty (1959) for spheres: 128 times (1 - solids / 0.85) to the power
    -2.125, which is -2.5 times 0.85.
    """
    return PASTE_CONSTANT * (1 - solids / PASTE_DENSEST) ** (-2.5 * PASTE_DENSEST)


def film_layer(viscosity: float, aggregate: float) -> float:
    """Return the layer's viscosity [Pa s/m], as if the layer were the paste between the aggregates.

    `viscosity` is the concrete's [Pa s], and `aggregate` the share of sand and stones in its volume. Aggregate thickens
    the paste by f = (1 - aggregate / 0.80)^(-2.5 0.80) (Krieger & Dougherty 1959); the layer is 3 mm thick.
    """
    return viscosity / (aggregate_factor(aggregate) * FILM)


def aggregate_factor(aggregate: float) -> float:
    """Return the factor by which a share of sand and stones thickens paste (Krieger & Dougherty 1959)."""
    return (1 - aggregate / AGGREGATE_DENSEST) ** (-2.5 * AGGREGATE_DENSEST)


def slump_layer(slump: float) -> tuple[float, float]:
    """Return the viscosity [Pa s/m] and the yield stress [Pa] of the slip layer from the `slump` [m].

    They follow from the Chinese rule JGJ/T 10, which goes back to Morinaga (1973). For a pipe of radius r and the
    velocity v, the pressure loss by this rule is 2 / r (K1 + 1.3 K2 v) 0.9. Here K1 = 300 - slump [Pa] and K2 = 400 -
    slump [Pa s/m], with the slump in millimetres.
    """
    return 0.9 * 1.3 * (400 - 1e3 * slump), 0.9 * max(300 - 1e3 * slump, 0.0)


def layers(given: MixEntries, concrete: Concrete, viscosity: Figure) -> Iterator[Pair]:
    """Generate pairs of viscosity and yield stress of the slip layer, the most reliable pair first.

    The pairs come from measurements of the layer, the paste, the film between aggregates, the slump, and finally from
    an assumption. Sources about which the mix contains nothing are skipped. `concrete` supplies density, yield stress
    and viscosity of the bulk, and `viscosity` is the bulk's viscosity with its band and origin.
    """
    yield from _measured(given, concrete)
    thick, blur = (THICKENER_FACTOR, THICKENER_ERROR) if given.thickener else (1.0, 1.0)
    more = f", times {thick:g} for a viscosity-modifying admixture (Xu, Li & Jiang 2021)" if given.thickener else ""
    if given.paste_solids is not None:
        value, error = thick * paste_layer(given.paste_solids), blur * PASTE_ERROR_FACTOR
        yield _pair(value, (value / error, value * error), PASTE_YIELD, concrete,
                    f"{100 * given.paste_solids:.3g} % of powder in the paste",
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
                    f"slump of {1e3 * given.slump:.4g} mm", f"JGJ/T 10, after Morinaga 1973{more}")  # fmt: skip
    value, stress = ASSUMED
    error = ASSUMED_ERROR_FACTOR * blur
    yield _pair(
        thick * value, (thick * value / error, thick * value * error), (stress, 0.0, 5 * stress), concrete, ASSUMPTION,
        f"uncertain by a factor of {error:.3g}: state the parts of the mix, or measure it",
    )  # fmt: skip


def _measured(given: MixEntries, concrete: Concrete) -> Iterator[Pair]:
    """Generate the slip layers that the mix states as measured.

    They come from constants of the layer, from pressures of a pipe, and from points of a tribometer.
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


_SOURCES = {True: "; 30 % between deliveries", False: "; a tribometer differs from pipes by 0.3 to 2 (Tavangar 2022)"}
"""Explanations of the uncertainty band of a measured slip layer, used if the measurement states no uncertainty. The
first text is for a layer fitted to pipe pressures, and the second for one measured with a tribometer."""


def _factors(uncertainty: float | None, pipe: bool) -> tuple[float, float]:
    """Return the factors by which a measured constant is multiplied to get the lower and the upper end of its band."""
    if uncertainty is not None:
        return 1 - uncertainty, 1 + uncertainty
    return (1 / (1 + PIPE_UNCERTAINTY), 1 + PIPE_UNCERTAINTY) if pipe else TRIBOMETER_RATIO


def _pair_of(eta: float, tau: float, low: float, high: float, way: str, source: str) -> Pair:
    return (Figure("slip viscosity", eta, low * eta, high * eta, "Pa s/m", way, source),
            Figure("slip yield", tau, low * tau, high * tau, "Pa", way, source))  # fmt: skip


def _pair(
    value: float,
    ends: tuple[float, float],
    stress: tuple[float, float, float],
    concrete: Concrete,
    way: str,
    source: str,
) -> Pair:
    """Return an estimated slip layer, whose yield stress is limited to that of the concrete.

    The limit holds because the layer is concrete without its stones. `value` is the viscosity and `ends` its band [Pa
    s/m]. `stress` holds the yield stress with the lower and the upper end of its band [Pa].
    """
    tau, low, high = (min(each, concrete.yield_stress) for each in stress)
    return (Figure("slip viscosity", value, *ends, "Pa s/m", way, source),
            Figure("slip yield", tau, low, high, "Pa", way, source))  # fmt: skip


def _fitted(fit: StraightLine, count: int, way: str, pipe: bool) -> Pair:
    """Return a layer fitted to measured points; its band covers the error of the fit and that of the instrument."""
    found = []
    for name, value, error, unit in (("slip viscosity", fit.slope, fit.slope_error, "Pa s/m"),
                                     ("slip yield", fit.offset, fit.offset_error, "Pa")):  # fmt: skip
        line = of_line(name, value, line_uncertainty(error, count, value, 0.0), unit, way, count)
        low, high = _factors(None, pipe)
        found.append(Figure(name, value, min(line.low, low * value), max(line.high, high * value), unit, way,
                            f"straight line{_SOURCES[pipe]}"))  # fmt: skip
    return found[0], found[1]
