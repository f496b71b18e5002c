"""Yield stress and viscosity of a mix's concrete, mortar and slip layer: measured, or from published relations.

Different models of rheometers give different values for the same concrete (Ferraris & Martys 2003; RILEM TC 266-MRP
2023), so a relation that was derived with one rheometer is at best as accurate as that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ..core.errors import refuse
from ..theory.fits import StraightLine, straight_line
from ..theory.inverse import (
    viscosity_of_t500,
    viscosity_of_t500_sedran,
    yield_of_heap,
    yield_of_long_heap,
    yield_of_slump,
    yield_of_slump_measured,
)
from ..theory.pipe import CONCRETES, Concrete, Line, measured_layer
from ..theory.suspension import SUSPENSIONS, power_thickening, thickening
from .figures import Figure, around
from .given import PACKING, Measured, MixEntries

RHEOMETER = 0.2
"""Relative uncertainty of measured constants of a concrete or mortar that are stated without one."""
TRIBOMETER = 0.15
"""Relative uncertainty of a slip layer's constants that are stated without one: pressures calculated from such
constants agree with measured ones within 15 % (Mai et al. 2014)."""
READ_SLUMP, READ_SPREAD, READ_TIME = 0.01, 0.02, 0.5
"""Possible reading errors of slump [m], spread [m] and T500 [s]; EN 12350-2 and -8 give a repeatability of 16 to 42
mm."""
THICKENING_UPPER, THICKENING_LOWER = (3.25, PACKING), (2.5, 0.65)
"""Intrinsic viscosity and densest packing for the lower and the upper end of the band of factors by which aggregate
thickens mortar. The upper end stands for rough grains: an intrinsic viscosity a third above that of spheres, which is a
choice (ascribed to Barnes, Hutton & Walters 1989, for ground gypsum; not seen), in the packing of equal spheres (Mahaut
et al. 2008). The lower end stands for spheres of mixed sizes.
"""
T500_ERROR_FACTOR = 1.3
"""Factor by which the relation for T500 may be wrong, because of inertia and of lifting the cone in 1 to 3 s, as found
in simulations."""
ASSUMED_VISCOSITY = (70.0, 20.0, 400.0)
"""Plastic viscosity assumed if the mix contains no information about it, with its lower and upper limit [Pa s]. The
band covers the three concretes of Xu, Li & Jiang (2021) and thinner ones."""
LAYER_ERROR_FACTOR = 3.0
"""Factor, in both directions, by which an assumed slip layer may differ from the true one."""
STUDENT_T = {1: 12.7, 2: 4.30, 3: 3.18, 4: 2.78, 5: 2.57, 6: 2.45, 7: 2.36, 8: 2.31, 9: 2.26, 10: 2.23}
"""Factor from the standard error to the 95 % confidence limit, Student's t, by the number of points minus two."""


def yield_stresses(given: MixEntries) -> Iterator[Figure]:
    """Generate estimates of the concrete's yield stress, the most accurate first.

    Each entry of the mix that determines the yield stress gives one estimate.
    """
    yield from _stated(given.concrete, "yield_stress", "Pa", "concrete")
    if given.viscometer_points is not None:
        yield _offset("yield stress", given.viscometer_points, "Pa", "viscometer")
    if (own := _mortar(given, "yield_stress", "Pa")) is not None:
        yield _from_mortar(own, given, 1, "Chateau, Ovarlez & Trung 2008")
    if given.spread is not None:
        at = [given.spread + off for off in (READ_SPREAD, 0.0, -READ_SPREAD)]
        yield Figure("yield stress", yield_of_heap(at[1], given.density), yield_of_heap(at[0], given.density),
                     yield_of_long_heap(at[2], given.density), "Pa", f"spread of {1e3 * given.spread:.4g} mm",
                     "heap that resists its stretch; upper limit Roussel & Coussot 2005", "cone")  # fmt: skip
    if given.slump is not None:
        at = [given.slump + off for off in (READ_SLUMP, 0.0, -READ_SLUMP)]
        value = yield_of_slump(at[1], given.density)
        yield Figure("yield stress", value, yield_of_slump(at[0], given.density, 2.0),
                     yield_of_slump_measured(at[2], given.density),
                     "Pa", f"slump of {1e3 * given.slump:.4g} mm",
                     "tall cone (Murata 1984, von Mises; lower limit Tresca); upper limit Ferraris & de Larrard 1998",
                     "cone")  # fmt: skip


