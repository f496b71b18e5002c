"""Stages of the discrete element method. One step is: contacts, meshes, walls' motion, bodies, clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .kernels.bodies import clump_kernel, publish_kernel, sphere_kernel, tick_kernel
from .kernels.contacts import contact_kernel
from .kernels.mesh_walls import mesh_kernel
from .kernels.types import SPAN
from .kernels.wall_motion import advance_kernel
from .kernels.walls import wall_kernel
from .launching import Stage, barrier_stage

if TYPE_CHECKING:
    from .batch import Batch


def tasks(batch: Batch, bodies: int) -> int:
    """Tasks of a kernel over so many bodies."""
    return -(-bodies // SPAN) if batch.features.half_list else bodies


def step_stages(batch: Batch) -> list[list[Stage]]:
    """Stages of one step on the arrays that the batch holds now, a list for each thread."""
    b, f, device = batch, batch.features, batch.device
    parts = []
    meet = barrier_stage(b.threads, device)
    for part in range(b.threads):
        first, last = int(b.sphere_chunks[part]), int(b.sphere_chunks[part + 1])
        first_body, last_body = int(b.body_chunks[part]), int(b.body_chunks[part + 1])
        stages = [
            Stage(
                contact_kernel(
                    b.scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds, f.healing,
                    f.analytic and not f.half_list, f.losses
                ),
                tasks(batch, last - first),
                [
                    b.scenes, first, last, part, b.pair_parameters, b.bond_parameters, b.sphere_scene,
                    b.sphere_position, b.sphere_velocity, b.sphere_spin, b.sphere_material, b.pair_start,
                    b.pair_other, b.clock, b.flags, b.sphere_touching, b.pair_history, b.pair_bond,
                    b.pair_bond_force, b.pair_bond_moment, b.wall_parameters, b.wall_table, b.segments,
                    b.wall_position, b.wall_normal, b.wall_velocity, b.wall_spin, b.sphere_clear, b.slot_touching,
                    b.slot_history,
                    b.wall_step_force, b.force, b.moment, b.sphere_lost, b.sphere_broken,
                ],
                device,
            )
        ]  # fmt: skip
        if f.analytic and f.half_list:
            stages.append(
                Stage(
                    wall_kernel(b.scalar, f.wall_law, f.losses),
                    tasks(batch, last - first),
                    [
                        b.scenes, first, last, part, b.wall_parameters, b.wall_table, b.segments, b.wall_position,
                        b.wall_normal, b.wall_velocity, b.wall_spin, b.sphere_scene, b.sphere_position,
                        b.sphere_velocity, b.sphere_spin, b.sphere_material, b.clock, b.flags, b.sphere_clear,
                        b.slot_touching,
                        b.slot_history, b.force, b.moment, b.wall_step_force, b.sphere_lost,
                    ],
                    device,
                )
            )  # fmt: skip
        if f.meshes:
            stages.append(
                Stage(
                    mesh_kernel(b.scalar, f.wall_law, f.half_list, f.losses),
                    tasks(batch, last - first),
                    [
                        b.scenes, first, last, part, b.wall_parameters, b.wall_table, b.wall_position,
                        b.wall_orientation, b.wall_velocity, b.wall_spin, b.corners, b.faces, b.face_across,
                        b.ring_start, b.ring, b.face_wall, b.candidate_start, b.candidate_face,
                        b.sphere_scene, b.sphere_position, b.sphere_velocity, b.sphere_spin, b.sphere_material, b.clock,
                        b.flags, b.slot_history,
                        b.slot_normal, b.slot_overlap, b.slot_wall, b.force, b.moment, b.wall_step_force,
                        b.sphere_lost,
                    ],
                    device,
                )
            )  # fmt: skip
        stages += meet
        if f.walls and part == 0:
            stages.append(
                Stage(
                    advance_kernel(b.scalar),
                    b.walls,
                    [
                        b.scenes, b.wall_scene, b.wall_table, b.rest_position, b.clock, b.flags, b.wall_step_force,
                        b.wall_position_exact, b.wall_velocity_exact, b.wall_position, b.wall_orientation,
                        b.wall_normal, b.wall_velocity, b.wall_spin, b.wall_force, b.wall_moment, b.wall_impulse,
                        b.wall_angular_impulse, b.wall_travel, b.wall_work, b.wall_moved,
                    ],
                    device,
                )
            )  # fmt: skip
        stages.append(_motion(batch, first_body, last_body))
        stages += meet
        if part == 0:
            tick = tick_kernel(b.scalar, f.growth)
            stages.append(Stage(tick, b.count, [b.scenes, b.clock, b.flags, b.scale], device))
        stages += meet
        parts.append(stages)
    return parts


def _motion(batch: Batch, first: int, last: int) -> Stage:
    b, f = batch, batch.features
    if not f.clumps:
        kernel = sphere_kernel(b.scalar, f.drives, f.growth, f.meshes, f.rotation, f.half_list, f.losses)
        arguments = [
            b.scenes, first, last, b.segments, b.drive_axis, b.drive_force, b.body_group, b.sphere_scene,
            b.sphere_offset, b.sphere_built, b.reference_velocity, b.clock, b.flags, b.scale, b.force, b.moment,
            b.sphere_lost, b.body_rounding, b.sphere_position, b.sphere_velocity, b.sphere_spin,
        ]  # fmt: skip
    else:
        kernel = clump_kernel(b.scalar, f.drives, f.growth, f.meshes, f.half_list, f.losses)
        arguments = [
            b.scenes, first, last, b.segments, b.drive_axis, b.drive_force, b.body_scene, b.body_group, b.body_mass,
            b.body_inertia, b.body_first, b.sphere_offset, b.sphere_built, b.reference_velocity, b.clock, b.flags,
            b.scale, b.force, b.moment, b.sphere_lost, b.body_position, b.body_rounding, b.body_velocity,
            b.body_spin, b.body_orientation, b.body_angular_momentum, b.sphere_position, b.sphere_velocity,
            b.sphere_spin,
        ]  # fmt: skip
    return Stage(kernel, tasks(batch, last - first), arguments, b.device)


def publish_stage(batch: Batch) -> Stage:
    """Bodies from spheres, where every body is one."""
    b = batch
    arrays = [b.sphere_position, b.sphere_velocity, b.sphere_spin, b.body_position, b.body_velocity, b.body_spin]
    return Stage(publish_kernel(b.scalar), b.spheres, arrays, b.device)
