"""What is measured: sums over bodies, contacts and walls, added in a fixed order in double precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from .kernels import probes as column
from .kernels.types import types
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
    mass = float(state.body_mass.numpy().sum(dtype=float))
    if n == 0:
        return BodySums(0.0, 0.0, np.zeros(3), 0.0, np.zeros(3), np.zeros(3), 0.0, 0.0)
    values = wp.zeros((n, int(column.BODY_COLUMNS)), dtype=wp.float64, device=model.device)
    wp.launch(
        column.body_probe(model.scalar),
        dim=n,
        inputs=[
            types(model.scalar).vec3(*model.scene.gravity), model.segments, model.drive_axis, model.drive_force,
            state.body_group, state.body_mass, state.body_inertia, state.body_position, state.body_velocity,
            state.body_spin, state.body_orientation, state.body_id, state.clock, values,
        ],
        device=model.device,
    )  # fmt: skip
    rows = values.numpy()
    total = rows.sum(0)
    return BodySums(
        kinetic_energy=float(total[column.KINETIC]),
        potential_energy=float(total[column.POTENTIAL]),
        momentum=total[column.MOMENTUM : column.MOMENTUM + 3],
        mass=mass,
        centroid=total[column.LIFT : column.LIFT + 3] / mass,
        drive_force=total[column.DRIVEN : column.DRIVEN + 3],
        drive_power=float(total[column.DRIVE_POWER]),
        reach=float(rows[:, column.REACH].max()),
    )


def contact_sums(model: Model, state: State, *, coordination: bool = False) -> ContactSums:
    """Number, overlap, energies and bonds of all contacts; the coordination number only when asked for."""
    if state.sphere_count == 0:
        return ContactSums(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    rows, _ = _measure_contacts(model, state)
    total = rows.sum(0)
    contacts = int(total[column.CONTACTS])
    return ContactSums(
        contacts=contacts,
        coordination_number=2 * len(touching_bodies(state)) / state.body_count if coordination else float("nan"),
        mean_overlap=float(total[column.OVERLAP_SUM] / contacts) if contacts else 0.0,
        largest_overlap=float(rows[:, column.OVERLAP_MAX].max()),
        deepest=float(rows[:, column.DEPTH_MAX].max()),
        elastic_energy=float(total[column.ELASTIC_ENERGY]),
        bond_energy=float(total[column.BOND_ENERGY]),
        bonded=int(total[column.BONDED]),
        hydrated=int(total[column.BONDED_HYDRATED]),
        virial=float(total[column.VIRIAL]),
    )


def _measure_contacts(model: Model, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the contact probe in the order of the spheres' permanent numbers, and each listed pair's normal force."""
    f, n = model.features, state.sphere_count
    values = wp.zeros((n, int(column.CONTACT_COLUMNS)), dtype=wp.float64, device=model.device)
    forces = wp.zeros(state.pair_total, dtype=model.scalar, device=model.device)
    wp.launch(
        column.contact_probe(model.scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds),
        dim=n,
        inputs=[
            model.pair_parameters, model.wall_parameters, model.bond_parameters, model.material_count,
            model.wall_table, model.analytic_walls, model.segments, state.wall_position, state.wall_orientation,
            state.wall_velocity, state.slot_history, state.slot_normal, state.slot_overlap, state.slot_wall,
            state.body_position, state.sphere_body, state.sphere_id, state.sphere_position, state.sphere_velocity,
            state.sphere_material, state.pair_start, state.pair_other, state.pair_history, state.pair_bond,
            state.pair_bond_force, state.pair_bond_moment, state.clock, values, forces,
        ],
        device=model.device,
    )  # fmt: skip
    return values.numpy(), forces.numpy()


def deepest_sphere(model: Model, state: State) -> int:
    """Permanent number of a body whose overlap is the deepest."""
    rows, _ = _measure_contacts(model, state)
    sphere = int(np.flatnonzero(state.sphere_id.numpy() == int(rows[:, column.DEPTH_MAX].argmax()))[0])
    return int(state.body_id.numpy()[state.sphere_body.numpy()[sphere]])


def largest_forces(model: Model, state: State) -> np.ndarray:
    """Largest normal contact force on each body [N], in the order of the state's arrays."""
    result = np.zeros(state.body_count)
    if state.sphere_count:
        force = _measure_contacts(model, state)[1]
        i, j, place = listed_pairs(state)
        body = state.sphere_body.numpy()
        np.maximum.at(result, body[i], force[place])
        np.maximum.at(result, body[j], force[place])
    return result


def listed_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of both spheres of every listed pair, each pair once, and its place in the pair arrays."""
    start = state.pair_start.numpy()
    other = state.pair_other.numpy()[: state.pair_total]
    i = np.repeat(np.arange(state.sphere_count), np.diff(start))
    place = np.arange(state.pair_total)
    if not state.model.features.half_list:
        once = other >= 0
        i, other, place = i[once], other[once], place[once]
    return i, np.where(other >= 0, other, -1 - other), place


def touching_bodies(state: State) -> np.ndarray:
    """Pairs of touching bodies, shape (m, 2), each once, as places in the body arrays."""
    i, j, _ = listed_pairs(state)
    position = state.sphere_position.numpy()
    touching = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < position[i, 3] + position[j, 3]
    body = state.sphere_body.numpy()
    a, b = body[i[touching]], body[j[touching]]
    return np.unique(np.stack([np.minimum(a, b), np.maximum(a, b)], 1), axis=0).reshape(-1, 2)


def fastest_body(model: Model, state: State) -> int:
    """Permanent number of the body with the largest speed, or of one whose motion is not a number."""
    speed = np.linalg.norm(state.body_velocity.numpy(), axis=1)
    if not len(speed):
        return -1
    wrong = np.flatnonzero(~np.isfinite(speed + state.body_spin.numpy().sum(axis=1)))
    place = int(wrong[0]) if len(wrong) else int(np.argmax(speed))
    return int(state.body_id.numpy()[place])


def farthest_body(state: State) -> int:
    """Permanent number of the body farthest from the origin."""
    return int(state.body_id.numpy()[np.abs(state.body_position.numpy()).max(1).argmax()])
