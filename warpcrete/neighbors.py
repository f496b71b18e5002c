"""Verlet lists: built on Warp's hash grid, carried over exactly, re-sorted along the grid now and then."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from .batch import MOST_ENTRIES, Batch
from .errors import CapacityError
from .kernels.mesh_walls import candidate_kernels
from .kernels.neighbors import invert, iota, neighbor_kernels, order_kernels, permute_kernel
from .kernels.types import STALE, types
from .launching import Stage
from .stages import tasks
from .state import State, pair_types

DRIFT_LANES = 256


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
        self.mean_radius = np.array([s.mean_radius for s in batch.states])
        """Of a scene's spheres at full size [m]."""
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
        # Half lists: what a search finds, in a room for each chunk, and where a sphere's part of that begins.
        self._room = np.full(batch.threads, 8 * n // batch.threads)
        self._found = wp.empty(int(self._room.sum()) if f.half_list else 0, dtype=wp.int32, device=device)
        self._place = wp.zeros(n if f.half_list else 0, dtype=wp.int32, device=device)
        self._wanted = wp.zeros(batch.threads, dtype=wp.int32, device=device)
        self._boxes = wp.zeros((batch.threads, 2), dtype=t.vec3, device=device)
        self._total = wp.zeros(scenes, dtype=wp.int32, device=device)
        self._face_total = wp.zeros(scenes, dtype=wp.int32, device=device)
        self._identity = wp.zeros(n, dtype=wp.int32, device=device)
        self._old_place = wp.zeros(n, dtype=wp.int32, device=device)
        self._new_place = wp.zeros(n, dtype=wp.int32, device=device)
        self._lanes = wp.zeros((scenes, DRIFT_LANES), dtype=wp.vec3d, device=device)
        self._stretched = wp.zeros(n if f.bonds else 0, dtype=batch.scalar, device=device)
        self._old_start = wp.zeros(n + scenes, dtype=wp.int32, device=device)
        self._used = {name: dtype for name, (dtype, used) in pair_types(batch.models[0]).items() if used}
        self._old: dict[str, wp.array] = {}
        self._recorded: dict[bool, dict[str, Any]] = {}
        self._version = -1
        wp.launch(iota, dim=n, inputs=[self._identity], device=device)

    def __call__(self) -> None:
        """Rebuild the lists of every scene that is marked stale."""
        b = self.batch
        b.changed()
        if b.spheres == 0:
            self._launches(False)["freshen"]()
            b.changed()
            return
        stale = b.host_flags()[:, int(STALE)] != 0
        due = stale & (self.sort_every > 0) & (self.builds % np.maximum(self.sort_every, 1) == 0)
        sort = bool(due.any()) and b.bodies > 1
        if sort:
            self._sort(due)
        self.builds[stale] += 1
        wp.copy(self._old_start, b.pair_start)
        self._keep_old()
        launches = self._launches(sort)
        launches["centres"]()
        scale = b.scale.numpy() if b.features.growth else 1.0
        # Cells for the many small spheres: the few large ones look through more of them.
        cell = float(np.max(2 * self.mean_radius * scale + b.rows["skin"]))
        self._grid.build(self._centre, radius=cell, groups=b.sphere_scene if b.count > 1 else None)
        if b.features.bonds:
            self._stretched.zero_()
            launches["stretch"]()
        if b.features.half_list:
            launches = self._search(sort)
        else:
            b.in_parts(launches["count"])
        wanted = self._starts(launches["starts"], self._total, "neighbour list", "pairs")
        if np.any(wanted > b.capacity):
            b.reserve_pairs(wanted)
            self._keep_old()  # the scenes' places in the pair arrays are others now
            launches = self._launches(sort)
        for s in np.flatnonzero(stale):
            b.states[s].pair_total = int(wanted[s])
        if not b.features.half_list:
            b.in_parts(launches["search"])
        b.in_parts(launches["carry"])
        if b.features.meshes:
            launches["count faces"]()
            wanted = self._starts(launches["face starts"], self._face_total, "mesh candidates", "faces")
            if np.any(wanted > b.face_capacity):
                b.reserve_faces(wanted)
                launches = self._launches(sort)
            launches["fill faces"]()
        launches["drift"]()
        launches["freshen"]()
        b.changed()
        b.built()

    def _search(self, sort: bool) -> dict[str, Any]:
        """Half lists: search chunk by chunk into buffers, once more where one was too short."""
        b = self.batch
        if b.threads > 1:
            places = self._centre.numpy()
            nowhere = [np.full(3, np.inf), np.full(3, -np.inf)]
            chunks = [places[first:last] for first, last in pairwise(b.sphere_chunks.tolist())]
            self._boxes.assign(np.array([[c.min(0), c.max(0)] if len(c) else nowhere for c in chunks]))
        while True:
            launches = self._launches(sort)
            b.in_parts(launches["search"])
            wanted = self._wanted.numpy().astype(np.int64)
            if np.all((wanted >= 0) & (wanted <= self._room)):
                return launches
            room = np.maximum(self._room, wanted + wanted // 4)
            if np.any(wanted < 0) or room.sum() > MOST_ENTRIES:
                raise CapacityError(f"neighbour list of {b.spheres} spheres has more pairs than 32 bits can count")
            self._room = room
            self._found = wp.empty(int(self._room.sum()), dtype=wp.int32, device=b.device)
            self._recorded.clear()

    def _keep_old(self) -> None:
        """Copy of the list that the new one takes history from."""
        b = self.batch
        for name, dtype in self._used.items():
            if name == "pair_other" and not (b.features.history or b.features.bonds):
                continue
            array = getattr(b, name)
            if name not in self._old or len(self._old[name]) != len(array):
                self._old[name] = wp.empty(len(array), dtype=dtype, device=b.device)
                self._recorded.clear()
            wp.copy(self._old[name], array, count=b.states[0].pair_total if b.count == 1 else len(array))

    def _launches(self, sorted_now: bool) -> dict[str, Any]:
        """Recorded launches of a rebuild, after a re-sorting or without one, on the arrays that the batch has now."""
        b, n, kernels = self.batch, self.batch.spheres, self._kernels
        if self._version != b.version:
            self._recorded.clear()
            self._version = b.version
        if sorted_now in self._recorded:
            return self._recorded[sorted_now]
        old_place = self._old_place if sorted_now else self._identity
        new_place = self._new_place if sorted_now else self._identity
        old = [self._old.get(name, getattr(b, name)) for name in State.PAIR_ARRAYS]

        def stage(kernel, dim: Any, *arguments: Any) -> Stage:
            return Stage(kernel, dim, [b.scenes, b.flags, *arguments], b.device)

        edges = np.concatenate([[0], np.cumsum(self._room)])

        def searching(kernel) -> list[Stage]:
            return [
                stage(
                    kernel, 1 if b.features.half_list else n, self._grid.id, first, last, part, self._boxes,
                    b.sphere_scene, b.sphere_position, b.sphere_body, b.scale, self._stretched, old_place,
                    self._old_start, old[0], old[2], b.pair_start, self._count, self._place,
                    wp.vec2i(int(edges[part]), int(edges[part + 1])), self._wanted,
                    self._found if b.features.half_list else b.pair_other,
                )
                for part, (first, last) in enumerate(pairwise(b.sphere_chunks.tolist()))
            ]  # fmt: skip

        carrying = [
            stage(
                kernels.carry, tasks(b, last - first), first, last, b.sphere_scene, b.sphere_id, self._place,
                self._found if b.features.half_list else b.pair_other, old_place, self._old_start, *old, b.pair_start,
                b.sphere_touching, b.pair_other, b.pair_history, b.pair_bond, b.pair_bond_force, b.pair_bond_moment,
            )
            for first, last in pairwise(b.sphere_chunks.tolist())
        ]  # fmt: skip

        def starts(start: wp.array, total: wp.array) -> Stage:
            return stage(kernels.starts, n + b.count, b.slot_scene, self._scanned, start, total)

        found: dict[str, Any] = {
            "centres": Stage(
                kernels.centres, n, [b.flags, b.sphere_scene, b.sphere_position, self._centre, b.sphere_built], b.device
            ),
            "stretch": stage(
                kernels.stretch, n, b.sphere_scene, b.sphere_position, old_place, new_place, self._old_start, old[0],
                old[2], self._stretched,
            ),
            "count": searching(kernels.count),
            "search": searching(kernels.search),
            "starts": starts(b.pair_start, self._total),
            "carry": carrying,
            "drift": stage(kernels.drift, (b.count, DRIFT_LANES), b.sphere_velocity, self._lanes),
            "freshen": Stage(
                kernels.freshen, b.count,
                [b.scenes, self._lanes, b.reference_velocity, b.wall_moved, b.clock, b.flags], b.device,
            ),
        }  # fmt: skip
        if b.features.meshes:
            arguments = [
                b.wall_table, b.wall_position, b.wall_orientation, b.corners, b.faces, b.sphere_scene,
                b.sphere_position, b.candidate_start, self._count, b.candidate_face,
            ]  # fmt: skip
            found["count faces"] = stage(self._count_faces, n, *arguments)
            found["face starts"] = starts(b.candidate_start, self._face_total)
            found["fill faces"] = stage(self._fill_faces, n, *arguments)
        self._recorded[sorted_now] = found
        return found

    def _starts(self, place: Stage, total: wp.array, what: str, entries: str) -> np.ndarray:
        """Scan the counts into row starts; returns how many entries each scene now has."""
        wp.utils.array_scan(self._count, self._scanned, inclusive=False)
        place()
        wanted = total.numpy().astype(np.int64)
        if np.any(wanted < 0) or wanted.sum() > MOST_ENTRIES:
            raise CapacityError(f"{what} of {self.batch.spheres} spheres has more than 2^31 {entries}")
        return wanted

    def _sort(self, due: np.ndarray) -> None:
        """Re-order bodies along a space-filling curve; notes the old place of each new sphere and the reverse."""
        b, device, kernels = self.batch, self.batch.device, self._order
        bodies, spheres = b.bodies, b.spheres
        keys = wp.zeros(2 * bodies, dtype=wp.int64, device=device)
        order = wp.zeros(2 * bodies, dtype=wp.int32, device=device)
        sort = wp.array(due.astype(np.int32), dtype=wp.int32, device=device)
        lowest = wp.full((b.count, 3), 2**30, dtype=wp.int32, device=device)
        places = [b.body_scene, b.body_position]
        wp.launch(kernels.corner, dim=bodies, inputs=[b.scenes, *places, lowest], device=device)
        wp.launch(kernels.keys, dim=bodies, inputs=[b.scenes, sort, lowest, *places, keys, order], device=device)
        wp.utils.radix_sort_pairs(keys, order, bodies, end_bit=30 + int(b.count).bit_length())
        order = order[:bodies]
        count = wp.zeros(bodies + 1, dtype=wp.int32, device=device)
        start = wp.zeros(bodies + 1, dtype=wp.int32, device=device)
        wp.launch(kernels.counts, dim=bodies, inputs=[b.body_scene, order, b.body_first, count], device=device)
        wp.utils.array_scan(count, start, inclusive=False)
        old_place, new_place = self._old_place, self._new_place
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
        if b.features.analytic:
            _permute(b.sphere_clear, old_place)
        b.split()


def _permute(array: wp.array, order: wp.array) -> None:
    kernel = permute_kernel(array.dtype, array.ndim == 2)
    wp.launch(kernel, dim=array.shape, inputs=[wp.clone(array), order, array], device=array.device)
