"""Yield stress and viscosity of a mix's concrete and mortar: measured, or from published relations.

Rheometers of different models give different values for the same concrete (Ferraris & Martys 2003; RILEM TC 266-MRP
2023). A relation that was derived with one rheometer is therefore no more accurate than the agreement between
rheometers.
"""

from collections.abc import Iterator
from dataclasses import replace

from ..core.inputs.customary import both
from ..theory.fits import straight_line
from ..theory.inverse import (
    viscosity_of_t500,
    viscosity_of_t500_sedran,
    yield_of_heap,
    yield_of_long_heap,
    yield_of_slump,
    yield_of_slump_measured,
)
from ..theory.pipe import Concrete
from ..theory.suspension import SUSPENSIONS, power_thickening, thickening
from .entries import MixEntries
from .figures import Figure, around, line_uncertainty, of_line
from .layer import ESTIMATE, FILM, FILM_ERROR_FACTOR, PASTE_DENSEST, THICKENER_FACTOR, aggregate_factor, paste_layer
from .measurements import Measured
from .reading import PACKING

RHEOMETER = 0.2
"""Relative uncertainty of measured constants of concrete or mortar, if the mix states none."""
RHEOMETER_OVER_HEAP = 5.0
"""Factor by which a rheometer's yield stress may exceed the yield stress with which the concrete comes to rest.

For some 80 concretes in the rheometer BTRHEOM, Ferraris & de Larrard (1998) found a yield stress of density (300 mm -
slump) / 347 mm + 212 Pa, with a mean deviation of 162 Pa. By the theories of heaps and tall cones, the same slumps have
a yield stress that is lower by a factor of 2.3 (median) to 5.4 (90th percentile). For 89 % of the slumps, this factor
is at most 5.
"""
READ_SLUMP, READ_SPREAD, READ_TIME = 0.01, 0.02, 0.5
"""Possible reading errors of slump [m], spread [m] and T500 [s]. For comparison, EN 12350-2 and -8 state a
repeatability of slump and spread of 16 to 42 mm."""
HEAP_CENTRE, HEAP_CENTRE_MEDIAN, FLATTEST = 0.10, 0.03, 0.295
"""Three heights in tests with a slump cone [m].

Aggregate piles up in the centre of a real heap, so the heap is higher there than a homogeneous heap of the same spread.
HEAP_CENTRE is an upper limit of this excess height, and HEAP_CENTRE_MEDIAN its median. They come from 82 tests of Yeh
(2007) with measured slump and spread, in which the excess height is 0 to 100 mm (5th to 95th percentile). FLATTEST is
the largest slump of a cone.
"""
THICKENING_UPPER, THICKENING_LOWER = (3.25, PACKING), (2.5, 0.65)
"""Pairs of intrinsic viscosity and densest packing (as a volume fraction) of aggregate.

The two pairs give the highest and the lowest estimate of the factor by which aggregate thickens mortar. The first pair
is for rough grains. Its packing is the random loose packing of equal spheres (Mahaut et al. 2008). Its intrinsic
viscosity is assumed to be 30 % above the value for spheres; Barnes, Hutton & Walters (1989) are said to give this value
for ground gypsum, but their book was not checked. The second pair is for spheres of mixed sizes.
"""
T500_ERROR_FACTOR = 1.3
"""Factor by which the true viscosity may be smaller or larger than that from the relation for T500. Simulations show
this error, which is due to inertia and to the lifting of the cone in 1 to 3 s."""
USUAL_AGGREGATE = 0.66
"""Volume fraction of sand and stones in the concrete if the mix states no ingredients. Usual fractions are 0.57 to
0.70."""
ASSUMED_VISCOSITY = (70.0, 20.0, 400.0)
"""Plastic viscosity assumed if the mix contains no information about it, with its lower and upper limit [Pa s]. The
band covers the three concretes of Xu, Li & Jiang (2021) and thinner concretes."""


