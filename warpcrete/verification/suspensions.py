"""Verification of rigid spheres in a mortar against closed forms and published solutions.

The mortar fills the whole simulated box in all cases, so there is no free surface. The mortar sticks to the box's
walls.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.device.device import find_device
from ..core.records import SceneArguments
from ..kernels.mps.grid.cells import GridKind
from ..mps.grid.distances import Distance
from ..mps.grid.filling import fill_cells
from ..mps.grid.flow import GridFlow
from ..mps.grid.geometry import (
    MIRROR,
    NO_SLIP_VISCOSITY,
    OPEN_SIDE,
    PLATE,
    ROUGH,
    WALL,
    Room,
    geometry_of,
    nearest_wall,
)
from ..mps.grid.layout import GridLayout, Motion
from ..mps.grid.state import GridState
from ..suspension.aggregates import Aggregates
from ..suspension.flow import SuspensionFlow
from ..suspension.solve import Tolerances
from ..theory.pipe import Concrete
from .case import Case, Row

RADIUS, VISCOSITY, DENSITY, GRAVITY = 0.01, 20.0, 2200.0, 9.81
CLOSED = ((WALL, WALL),) * 3


@dataclass(frozen=True)
class _Settings:
    """Replacement for a scene, with the settings that a flow on a grid reads; mortar fills the whole box."""

    concrete: Concrete
    time_step: float
    gravity: float = GRAVITY
    step_error: float = 0.0
    regularisation: float = 1e4
    tolerance: float = 1e-3
    maximum_iterations: int = 20000


def mortar_state(
    cells: Sequence[int],
    width: float,
    device: str,
    precision: str,
    *,
    sides: tuple[tuple[str, str], ...] = CLOSED,
    walls: Sequence[tuple[Distance, int]] = (),
    motions: tuple[Motion, ...] = (),
    periodic: bool = False,
    yield_stress: float = 0.0,
    time_step: float = 0.1,
    speed: float = 1e-3,
    regularisation: float = 1e4,
) -> GridState:
    """Return the state of a mortar at rest that fills a box centred on the origin.

    `cells` is the number of cells along each axis, and `width` the edge length of a cell [m]. `sides` holds the kinds
    of the box's two sides along each axis. `walls` holds further walls, each as a distance function and a number, and
    `motions` the motions of walls. `speed` is the velocity scale of the flow [m/s].
    """
    room = Room(tuple(cells), (width,) * 3, tuple(-0.5 * n * width for n in cells), sides)
    geometry, nearest = geometry_of(room, walls), nearest_wall(room, walls)
    places, mass = fill_cells(room, 2, lambda x: nearest(x)[0] > 0)
    layout = GridLayout(
        kind=GridKind(3, cut=True, periodic=periodic), room=room, solid=geometry.solid, fluid=places, mass=mass,
        particle_spacing=width / 2, slip=(NO_SLIP_VISCOSITY, 0.0), slips=False, speed=speed,
        length=width * min(cells) / 2, geometry=geometry, full=True, weightless=True, motions=motions,
        mean_velocity_fixed=False,
    )  # fmt: skip
    mortar = Concrete(
        name="mortar", density=DENSITY, viscosity=VISCOSITY, yield_stress=yield_stress,
        slip_viscosity=NO_SLIP_VISCOSITY, slip_yield=0.0,
    )  # fmt: skip
    settings = _Settings(mortar, time_step, regularisation=regularisation)
    return GridState(settings, layout, find_device(device), precision)


def mortar_flow(
    cells: Sequence[int], width: float, aggregates: Aggregates, device: str, precision: str, *,
    tolerances: Tolerances | None = None, friction: float = 0.0, **room: object,
) -> SuspensionFlow:  # fmt: skip
    """Return a flow of mortar with aggregates.

    `cells` is the number of cells along each axis, `width` the edge length of a cell [m], `friction` the coefficient of
    friction of the aggregates, and `room` holds further arguments of :func:`mortar_state`.
    """
    state = mortar_state(cells, width, device, precision, **room)
    return SuspensionFlow(state, aggregates, friction=friction, tolerances=tolerances or Tolerances())


def take(flow: SuspensionFlow, steps: int) -> np.ndarray:
    """Take `steps` time steps, and return the velocities of the aggregates afterwards [m/s], shape (n, 3)."""
    flow.take(steps)
    return flow.aggregates.bodies.velocity.numpy().astype(float)


def settling(across: int, shift: float, ratio: float, device: str, precision: str) -> float:
    """Return the settling speed of a sphere on the axis of a closed cylinder, divided by the exact speed.

    `across` is the number of cells across the sphere. `shift` is the offset of the sphere's centre from a corner of a
    cell along each axis, in cells. `ratio` is the radius of the sphere divided by that of the cylinder. The exact speed
    is that in an infinitely long cylinder (Haberman & Sayre 1958).
    """
    width, outer = 2 * RADIUS / across, RADIUS / ratio
    wide, high = 2 * int(np.ceil(outer / width)) + 4, int(np.ceil(6 * outer / width))
    cylinder = (lambda x: outer - np.linalg.norm(x[:, :2], axis=1), PLATE)
    sphere = Aggregates(np.full((1, 3), shift * width), np.array([RADIUS]), DENSITY + 500)
    flow = mortar_flow((wide, wide, high), width, sphere, device, precision, walls=[cylinder])
    free = 2 / 9 * 500 * GRAVITY * RADIUS**2 / VISCOSITY
    return float(-take(flow, 3)[0, 2] / (free * slowing_by_cylinder(ratio)))


def slowing_by_cylinder(ratio: float) -> float:
    """Return the speed of a sphere on the axis of a cylinder, divided by that without walls (Haberman & Sayre 1958).

    `ratio` is the radius of the sphere divided by that of the cylinder.
    """
    upper = 1 - 2.105 * ratio + 2.0865 * ratio**3 - 1.7068 * ratio**5 + 0.72603 * ratio**6
    return upper / (1 - 0.75857 * ratio**5)


def shear_room(across: int, wide: int, rate: float) -> SceneArguments:
    """Return the arguments of :func:`mortar_state` for a shear flow with a shear rate of `rate` [1/s].

    The box is a cube with `wide` cells along each edge, between two walls that move in opposite directions along the
    last axis. `across` is the number of cells across a sphere, from which the edge length of a cell follows.
    """
    width = 2 * RADIUS / across
    half = 0.5 * wide * width
    speed = half * rate
    return {
        "cells": (wide,) * 3,
        "width": width,
        "sides": ((WALL, WALL), (MIRROR, MIRROR), (OPEN_SIDE, OPEN_SIDE)),
        "walls": [(lambda x: x[:, 0] + half, ROUGH + 1), (lambda x: half - x[:, 0], ROUGH + 2)],
        "motions": (Motion((0.0, 0.0, -speed)), Motion((0.0, 0.0, speed))),
        "periodic": True,
        "speed": speed,
    }


def _wall_rate(flow: GridFlow) -> float:
    """Return the mean shear rate at both walls of a shear flow [1/s], from the cell faces next to the walls."""
    along = flow.state.faces("velocity")[2][1:-1, 1:-1, 1:-1]
    steps = np.diff(along, axis=2).mean((0, 1)) / flow.state.layout.spacing
    return float(0.5 * (steps[0] + steps[-1]))


def sheared(across: int, wide: int, shift: Sequence[float], device: str, precision: str) -> tuple[float, float]:
    """Return the spin of a free sphere in a shear flow, divided by the exact spin, and the slope of the viscosity.

    The exact spin is half the shear rate. The slope is the relative increase of the wall stress that the sphere causes,
    divided by the volume fraction of the sphere; its exact value is 2.5. `across` is the number of cells across the
    sphere, `wide` the number of cells along each edge of the cubic box, and `shift` the offset of the sphere from the
    centre of the box, in cells.
    """
    room = shear_room(across, wide, SHEAR_RATE) | {"time_step": SHEAR_STRAIN / SHEAR_RATE}
    sphere = Aggregates(np.array([shift]) * room["width"], np.array([RADIUS]), DENSITY)
    flow = mortar_flow(
        aggregates=sphere, device=device, precision=precision, tolerances=Tolerances(coupled=1e-5), **room
    )
    take(flow, SHEAR_STEPS)
    empty = GridFlow(mortar_state(device=device, precision=precision, **room))
    empty.take(SHEAR_STEPS)
    rate, fraction = _wall_rate(empty), 4 / 3 * np.pi * RADIUS**3 / (wide * room["width"]) ** 3
    spin = float(-2 * flow.aggregates.bodies.spin.numpy()[0, 1])
    return spin / rate, (_wall_rate(flow) / rate - 1) / fraction


def falling_in_bingham(number: float, regularisation: float, device: str, precision: str) -> float:
    """Return the settling speed of a sphere in a Bingham mortar, divided by its Stokes speed without yield stress.

    `number` is 2 pi R^2 times the yield stress, divided by the weight minus the buoyancy of the sphere, where R is its
    radius (Beris et al. 1985). `regularisation` is the parameter beta of the regularised flow law [s].
    """
    weight, stokes = 500 * GRAVITY * 4 / 3 * np.pi * RADIUS**3, 2 / 9 * 500 * GRAVITY * RADIUS**2 / VISCOSITY
    # The sphere starts with 30 % of its Stokes speed. From rest, the mortar would yield so slowly near the yield
    # criterion that the run would take too long.
    sphere = Aggregates(np.zeros((1, 3)), np.array([RADIUS]), DENSITY + 500, np.array([[0.0, 0.0, -0.3 * stokes]]))
    flow = mortar_flow(
        (16,) * 3, RADIUS / 2, sphere, device, precision,
        yield_stress=number * weight / (2 * np.pi * RADIUS**2), regularisation=regularisation, time_step=0.2,
    )  # fmt: skip
    return float(-take(flow, BINGHAM_STEPS)[0, 2] / stokes)


SHEAR_RATE, SHEAR_STRAIN, SHEAR_STEPS = 1e-3, 0.01, 3
"""Shear rate [1/s], shear strain of a time step, and number of time steps of a sphere in a shear flow.

