"""Balance of power and of momentum in the last time step of a flow of mortar with aggregates."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernels.mps.grid.cells import FIXED, FORCE, GHOST, LAST, LAST_FORCE, LIQUID, VELOCITY_CORRECTION
from ..kernels.suspension.pairs import CAPACITY, WALL
from .flow import SuspensionFlow

PAIRS = (0, 1), (0, 2), (1, 2)
"""Pairs of axes that span the planes of shear. The grid stores its edges in the order of these pairs."""


@dataclass(frozen=True)
class Balance:
    """Balance of one time step: powers of all forces [W], and the change of momentum.

    The powers are computed with the velocities at the end of the step. The terms of the momentum balance are components
    along the last axis of the grid, as forces [N] unless another unit is stated.
    """

    walls: float
    """Power that moving walls supply by friction on the mortar and by forces on aggregates."""
    weight: float
    """Power that weight and other external forces supply."""
    viscous: float
    """Power that the plastic viscosity of the mortar dissipates."""
    yielding: float
    """Power that the yield stress of the mortar dissipates."""
    film: float
    """Power that friction between mortar and walls dissipates: in the slip layer, or in the thin film of high viscosity
    that represents a wall without slip."""
    lubrication: float
    """Power dissipated by those lubrication forces between aggregates that the grid does not resolve."""
    contacts: float
    """Power that is dissipated by contacts between aggregates and by contacts of aggregates with walls, including
    friction. The power that contacts supply to remove overlaps is subtracted."""
    kinetic: float
    """Increase of the kinetic energy of mortar and aggregates in the step, divided by the length of the step."""
    damping: float
    """Power that is lost because the implicit Euler method damps motion in a step of finite length."""
    momentum: float
    """Increase of the momentum of mortar and aggregates in the step, divided by the length of the step."""
    held: float
    """Total momentum of mortar and aggregates at the end of the step [kg m/s]."""
    impulse: float
    """Sum of the forces of walls, weight and other external forces along the last axis of the grid. It equals
    `momentum`, unless aggregates enter at a given speed, because the force that guides them is not included. The force
    that keeps the mean velocity in a periodic pipe constant is an external force."""
    impulse_scale: float
    """Sum of the magnitudes of the forces whose sum is `impulse`."""

    @property
    def momentum_error(self) -> float:
        """Difference of `momentum` and `impulse`, divided by the sum of the magnitudes of all forces."""
        return (self.momentum - self.impulse) / max(self.impulse_scale, 1e-300)

    @property
    def supplied(self) -> float:
        """Power that moving walls, weight and other external forces supply [W]."""
        return self.walls + self.weight

    @property
    def spent(self) -> float:
        """Dissipated power, including numerical damping, plus the increase of kinetic energy per time [W]."""
        dissipated = self.viscous + self.yielding + self.film + self.lubrication + self.contacts
        return dissipated + self.kinetic + self.damping

    @property
    def error(self) -> float:
        """Difference of supplied and spent power, divided by the sum of the magnitudes of all powers in the balance."""
        terms = (self.walls, self.weight, self.viscous, self.yielding, self.film, self.lubrication, self.contacts,
                 self.kinetic, self.damping)  # fmt: skip
        return (self.supplied - self.spent) / max(sum(abs(term) for term in terms), 1e-300)


def step_with_balance(flow: SuspensionFlow) -> Balance:
    """Take one time step, and return its balance."""
    bodies = flow.aggregates.bodies
    before = bodies.velocity.numpy().astype(float), bodies.spin.numpy().astype(float)
    flow.take(1)
    balanced_step = _Step(flow, *before)
    return balanced_step.balance()


def last_balance(flow: SuspensionFlow) -> Balance:
    """Return the balance of the last time step, which this process must have completed."""
    bodies, solution = flow.aggregates.bodies, flow.coupled.solution
    velocity = bodies.velocity.numpy().astype(float) - solution.linear.numpy()
    velocity[:, 2] -= _hastened(flow)
    return _Step(flow, velocity, bodies.spin.numpy().astype(float) - solution.angular.numpy()).balance()


def _hastened(flow: SuspensionFlow) -> float:
    """Return the velocity [m/s] that was added to all concrete after the solve, to keep the mean velocity constant."""
    layout = flow.state.layout
    fixed = layout.kind.periodic and layout.mean_velocity_fixed
    return float(flow.mesh.drive.numpy()[int(VELOCITY_CORRECTION)]) if fixed else 0.0


def wall_friction(flow: SuspensionFlow) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return forces [N], velocities [m/s] and stiffnesses [N s/m] of the friction at walls at the end of the last step.

    The forces act on the walls, and the velocities are the velocities of the walls. The arrays have the shape (3, 3,
    *shape). The first index is the component of force or velocity, the second is the axis along which the wall is
    crossed, and the others are the indices of the cell.
    """
    field = _Grid(flow)
    velocity, start = field.faces("velocity"), field.faces("start")
    # The last correction of the mean velocity acts as a uniform force on the concrete, and causes no friction at walls
    # in this step. Subtract it from the velocities.
    velocity[2] -= np.where(field.faces("kind")[2] == int(LIQUID), flow.mesh.drive.numpy()[int(VELOCITY_CORRECTION)], 0)
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