def yield_stresses(given: MixEntries) -> Iterator[Figure]:
    """Generate estimates of the concrete's yield stress, the most accurate first.

    Each of the following entries of the mix gives one estimate: a measured constant, points of a viscometer, the
    mortar, the spread and the slump.
    """
    yield from _stated(given.concrete, "yield_stress", "Pa", "concrete")
    if given.viscometer_points is not None:
        yield _against_heaps(_yield_stress_of(given.viscometer_points))
    if (own := _mortar(given, "yield_stress", "Pa")) is not None:
        yield _from_mortar(own, given, 1, "Chateau, Ovarlez & Trung 2008")
    if given.spread is not None:
        at = [given.spread + off for off in (READ_SPREAD, 0.0, -READ_SPREAD)]
        yield Figure("yield stress", yield_of_heap(at[1], given.density), yield_of_heap(at[0], given.density),
                     yield_of_long_heap(at[2], given.density), "Pa",
                     f"spread of {both(given.customary, 'mm', given.spread)}",
                     "heap with its resistance to stretching; upper limit Roussel & Coussot 2005", "cone")  # fmt: skip
    if given.slump is not None:
        flat = min(given.slump + HEAP_CENTRE + READ_SLUMP, FLATTEST)
        yield Figure("yield stress", yield_of_slump(given.slump, given.density), yield_of_slump(flat, given.density),
                     yield_of_slump_measured(given.slump - READ_SLUMP, given.density),
                     "Pa", f"slump of {both(given.customary, 'mm', given.slump)}",
                     "tall cone (Murata 1984, von Mises), lower limit for a heap that is 100 mm too high in its centre "
                     "(Yeh 2007); upper limit Ferraris & de Larrard 1998", "cone")  # fmt: skip


def viscosities(given: MixEntries) -> Iterator[Figure]:
    """Generate estimates of the concrete's plastic viscosity, the most accurate first.

    Each of the following entries of the mix gives one estimate: a measured constant, points of a viscometer, the
    mortar, and T500 together with the spread.
    """
    yield from _stated(given.concrete, "viscosity", "Pa s", "concrete")
    if given.viscometer_points is not None:
        yield _viscosity_of(given.viscometer_points)
    if (own := _mortar(given, "viscosity", "Pa s")) is not None:
        yield _from_mortar(own, given, 0, "Krieger & Dougherty 1959")
    if given.t500 is not None and given.spread is not None:
        value = viscosity_of_t500(given.t500, given.spread, given.density)
        late, early = 1 + READ_TIME / given.t500, max(1 - READ_TIME / given.t500, 0.1)
        highest = max(T500_ERROR_FACTOR * value, viscosity_of_t500_sedran(given.t500, given.spread, given.density))
        yield Figure("viscosity", value, early * value / T500_ERROR_FACTOR, late * highest, "Pa s",
                     f"T500 of {given.t500:g} s and spread",
                     "simulations; upper limit attributed to Sedran & de Larrard 1999", "cone")  # fmt: skip


def unknown_viscosity(given: MixEntries) -> Figure:
    """Return an estimate of the plastic viscosity of a mix for which no viscosity was measured.

    If the composition of the paste is known, the viscosity of the paste is the viscosity of a slip layer of paste
    (:func:`.layer.paste_layer`) times the thickness of the layer. The factor :func:`.layer.aggregate_factor` accounts
    for sand and stones. If the composition is unknown, the result is an assumption.
    """
    if given.paste_solids is None or given.paste_solids >= PASTE_DENSEST:
        return Figure("viscosity", *ASSUMED_VISCOSITY, "Pa s", "assumption",
                      "Xu, Li & Jiang 2021 measured 297 to 397 Pa s; no source for thinner concretes")  # fmt: skip
    thick = THICKENER_FACTOR if given.thickener else 1.0
    aggregate = USUAL_AGGREGATE if given.sand_and_stone is None else given.sand_and_stone
    value = thick * paste_layer(given.paste_solids) * FILM * aggregate_factor(aggregate)
    return Figure("viscosity", value, value / FILM_ERROR_FACTOR, value * FILM_ERROR_FACTOR, "Pa s",
                  f"{ESTIMATE} {100 * given.paste_solids:.3g} % of powder in the paste",
                  "viscosity of the paste, raised by sand and stones")  # fmt: skip


