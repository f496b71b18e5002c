"""Measurements on the state of a run: sums over bodies, contacts and walls.

The values are added in a fixed order and in double precision.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from ...core.device.arrays import Kernel
from ...core.device.exchange import LaunchAndRead
from ...core.device.graphs import Call, GraphLaunch
from ...core.device.launching import DEFAULT_BLOCK, Size, Stage, completed
from ...kernels.dem import probes as column
from ..engine.model import Model
from ..engine.pairs import listed_pairs
from ..engine.state import State


@dataclass(frozen=True)
class ContactSums:
    """Sums over the sphere-sphere contacts of a state; elastic energy and deepest overlap include wall contacts."""

    contacts: int
    coordination_number: float
    """Coordination number: mean number of touching neighbours per body; NaN if it was not requested."""
    mean_overlap: float
    """Mean overlap of touching spheres; each overlap is divided by the radius of the smaller sphere."""
    largest_overlap: float
    deepest: float
    """Largest overlap of any contact, divided by the overlap up to which contact laws are meaningful.

    Between spheres, this limit is the overlap at which the larger sphere contains the smaller one, or at which the
    centres are only half as far apart as at first touch, whichever comes first. On walls, the limit is the radius of
    the sphere.
    """
    elastic_energy: float
    """Energy stored in contact springs, walls included, at the middle of the last step [J]."""
    bond_energy: float
    """Energy stored in all bonds [J]."""
    bonded: int
    hydrated: int
    virial: float
    """Sum over contacts of the scalar product of the normal spring force and the vector from centroid to centroid
    [J]."""
    broken_tension: int
    """Number of bonds broken by tension since t = 0."""
    broken_shear: int


@dataclass(frozen=True)
class BodySums:
    """Energies, momentum and other sums over the bodies of a state."""

    kinetic_energy: float
    """Kinetic energy of all bodies at the middle of the last step [J]."""
    potential_energy: float
    """Potential energy of all bodies in gravity, zero at the origin [J]."""
    momentum: np.ndarray
    """Total momentum at the middle of the last step [kg m/s], shape (3,)."""
    mass: float
    """Total mass of all bodies [kg]."""
    centroid: np.ndarray
    """Centroid of all bodies [m], shape (3,)."""
    drive_force: np.ndarray
    """Sum of the forces of all axis drives [N], shape (3,).

    An axis drive pushes the bodies of a group along a pipe's axis.
    """
    drive_power: float
    """Sum of the power of all axis drives [W]; an axis drive pushes the bodies of a group along a pipe's axis."""
    reach: float
    """Largest absolute value of any coordinate of any body [m]."""


def body_sums(model: Model, state: State) -> BodySums:
    """Return energies, momentum and driving forces of all bodies."""
    if state.body_count:
        launch_recorded(state, "bodies", lambda: _body_stages(model, state))
    return _bodies_of(state, *_read(state, "bodies"))


def contact_sums(model: Model, state: State, *, coordination: bool = False) -> ContactSums:
    """Return sums over all contacts: their number, overlaps, energies and bonds.

    The coordination number is computed only if `coordination` is True.
    """
    if state.sphere_count:
        launch_recorded(state, "contacts", lambda: _contact_stages(model, state))
    return _contacts_of(state, *_read(state, "contacts"), coordination)


def row_sums(model: Model, state: State) -> tuple[BodySums, ContactSums, np.ndarray]:
    """Return the values for a row of the time series: sums over bodies, sums over contacts, and values of each wall.

    The values of the walls have the shape (walls, WALL_COLUMNS). A GPU measures everything with one launch.
    """
    batch, index = state.batch, state.index
    recorded = state.launches(batch.version)
    if "row" not in recorded:
        stages = [batch.wall_stage()]
        if state.body_count:
            stages += _body_stages(model, state) + _contact_stages(model, state)
        sums_of = [_sums(state, each, columns) for each, columns in COLUMNS.items() if state.body_count]
        recorded["row"] = LaunchAndRead(stages, [batch.wall_array, *sums_of], batch.device)
    walls, *found = recorded["row"]()
    bodies, contacts = found or [np.zeros(columns) for columns in COLUMNS.values()]
    return _bodies_of(state, bodies), _contacts_of(state, contacts, False), batch.own_walls(index, walls)


COLUMNS = {"bodies": int(column.BODY_COLUMNS), "contacts": int(column.CONTACT_COLUMNS)}


