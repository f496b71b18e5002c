"""Stages of the discrete element method. One step is: contacts, walls, wall motion, bodies, clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from .errors import InstabilityError
from .kernels.bodies import body_kernel, tick_kernel
from .kernels.bonds import bond_kernels
from .kernels.contacts import contact_kernel
from .kernels.timestep import timestep_kernels
from .kernels.types import TIME, types
from .kernels.wall_motion import advance_kernel
from .kernels.walls import wall_kernel
from .model import Model
from .scene import Bonds, Driven, MeshWall, PlaneWall, Scene
from .state import State


class Stage:
    """One kernel launch of a step, recorded once and replayed until an array of its changes."""

    def __init__(self, kernel, dim: int, arguments: list, device) -> None:
        self.kernel, self.dim, self.arguments, self.device = kernel, dim, arguments, device
        self._command: Any = None

    def __call__(self) -> None:
        if self.dim == 0:
            return
        if self._command is None:
            self._command = wp.launch(
                self.kernel, dim=self.dim, inputs=self.arguments, device=self.device, record_cmd=True
            )
        self._command.launch()


def step_stages(
    model: Model,
    state: State,
    *,
    skin: float,
    mesh_skin: float,
    local_damping: float = 0.0,
    growth_rate: float = 0.0,
    growth_end: float = 1.0,
) -> list[Stage]:
    """Stages of one step on the arrays that the state holds now."""
    f, scalar, device = model.features, model.scalar, model.device
    gravity = types(scalar).vec3(*model.scene.gravity)
    # What spheres and moving meshes may go between two builds adds up to the skin.
    moving_mesh = any(isinstance(wall, MeshWall) and wall.motion is not None for wall in model.walls)
    sphere_share = 0.5 * mesh_skin if moving_mesh else mesh_skin
    stages = [
        Stage(
            contact_kernel(scalar, f.pair_law, f.half_list, f.history, f.bonds, f.healing, f.losses),
            state.sphere_count,
            [
                model.pair_parameters, model.bond_parameters, model.material_count, state.sphere_position,
                state.sphere_velocity, state.sphere_spin, state.sphere_material, state.pair_start, state.pair_other,
                state.clock, state.flags, state.pair_history, state.pair_bond, state.pair_bond_force,
                state.pair_bond_moment, state.force, state.moment, state.sphere_lost,
            ],
            device,
        )
    ]  # fmt: skip
    if f.walls:
        stages.append(
            Stage(
                wall_kernel(scalar, f.wall_law, f.meshes, f.losses),
                state.sphere_count,
                [
                    model.wall_parameters, model.material_count, model.wall_table, model.analytic_walls,
                    model.segments, state.wall_position, state.wall_orientation, state.wall_velocity, state.wall_spin,
                    model.corners, model.faces, model.face_across, model.ring_start, model.ring, model.face_wall,
                    state.candidate_start, state.candidate_face, state.sphere_position, state.sphere_velocity,
                    state.sphere_spin, state.sphere_material, state.clock, state.flags, state.slot_history,
                    state.slot_normal, state.slot_overlap, state.slot_wall, state.force, state.moment,
                    state.wall_step_force, state.sphere_lost,
                ],
                device,
            )
        )  # fmt: skip
        stages.append(
            Stage(
                advance_kernel(scalar),
                len(model.walls),
                [
                    model.wall_table, model.rest_position, state.clock, state.flags,
                    state.wall_step_force, state.wall_position_exact, state.wall_velocity_exact, state.wall_position,
                    state.wall_orientation, state.wall_velocity, state.wall_spin, state.wall_force,
                    state.wall_moment, state.wall_impulse, state.wall_angular_impulse, state.wall_travel,
                    state.wall_work, state.wall_moved, mesh_skin,
                ],
                device,
            )
        )  # fmt: skip
    stages.append(
        Stage(
            body_kernel(scalar, f.clumps, f.drives, f.growth, f.meshes, f.losses),
            state.body_count,
            [
                gravity, local_damping, model.scene.watch.speed, model.segments, model.drive_axis, model.drive_force,
                state.body_group, state.body_mass, state.body_inertia, state.body_first, state.sphere_offset,
                state.sphere_built, state.reference_velocity, skin, sphere_share, growth_rate, growth_end, state.clock,
                state.flags, state.scale, state.force, state.moment, state.sphere_lost, state.body_position,
                state.body_rounding, state.body_velocity,
                state.body_spin, state.body_orientation, state.body_angular_momentum, state.sphere_position,
                state.sphere_velocity, state.sphere_spin,
            ],
            device,
        )
    )  # fmt: skip
    tick = tick_kernel(scalar, f.growth)
    stages.append(Stage(tick, 1, [growth_rate, growth_end, state.clock, state.flags, state.scale], device))
    return stages


class StableStep:
    """Estimate of the largest stable step from masses and live stiffness, bonds included."""

    def __init__(self, model: Model, state: State, horizon: float) -> None:
        """`horizon` [s] is the longest time until the next estimate."""
        f = model.features
        self._foreseen = foreseen_speed(model.scene, horizon)
        self._gather, self._reduce = timestep_kernels(model.scalar, f.pair_law, f.wall_law, f.half_list, f.bonds)
        self._sums = wp.zeros((state.sphere_count, 4), dtype=types(model.scalar).mat33, device=model.device)
        self._wall_load = wp.zeros((len(model.walls), 2), dtype=wp.int64, device=model.device)
        self._driven = [(w, wall.motion) for w, wall in enumerate(model.walls) if isinstance(wall.motion, Driven)]
        self._smallest = wp.zeros(1, dtype=wp.float64, device=model.device)
        self._fastest = wp.zeros(1, dtype=wp.float64, device=model.device)

    def __call__(self, model: Model, state: State) -> float:
        """Step [s], without safety factor; infinite for a state without bodies."""
        if state.body_count == 0:
            return float("inf")
        self._smallest.fill_(1e30)
        self._wall_load.zero_()
        self._fastest.fill_(self._foreseen)
        device = model.device
        wp.launch(
            self._gather,
            dim=state.sphere_count,
            inputs=[
                model.pair_parameters, model.wall_parameters, model.bond_parameters, model.material_count,
                model.wall_table, model.analytic_walls, model.segments, state.wall_position, state.wall_orientation,
                state.wall_velocity, state.wall_spin, state.body_position, state.sphere_body, state.sphere_position,
                state.sphere_velocity, state.sphere_material, state.slot_wall, state.slot_normal, state.slot_overlap,
                state.pair_start, state.pair_other, state.pair_bond, self._sums, self._wall_load,
                self._fastest,
            ],
            device=device,
        )  # fmt: skip
        wp.launch(
            self._reduce,
            dim=state.body_count,
            inputs=[
                model.pair_parameters, model.wall_parameters, model.material_count, self._fastest,
                state.body_mass, state.body_inertia, state.body_position, state.body_orientation,
                state.body_first, state.sphere_position,
                state.sphere_velocity, state.sphere_material, self._sums, self._smallest,
            ],
            device=device,
        )  # fmt: skip
        step = float(self._smallest.numpy()[0])
        if self._driven:
            # A driven wall is a body, too; never less than one contact with the largest sphere.
            load = self._wall_load.numpy() / 1000
            for wall, motion in self._driven:
                stiffness = max(float(load[wall, 0]), np.pi * model.stress_scale * state.largest_radius)
                # Dashpots are sized for the aggregates' masses and may be far beyond critical for the wall's.
                ratio = 0.5 * float(load[wall, 1]) / np.sqrt(motion.mass * stiffness)
                step = min(step, float(np.sqrt(motion.mass / stiffness) * (np.hypot(1, ratio) - ratio)))
        if not step > 0:
            time = float(state.clock.numpy()[int(TIME)])
            raise InstabilityError(
                f"t = {time:.6g} s: the stable time step came out as {step:.3g} s; usual cures: masses, stiffnesses "
                "and dashpots that single precision can hold, or precision float64"
            )
        return step


def foreseen_speed(scene: Scene, horizon: float) -> float:
    """Speed that a wall will have, or that forces can give within `horizon` [m/s]."""
    gained = [float(np.linalg.norm(scene.gravity))]
    speeds = [0.0]
    for wall in scene.walls:
        motion = wall.motion
        if isinstance(motion, Driven):
            gained.append(abs(motion.force) / motion.mass)
        elif motion is not None:
            if isinstance(wall, MeshWall):
                places = wall.vertices
            else:
                places = np.array([wall.point if isinstance(wall, PlaneWall) else motion.pivot])
            lever = float(np.linalg.norm(places - np.array(motion.pivot), axis=1).max())
            speeds.append(float(np.linalg.norm(motion.velocity)) + lever * float(np.linalg.norm(motion.spin)))
    return max(speeds) + max(gained) * horizon


def make_bonds(model: Model, state: State, bonds: Bonds, kind: int, group: int = -1) -> int:
    """Bond, without load, every listed pair within `bonds.gap` that is not bonded (inside `group` only, if given).

    Returns the number of pairs that are bonded afterwards. The list must be fresh and reach as far as the gap.
    """
    make, _ = bond_kernels(model.scalar)
    wp.launch(
        make,
        dim=state.sphere_count,
        inputs=[
            kind, bonds.gap, group, state.sphere_position, state.sphere_body, state.body_group, state.pair_start,
            state.pair_other, state.pair_bond, state.pair_bond_force, state.pair_bond_moment,
        ],
        device=model.device,
    )  # fmt: skip
    return int(np.count_nonzero(_bonds(model, state) == kind))


def reassign_bonds(model: Model, state: State, old: int, new: int, share: float, seed: int) -> int:
    """Give a random `share` of the bonds of kind `old` the properties of kind `new`; returns how many have them."""
    _, reassign = bond_kernels(model.scalar)
    wp.launch(
        reassign,
        dim=state.sphere_count,
        inputs=[
            old,
            new,
            share,
            seed & 0xFFFFFFFF,
            state.sphere_id,
            state.pair_start,
            state.pair_other,
            state.pair_bond,
        ],
        device=model.device,
    )
    return int(np.count_nonzero(_bonds(model, state) == new))


def _bonds(model: Model, state: State) -> np.ndarray:
    """Bond state of every listed pair, each pair once."""
    bonds = state.pair_bond.numpy()[: state.pair_total]
    if not model.features.half_list:
        bonds = bonds[state.pair_other.numpy()[: state.pair_total] >= 0]
    return bonds