@dataclass(frozen=True)
class PairForces:
    """Forces between the spheres of aggregates, and of walls on them, at the end of the last step.

    All arrays have one entry for each neighbour of a sphere, so a pair of spheres occurs twice.
    """

    own: np.ndarray
    """Index of the sphere on which the force acts."""
    other: np.ndarray
    """Index of the neighbouring sphere, or the code WALL."""
    normal: np.ndarray
    """Unit vector from the sphere towards the neighbour, shape (n, 3)."""
    wall_velocity: np.ndarray
    """Velocity of the wall [m/s], shape (n, 3); 0 if the neighbour is a sphere. Without friction, only the component
    along `normal` is included."""
    approach: np.ndarray
    """Speed at which sphere and neighbour approach each other [m/s]."""
    sliding: np.ndarray
    """Tangential velocity of the sphere relative to its neighbour, perpendicular to `normal` [m/s], shape (n, 3); 0
    without friction."""
    lubrication: np.ndarray
    """Force of lubrication that the grid does not resolve [N]; positive if it pushes sphere and neighbour apart."""
    contact: np.ndarray
    """Force of the contact along `normal` [N]; positive if it pushes sphere and neighbour apart."""
    rubbing: np.ndarray
    """Friction force of the contact on the sphere [N], shape (n, 3)."""

    @property
    def force(self) -> np.ndarray:
        """Sum of the forces of contact, friction and lubrication on the sphere [N], shape (n, 3)."""
        return self.rubbing - (self.lubrication + self.contact)[:, None] * self.normal


def pair_forces(flow: SuspensionFlow) -> PairForces:
    """Return the forces between aggregates, and of walls on aggregates, at the end of the last step."""
    pairs = flow.aggregates.pairs
    number, rows = pairs.count.numpy(), np.arange(flow.aggregates.spheres)
    own = np.repeat(rows, number)
    places = np.concatenate([b * int(CAPACITY) + np.arange(n) for b, n in zip(rows, number, strict=True)])
    other = pairs.other.numpy()[places]
    wall = other == int(WALL)
    normal, gap, rough, still, slow, hold, touching = (
        getattr(pairs, name).numpy().astype(float)[places]
        for name in ("normal", "gap", "rough", "still", "lubrication", "hold", "touching")
    )
    velocity = _velocities_at_gaps(flow, own, np.where(wall, own, other), normal, gap)
    relative = velocity[0] - np.where(wall[:, None], 0.0, velocity[1])
    approach = np.sum(relative * normal, 1) - still
    # Contacts that were found only after the last solve exert no force in this step.
    hold = hold * (touching == 1)
    contact = hold * (approach + (rough - gap) / flow.scene.time_step)
    wall_velocity, sliding, rubbing = still[:, None] * normal, np.zeros_like(normal), np.zeros_like(normal)
    if flow.aggregates.kind.friction:
        grip, drift = (getattr(pairs, name).numpy().astype(float)[places] for name in ("grip", "drift"))
        wall_velocity += drift
        sliding = relative - np.sum(relative * normal, 1)[:, None] * normal - drift
        rubbing = -grip[:, None] * sliding
    return PairForces(own, other, normal, wall_velocity, approach, sliding, slow * approach, contact, rubbing)