def viscosities(given: MixEntries) -> Iterator[Figure]:
    """Generate estimates of the concrete's plastic viscosity, the most accurate first.

    Each entry of the mix that determines the viscosity gives one estimate.
    """
    yield from _stated(given.concrete, "viscosity", "Pa s", "concrete")
    if given.viscometer_points is not None:
        yield _slope("viscosity", given.viscometer_points, "Pa s", "viscometer")
    if (own := _mortar(given, "viscosity", "Pa s")) is not None:
        yield _from_mortar(own, given, 0, "Krieger & Dougherty 1959")
    if given.t500 is not None and given.spread is not None:
        value = viscosity_of_t500(given.t500, given.spread, given.density)
        late, early = 1 + READ_TIME / given.t500, max(1 - READ_TIME / given.t500, 0.1)
        highest = max(T500_ERROR_FACTOR * value, viscosity_of_t500_sedran(given.t500, given.spread, given.density))
        yield Figure("viscosity", value, early * value / T500_ERROR_FACTOR, late * highest, "Pa s",
                     f"T500 of {given.t500:g} s and spread",
                     "simulations; upper limit attributed to Sedran & de Larrard 1999", "cone")  # fmt: skip


def unknown_viscosity() -> Figure:
    """Return the assumed plastic viscosity of a mix that contains no information about it."""
    return Figure("viscosity", *ASSUMED_VISCOSITY, "Pa s", "assumption",
                  "Xu, Li & Jiang 2021 measured 297 to 397 Pa s; no source for thinner concretes")  # fmt: skip


def mortar(given: MixEntries, concrete: Concrete, bulk: dict[str, Figure]) -> list[Figure]:
    """Return density, viscosity and yield stress of the mortar; empty if the coarse aggregate's share is unknown."""
    found = []
    if given.share is None:
        return found
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
        found.append(replace(own, name=f"mortar's {name}"))
    rest = (concrete.density - given.share * given.aggregate_density) / (1 - given.share)
    density = around("mortar's density", rest, 0.03, "kg/m3", "density and aggregate", "remaining volume")
    return [density, *found]


def layer(given: MixEntries, concrete: Concrete) -> tuple[Figure, Figure]:
    """Return viscous constant and yield stress of the slip layer, measured or assumed from published values."""
    own = given.layer
    if own.constants is not None:
        off = TRIBOMETER if own.constants.uncertainty is None else own.constants.uncertainty
        eta, tau = (own.constants.values[key] for key in ("viscosity", "yield_stress"))
        source = "as given" + ("" if own.constants.uncertainty is not None else "; 15 % as Mai et al. 2014")
        return (around("slip viscosity", eta, off, "Pa s/m", "layer", source),
                around("slip yield", tau, off, "Pa", "layer", source))  # fmt: skip
    if own.pipe_points is not None:
        flows, pressures = own.pipe_points
        line = Line(radius=own.diameter / 2, length=own.length, rise=own.rise / own.length)
        fit = measured_layer(concrete, line, flows, pressures)
        way = f"{len(flows)} points of a pipe of {1e3 * own.diameter:g} mm"
        return _fitted_layer(fit, len(flows), way)
    if own.tribometer_points is not None:
        speeds, stresses = own.tribometer_points
        return _fitted_layer(straight_line(speeds, stresses), len(speeds), f"{len(speeds)} points of a tribometer")
    known = CONCRETES.values()
    eta = sum(each.slip_viscosity for each in known) / len(CONCRETES)
    # The slip layer is concrete without its stones, so that its yield stress cannot exceed the concrete's.
    tau = min(sum(each.slip_yield for each in known) / len(CONCRETES), concrete.yield_stress)
    source = f"assumption, uncertain by a factor of {LAYER_ERROR_FACTOR:g} in both directions: measure it"
    return (
        Figure("slip viscosity", eta, eta / LAYER_ERROR_FACTOR, eta * LAYER_ERROR_FACTOR, "Pa s/m",
               "assumption: mean of Xu, Li & Jiang 2021", source),
        Figure("slip yield", tau, tau / LAYER_ERROR_FACTOR, tau * LAYER_ERROR_FACTOR, "Pa",
               "assumption: mean of Xu, Li & Jiang 2021, or less", source),
    )  # fmt: skip


