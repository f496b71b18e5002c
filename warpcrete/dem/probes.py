"""What is measured: sums over bodies, contacts and walls, added in a fixed order in double precision."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from ..core.launching import DEFAULT_BLOCK, Size, Stage, parameter_names
from ..kernels.dem import probes as column
from .model import Model
from .state import State


@dataclass(frozen=True)
class ContactSums:
    """Sphere-sphere contacts of a state; the elastic energy includes walls."""

    contacts: int
    coordination_number: float
    """Mean number of touching neighbours of a body; NaN if not asked for."""
    mean_overlap: float
    """Over the smaller radius."""
    largest_overlap: float
    deepest: float
    """Largest overlap over the one that swallows the smaller sphere whole or halves the distance of the centres,
    whichever comes first; on walls over the radius. Past 1 a contact no longer means anything."""
    elastic_energy: float
    """[J]"""
    bond_energy: float
    """[J]"""
    bonded: int
    hydrated: int
    virial: float
    """Sum over contacts of normal spring force times the vector between the bodies' centroids [J]."""
    broken_tension: int
    """Bonds broken by tension since the start."""
    broken_shear: int


@dataclass(frozen=True)
class BodySums:
    """Sums over the bodies of a state."""

    kinetic_energy: float
    """[J], at the middle of the last step."""
    potential_energy: float
    """[J], gravity, zero at the origin."""
    momentum: np.ndarray
    """[kg m/s], shape (3,), at the middle of the last step."""
    mass: float
    """[kg]"""
    centroid: np.ndarray
    """[m], shape (3,)."""
    drive_force: np.ndarray
    """Sum of the axis drives [N], shape (3,)."""
    drive_power: float
    """Of the axis drives [W]."""
    reach: float
    """Largest coordinate of a body [m]."""


def body_sums(model: Model, state: State) -> BodySums:
    """Energies, momentum and drive forces of all bodies."""
    n = state.body_count
    if n == 0:
        return BodySums(0.0, 0.0, np.zeros(3), 0.0, np.zeros(3), np.zeros(3), 0.0, 0.0)
    values = state.scratch("body rows", (n, int(column.BODY_COLUMNS)), wp.float64)
    _launch(state, "bodies", lambda: (column.body_probe(model.scalar), n, {"values": values}))
    total = _summed(state, "bodies", values, n, column.BODY_MAXIMA)
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


def contact_sums(model: Model, state: State, *, coordination: bool = False) -> ContactSums:
    """Number, overlap, energies and bonds of all contacts; the coordination number only when asked for."""
    if state.sphere_count == 0:
        return ContactSums(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0, 0, 0)
    values = _measure_contacts(state)[0]
    total = _summed(state, "contacts", values, state.sphere_count, column.CONTACT_MAXIMA)
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


def _summed(state: State, what: str, values: wp.array, rows: int, maxima: tuple[int, ...]) -> np.ndarray:
    """Sum (or maximum) of every column, added on the device in an order that depends on the number of rows only."""
    columns = values.shape[1]
    lanes = state.scratch(f"{what}, lanes", (column.LANES, columns), wp.float64)
    sums = state.scratch(f"{what}, sums", (columns,), wp.float64)
    partial, whole = column.column_kernels(maxima)
    given = {"values": values, "rows": rows, "lanes": lanes}
    _launch(state, f"{what}, lanes", lambda: (partial, (column.LANES, columns), given))
    _launch(state, f"{what}, sums", lambda: (whole, columns, {"lanes": lanes, "sums": sums}))
    return sums.numpy().copy()


def _launch(state: State, what: str, make: Callable[[], tuple[Any, Size, dict[str, Any]]]) -> None:
    """Launch over one scene of a batch what `make` says: a kernel, its tasks and arguments. Parameters that it does not
    name are the batch's attributes of their names. Recorded once, until an array of the batch's is another.
    """
    batch = state.batch
    stages = state.launches(batch.version)
    if what not in stages:
        kernel, dim, named = make()
        given = {"s": state.index, **named}
        bound = {name: given[name] if name in given else getattr(batch, name) for name in parameter_names(kernel)}
        stages[what] = Stage(kernel, dim, bound, batch.device, block=DEFAULT_BLOCK)
    stages[what]()


def _measure_contacts(state: State) -> tuple[wp.array, wp.array]:
    """Rows of the contact probe in the order of the spheres' permanent numbers, and each listed pair's normal force."""
    f, model, n = state.model.features, state.model, state.sphere_count
    values = state.scratch("contact rows", (n, int(column.CONTACT_COLUMNS)), wp.float64)
    forces = state.scratch("pair forces", (len(state.pairs.other),), model.scalar)
    probe = column.contact_probe(model.scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds)
    base = int(state.batch.rows["spheres"][state.index])
    for first, last in pairwise(state.chunks):
        given = {"first": base + first, "last": base + last, "values": values, "pair_normal_force": forces}
        _launch(state, f"contacts of {first} to {last}", lambda given=given, tasks=last - first: (probe, tasks, given))
    return values, forces


def deepest_sphere(model: Model, state: State) -> int:
    """Permanent number of a body whose overlap is the deepest."""
    rows = _measure_contacts(state)[0].numpy()
    sphere = int(np.flatnonzero(state.spheres.id.numpy() == int(rows[:, column.DEPTH_MAX].argmax()))[0])
    return int(state.bodies.id.numpy()[state.spheres.body.numpy()[sphere]])


def largest_forces(model: Model, state: State) -> np.ndarray:
    """Largest normal contact force on each body [N], in the order of the state's arrays."""
    result = np.zeros(state.body_count)
    if state.sphere_count:
        force = _measure_contacts(state)[1].numpy()
        i, j, place = listed_pairs(state)
        body = state.spheres.body.numpy()
        np.maximum.at(result, body[i], force[place])
        np.maximum.at(result, body[j], force[place])
    return result


def listed_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of both spheres of every listed pair, each pair once, and its place in the pair arrays."""
    start = state.pairs.start.numpy()
    other = state.pairs.other.numpy()[: state.pair_total]
    i = np.repeat(np.arange(state.sphere_count), np.diff(start))
    j = np.where(other >= 0, other, -1 - other)
    once = other >= 0
    if state.model.features.half_list:
        # Pairs inside a chunk stand once, at either sphere.
        once |= np.searchsorted(state.chunks, i, "right") == np.searchsorted(state.chunks, j, "right")
    return i[once], j[once], np.flatnonzero(once)


def touching_bodies(state: State) -> np.ndarray:
    """Pairs of touching bodies, shape (m, 2), each once, as places in the body arrays."""
    i, j, _ = listed_pairs(state)
    position = state.spheres.position.numpy()
    touching = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < position[i, 3] + position[j, 3]
    body = state.spheres.body.numpy()
    a, b = body[i[touching]], body[j[touching]]
    return np.unique(np.stack([np.minimum(a, b), np.maximum(a, b)], 1), axis=0).reshape(-1, 2)


def fastest_body(model: Model, state: State) -> int:
    """Permanent number of the body with the largest speed, or of one whose motion is not a number."""
    speed = np.linalg.norm(state.bodies.velocity.numpy(), axis=1)
    if not len(speed):
        return -1
    wrong = np.flatnonzero(~np.isfinite(speed + state.bodies.spin.numpy().sum(axis=1)))
    place = int(wrong[0]) if len(wrong) else int(np.argmax(speed))
    return int(state.bodies.id.numpy()[place])


def farthest_body(state: State) -> int:
    """Permanent number of the body farthest from the origin."""
    return int(state.bodies.id.numpy()[np.abs(state.bodies.position.numpy()).max(1).argmax()])
