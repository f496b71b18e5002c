"""Verification of clumps in a mortar: two spheres that touch each other and move as one rigid body.

The solutions for such a pair of spheres are exact. The module `suspensions` verifies single spheres in the same flows.
"""

from collections.abc import Sequence

import numpy as np

from ..dem.scene.clumps import ClumpTemplate, clump
from ..mps.grid.geometry import PLATE
from ..suspension.aggregates import Aggregates, rotated
from ..suspension.flow import SuspensionFlow
from .case import Case, Row
from .suspensions import (
    DENSITY,
    GRAVITY,
    RADIUS,
    VISCOSITY,
    mortar_flow,
    order_row,
    shear_room,
    slowing_by_cylinder,
    take,
)

RATE = 1e-5
"""Shear rate [1/s], so low that the inertia of the mortar does not matter."""
DRAG = {"along": 1.2903, "across": 1.4489}
"""Drag of two spheres that touch each other, divided by that of one sphere.

The values are those of Stimson & Jeffery (1926) for motion along the line of centres, and of Goldman, Cox & Brenner
(1966) for motion across it.
"""
ASPECT = 1.98
"""Ratio of length to width of the spheroid that turns like two touching spheres in shear (Nir & Acrivos 1973)."""
TURNS = {"along": (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)), "across": (0.0, 0.0, 0.0, 1.0)}
"""Orientations, as quaternions (x, y, z, w), in which the pair's axis lies along and across the last axis."""


def doublet() -> ClumpTemplate:
    """Return the shape of two equal spheres that touch each other; their line of centres is the first axis."""
    return clump("doublet", np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.ones(2))


def pair_at(centre: Sequence[float], turn: Sequence[float], density: float = DENSITY) -> Aggregates:
    """Return an aggregate of two touching spheres of radius RADIUS, with its `centre` [m] and orientation `turn`.

    The orientation is a quaternion (x, y, z, w), and `density` the density of the spheres [kg/m3].
    """
    radius = np.array([2 ** (1 / 3) * RADIUS])
    return Aggregates(np.array([centre]), radius, density, shapes=(doublet(),), turn=np.array([turn]))


def settling_pair(across: int, shift: float, ratio: float, way: str, device: str, precision: str) -> float:
    """Return the settling speed of two touching spheres in a closed cylinder, divided by the exact speed.

    `across` is the number of cells across a sphere, `shift` the offset of the centre along each axis in cells, and
    `ratio` the radius of a sphere divided by that of the cylinder. The pair moves along its line of centres if `way` is
    "along", and across this line if `way` is "across". The cylinder slows the pair down like a sphere with the same
    drag (Brenner 1962).
    """
    width, outer = 2 * RADIUS / across, RADIUS / ratio
    wide, high = 2 * int(np.ceil(outer / width)) + 4, int(np.ceil(6 * outer / width))
    cylinder = (lambda x: outer - np.linalg.norm(x[:, :2], axis=1), PLATE)
    pair = pair_at([shift * width] * 3, TURNS[way], DENSITY + 500)
    flow = mortar_flow((wide, wide, high), width, pair, device, precision, walls=[cylinder])
    free = 2 * 2 / 9 * 500 * GRAVITY * RADIUS**2 / VISCOSITY / DRAG[way]
    return float(-take(flow, 3)[0, 2] / (free * slowing_by_cylinder(DRAG[way] * ratio)))


def turning_pair(
    across: int, wide: int, angle: float, shift: Sequence[float], device: str, precision: str, strain: float = 1e-3,
    rate: float = RATE,
) -> SuspensionFlow:  # fmt: skip
    """Return the shear flow around two touching spheres whose axis lies at an angle [rad] to the velocity.

    `across` is the number of cells across a sphere, `wide` the number of cells along each edge of the cubic box, and
    `shift` the offset of the pair from the centre of the box in cells. Each step shears the mortar by `strain` at the
    shear rate `rate` [1/s].
    """
    room = shear_room(across, wide, rate)
    turn = 0.5 * (angle - 0.5 * np.pi)
    pair = pair_at(np.array(shift) * room["width"], (0.0, np.sin(turn), 0.0, np.cos(turn)))
    return mortar_flow(
        aggregates=pair, device=device, precision=precision, time_step=strain / rate, regularisation=1e2 / rate, **room
    )


def orbit(across: int, wide: int, shift: Sequence[float], device: str, precision: str) -> list[float]:
    """Return slowest spin, fastest spin and period of two touching spheres in a shear flow, divided by exact values.

    The spin of a spheroid is A + B cos 2 f at the angle f of its axis to the velocity (Jeffery 1922), and the period is
    2 pi / sqrt(A^2 - B^2). The constants A and B are fitted to the spins at four angles. :func:`turning_pair` explains
    `across`, `wide` and `shift`.
    """
    angles = np.radians([0.0, 30.0, 60.0, 90.0])
    spins = []
    for angle in angles:
        flow = turning_pair(across, wide, float(angle), shift, device, precision)
        flow.take(1)
        spins.append(-float(flow.aggregates.bodies.spin.numpy()[0, 1]) / RATE)
    slope, mean = np.polyfit(np.cos(2 * angles), spins, 1)
    square = ASPECT**2
    period = (ASPECT + 1 / ASPECT) * np.sqrt(mean**2 - slope**2)
    return [spins[0] * (square + 1), spins[3] * (square + 1) / square, 1 / float(period)]