def _stated(given: Measured, key: str, unit: str, way: str) -> Iterator[Figure]:
    if key in given.values:
        off = RHEOMETER if given.uncertainty is None else given.uncertainty
        source = "as given" + ("" if given.uncertainty is not None else "; usual error of rheometers")
        yield around(key.replace("_", " "), given.values[key], off, unit, way, source)


def _mortar(given: MixEntries, key: str, unit: str) -> Figure | None:
    return next(_stated(given.mortar, key, unit, "mortar"), None)


def _factors(share: float) -> tuple[tuple[float, float], ...]:
    """Return the most likely, lowest and highest factor by which aggregate raises viscosity and yield stress."""
    return tuple(thickening(share, *each) for each in (SUSPENSIONS["spheres"], THICKENING_LOWER, THICKENING_UPPER))


def _from_mortar(own: Figure, given: MixEntries, place: int, source: str) -> Figure:
    """Return the concrete's viscosity or yield stress, calculated from the same constant of its mortar."""
    assert given.share is not None
    value, least, most = (each[place] for each in _factors(given.share))
    return Figure(own.name, value * own.value, least * own.low, most * own.high, own.unit,
                  f"mortar with a share {given.share:.3g} of aggregate", source)  # fmt: skip


def _line_uncertainty(error: float, count: int, value: float, default: float) -> float:
    """Return the uncertainty of a value from a straight line through `count` points.

    With three or more points, this is the half width of the 95 % confidence interval, from the standard `error`. With
    two points, it is the share `default` of the value.
    """
    if count < 3:
        return default * abs(value)
    return STUDENT_T.get(count - 2, 2.1) * error


def _slope(name: str, points: tuple[list[float], list[float]], unit: str, way: str) -> Figure:
    fit, count = straight_line(*points), len(points[0])
    off = _line_uncertainty(fit.slope_error, count, fit.slope, RHEOMETER)
    return _of_line(name, fit.slope, off, unit, way, count)


def _offset(name: str, points: tuple[list[float], list[float]], unit: str, way: str) -> Figure:
    fit, count = straight_line(*points), len(points[0])
    off = _line_uncertainty(fit.offset_error, count, fit.offset, RHEOMETER)
    return _of_line(name, fit.offset, off, unit, way, count)


def _fitted_layer(fit: StraightLine, count: int, way: str) -> tuple[Figure, Figure]:
    slope_off = _line_uncertainty(fit.slope_error, count, fit.slope, TRIBOMETER)
    offset_off = _line_uncertainty(fit.offset_error, count, fit.offset, TRIBOMETER)
    return (_of_line("slip viscosity", fit.slope, slope_off, "Pa s/m", way, count),
            _of_line("slip yield", fit.offset, offset_off, "Pa", way, count))  # fmt: skip


def _of_line(name: str, value: float, off: float, unit: str, way: str, count: int) -> Figure:
    viscous = unit.startswith("Pa s")
    if value < 0 or (viscous and value == 0):
        refuse(f"mix {name}", round(value, 6), f"is the result of a straight line through {way}, but is impossible",
               "check the points and their units")  # fmt: skip
    source = "straight line, 95 %" if count > 2 else "straight line; two points give no uncertainty"
    return Figure(name, value, max(value - off, 0.1 * value if viscous else 0.0), value + off, unit, way, source)
