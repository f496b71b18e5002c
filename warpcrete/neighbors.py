"""Verlet lists: built on Warp's hash grid, carried over exactly, re-sorted along the grid now and then."""

from __future__ import annotations

import warp as wp

from .errors import CapacityError
from .kernels.neighbors import (
    body_sphere_counts,
    invert,
    iota,
    neighbor_kernels,
    permute_kernel,
    sphere_order,
)
from .kernels.types import SINCE_BUILD, STALE, types
from .kernels.walls import candidate_kernels
from .model import Model
from .state import State

GRID_CELLS = 64  # hash table cells a direction; positions wrap, so any domain fits


class NeighborLists:
    """Stage: (re)builds pair list and mesh candidates of a state.

    `skin` [m] is the gap up to which pairs are listed. A list stays complete until some sphere has moved by
    half the skin against a common drift (its mean velocity at the build), or by `mesh_skin` against a mesh.
    """

    def __init__(self, model: Model, state: State, *, skin: float, mesh_skin: float, sort_every: int = 20) -> None:
        self.skin, self.mesh_skin, self.sort_every = skin, mesh_skin, sort_every
        self.builds = 0
        features = model.features
        self._kernels = neighbor_kernels(model.scalar, features.half_list, features.history, features.bonds)
        self._count_faces, self._fill_faces = candidate_kernels(model.scalar)
        t = types(model.scalar)
        n = state.sphere_count
        device = model.device
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=device, dtype=model.scalar)
        self._grid.reserve(n)
        self._centre = wp.zeros(n, dtype=t.vec3, device=device)
        self._count = wp.zeros(n + 1, dtype=wp.int32, device=device)
        self._identity = wp.zeros(n, dtype=wp.int32, device=device)
        wp.launch(iota, dim=n, inputs=[self._identity], device=device)

    def __call__(self, model: Model, state: State) -> bool:
        """Rebuild; returns True if arrays were reallocated, so that recorded launches are void."""
        if state.sphere_count == 0:
            state.wall_moved.zero_()
            self._mark_fresh(state)
            return False
        n, device = state.sphere_count, model.device
        old_place = new_place = self._identity
        if self.sort_every and self.builds % self.sort_every == 0 and state.body_count > 1:
            old_place, new_place = self._sort(model, state)
        self.builds += 1

        kernels = self._kernels
        wp.launch(
            kernels.centres, dim=n, inputs=[state.sphere_position, self._centre, state.sphere_built], device=device
        )
        largest = state.largest_radius * float(state.scale.numpy()[0])
        self._grid.build(self._centre, radius=2 * largest + self.skin)
        old_start = wp.clone(state.pair_start)
        old = [wp.clone(a) for a in self._pair_arrays(state)]
        arguments = [
            self._grid.id, state.sphere_position, state.sphere_body, state.sphere_id, largest, self.skin,
            old_place, new_place, old_start, *old, state.pair_start, self._count,
        ]  # fmt: skip
        wp.launch(kernels.count, dim=n, inputs=[*arguments, *self._pair_arrays(state)], device=device)
        wp.utils.array_scan(self._count, state.pair_start, inclusive=False)
        total = int(state.pair_start[n:].numpy()[0])
        if total < 0 or total > 2**31 - 2**20:
            raise CapacityError(f"neighbour list of {state.sphere_count} spheres has more than 2^31 pairs")
        grown = total > state.pair_capacity
        if grown:
            state.reserve_pairs(total + total // 4 + 64)
        state.pair_total = total
        wp.launch(kernels.fill, dim=n, inputs=[*arguments, *self._pair_arrays(state)], device=device)
        if model.features.meshes:
            grown = self._list_faces(model, state) or grown

        mean = state.sphere_velocity.numpy()[:, :3].mean(0, dtype=float)
        state.reference_velocity.assign([tuple(mean)])
        self._mark_fresh(state)
        return grown

    @staticmethod
    def _mark_fresh(state: State) -> None:
        clock = state.clock.numpy()
        clock[int(SINCE_BUILD)] = 0.0
        state.clock.assign(clock)
        flags = state.flags.numpy()
        flags[int(STALE)] = 0
        state.flags.assign(flags)

    @staticmethod
    def _pair_arrays(state: State) -> list[wp.array]:
        return [state.pair_other, state.pair_history, state.pair_bond, state.pair_bond_force, state.pair_bond_moment]

    def _list_faces(self, model: Model, state: State) -> bool:
        n, device = state.sphere_count, model.device
        arguments = [
            model.wall_table, model.analytic_walls, len(model.walls), state.wall_position, state.wall_orientation,
            model.corners, model.faces, state.sphere_position, self.mesh_skin, state.candidate_start, self._count,
        ]  # fmt: skip
        wp.launch(self._count_faces, dim=n, inputs=[*arguments, state.candidate_face], device=device)
        wp.utils.array_scan(self._count, state.candidate_start, inclusive=False)
        total = int(state.candidate_start[n:].numpy()[0])
        grown = total > len(state.candidate_face)
        if grown:
            state.candidate_face = wp.zeros(total + total // 4 + 64, dtype=wp.int32, device=device)
        wp.launch(self._fill_faces, dim=n, inputs=[*arguments, state.candidate_face], device=device)
        state.wall_moved.zero_()
        return grown

    def _sort(self, model: Model, state: State) -> tuple[wp.array, wp.array]:
        """Re-order bodies along a space-filling curve; returns old place of each new sphere and the reverse."""
        device, bodies, spheres = model.device, state.body_count, state.sphere_count
        keys = wp.zeros(2 * bodies, dtype=wp.int32, device=device)
        order = wp.zeros(2 * bodies, dtype=wp.int32, device=device)
        cell = 2 * state.largest_radius + self.skin
        wp.launch(self._kernels.cell_keys, dim=bodies, inputs=[state.body_position, cell, keys, order], device=device)
        wp.utils.radix_sort_pairs(keys, order, bodies)
        order = order[:bodies]
        count = wp.zeros(bodies + 1, dtype=wp.int32, device=device)
        first = wp.zeros(bodies + 1, dtype=wp.int32, device=device)
        wp.launch(body_sphere_counts, dim=bodies, inputs=[order, state.body_first, count], device=device)
        wp.utils.array_scan(count, first, inclusive=False)
        old_place = wp.zeros(spheres, dtype=wp.int32, device=device)
        new_place = wp.zeros(spheres, dtype=wp.int32, device=device)
        wp.launch(
            sphere_order,
            dim=bodies,
            inputs=[order, state.body_first, first, old_place, state.sphere_body],
            device=device,
        )
        wp.launch(invert, dim=spheres, inputs=[old_place, new_place], device=device)
        wp.copy(state.body_first, first)
        for names, places in ((State.BODY_ARRAYS, order), (State.SPHERE_ARRAYS, old_place)):
            for name in names:
                if name != "sphere_lost" or model.features.losses:
                    _permute(getattr(state, name), places)
        for name in ("slot_history", "slot_normal", "slot_overlap", "slot_wall"):
            array = getattr(state, name)
            if array.shape[1] > 0:
                _permute(array, old_place)
        return old_place, new_place


def _permute(array: wp.array, order: wp.array) -> None:
    kernel = permute_kernel(array.dtype, array.ndim == 2)
    wp.launch(kernel, dim=array.shape, inputs=[wp.clone(array), order, array], device=array.device)