def _velocities_at_gaps(
    flow: SuspensionFlow, own: np.ndarray, other: np.ndarray, normal: np.ndarray, gap: np.ndarray
) -> list[np.ndarray]:
    """Return the velocities of two neighbouring spheres in the middle of their gap [m/s], shape (n, 3) for each sphere.

    Without friction, only the components along the normal are correct, because the rotation of spheres about their
    centres is left out.
    """
    aggregates = flow.aggregates
    parts, kind, bodies, velocities = aggregates.parts, aggregates.kind, aggregates.bodies, []
    moved, turned = bodies.velocity.numpy().astype(float), bodies.spin.numpy().astype(float)
    for sphere, side in ((own, normal), (other, -normal)):
        lever = np.zeros_like(normal)
        if kind.clumps:
            lever += bodies.arm.numpy().astype(float)[sphere]
        if kind.friction:
            lever += (parts.radius[sphere] + 0.5 * gap)[:, None] * side
        body = parts.body[sphere]
        velocities.append(moved[body] + np.cross(turned[body], lever))
    return velocities


class _Grid:
    """Host copies of the arrays of a grid. On a periodic axis, the extra layer of cells at each end is left out."""

    def __init__(self, flow: SuspensionFlow) -> None:
        self.shape = flow.state.shape
        self.inner = slice(1, -1) if flow.state.layout.kind.periodic else slice(None)
        self.mesh = flow.mesh

    def array(self, values: Any, count: int) -> np.ndarray:
        """Return a device array with `count` values per cell as a host array of doubles, shape (count, cells...)."""
        return values.numpy().astype(float).reshape(count, *self.shape)[:, self.inner]

    def faces(self, name: str) -> np.ndarray:
        """Return the values of the flow's array `name` on the faces of the grid, shape (3, cells...)."""
        return self.array(getattr(self.mesh, name), 3)

    @staticmethod
    def next(values: np.ndarray, axis: int) -> np.ndarray:
        """Return, for each cell, the value of its upper neighbour along an axis."""
        return np.roll(values, -1, 2 - axis)

    @staticmethod
    def last(values: np.ndarray, axis: int) -> np.ndarray:
        """Return, for each cell, the value of its lower neighbour along an axis."""
        return np.roll(values, 1, 2 - axis)