def _read(state: State, *what: str) -> list[np.ndarray]:
    """Read measured sums from the device; return one array for each name in `what`.

    The name "bodies" stands for the sums over all bodies, and "contacts" for the sums over all contacts.
    """
    if state.body_count == 0:
        return [np.zeros(COLUMNS[each]) for each in what]
    return state.batch.exchange.read(*(_sums(state, each, COLUMNS[each]) for each in what))


def _bodies_of(state: State, total: np.ndarray) -> BodySums:
    if state.body_count == 0:
        return BodySums(0.0, 0.0, np.zeros(3), 0.0, np.zeros(3), np.zeros(3), 0.0, 0.0)
    mass = state.total_mass
    return BodySums(
        kinetic_energy=float(total[column.KINETIC]),
        potential_energy=float(total[column.POTENTIAL]),
        momentum=total[column.MOMENTUM : column.MOMENTUM + 3],
        mass=mass,
        centroid=total[column.LIFT : column.LIFT + 3] / mass,
        drive_force=total[column.DRIVEN : column.DRIVEN + 3],
        drive_power=float(total[column.DRIVE_POWER]),
        reach=float(total[column.REACH]),
    )


def _contacts_of(state: State, total: np.ndarray, coordination: bool) -> ContactSums:
    if state.sphere_count == 0:
        return ContactSums(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0, 0, 0)
    contacts = int(total[column.CONTACTS])
    return ContactSums(
        contacts=contacts,
        coordination_number=2 * len(touching_bodies(state)) / state.body_count if coordination else float("nan"),
        mean_overlap=float(total[column.OVERLAP_SUM] / contacts) if contacts else 0.0,
        largest_overlap=float(total[column.OVERLAP_MAX]),
        deepest=float(total[column.DEPTH_MAX]),
        elastic_energy=float(total[column.ELASTIC_ENERGY]),
        bond_energy=float(total[column.BOND_ENERGY]),
        bonded=int(total[column.BONDED]),
        hydrated=int(total[column.BONDED_HYDRATED]),
        virial=float(total[column.VIRIAL]),
        broken_tension=int(total[column.BROKEN_TENSION]),
        broken_shear=int(total[column.BROKEN_SHEAR]),
    )


def _body_stages(model: Model, state: State) -> list[Stage]:
    n = state.body_count
    values = state.scratch("body rows", (n, int(column.BODY_COLUMNS)), wp.float64)
    probe = scene_stage(state, column.body_probe(model.scalar), n, values=values)
    return [probe, *_column_sum_stages(state, "bodies", values, n, column.BODY_MAXIMA)]


def _contact_stages(model: Model, state: State) -> list[Stage]:
    values, n = _contact_rows(state)[0], state.sphere_count
    return [
        *_contact_probe_stages(model, state),
        *_column_sum_stages(state, "contacts", values, n, column.CONTACT_MAXIMA),
    ]


def _sums(state: State, what: str, columns: int) -> wp.array:
    return state.scratch(f"{what}, sums", (columns,), wp.float64)


def _column_sum_stages(state: State, what: str, values: wp.array, rows: int, maxima: tuple[int, ...]) -> list[Stage]:
    """Return the kernel launches that reduce each column of `values` to one number.

    This number is the maximum for the columns in `maxima`, and the sum for the others. The order of the additions
    depends only on the number of rows, so that the sums are reproducible to the bit.
    """
    columns = values.shape[1]
    lanes = state.scratch(f"{what}, lanes", (column.LANES, columns), wp.float64)
    partial, whole = column.column_kernels()
    bits = sum(1 << c for c in maxima)
    return [
        scene_stage(state, partial, (column.LANES, columns), values=values, rows=rows, maxima=bits, lanes=lanes),
        scene_stage(state, whole, columns, lanes=lanes, maxima=bits, sums=_sums(state, what, columns)),
    ]


def scene_stage(state: State, kernel: Kernel, dim: Size, **named: object) -> Stage:
    """Return a launch of `kernel` with `dim` tasks (threads) for the scene to which `state` belongs.

    `named` contains arguments of the kernel by name. All other parameters receive the batch's arrays of the same name,
    and the parameter `s` receives the index of the scene in the batch.
    """
    batch = state.batch
    arguments = completed(kernel, named, {"s": state.index, **batch.kernel_arrays})
    return Stage(kernel, dim, arguments, batch.device, block=DEFAULT_BLOCK)


def launch_recorded(state: State, what: str, make: Callable[[], list[Any]]) -> None:
    """Launch the kernels of the measurement with the name `what` together, as one recorded graph.

    `make` returns the launches to record. It is called at the first launch, and again whenever the batch's arrays have
    changed.
    """
    recorded = state.launches(state.batch.version)
    if what not in recorded:
        recorded[what] = GraphLaunch(make(), state.batch.device)
    recorded[what]()