def tumbling(across: int, wide: int, device: str, precision: str) -> float:
    """Return the period of two touching spheres in a shear flow, divided by the exact period.

    The period is twice the simulated time of half a turn. Each step shears the mortar by a shear strain of 0.1, at a
    Reynolds number of 0.01. :func:`turning_pair` explains `across` and `wide`.
    """
    flow, strain = turning_pair(across, wide, 0.0, (0.0, 0.0, 0.0), device, precision, strain=0.1, rate=1.0), 0.1
    turns, strains = [0.0], [0.0]
    while turns[-1] < np.pi:
        flow.take(1)
        axis = rotated(flow.aggregates.bodies.turn.numpy().astype(float), np.array([[1.0, 0.0, 0.0]]))[0]
        # Both ends of the pair's axis are alike, so the angle of the axis is known only up to multiples of pi.
        angle = -float(np.arctan2(axis[0], axis[2]))
        turns.append(turns[-1] + (angle - turns[-1] + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
        strains.append(strains[-1] + strain)
    return 2 * float(np.interp(np.pi, turns, strains)) / (2 * np.pi * (ASPECT + 1 / ASPECT))


# Largest accepted relative errors of three cases with 4 cells across a sphere: settling speed of a clump, period of a
# turning clump, and spin of a clump.
SETTLING, PERIOD, SPIN = 0.085, 0.05, 0.085
FINE_PERIOD, FINE_SPIN = 0.02, 0.03
"""Largest accepted relative errors of period and spin of a turning clump with 8 cells across a sphere."""
PERIOD_ORDER = 0.5
"""Smallest accepted order of the error of the period. The walls of the box cause a part of the error, which does not
fall with the width of the cells."""
ORBIT_SHIFTS = ((0.0, 0.0, 0.0), (0.25, 0.1, 0.3))


def settling_case(device: str, precision: str) -> list[Row]:
    """Compare the settling speed of two touching spheres with exact solutions."""
    return [
        Row(
            f"{way} the line of centres, {shift:g} cells off",
            settling_pair(4, shift, 0.15, way, device, precision),
            1.0,
            SETTLING,
        )
        for way in DRAG
        for shift in (0.0, 0.25)
    ]


def orbit_rows(across: int, period: float, spin: float, device: str, precision: str) -> list[Row]:
    """Compare the rotation of two touching spheres in a shear flow with Jeffery's orbit, at two positions.

    `across` is the number of cells across a sphere. `period` and `spin` are the largest accepted relative errors of the
    period and of the slowest and fastest spin.
    """
    rows = []
    for shift in ORBIT_SHIFTS:
        name = f"{across} cells, {shift[0]:g} cells off"
        slow, fast, whole = orbit(across, 6 * across, shift, device, precision)
        rows += [Row(f"{name}: axis along the velocity", slow, 1.0, spin), Row(f"{name}: axis across", fast, 1.0, spin),
                 Row(f"{name}: period", whole, 1.0, period)]  # fmt: skip
    return rows


def orbit_case(device: str, precision: str) -> list[Row]:
    """Compare the rotation of two touching spheres in a shear flow with Jeffery's orbit, with 4 cells across."""
    return orbit_rows(4, PERIOD, SPIN, device, precision)


def fine_orbit_case(device: str, precision: str) -> list[Row]:
    """Compare the rotation of two touching spheres in a shear flow with Jeffery's orbit, with 4 and 8 cells across."""
    coarse = orbit_rows(4, PERIOD, SPIN, device, precision)
    fine = orbit_rows(8, FINE_PERIOD, FINE_SPIN, device, precision)
    return [*fine, order_row("period", [*coarse[2::3], *fine[2::3]], PERIOD_ORDER)]


def tumbling_case(device: str, precision: str) -> list[Row]:
    """Compare the duration of half a turn of two touching spheres in a shear flow with Jeffery's orbit."""
    return [Row("4 cells: period", tumbling(4, 24, device, precision), 1.0, PERIOD)]


GROUP = "aggregates in mortar"
CASES = [
    Case("two touching spheres that settle", "Stimson & Jeffery 1926; Goldman et al. 1966", settling_case, GROUP),
    Case("two touching spheres in a shear flow", "Jeffery 1922; Nir & Acrivos 1973", orbit_case, GROUP),
    Case(
        "two touching spheres in a shear flow, finer cells",
        "Jeffery 1922; Nir & Acrivos 1973",
        fine_orbit_case,
        GROUP,
        slow=True,
    ),
    Case("half a turn of two touching spheres", "Jeffery 1922; Nir & Acrivos 1973", tumbling_case, GROUP, slow=True),
]
