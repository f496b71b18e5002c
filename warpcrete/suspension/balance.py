"""Balance of power and of momentum in the last time step of a mortar with aggregates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernels.mps.grid.cells import DT, FIXED, GHOST, LIQUID
from ..kernels.suspension.pairs import CAPACITY, WALL
from .flow import SuspensionFlow

PAIRS = (0, 1), (0, 2), (1, 2)
"""Axes of the planes of shear, in the order in which the grid stores edges."""


@dataclass(frozen=True)
class Balance:
    """Power of all forces in a time step [W], at the velocities of its end, and momentum along the last axis [N]."""

    walls: float
    """Power that moving walls supply, by friction and by pushing aggregates."""
    weight: float
    """Power of weight and other external forces."""
    viscous: float
    """Power that the plastic viscosity of the mortar dissipates."""
    yielding: float
    """Power that the yield stress of the mortar dissipates."""
    film: float
    """Power that is dissipated between mortar and walls, in slip layers or in the film that makes mortar stick."""
    lubrication: float
    """Power that the added lubrication forces dissipate."""
    contacts: float
    """Power that contacts dissipate, minus the power by which they remove overlaps."""
    kinetic: float
    """Increase of the kinetic energy of mortar and aggregates per time."""
    damping: float
    """Power that the implicit Euler method dissipates in a step of finite length."""
    momentum: float
    """Increase of the momentum of mortar and aggregates per time."""
    held: float
    """Momentum of mortar and aggregates at the end of the step [kg m/s]."""
    impulse: float
    """Force of walls, weight and other external forces; equals `momentum` unless a wall is normal to the axis."""
    impulse_scale: float
    """Sum of the magnitudes of these forces."""

    @property
    def supplied(self) -> float:
        """Supplied power [W]."""
        return self.walls + self.weight

    @property
    def spent(self) -> float:
        """Dissipated and stored power [W]."""
        dissipated = self.viscous + self.yielding + self.film + self.lubrication + self.contacts
        return dissipated + self.kinetic + self.damping

    @property
    def error(self) -> float:
        """Difference of supplied and spent power, divided by the sum of the magnitudes of all terms."""
        terms = (self.walls, self.weight, self.viscous, self.yielding, self.film, self.lubrication, self.contacts,
                 self.kinetic, self.damping)  # fmt: skip
        return (self.supplied - self.spent) / max(sum(abs(term) for term in terms), 1e-300)


def step_with_balance(flow: SuspensionFlow) -> Balance:
    """Take one time step, and return its balance."""
    bodies = flow.aggregates.bodies
    before = bodies.velocity.numpy().astype(float), bodies.spin.numpy().astype(float)
    flow.take(1)
    found = _Step(flow, *before)
    return found.balance()


def wall_friction(flow: SuspensionFlow) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return forces [N], velocities [m/s] and stiffnesses [N s/m] of the friction at walls at the end of the last step.

    The force is that of the concrete on the wall, and the velocity that of the wall. The arrays have the shape (3, 3,
    *shape), for the components of the velocity, the axes across the wall, and the cells.
    """
    field = _Grid(flow)
    velocity, start = field.faces("velocity"), field.faces("start")
    stiffness, on, force = (
        field.array(getattr(flow.mesh, name), 9) for name in ("wall_stiffness", "wall_weight", "wall_force")
    )
    known = stiffness > 0
    reached = np.zeros_like(stiffness)
    for axis in range(3):
        for across in range(3):
            k, change = 3 * axis + across, velocity[axis] - start[axis]
            force[k] += stiffness[k] * ((1 - on[k]) * change + on[k] * field.next(change, across))
            reached[k] = (1 - on[k]) * velocity[axis] + on[k] * field.next(velocity[axis], across)
    force = np.where(known, force, 0.0)
    speed = np.where(known, reached - force / np.where(known, stiffness, 1.0), 0.0)
    shape = (3, 3, *force.shape[1:])
    return force.reshape(shape), speed.reshape(shape), np.where(known, stiffness, 0.0).reshape(shape)