class _Step:
    """Velocities at the start and at the end of a time step, from which the terms of its balance are computed."""

    def __init__(self, flow: SuspensionFlow, velocity: np.ndarray, spin: np.ndarray) -> None:
        self.flow, self.grid, self.before = flow, _Grid(flow), (velocity, spin)
        self.dt = float(flow.mesh.clock.numpy()[int(LAST)])
        bodies = flow.aggregates.bodies
        self.after = bodies.velocity.numpy().astype(float), bodies.spin.numpy().astype(float)
        self.u, self.start, self.kind = (self.grid.faces(name) for name in ("velocity", "start", "kind"))
        self.unknown = (self.kind == int(LIQUID)) | (self.kind == int(GHOST))
        self.mass = np.where(self.unknown, flow.scene.concrete.density * self.grid.faces("volume"), 0.0)

    def balance(self) -> Balance:
        """Return the balance of power and of momentum in the time step."""
        bodies, (velocity, spin) = self.flow.aggregates.bodies, self.after
        force, torque = bodies.force.numpy().astype(float), bodies.torque.numpy().astype(float)
        gravity = np.array(self.flow.g.gravity)
        # Faces inside walls have mass, but no weight.
        weight = np.where(self.kind == int(LIQUID), self.mass, 0.0) * gravity.reshape(3, 1, 1, 1)
        friction, speed, stiffness = wall_friction(self.flow)
        rubs = stiffness > 0
        lubrication, contacts, by_walls, pushed = self._pairs()
        kinetic, damping, momentum, held = self._inertia()
        viscous, yielding, held_back = self._dissipation()
        on_walls = friction[2][rubs[2]]
        pressures, drive = self._pressures() + held_back, self._drive()
        return Balance(
            walls=by_walls - float(np.sum(friction * speed)),
            weight=float(np.sum(force * velocity) + np.sum(torque * spin) + np.sum(weight * self.u)),
            viscous=viscous, yielding=yielding,
            film=float(np.sum(friction[rubs] ** 2 / stiffness[rubs])), lubrication=lubrication, contacts=contacts,
            kinetic=kinetic, damping=damping, momentum=momentum, held=held,
            impulse=float(pushed + force[:, 2].sum() + weight[2].sum() - on_walls.sum()) + pressures + drive,
            impulse_scale=float(np.abs(force[:, 2]).sum() + np.abs(weight[2]).sum() + np.abs(on_walls).sum())
            + abs(pressures) + abs(drive),
        )  # fmt: skip

    def _pressures(self) -> float:
        """Return the component along the last axis of the pressure forces of walls [N].

        The result is the sum of all pressure forces on mortar and aggregates, in which pressures within the concrete
        cancel.
        """
        coupled = self.flow.coupled
        coupled.pressure_forces()
        return float(self.grid.array(coupled.force, 3)[2][self.kind[2] == int(LIQUID)].sum())

    def _drive(self) -> float:
        """Return the force that drives the concrete through a periodic pipe [N]."""
        fixed, heavy = self.flow.state.layout.mean_velocity_fixed, self.flow.aggregates.bodies.extra_mass.numpy()
        per_volume = float(self.flow.mesh.drive.numpy()[int(LAST_FORCE if fixed else FORCE)])
        volume = float(self.mass[2][self.kind[2] == int(LIQUID)].sum()) / self.flow.scene.concrete.density
        return per_volume * volume + _hastened(self.flow) * float(heavy.astype(float).sum()) / self.dt

    def _inertia(self) -> tuple[float, float, float, float]:
        """Return three rates of change in the step, and the momentum at its end [kg m/s].

        The rates are the increase of kinetic energy per time [W], the power that the implicit Euler method removes by
        numerical damping [W], and the increase of momentum per time [N].
        """
        bodies, clumps = self.flow.aggregates.bodies, self.flow.aggregates.kind.clumps
        heavy, round = (a.numpy().astype(float)[:, None] for a in (bodies.extra_mass, bodies.extra_inertia))
        kinetic = damping = 0.0
        changes = [
            np.where(self.mass != 0, self.u - self.start, 0.0),
            *(b - a for a, b in zip(self.before, self.after, strict=True)),
        ]
        gains = [self.mass * changes[0], heavy * changes[1], round * changes[2]]
        if clumps:
            gains[2] = np.einsum("nij,nj->ni", bodies.tensor.numpy().astype(float), changes[2])
            # The gyroscopic torque turns the angular momentum of a clump, and does no work on it.
            kinetic -= self.dt * float(np.sum(bodies.gyration.numpy().astype(float) * self.after[1]))
        for gain, change, after in zip(gains, changes, (self.u, *self.after), strict=True):
            kinetic += float(np.sum(gain * (after - 0.5 * change)))
            damping += float(np.sum(0.5 * gain * change))
        ends = [
            float(np.sum(self.mass[2] * u[2]) + np.sum(heavy[:, 0] * bodies[:, 2]))
            for u, bodies in ((self.start, self.before[0]), (self.u, self.after[0]))
        ]
        return kinetic / self.dt, damping / self.dt, (ends[1] - ends[0]) / self.dt, ends[1]

    def _dissipation(self) -> tuple[float, float, float]:
        """Return two dissipated powers [W], and the viscous force on faces that move with walls [N].

        The plastic viscosity of the mortar dissipates the first power, and its yield stress the second. The force is
        the component along the last axis of the grid.
        """
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
        # The viscous stress of a cell acts on two opposite faces. The forces on both cancel, unless one belongs to a
        # wall. The forces of the shear stress of an edge cancel in the same way.
        free = self.unknown[2].astype(float)
        stress = np.where(liquid, 2 * volume * fill * room * cut * rates[2] / width[2], 0.0)
        by_walls = float(np.sum(stress * (free - grid.next(free, 2))))
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
            if b == 2:
                stress = np.where(ends, wet * volume * rate * cut[pair] / width[a], 0.0)
                by_walls += float(np.sum(stress * (grid.last(free, a) - free)))
        return viscous, sum_all - viscous, by_walls

    def _pairs(self) -> tuple[float, float, float, float]:
        """Return three powers of the forces on aggregates [W], and the force of walls on aggregates [N].

        The powers are dissipated by lubrication, dissipated by contacts, and supplied by walls that push aggregates.
        The force is the component along the last axis of the grid.
        """
        forces = pair_forces(self.flow)
        wall = forces.other == int(WALL)
        # Both aggregates of a pair have an entry for it, so each entry counts half of the pair's power.
        share = np.where(wall, 1.0, 0.5)
        return (
            float(np.sum(share * forces.lubrication * forces.approach)),
            float(np.sum(share * (forces.contact * forces.approach - np.sum(forces.rubbing * forces.sliding, 1)))),
            float(np.sum(forces.force[wall] * forces.wall_velocity[wall])),
            float(np.sum(forces.force[wall, 2])),
        )