A time step of 10 s is so long that the flow is steady after three steps.
"""
BINGHAM_STEPS = 30
# Largest accepted errors with 4 and with 8 cells across a sphere. `validation/suspension-exact.md` lists the actual
# errors.
SETTLING = {4: 0.085, 8: 0.02}
SPIN = {4: 0.02, 8: 0.01}
SLOPE = {4: 0.07, 8: 0.05}
ORDER = 1.5
"""Smallest accepted order of the error of settling speed and viscosity."""


def order_row(quantity: str, rows: Sequence[Row], order: float) -> Row:
    """Return a row with the observed order of the errors of a quantity, which must be at least `order`.

    The first half of `rows` has 4 cells across a sphere, and the second half 8 cells. The order is the logarithm to
    base 2 of the ratio of both root mean square errors.
    """
    coarse, fine = np.array([row.error for row in rows]).reshape(2, -1)
    observed = float(0.5 * np.log2((coarse**2).mean() / (fine**2).mean()))
    return Row(f"{quantity}: observed order", observed, order, 0.0, at_least=True)


def settling_case(device: str, precision: str) -> list[Row]:
    """Compare the settling speed of a sphere in a cylinder with the solution of Haberman & Sayre (1958)."""
    rows = [
        Row(
            f"{across} cells, {shift:g} cells off",
            settling(across, shift, 0.3, device, precision),
            1.0,
            SETTLING[across],
        )
        for across in (4, 8)
        for shift in (0.0, 0.25, 0.5)
    ]
    return [*rows, order_row("settling speed", rows, 2.0)]


def shear_case(device: str, precision: str) -> list[Row]:
    """Compare a sphere's spin in a shear flow, and the viscosity of the mixture, with the values of Einstein (1906)."""
    rows = []
    for across in (4, 8):
        for shift in ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (0.25, 0.1, 0.3)):
            spin, slope = sheared(across, 4 * across, shift, device, precision)
            name = f"{across} cells, {shift[0]:g} cells off"
            rows += [
                Row(f"{name}: spin", spin, 1.0, SPIN[across]),
                Row(f"{name}: slope of the viscosity", slope, 2.5, SLOPE[across]),
            ]
    return [*rows, order_row("slope of the viscosity", rows[1::2], ORDER)]


def bingham_case(device: str, precision: str) -> list[Row]:
    """Check that a sphere sinks in mortar of a low yield stress, and stays in mortar of a high yield stress.

    The limit between the two is the yield criterion of Beris et al. (1985), a ratio of yield stress to weight. The
    regularised mortar creeps even below its yield stress, so each sphere is simulated with two regularisations. With a
    ten times stiffer regularisation, a sinking sphere keeps its speed, while the speed of a sphere that should stay
    drops to a tenth.
    """
    ratios = [
        falling_in_bingham(number, 1e5, device, precision) / falling_in_bingham(number, 1e4, device, precision)
        for number in (0.13, 0.16)
    ]
    return [Row("falls at 0.13", ratios[0], 1.0, 0.4, at_least=True), Row("stays at 0.16", ratios[1], 0.1, 0.2)]


GROUP = "aggregates in mortar"
CASES = [
    Case("sphere that settles in a cylinder", "Haberman & Sayre 1958", settling_case, GROUP),
    Case("sphere in a shear flow", "Einstein 1906", shear_case, GROUP),
    Case("sphere in a yield stress fluid", "Beris et al. 1985", bingham_case, GROUP, slow=True),
]
