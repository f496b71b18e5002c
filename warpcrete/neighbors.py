"""Verlet lists: built on Warp's hash grid, carried over exactly, re-sorted along the grid now and then."""

from __future__ import annotations

import numpy as np
import warp as wp

from .batch import Batch
from .errors import CapacityError
from .kernels.neighbors import invert, iota, neighbor_kernels, order_kernels, permute_kernel
from .kernels.types import STALE, types
from .kernels.walls import candidate_kernels
from .state import State, pair_types

MOST_PAIRS = 2**31 - 2**20
DRIFT_LANES = 64


class NeighborLists:
    """(Re)builds pair lists and mesh candidates of the scenes of a batch that are stale.

    A list holds the pairs within a skin [m] of each other. It stays complete until some sphere has moved by half
    the skin against a common drift (its scene's mean velocity at the build), or by the mesh skin against a mesh.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.sort_every = np.full(batch.count, 20)
        """Builds of a scene from one re-sorting of its bodies to the next; 0: never."""
        self.builds = np.zeros(batch.count, dtype=int)
        f, t, device = batch.features, types(batch.scalar), batch.device
        self._kernels = neighbor_kernels(batch.scalar, f.half_list, f.history, f.bonds)
        self._order = order_kernels(batch.scalar)
        self._count_faces, self._fill_faces = candidate_kernels(batch.scalar)
        n, scenes = batch.spheres, batch.count
        # Few points to a cell; positions wrap, so any domain fits.
        side = int(np.clip(2 ** np.ceil(np.log2(max(n, 1) ** (1 / 3))), 16, 256 if batch.is_cuda else 64))
        self._grid = wp.HashGrid(side, side, side, device=device, dtype=batch.scalar)
        self._centre = wp.zeros(n, dtype=t.vec3, device=device)
        self._count = wp.zeros(n + scenes, dtype=wp.int32, device=device)
        self._scanned = wp.zeros(n + scenes, dtype=wp.int32, device=device)
        self._total = wp.zeros(scenes, dtype=wp.int32, device=device)
        self._identity = wp.zeros(n, dtype=wp.int32, device=device)
        self._lanes = wp.zeros((scenes, DRIFT_LANES), dtype=wp.vec3d, device=device)
        self._stretched = wp.zeros(n if f.bonds else 0, dtype=batch.scalar, device=device)
        self._old_start = wp.zeros(n + scenes, dtype=wp.int32, device=device)
        self._used = {name: dtype for name, (dtype, used) in pair_types(batch.models[0]).items() if used}
        self._old: dict[str, wp.array] = {}
        wp.launch(iota, dim=n, inputs=[self._identity], device=device)

    def __call__(self) -> None:
        """Rebuild the lists of every scene that is marked stale."""
        b, kernels, device = self.batch, self._kernels, self.batch.device
        n = b.spheres
        b.changed()
        stale = b.host_flags()[:, int(STALE)] != 0
        if n == 0:
            self._freshen()
            return
        old_place = new_place = self._identity
        due = stale & (self.sort_every > 0) & (self.builds % np.maximum(self.sort_every, 1) == 0)
        if due.any() and b.bodies > 1:
            old_place, new_place = self._sort(due)
        self.builds[stale] += 1
        self._keep_old()
        old = [self._old.get(name, getattr(b, name)) for name in State.PAIR_ARRAYS]

        wp.launch(
            kernels.centres, dim=n, inputs=[b.flags, b.sphere_scene, b.sphere_position, self._centre, b.sphere_built],
            device=device,
        )  # fmt: skip
        scale = b.scale.numpy() if b.features.growth else 1.0
        reach = float(np.max(2 * b.rows["largest_radius"] * scale + b.rows["skin"]))
        self._grid.build(self._centre, radius=reach, groups=b.sphere_scene)
        if b.features.bonds:
            self._stretched.zero_()
            wp.launch(
                kernels.stretch, dim=n,
                inputs=[
                    b.scenes, b.flags, b.sphere_scene, b.sphere_position, old_place, new_place, self._old_start, old[0],
                    old[2], self._stretched,
                ],
                device=device,
            )  # fmt: skip
        self._list_pairs(kernels.count, old_place, new_place, old)
        wanted = self._starts(b.pair_start, "neighbour list", "pairs")
        if np.any(wanted > b.capacity):
            b.reserve_pairs(wanted)
        for s in np.flatnonzero(stale):
            b.states[s].pair_total = int(wanted[s])
        self._list_pairs(kernels.fill, old_place, new_place, old)
        if b.features.meshes:
            self._list_faces()
        wp.launch(
            kernels.drift, dim=(b.count, DRIFT_LANES), inputs=[b.scenes, b.flags, b.sphere_velocity, self._lanes],
            device=device,
        )  # fmt: skip
        self._freshen()
        b.built()

    def _freshen(self) -> None:
        b = self.batch
        wp.launch(
            self._kernels.freshen, dim=b.count,
            inputs=[b.scenes, self._lanes, b.reference_velocity, b.wall_moved, b.clock, b.flags],
            device=b.device,
        )  # fmt: skip
        b.changed()

    def _keep_old(self) -> None:
        """Copy of the list that the new one takes history from."""
        b = self.batch
        wp.copy(self._old_start, b.pair_start)
        for name, dtype in self._used.items():
            if name == "pair_other" and not (b.features.history or b.features.bonds):
                continue
            array = getattr(b, name)
            if name not in self._old or len(self._old[name]) != len(array):
                self._old[name] = wp.empty(len(array), dtype=dtype, device=b.device)
            wp.copy(self._old[name], array, count=b.states[0].pair_total if b.count == 1 else len(array))

    def _list_pairs(self, kernel, old_place: wp.array, new_place: wp.array, old: list[wp.array]) -> None:
        b = self.batch
        for part in range(b.threads):
            first, last = int(b.sphere_chunks[part]), int(b.sphere_chunks[part + 1])
            wp.launch(
                kernel, dim=last - first,
                inputs=[
                    b.scenes, b.flags, self._grid.id, first, last, b.threads, b.sphere_scene, b.sphere_position,
                    b.sphere_body, b.sphere_id, b.scale, self._stretched, old_place, new_place, self._old_start, *old,
                    b.pair_start, self._count, b.sphere_touching, b.pair_other, b.pair_history, b.pair_bond,
                    b.pair_bond_force, b.pair_bond_moment,
                ],
                device=b.device,
            )  # fmt: skip

    def _starts(self, start: wp.array, what: str, entries: str) -> np.ndarray:
        """Scan the counts into row starts; returns how many entries each scene now has."""
        b = self.batch
        wp.utils.array_scan(self._count, self._scanned, inclusive=False)
        wp.launch(
            self._kernels.starts, dim=b.spheres + b.count,
            inputs=[b.scenes, b.flags, b.slot_scene, self._scanned, start, self._total],
            device=b.device,
        )  # fmt: skip
        wanted = self._total.numpy().astype(np.int64)
        if np.any(wanted < 0) or wanted.sum() > MOST_PAIRS:
            raise CapacityError(f"{what} of {b.spheres} spheres has more than 2^31 {entries}")
        return wanted

    def _list_faces(self) -> None:
        b = self.batch
        arguments = [
            b.scenes, b.flags, b.wall_table, b.wall_position, b.wall_orientation, b.corners, b.faces, b.sphere_scene,
            b.sphere_position, b.candidate_start, self._count,
        ]  # fmt: skip
        wp.launch(self._count_faces, dim=b.spheres, inputs=[*arguments, b.candidate_face], device=b.device)
        wanted = self._starts(b.candidate_start, "mesh candidates", "faces")
        if np.any(wanted > b.face_capacity):
            b.reserve_faces(wanted)
        wp.launch(self._fill_faces, dim=b.spheres, inputs=[*arguments, b.candidate_face], device=b.device)

    def _sort(self, due: np.ndarray) -> tuple[wp.array, wp.array]:
        """Re-order bodies along a space-filling curve; returns old place of each new sphere and the reverse."""
        b, device, kernels = self.batch, self.batch.device, self._order
        bodies, spheres = b.bodies, b.spheres
        keys = wp.zeros(2 * bodies, dtype=wp.int64, device=device)
        order = wp.zeros(2 * bodies, dtype=wp.int32, device=device)
        sort = wp.array(due.astype(np.int32), dtype=wp.int32, device=device)
        wp.launch(
            kernels.keys, dim=bodies, inputs=[b.scenes, sort, b.body_scene, b.body_position, keys, order], device=device
        )
        wp.utils.radix_sort_pairs(keys, order, bodies, end_bit=30 + int(b.count).bit_length())
        order = order[:bodies]
        count = wp.zeros(bodies + 1, dtype=wp.int32, device=device)
        start = wp.zeros(bodies + 1, dtype=wp.int32, device=device)
        wp.launch(kernels.counts, dim=bodies, inputs=[b.body_scene, order, b.body_first, count], device=device)
        wp.utils.array_scan(count, start, inclusive=False)
        old_place = wp.zeros(spheres, dtype=wp.int32, device=device)
        new_place = wp.zeros(spheres, dtype=wp.int32, device=device)
        old_first = wp.clone(b.body_first)
        wp.launch(
            kernels.spheres, dim=bodies,
            inputs=[b.scenes, b.body_scene, order, old_first, start, b.body_first, old_place, b.sphere_body],
            device=device,
        )  # fmt: skip
        wp.launch(invert, dim=spheres, inputs=[old_place, new_place], device=device)
        for names, places in ((State.BODY_ARRAYS, order), (State.SPHERE_ARRAYS, old_place)):
            for name in names:
                if name not in ("force", "moment") and getattr(b, name).size:
                    _permute(getattr(b, name), places)
        b.split()
        return old_place, new_place


def _permute(array: wp.array, order: wp.array) -> None:
    kernel = permute_kernel(array.dtype, array.ndim == 2)
    wp.launch(kernel, dim=array.shape, inputs=[wp.clone(array), order, array], device=array.device)