def mortar(given: MixEntries, concrete: Concrete, bulk: dict[str, Figure]) -> list[Figure]:
    """Return density, viscosity and yield stress of the mortar, as stated or calculated from the concrete.

    The result is empty if the volume fraction of the coarse aggregate is unknown.
    """
    figures = []
    if given.share is None:
        return figures
    for name, key, unit, place in (("viscosity", "viscosity", "Pa s", 0), ("yield stress", "yield_stress", "Pa", 1)):
        own = _mortar(given, key, unit)
        if own is None:
            index = concrete.flow_index if place == 0 else 1.0
            whole, (value, least, most) = (
                bulk[name],
                (power_thickening(f[place], given.share, index) for f in _factors(given.share)),
            )
            own = Figure("", whole.value / value, whole.low / most, whole.high / least, unit,
                         f"{name} of the concrete, share {given.share:.3g} of aggregate",
                         "Krieger & Dougherty 1959; Chateau, Ovarlez & Trung 2008")  # fmt: skip
        figures.append(replace(own, name=f"mortar's {name}"))
    rest = (concrete.density - given.share * given.aggregate_density) / (1 - given.share)
    density = around("mortar's density", rest, 0.03, "kg/m3", "density and aggregate", "remaining volume")
    return [density, *figures]


def _stated(given: Measured, key: str, unit: str, way: str) -> Iterator[Figure]:
    if key in given.values:
        off = RHEOMETER if given.uncertainty is None else given.uncertainty
        source = "as given" + ("" if given.uncertainty is not None else "; usual error of rheometers")
        own = around(key.replace("_", " "), given.values[key], off, unit, way, source)
        yield _against_heaps(own) if given.uncertainty is None and (key, way) == ("yield_stress", "concrete") else own


def _against_heaps(own: Figure) -> Figure:
    """Widen the uncertainty band of a rheometer's yield stress, so that it covers the value in a slump test.

    Concrete in a slump test comes to rest at a lower yield stress than a rheometer measures. The lower end of the band
    is therefore at most the rheometer's value divided by :data:`RHEOMETER_OVER_HEAP`.
    """
    low = own.value / RHEOMETER_OVER_HEAP
    if own.low <= low:
        return own
    return replace(own, low=low, source=f"{own.source}; lower end from slumps (Ferraris & de Larrard 1998)")


def _mortar(given: MixEntries, key: str, unit: str) -> Figure | None:
    return next(_stated(given.mortar, key, unit, "mortar"), None)


def _factors(share: float) -> tuple[tuple[float, float], ...]:
    """Return three estimates of the factors by which aggregate raises viscosity and yield stress.

    The estimates are the most likely one, the lowest and the highest; each is a pair of factors. `share` is the volume
    fraction of aggregate.
    """
    return tuple(thickening(share, *each) for each in (SUSPENSIONS["spheres"], THICKENING_LOWER, THICKENING_UPPER))


def _from_mortar(own: Figure, given: MixEntries, place: int, source: str) -> Figure:
    """Return the viscosity or the yield stress of a concrete, calculated from the same property of its mortar.

    `own` is the measured property of the mortar. `place` is 0 for the viscosity and 1 for the yield stress. `source` is
    the publication of the relation between concrete and mortar.
    """
    assert given.share is not None
    value, least, most = (each[place] for each in _factors(given.share))
    return Figure(own.name, value * own.value, least * own.low, most * own.high, own.unit,
                  f"mortar with a share {given.share:.3g} of aggregate", source)  # fmt: skip


def _viscosity_of(points: tuple[list[float], list[float]]) -> Figure:
    fit, count = straight_line(*points), len(points[0])
    return of_line("viscosity", fit.slope, _error(fit.slope, fit.slope_error, count), "Pa s", "viscometer", count)


def _yield_stress_of(points: tuple[list[float], list[float]]) -> Figure:
    fit, count = straight_line(*points), len(points[0])
    return of_line("yield stress", fit.offset, _error(fit.offset, fit.offset_error, count), "Pa", "viscometer", count)


def _error(value: float, error: float, count: int) -> float:
    """Return the uncertainty of a constant that was fitted to points of a viscometer, in the unit of `value`.

    The uncertainty is the half width of the 95 % confidence interval, which follows from the standard `error` of the
    fit to `count` points. It is at least the usual error of a rheometer, because this error also affects points that
    happen to lie on a straight line.
    """
    return max(line_uncertainty(error, count, value, RHEOMETER), RHEOMETER * abs(value))
