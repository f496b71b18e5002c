"""Neighbour (Verlet) lists: search on a grid of cells, exact transfer of contact history, and re-sorting of bodies.

A list contains all pairs of spheres whose gap is less than a given margin, the skin. It remains valid for many steps,
until some sphere may have moved too far (L. Verlet, Phys. Rev. 159 (1967) 98). It stores the neighbours of each sphere
together. A full list (GPU) contains each pair at both spheres. A half list (CPU) contains each pair at only one of its
spheres, with one exception: a pair of spheres that belong to different CPU threads is listed at both, once for each
thread.
"""

from itertools import pairwise

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, Kernel, Shape, copy_array, empty, zeros
from ...core.device.graphs import Call, Recordable
from ...core.device.launching import Arguments, Stage
from ...core.device.scan import scan_stages
from ...core.errors import CapacityError
from ...kernels.common.control import STALE, STEPS
from ...kernels.common.types import types
from ...kernels.dem.full_search import full_search_kernels
from ...kernels.dem.half_search import half_search_kernel
from ...kernels.dem.linking import linking_kernels
from ...kernels.dem.lists import list_kernels, transfer_kernel
from ...kernels.dem.mesh_faces import candidate_kernels
from .batch import Batch
from .batch_arrays import MAXIMUM_ENTRIES
from .cells import Cells
from .links import rows_of
from .rebuild_phases import Chunks, Phase, Rebuild
from .sorting import sort_bodies, sorting_kernels
from .stages import MANY_SPHERES, near_stages, tasks
from .state import PAIR_ARRAYS, pair_bytes, struct_of
from .struct_types import Pairs

DRIFT_LANES = 64
"""Number of threads that together compute the mean velocity of a scene's spheres."""
OCTANTS = 8
"""Number of GPU threads that find the neighbours of one sphere in a small scene, one for each octant around the
sphere."""
KEPT = 32
"""Maximum number of neighbours per sphere that a GPU stores when it counts them.

The GPU later copies these neighbours into the lists, so that it need not search twice. The search is repeated only for
a sphere with more neighbours.
"""
MOST_KEPT = 64
"""Larger value for `KEPT`, used after some sphere has had more than `KEPT` but at most `MOST_KEPT` neighbours."""


