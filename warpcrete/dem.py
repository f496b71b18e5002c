"""Around the step: the estimate of its stable size, and the making of bonds."""

from __future__ import annotations

import numpy as np
import warp as wp

from .batch import Batch
from .kernels.bonds import bond_kernels
from .kernels.timestep import timestep_kernels
from .launching import Stage
from .model import Model
from .probes import listed_pairs
from .scene import Bonds, Driven, MeshWall, PlaneWall, Scene
from .state import State


class StableStep:
    """Estimate of the largest stable step of a scene from masses and live stiffness, bonds included.

    It sets the scene's `clock[STABLE]` and, from that and the settings in the scene's row, `clock[DT]`.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        f = batch.features
        self._kernels = timestep_kernels(batch.scalar, f.pair_law, f.wall_law, f.half_list, f.bonds)

        self._recorded: dict[int, list[Stage]] = {}
        self._version = -1

    def __call__(self, s: int) -> None:
        """Estimate for scene number `s`."""
        if self._version != self.batch.version:  # old launches would hold arrays that nothing else needs
            self._recorded.clear()
            self._version = self.batch.version
        if s not in self._recorded:
            self._recorded[s] = self._stages(s)
        self.batch.changed()
        for stage in self._recorded[s]:
            stage()
        self.batch.changed()

    def _stages(self, s: int) -> list[Stage]:
        b, device = self.batch, self.batch.device
        begin, gather, reduce, settle = self._kernels
        first = int(b.rows["spheres"][s])
        stages = [Stage(begin, 1, [b.scenes, s, b.smallest, b.fastest, b.wall_load], device)]
        for chunk, end in zip(b.states[s].chunks[:-1], b.states[s].chunks[1:]):
            arguments = [
                b.scenes, s, first + chunk, first + end, b.pair_parameters, b.wall_parameters, b.bond_parameters,
                b.wall_table, b.segments, b.wall_position, b.wall_normal, b.wall_velocity, b.wall_spin,
                b.body_position, b.sphere_body, b.sphere_position, b.sphere_velocity, b.sphere_material, b.slot_wall,
                b.slot_normal, b.slot_overlap, b.slot_history.shape[1], b.pair_start, b.pair_other, b.pair_bond,
                b.sums, b.wall_load, b.fastest,
            ]  # fmt: skip
            stages.append(Stage(gather, end - chunk, arguments, device))
        arguments = [
            b.scenes, s, b.pair_parameters, b.wall_parameters, b.fastest, b.body_mass, b.body_inertia,
            b.body_position, b.body_orientation, b.body_first, b.sphere_position, b.sphere_velocity,
            b.sphere_material, b.sums, b.smallest,
        ]  # fmt: skip
        # Without bodies nothing bounds the step but its largest allowed size.
        stages.append(Stage(reduce, b.states[s].body_count, arguments, device))
        stages.append(Stage(settle, 1, [b.scenes, s, b.wall_table, b.wall_load, b.smallest, b.clock], device))
        return stages


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
    return int(np.count_nonzero(_bonds(state) == kind))


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
    return int(np.count_nonzero(_bonds(state) == new))


def _bonds(state: State) -> np.ndarray:
    """Bond state of every listed pair, each pair once."""
    return state.pair_bond.numpy()[listed_pairs(state)[2]]