class _Grid:
    """Access to the arrays of a grid, without the frame of cells at the ends of a periodic axis."""

    def __init__(self, flow: SuspensionFlow) -> None:
        self.shape = flow.state.shape
        self.inner = slice(1, -1) if flow.state.layout.kind.periodic else slice(None)
        self.mesh = flow.mesh

    def array(self, values: Any, count: int) -> np.ndarray:
        """Return an array of the device with `count` values per cell, in double precision."""
        return values.numpy().astype(float).reshape(count, *self.shape)[:, self.inner]

    def faces(self, name: str) -> np.ndarray:
        """Return an array of the mesh with one value per face."""
        return self.array(getattr(self.mesh, name), 3)

    @staticmethod
    def next(values: np.ndarray, axis: int) -> np.ndarray:
        """Return the value of the next cell along an axis, for each cell."""
        return np.roll(values, -1, 2 - axis)

    @staticmethod
    def last(values: np.ndarray, axis: int) -> np.ndarray:
        """Return the value of the previous cell along an axis, for each cell."""
        return np.roll(values, 1, 2 - axis)


class _Step:
    """Velocities at both ends of a step, and the terms of its balance."""

    def __init__(self, flow: SuspensionFlow, velocity: np.ndarray, spin: np.ndarray) -> None:
        self.flow, self.grid, self.before = flow, _Grid(flow), (velocity, spin)
        self.dt = float(flow.mesh.clock.numpy()[int(DT)])
        bodies = flow.aggregates.bodies
        self.after = bodies.velocity.numpy().astype(float), bodies.spin.numpy().astype(float)
        self.u, self.start, self.kind = (self.grid.faces(name) for name in ("velocity", "start", "kind"))
        self.unknown = (self.kind == int(LIQUID)) | (self.kind == int(GHOST))
        self.mass = np.where(self.unknown, flow.scene.concrete.density * self.grid.faces("volume"), 0.0)

    def balance(self) -> Balance:
        """Return the balance of the step."""
        bodies, (velocity, spin) = self.flow.aggregates.bodies, self.after
        force, torque = bodies.force.numpy().astype(float), bodies.torque.numpy().astype(float)
        gravity = np.array(self.flow.g.gravity)
        weight = self.mass * gravity.reshape(3, 1, 1, 1)
        friction, speed, stiffness = wall_friction(self.flow)
        rubs = stiffness > 0
        lubrication, contacts, by_walls, pushed = self._pairs()
        kinetic, damping, momentum, held = self._inertia()
        viscous, yielding = self._dissipation()
        on_walls = friction[2][rubs[2]]
        return Balance(
            walls=by_walls - float(np.sum(friction * speed)),
            weight=float(np.sum(force * velocity) + np.sum(torque * spin) + np.sum(weight * self.u)),
            viscous=viscous, yielding=yielding,
            film=float(np.sum(friction[rubs] ** 2 / stiffness[rubs])), lubrication=lubrication, contacts=contacts,
            kinetic=kinetic, damping=damping, momentum=momentum, held=held,
            impulse=float(pushed + force[:, 2].sum() + weight[2].sum() - on_walls.sum()),
            impulse_scale=float(np.abs(force[:, 2]).sum() + np.abs(weight[2]).sum() + np.abs(on_walls).sum()),
        )  # fmt: skip

    def _inertia(self) -> tuple[float, float, float, float]:
        """Return the increase of kinetic energy, the loss by the implicit method, and increase and value of momentum.

        The increases are those per time.
        """
        bodies = self.flow.aggregates.bodies
        heavy, round = (a.numpy().astype(float)[:, None] for a in (bodies.extra_mass, bodies.extra_inertia))
        kinetic = damping = 0.0
        for mass, after, before in (
            (self.mass, self.u, self.start),
            (heavy, self.after[0], self.before[0]),
            (round, self.after[1], self.before[1]),
        ):
            change = np.where(mass != 0, after - before, 0.0)
            kinetic += float(np.sum(mass * change * (after - 0.5 * change)))
            damping += float(np.sum(0.5 * mass * change**2))
        ends = [
            float(np.sum(self.mass[2] * u[2]) + np.sum(heavy[:, 0] * bodies[:, 2]))
            for u, bodies in ((self.start, self.before[0]), (self.u, self.after[0]))
        ]
        return kinetic / self.dt, damping / self.dt, (ends[1] - ends[0]) / self.dt, ends[1]

    def _dissipation(self) -> tuple[float, float]:
        """Return the power that the plastic viscosity and the yield stress of the mortar dissipate."""
        flow, grid = self.flow, self.grid
        width = flow.state.layout.room.width
        volume = float(np.prod(width))
        moves = self.unknown | (self.kind == int(FIXED))
        fill = grid.array(flow.mesh.fill, 1)[0]
        room = grid.array(flow.geometry.room, 1)[0]
        quarters = flow.geometry.quarter_fraction.numpy().astype(float).reshape(*flow.state.shape, 3, 4)[grid.inner]
        rates = [
            np.where(moves[a] & grid.next(moves[a], a), grid.next(self.u[a], a) - self.u[a], 0.0) / width[a]
            for a in range(3)
        ]
        liquid = grid.array(flow.mesh.liquid, 1)[0] != 0
        square = np.where(liquid, 2 * volume * fill * room * sum(rate**2 for rate in rates), 0.0)
        plain, cut = grid.array(flow.mesh.in_cell, 1)[0], grid.array(flow.cut.in_cell, 1)[0]
        total = square * cut
        viscosity = flow.scene.concrete.viscosity
        viscous = float(np.sum(total * viscosity / np.where(plain > 0, plain, 1.0)))
        sum_all = float(np.sum(total))
        plain, cut = grid.array(flow.mesh.in_corner, 3), grid.array(flow.cut.in_corner, 3)
        for pair, (a, b) in enumerate(PAIRS):
            ends = moves[a] & grid.last(moves[a], b) & moves[b] & grid.last(moves[b], a)
            rate = (self.u[a] - grid.last(self.u[a], b)) / width[b] + (self.u[b] - grid.last(self.u[b], a)) / width[a]
            wet = np.zeros_like(fill)
            for n in range(4):
                part = fill * quarters[..., pair, n]
                part = grid.last(part, a) if n % 2 else part
                wet += 0.25 * (grid.last(part, b) if n // 2 else part)
            total = np.where(ends, wet * volume * rate**2 * cut[pair], 0.0)
            viscous += float(np.sum(total * viscosity / np.where(plain[pair] > 0, plain[pair], 1.0)))
            sum_all += float(np.sum(total))
        return viscous, sum_all - viscous

    def _pairs(self) -> tuple[float, float, float, float]:
        """Return the power of lubrication, of contacts and of walls that push, and the force of such walls."""
        flow, pairs = self.flow, self.flow.aggregates.pairs
        number, rows = pairs.count.numpy(), np.arange(flow.aggregates.count)
        own = np.repeat(rows, number)
        places = np.concatenate([b * int(CAPACITY) + np.arange(n) for b, n in zip(rows, number, strict=True)])
        other = pairs.other.numpy()[places]
        wall = other == int(WALL)
        normal, gap, rough, still, slow, hold, touching = (
            getattr(pairs, name).numpy().astype(float)[places]
            for name in ("normal", "gap", "rough", "still", "lubrication", "hold", "touching")
        )
        velocity = self.after[0]
        relative = velocity[own] - np.where(wall[:, None], 0.0, velocity[np.where(wall, 0, other)])
        approach = np.sum(relative * normal, 1) - still
        # Contacts that the last solve has found do not act in it.
        hold = hold * (touching == 1)
        # A pair of aggregates has two entries, and each of them counts half of its power.
        share = np.where(wall, 1.0, 0.5)
        apart = hold / flow.scene.time_step * (rough - gap)
        force = -((slow + hold) * approach + apart)
        return (
            float(np.sum(share * slow * approach**2)),
            float(np.sum(share * (hold * approach + apart) * approach)),
            float(np.sum(np.where(wall, force * still, 0.0))),
            float(np.sum(np.where(wall, force * normal[:, 2], 0.0))),
        )