class NeighborLists:
    """Builder of the neighbour lists of all scenes of a batch whose lists are stale.

    The builder also makes the lists of mesh candidates, which are the triangles near each sphere. A neighbour list
    contains all pairs of spheres whose gap is less than a margin, the skin [m]. The list stays complete until a sphere
    has moved by half the skin relative to the scene as a whole. The scene as a whole is assumed to move at the mean
    velocity that its spheres had when the list was built. A list of mesh candidates stays complete until a sphere has
    moved by the mesh skin [m] relative to the mesh.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self._builds = np.zeros(batch.count, dtype=int)
        self.by_device = zeros(1, dtype=wp.int32, device=batch.device)
        """Number of list rebuilds that a GPU has done without the host, shape (1,); it stays 0 in a batch of several
        scenes."""
        f, t = batch.features, types(batch.scalar)
        n, scenes = batch.sphere_count, batch.count
        self._cells = Cells(batch)

        def new(shape: Shape, dtype: type = wp.int32) -> DeviceArray:
            return zeros(shape, dtype=dtype, device=batch.device)

        self._centre = new(n, t.vec3)
        self._count, self.scanned = new(n + scenes), new(n + scenes)
        slots = n + scenes if f.meshes else 0
        self._face_count, self.face_scanned = new(slots), new(slots)
        # Each CPU thread has a section of the array `_found`, where it stores the neighbours of its spheres. `_place`
        # contains, for each sphere, the position in this section at which the sphere's neighbours begin. A GPU does not
        # use these arrays.
        self._room = np.full(batch.threads, 8 * n // batch.threads)
        self._found = new(int(self._room.sum()) if f.half_list else 0)
        self._place = new(n if f.half_list else 0)
        self._wanted = new(batch.threads)
        self._searchers = self._searchers_for(n)
        self._finds = new((0, 0) if f.half_list else (KEPT, n))
        self._boxes = new((batch.threads, 2), t.vec3)
        # `_total` receives the number of neighbour list entries of each scene, and `_face_total` receives the number of
        # mesh candidates. The last element of `_total` receives the largest number of neighbours of a sphere for which
        # the search buffer `_finds` was too small.
        self._total, self._face_total = new(scenes + 1), new(scenes + 1)
        self._identity = DeviceArray(np.arange(n), dtype=wp.int32, device=batch.device)
        self._old_place, self._new_place = new(n), new(n)
        self._lanes = new((scenes, DRIFT_LANES), wp.vec3d)
        self._stretched = new(n if f.bonds and f.half_list else 0, batch.scalar)
        # `_old` contains the previous neighbour lists, from which a rebuild copies the contact history to the new
        # lists.
        self._old: Pairs = struct_of(batch.structs, "pairs")()
        self._old.start = new(n + scenes)
        self._entries = np.array([state.pair_total for state in batch.states])
        self._kept = [name for name in pair_bytes(batch.models[0]) if name != "other" or f.history or f.bonds]
        self._recorded: dict[tuple[bool, int], Rebuild] = {}
        self._version: tuple[int, ...] = ()

    @property
    def builds(self) -> np.ndarray:
        """Number of times that each scene's neighbour lists were built since it joined this batch, shape (scenes,)."""
        return self._builds + int(self.by_device.numpy()[0])

    def _searchers_for(self, spheres: int) -> int:
        """Return the number of GPU threads that search around each sphere in a rebuild for `spheres` spheres."""
        return OCTANTS if self.batch.parallel and spheres < MANY_SPHERES else 1

    def __call__(self) -> None:
        """Rebuild the neighbour lists of every scene whose lists are marked as stale."""
        with self.batch.changing():
            self._build()

    def _build(self) -> None:
        b = self.batch
        flags, sort_every = b.host_flags(), b.rows["sort_every"]
        if b.sphere_count == 0:
            b.planner.note_rebuilt(flags)
            self._rebuild(False).launch_singly("fresh", "fresh")
            return
        stale = flags[:, int(STALE)] != 0
        # Re-sort bodies only at fixed step counts. The times of rebuilds vary between devices and launches, and they
        # must not influence results.
        b.planner.note_rebuilt(flags)
        due = stale & (sort_every > 0) & (flags[:, int(STEPS)] % np.maximum(sort_every, 1) == 0)
        sort = bool(due.any()) and b.body_count > 1
        if sort:
            sort_bodies(b, due, self._old_place, self._new_place)
        self._builds[stale] += 1
        self._searchers = self._searchers_for(int(b.rows["sphere_count"][stale].sum()))
        self._keep_old(np.flatnonzero(stale))
        width = self._cells.width()
        made = self._cells.made
        self._cells.fit(width, due)
        self._cells.use_width(width)
        if self._cells.made > made and b.planner.rebuilds_on_device:
            b.invalidate_graphs()
        rebuild = self._search(sort) if b.features.half_list else self._rebuild(sort)
        # With half lists, which only a CPU uses, `_search` has already launched the phases `cells` and `search` of the
        # rebuild. In this case, continue with the phase `count`.
        rebuild.launch("count" if b.features.half_list else "cells", "starts")
        wanted, longest = self._found_of(self._total, "neighbour list", "pairs")
        if np.any(wanted > b.capacity):
            b.reserve_pairs(np.maximum(wanted, self._entries))
            # Enlarging the arrays moves the neighbour lists of the scenes to other array positions, so copy the old
            # lists again.
            self._keep_old(np.flatnonzero(stale))
        self._entries[stale] = wanted[stale]
        if b.features.meshes:
            wanted, _ = self._found_of(self._face_total, "mesh candidates", "faces")
            b.reserve_faces(wanted)
        # Launch the rest of the rebuild on the current arrays, which may just have been enlarged.
        self._rebuild(sort).launch("fill", "near")
        if len(self._finds) < longest <= MOST_KEPT:
            self._finds = empty((MOST_KEPT, b.sphere_count), dtype=wp.int32, device=b.device)
            self._version = ()  # Record all launches again, because a larger search buffer replaces the old buffer.
            if b.planner.rebuilds_on_device:
                b.invalidate_graphs()

    def _search(self, sort: bool) -> Rebuild:
        """Launch the phases `cells` and `search` of a rebuild on a CPU; return all phases of this rebuild.

        A phase is a group of kernel launches. `sort` is True if the bodies have just been re-sorted. If the search
        buffers are too small, they are enlarged and the search is repeated.
        """
        b = self.batch
        rebuild = self._rebuild(sort)
        rebuild.launch("cells", "cells")
        if b.threads > 1:
            places = self._centre.numpy()
            nowhere = [np.full(3, np.inf), np.full(3, -np.inf)]
            chunks = [places[first:last] for first, last in pairwise(b.sphere_chunks.tolist())]
            self._boxes.assign(np.array([[c.min(0), c.max(0)] if len(c) else nowhere for c in chunks]))
        while True:
            rebuild = self._rebuild(sort)
            rebuild.launch("search", "search")
            wanted = self._wanted.numpy().astype(np.int64)
            if np.all((wanted >= 0) & (wanted <= self._room)):
                return rebuild
            room = np.maximum(self._room, wanted + wanted // 4)
            if np.any(wanted < 0) or room.sum() > MAXIMUM_ENTRIES:
                raise CapacityError(
                    f"neighbour list of {b.sphere_count} spheres: has more than 2^31 pairs, the largest possible "
                    "number; use fewer or larger aggregates"
                )
            self._room = room
            self._found = empty(int(self._room.sum()), dtype=wp.int32, device=b.device)
            self._recorded.clear()

    def device_rebuild(self) -> Rebuild:
        """Return the launches of a list rebuild for :class:`DeviceRebuild`, which repeats them inside a CUDA graph.

        A rebuild on the device runs all phases, including the copy of the old lists. A rebuild by the host copies the
        old lists separately and starts at the phase `cells`, which sorts spheres into the cells of the search grid.
        """
        self._searchers = self._searchers_for(self.batch.sphere_count)
        self._keep_old(np.arange(self.batch.count))
        return self._rebuild(False)

    def lay_out_cells(self) -> None:
        """Fit the cell grid to scenes whose lists come from a checkpoint, because no search has fitted it yet."""
        width = self._cells.width()
        self._cells.fit(width, np.zeros(self.batch.count, dtype=bool))
        self._cells.use_width(width)

    def link(self, s: int) -> None:
        """Build the links of scene `s` after its neighbour lists were restored from a checkpoint.

        A link stands for one listed pair, whose contact force a GPU computes only once. A CPU uses no links, so the
        method then does nothing.
        """
        if self.batch.features.half_list:
            return
        before = self.batch.flags.numpy().copy()
        flags = before.copy()
        flags[:, int(STALE)] = np.arange(self.batch.count) == s
        self.batch.flags.assign(flags)
        rebuild = self._rebuild(False)
        rebuild.launch_singly("links", "links")
        self.batch.flags.assign(before)
        rebuild.launch_singly("near", "near")

    def kernels(self) -> list[Stage | Kernel]:
        """Return all kernels that a rebuild launches, so that they can be compiled before the run."""
        b = self.batch
        self._keep_old(np.arange(b.count))
        stages = self._rebuild(False).kernel_stages()
        # This case occurs only in batches: the whole batch has so many spheres that one thread searches for each
        # sphere, but the scenes to rebuild have so few spheres that `OCTANTS` threads search for each sphere. Add the
        # kernels for this case.
        if b.parallel and self._searchers == 1 and b.count > 1:
            stages += self._rebuild(False, OCTANTS).kernel_stages("search", "fill")
        return [*stages, *sorting_kernels(b)]

    def _keep_old(self, scenes: np.ndarray) -> None:
        """Copy the current neighbour lists of `scenes` to `_old`, from which the new lists receive contact history."""
        b = self.batch
        # Copy whole arrays if more than a quarter of the scenes of a batch are rebuilt. Also copy whole arrays for a
        # single scene on a GPU: the device may have rebuilt the lists itself, so their lengths are unknown to the host.
        whole = 4 * len(scenes) > b.count > 1 or (b.count == 1 and b.parallel)
        for name in PAIR_ARRAYS:
            array: DeviceArray = getattr(b.pairs, name)
            kept: DeviceArray | None = getattr(self._old, name)
            if name not in self._kept:  # No kernel reads the old values of this array, so do not copy it.
                if kept is not array:
                    setattr(self._old, name, array)
                    self._recorded.clear()
                continue
            if kept is None or len(kept) != len(array):
                kept = empty(len(array), dtype=array.dtype, device=b.device)
                setattr(self._old, name, kept)
                self._recorded.clear()
            if whole:
                copy_array(kept, array)
                continue
            for s in scenes:
                first, count = int(b.rows["pairs"][s]), int(self._entries[s])
                if count:  # Skip a count of 0, for which `wp.copy` would copy the whole array.
                    copy_array(kept, array, first, first, count)

    def _rebuild(self, sorted_now: bool, searchers: int | None = None) -> Rebuild:
        """Return the launches that rebuild the neighbour lists, recorded for the current arrays.

        `sorted_now` must be True if the bodies have just been re-sorted. `searchers` is the number of threads that find
        the neighbours of one sphere; by default it is the number chosen for the current rebuild.
        """
        version = self.batch.version, self._cells.made
        if self._version != version:
            self._recorded.clear()
            self._version = version
        key = sorted_now, searchers or self._searchers
        if key not in self._recorded:
            self._recorded[key] = Rebuild(self._phases(*key), self.batch.device)
        return self._recorded[key]

    def _phases(self, sorted_now: bool, searchers: int) -> list[Phase]:
        """Return the phases (groups of kernel launches) of a rebuild of the neighbour lists, in their fixed order.

        The phases before `starts` leave the current lists unchanged. If a device rebuilds its lists without the host
        and finds after the phase `count` that its arrays are too small, it stops there, and the host repeats the
        rebuild with larger arrays. A rebuild by the host reads the lengths of the new lists after the phase `starts`.
        """
        b, n = self.batch, self.batch.sphere_count
        old_place = self._old_place if sorted_now else self._identity
        new_place = self._new_place if sorted_now else self._identity
        old: Arguments = {"old_pairs": self._old, "old_place": old_place}
        search, fill = self._search_stages(old | {"stretched": self._stretched}, new_place, searchers)
        scan = scan_stages(self._count, self.scanned)
        count_faces, face_starts, fill_faces = self._face_stages()
        lists = list_kernels(b.scalar)
        return [
            # Copy the motion of single spheres to their bodies, because steps move only the spheres.
            Phase("bodies", b.sync_stages()),
            # Copy the previous neighbour lists, from which the new lists receive the contact history.
            Phase("history", [
                Call(copy_array, getattr(self._old, name), getattr(b.pairs, name)) for name in self._kept
            ]),
            # Sort the spheres' centres into the cells of the grid.
            Phase("cells", [
                Call(copy_array, self._old.start, b.pairs.start),
                b.stage(lists.centres, n, shift=self._cells.shift, centre=self._centre),
                *self._stretch_stages(old | {"new_place": new_place}),
                Call(self._cells.grid.held.zero_),
                *self._cells.stages(self._centre),
            ]),
            # Find the neighbours of each sphere and count them.
            Phase("search", search),
            # Compute the index of each sphere's first list entry, as prefix sums of the numbers of neighbours.
            Phase("count", [*scan, *count_faces]),
            # Write the index of each sphere's first list entry; from here on the previous neighbour lists are invalid.
            Phase("starts", [self._starts(self.scanned, b.pairs.start, self._total), *face_starts]),
            # Write the neighbours into the rows of the new neighbour lists, with the contact history from the previous
            # lists.
            Phase("fill", [*fill, self._transfer(old)]),
            # A GPU's neighbour list contains each pair of spheres twice. Build one link for each pair, so that a step
            # computes the pair only once.
            Phase("links", self._link_stages(scan)),
            # List the triangles of meshes within reach of each sphere as its mesh candidates.
            Phase("candidates", fill_faces),
            # Find the new list entries of pairs with sub-cycled (stiff) bonds, and the array indices of the bodies of
            # these pairs.
            Phase("subcycles", b.subcycles.locating()),
            # Compute the mean velocity of each scene's spheres, because the skin limits only their motion relative to
            # this mean.
            Phase("drift", [b.stage(lists.drift, (b.count, DRIFT_LANES), lanes=self._lanes)]),
            Phase("fresh", [b.stage(lists.clear_stale, b.count, lanes=self._lanes)]),
            # Select the near links, which are the pairs that may touch within the next steps.
            Phase("near", near_stages(b)),
        ]  # fmt: skip

    def _stretch_stages(self, old: Arguments) -> list[Recordable]:
        """Return the launches that measure the longest bond of each sphere.

        `old` contains the kernel arguments for the old neighbour lists. Only the search for the half lists of a CPU
        needs the longest bonds. The result is empty for the full lists of a GPU, and if the scenes have no bonds.
        """
        b = self.batch
        if not (b.features.bonds and b.features.half_list):
            return []
        stretch = b.stage(list_kernels(b.scalar).stretch, b.sphere_count, stretched=self._stretched, **old)
        return [Call(self._stretched.zero_), stretch]

    def _search_stages(
        self, old: Arguments, new_place: DeviceArray, searchers: int
    ) -> tuple[list[Recordable], list[Stage]]:
        """Return the launches of the phases `search` (find neighbours) and `fill` (write the neighbour lists).

        `old` contains the kernel arguments for the old neighbour lists, `new_place` maps the index of each sphere
        before a re-sorting to its new index, and `searchers` GPU threads search around each sphere. On a CPU there are
        no launches for `fill`, because the transfer of contact history writes the neighbour lists.
        """
        b, f, n = self.batch, self.batch.features, self.batch.sphere_count
        grid: Arguments = {"grid": self._cells.grid, "shift": self._cells.shift, "count": self._count}
        if not f.half_list:
            search_kernel, fill_kernel = full_search_kernels(b.scalar, f.bonds, searchers)
            finds: Arguments = {"finds": self._finds, "new_place": new_place, **grid, **old}
            search = b.stage(search_kernel, n * searchers, total=self._total, **finds)
            return [Call(self._count.zero_), Call(self._total.zero_), search], [
                b.stage(fill_kernel, n * searchers, **finds)
            ]
        kernel = half_search_kernel(b.scalar, f.bonds)
        edges = np.concatenate([[0], np.cumsum(self._room)]).tolist()
        parts = [
            b.stage(
                kernel, 1, first=first, last=last, part=part, boxes=self._boxes, place=self._place,
                room=wp.vec2i(edges[part], edges[part + 1]), wanted=self._wanted, other=self._found, **grid, **old,
            )
            for part, (first, last) in enumerate(pairwise(b.sphere_chunks.tolist()))
        ]  # fmt: skip
        return [Chunks(parts, b.launch_chunks)], []

    def _starts(self, scanned: DeviceArray, start: DeviceArray, total: DeviceArray) -> Stage:
        b = self.batch
        kernel = list_kernels(b.scalar).starts
        return b.stage(kernel, b.sphere_count + b.count, scanned=scanned, start=start, total=total)

    def _transfer(self, old: Arguments) -> Recordable:
        """Return the launch that copies contact history from the old neighbour lists to the new neighbour lists.

        On a CPU this is a group of launches, one for each thread, which also write the neighbours into the new lists.
        """
        b, f = self.batch, self.batch.features
        lanes = 1 if f.half_list else OCTANTS
        kernel = transfer_kernel(b.scalar, f.half_list, f.history, f.pair_law.rolls, f.bonds, f.healing, lanes)
        found = self._found if f.half_list else b.pairs.other
        parts = [
            b.stage(
                kernel, lanes * tasks(b, last - first), first=first, last=last, place=self._place, found=found, **old
            )
            for first, last in pairwise(b.sphere_chunks.tolist())
        ]
        return Chunks(parts, b.launch_chunks) if f.half_list else parts[0]

    def _link_stages(self, scan: list[Stage]) -> list[Stage]:
        """Return the launches that build a GPU's links from new neighbour lists; empty for the half lists of a CPU.

        A link represents the two list entries of a pair. `scan` contains the launches of the prefix sum that gives the
        index of each sphere's first link.
        """
        b, f, n = self.batch, self.batch.features, self.batch.sphere_count
        if f.half_list:
            return []
        linking = linking_kernels(b.scalar, f.history, f.pair_law.rolls, f.bonds, rows_of(f), OCTANTS)
        return [
            b.stage(linking.clear_links, len(b.links.link)),
            b.stage(linking.count_own, n, count=self._count),
            *scan,
            b.stage(linking.fill_links, OCTANTS * n, scanned=self.scanned),
        ]

    def _face_stages(self) -> tuple[list[Stage], list[Stage], list[Stage]]:
        """Return the launches that list the mesh candidates, which are the triangles near each sphere, as three lists.

        The first list counts the candidates, the second writes the index of each sphere's first candidate, and the
        third writes the candidates.
        """
        b, n = self.batch, self.batch.sphere_count
        if not b.features.meshes:
            return [], [], []
        count_faces, fill_faces = candidate_kernels(b.scalar)
        count = b.stage(count_faces, n, count=self._face_count)
        return (
            [count, *scan_stages(self._face_count, self.face_scanned)],
            [self._starts(self.face_scanned, b.candidates.start, self._face_total)],
            [b.stage(fill_faces, n, count=self._face_count)],
        )

    def _found_of(self, total: DeviceArray, what: str, entries: str) -> tuple[np.ndarray, int]:
        """Return the number of list entries of each scene, and the size of a larger search buffer if one is needed.

        The second result is 0 if the search buffer was large enough for every sphere. Otherwise it is the largest
        number of neighbours among the spheres for which the buffer was too small. Both results are read from the device
        array `total`. Raises :class:`CapacityError` if 32-bit indices cannot number the entries. `what` and `entries`
        are the names of the list and of its entries in the message.
        """
        (found,) = self.batch.exchange.read(total)
        found = found.astype(np.int64)
        wanted, longest = found[:-1], int(found[-1])
        if np.any(wanted < 0) or wanted.sum() > MAXIMUM_ENTRIES:
            raise CapacityError(
                f"{what} of {self.batch.sphere_count} spheres: has more than 2^31 {entries}, the largest possible "
                "number; use fewer or larger aggregates"
            )
        return wanted, longest
