"""What is measured: sums over bodies, contacts and walls, added in a fixed order in double precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from .kernels.probes import BODY_COLUMNS, CONTACT_COLUMNS, probe_kernels
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


def body_sums(model: Model, state: State) -> BodySums:
    """Energies, momentum and drive forces of all bodies."""
    n = state.body_count
    mass = float(state.body_mass.numpy().sum(dtype=float))
    if n == 0:
        return BodySums(0.0, 0.0, np.zeros(3), 0.0, np.zeros(3), np.zeros(3))
    f = model.features
    measure, _ = probe_kernels(model.scalar, f.half_list, f.friction, f.bonds)
    values = wp.zeros((n, BODY_COLUMNS), dtype=wp.float64, device=model.device)
    wp.launch(
        measure,
        dim=n,
        inputs=[
            types(model.scalar).vec3(*model.scene.gravity), model.segments, model.drive_axis, model.drive_force,
            state.body_group, state.body_mass, state.body_inertia, state.body_position, state.body_velocity,
            state.body_spin, state.body_orientation, state.body_id, values,
        ],
        device=model.device,
    )  # fmt: skip
    total = values.numpy().sum(0)
    return BodySums(
        kinetic_energy=float(total[0]),
        potential_energy=float(total[1]),
        momentum=total[2:5],
        mass=mass,
        centroid=total[5:8] / mass,
        drive_force=total[8:11],
    )


def contact_sums(model: Model, state: State, *, coordination: bool = False) -> ContactSums:
    """Number, overlap, energies and bonds of all contacts; the coordination number only when asked for."""
    n = state.sphere_count
    if n == 0:
        return ContactSums(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    f = model.features
    _, measure = probe_kernels(model.scalar, f.half_list, f.friction, f.bonds)
    values = wp.zeros((n, CONTACT_COLUMNS), dtype=wp.float64, device=model.device)
    wp.launch(
        measure,
        dim=n,
        inputs=[
            model.contact_parameters, model.bond_parameters, model.material_count, model.wall_table,
            model.analytic_walls, model.segments, state.wall_position, state.wall_orientation, state.slot_shear,
            state.slot_overlap, state.slot_wall,
            state.body_position, state.sphere_body, state.sphere_id, state.sphere_position,
            state.sphere_material, state.pair_start, state.pair_other,
            state.pair_shear, state.pair_bond, state.pair_bond_force, state.pair_bond_moment, values,
        ],
        device=model.device,
    )  # fmt: skip
    rows = values.numpy()
    total = rows.sum(0)
    contacts = int(total[0])
    return ContactSums(
        contacts=contacts,
        coordination_number=2 * len(touching_bodies(state)) / state.body_count if coordination else float("nan"),
        mean_overlap=float(total[1] / contacts) if contacts else 0.0,
        largest_overlap=float(rows[:, 2].max()),
        elastic_energy=float(total[3]),
        bond_energy=float(total[4]),
        bonded=int(total[5]),
        hydrated=int(total[7]),
        virial=float(total[6]),
    )


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