def _contact_rows(state: State) -> tuple[wp.array, wp.array]:
    """Return two device arrays that receive sums over the contacts of each sphere, and the force of each listed pair.

    The first array has one row for each sphere, in order of permanent numbers, shape (spheres, CONTACT_COLUMNS). The
    second contains a normal force for each entry of the neighbour list [N].
    """
    values = state.scratch("contact rows", (state.sphere_count, int(column.CONTACT_COLUMNS)), wp.float64)
    return values, state.scratch("pair forces", (len(state.pairs.other),), state.model.scalar)


def _contact_probe_stages(model: Model, state: State) -> list[Stage]:
    f = model.features
    values, forces = _contact_rows(state)
    probe = column.contact_probe(model.scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds)
    base = int(state.batch.rows["spheres"][state.index])
    return [
        scene_stage(
            state, probe, last - first, first=base + first, last=base + last, values=values, pair_normal_force=forces
        )
        for first, last in pairwise(state.chunks)
    ]


def _measure_contacts(state: State) -> tuple[wp.array, wp.array]:
    launch_recorded(state, "contact rows", lambda: _contact_probe_stages(state.model, state))
    return _contact_rows(state)


def deepest_sphere(model: Model, state: State) -> int:
    """Return the permanent number of a body with the largest relative overlap (`ContactSums.deepest`)."""
    rows = _measure_contacts(state)[0].numpy()
    sphere = int(np.flatnonzero(state.spheres.id.numpy() == int(rows[:, column.DEPTH_MAX].argmax()))[0])
    return int(state.bodies.id.numpy()[state.spheres.body.numpy()[sphere]])


def listed_forces(model: Model, state: State) -> np.ndarray:
    """Return the normal force of each entry of the neighbour list [N], shape (pairs,).

    If a pair has two entries, one for each of its spheres, one entry contains the force and the other contains 0.
    """
    return _measure_contacts(state)[1].numpy().copy() if state.sphere_count else np.zeros(0)


def largest_forces(model: Model, state: State) -> wp.array:
    """Return the largest normal contact force on each body [N], shape (n,), in the order of the state's arrays.

    The next call overwrites the returned array.
    """
    loads = state.scratch("loads", (state.body_count,), model.scalar)
    if state.sphere_count:
        launch_recorded(
            state,
            "loads",
            lambda: [Call(loads.zero_), *_contact_probe_stages(model, state), _load_stage(model, state, loads)],
        )
    return loads


def _load_stage(model: Model, state: State, loads: wp.array) -> Stage:
    forces = _contact_rows(state)[1]
    return scene_stage(
        state, column.load_probe(model.scalar), state.sphere_count, pair_normal_force=forces, loads=loads
    )


def pair_forces(model: Model, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return both sphere indices of every touching pair, each pair once, and the normal force of its spring [N]."""
    if not state.sphere_count:
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0)
    force = _measure_contacts(state)[1].numpy()
    i, j, place = listed_pairs(state)
    carried = force[place].astype(float)
    return i[carried > 0], j[carried > 0], carried[carried > 0]


def touching_bodies(state: State) -> np.ndarray:
    """Return the pairs of touching bodies as indices into the body arrays, shape (m, 2); each pair occurs once."""
    i, j, _ = listed_pairs(state)
    position = state.spheres.position.numpy()
    touching = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < position[i, 3] + position[j, 3]
    body = state.spheres.body.numpy()
    a, b = body[i[touching]].astype(np.int64), body[j[touching]].astype(np.int64)
    # Encode each pair of bodies as one number, because finding unique pairs in two columns takes seven times as long.
    number = np.unique(np.minimum(a, b) * state.body_count + np.maximum(a, b))
    return np.stack(np.divmod(number, max(state.body_count, 1)), axis=1)


def fastest_body(model: Model, state: State) -> int:
    """Return the permanent number of the fastest body, or of a body whose velocity or spin is not finite."""
    speed = np.linalg.norm(state.bodies.velocity.numpy(), axis=1)
    if not len(speed):
        return -1
    wrong = np.flatnonzero(~np.isfinite(speed + state.bodies.spin.numpy().sum(axis=1)))
    place = int(wrong[0]) if len(wrong) else int(np.argmax(speed))
    return int(state.bodies.id.numpy()[place])


def farthest_body(state: State) -> int:
    """Return the permanent number of the body with the largest absolute coordinate."""
    return int(state.bodies.id.numpy()[np.abs(state.bodies.position.numpy()).max(1).argmax()])
