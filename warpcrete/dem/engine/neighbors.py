"""Neighbour (Verlet) lists: search on a grid of cells, exact transfer of contact history, and re-sorting of bodies.

A list holds all pairs whose gap is less than the skin, and serves for many steps, until some sphere may have moved too
far (L. Verlet, Phys. Rev. 159 (1967) 98). A full list holds each pair in the rows of both spheres (GPU). A half list
holds each pair once, in the row of one of its spheres (CPU); a CPU's threads each own one chunk of the spheres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from ...core.device.graphs import captured
from ...core.device.launching import Stage
from ...core.device.scan import scan_stages
from ...core.errors import CapacityError
from ...kernels.common.control import STALE, STEPS
from ...kernels.common.types import types
from ...kernels.dem.linking import linking_kernels
from ...kernels.dem.lists import list_kernels, transfer_kernel
from ...kernels.dem.mesh_contacts import candidate_kernels
from ...kernels.dem.search import full_search_kernels, half_search_kernel
from .batch import Batch
from .batch_arrays import MAXIMUM_ENTRIES
from .cells import Cells
from .links import rows_of
from .sorting import sort_bodies, sorting_kernels
from .stages import MANY, near_stages, tasks
from .state import PAIR_ARRAYS, pair_bytes

DRIFT_LANES = 64
"""Threads per scene that sum the spheres' velocities to find the common drift."""
OCTANTS = 8
"""GPU threads that search and fill the row of one sphere if spheres are few: one thread per octant around it."""
KEPT = 32
"""Neighbours per sphere that the search stores for the fill kernel; a sphere with more is searched a second time."""
MOST_KEPT = 64
"""Larger number of stored neighbours, used once some sphere had more than `KEPT` but no more than this."""


@dataclass
class _Launches:
    """Recorded launches of one rebuild, and the CUDA graphs made of them."""

    centres: Stage
    stretch: Stage
    cells: list[Stage]
    """Stages that sort the spheres' centres into the cells of the grid."""
    search: list[Stage]
    fill: list[Stage]
    """Stage that writes the neighbours found by the search into the rows of the lists (GPU only)."""
    scan: list[Stage]
    """Stages that turn the lengths of the rows into their starts by a prefix sum."""
    starts: Stage
    transfer: list[Stage]
    drift: Stage
    clear_stale: Stage
    links: list[Stage] = field(default_factory=list)
    """Stages that clear, count and fill the links, which are the pairs as a GPU evaluates them (GPU only)."""
    near: list[Stage] = field(default_factory=list)
    """Stages that select the near links, whose spheres may touch within the next steps (GPU only)."""
    graphs: dict[str, Any] = field(default_factory=dict)
    """CUDA graphs of parts of the rebuild, by the name of the method that launches the part."""
    ran: set[str] = field(default_factory=set)
    """Names of the parts that have been launched at least once, so that their kernels are loaded."""
    count_faces: list[Stage] = field(default_factory=list)
    """Stages that count the triangles within reach of each sphere."""
    fill_faces: list[Stage] = field(default_factory=list)
    """Stages that compute where the rows of mesh candidates start, and fill the rows."""


class NeighborLists:
    """Builder of the neighbour lists and mesh candidates of those scenes of a batch that are flagged as stale.

    A list holds the pairs within a skin [m] of each other. It stays complete until some sphere has moved by half
    the skin relative to a common drift (its scene's mean velocity at the build), or by the mesh skin relative to a
    mesh.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self._builds = np.zeros(batch.count, dtype=int)
        self.by_device = wp.zeros(1, dtype=wp.int32, device=batch.device)
        """Number of rebuilds that the device started by itself, shape (1,); stays 0 unless the batch has one scene."""
        f, t = batch.features, types(batch.scalar)
        n, scenes = batch.sphere_count, batch.count
        self._cells = Cells(batch)

        def zeros(shape: Any, dtype: Any = wp.int32) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=batch.device)

        self._centre = zeros(n, t.vec3)
        self._count, self.scanned = zeros(n + scenes), zeros(n + scenes)
        slots = n + scenes if f.meshes else 0
        self._face_count, self.face_scanned = zeros(slots), zeros(slots)
        # Half lists: each chunk has its own section of `_found` for the neighbours that its search finds. `_place`
        # holds the position in that section where a sphere's neighbours begin.
        self._room = np.full(batch.threads, 8 * n // batch.threads)
        self._found = zeros(int(self._room.sum()) if f.half_list else 0)
        self._place = zeros(n if f.half_list else 0)
        self._wanted = zeros(batch.threads)
        self._searchers = self._searchers_for(n)
        self._finds = zeros((0, 0) if f.half_list else (KEPT, n))
        self._boxes = zeros((batch.threads, 2), t.vec3)
        # The last element of `_total` receives the length of the longest row that did not fit into `_finds`.
        self._total, self._face_total = zeros(scenes + 1), zeros(scenes + 1)
        self._identity = wp.array(np.arange(n), dtype=wp.int32, device=batch.device)
        self._old_place, self._new_place = zeros(n), zeros(n)
        self._lanes = zeros((scenes, DRIFT_LANES), wp.vec3d)
        self._stretched = zeros(n if f.bonds and f.half_list else 0, batch.scalar)
        # The previous lists, from which the new lists take over contact history.
        self._old = batch.structs.Pairs()
        self._old.start = zeros(n + scenes)
        self._entries = np.array([state.pair_total for state in batch.states])
        self._kept = [name for name in pair_bytes(batch.models[0]) if name != "other" or f.history or f.bonds]
        self._recorded: dict[tuple[bool, int], _Launches] = {}
        self._version: tuple[int, ...] = ()

    @property
    def builds(self) -> np.ndarray:
        """Number of list builds of each scene since it joined this batch, shape (scenes,)."""
        return self._builds + int(self.by_device.numpy()[0])

    def _searchers_for(self, spheres: int) -> int:
        """Return how many threads search for one sphere's neighbours when this many spheres are searched."""
        return OCTANTS if self.batch.parallel and spheres < MANY else 1

    def __call__(self) -> None:
        """Rebuild the lists of every scene that is flagged as stale."""
        b = self.batch
        b.device_changed()
        flags, sort_every = b.host_flags(), b.rows["sort_every"]
        if b.sphere_count == 0:
            b.ahead.built(flags)
            self._launches(False).clear_stale()
            b.device_changed()
            return
        stale = flags[:, int(STALE)] != 0
        # Re-sort only at fixed step counts: rebuilds come at varying times, which must not change the results.
        b.ahead.built(flags)
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
        if self._cells.made > made and b.ahead.rebuilds_itself:
            b.invalidate_graphs()
        launches = self._launches(sort)
        self._run(launches, self._before)
        if b.features.half_list:
            launches = self._search(sort)
            for stage in (*launches.scan, launches.starts):
                stage()
        else:
            self._run(launches, self._search_all)
        wanted, longest = self._found_of(self._total, "neighbour list", "pairs")
        if np.any(wanted > b.capacity):
            b.reserve_pairs(np.maximum(wanted, self._entries))
            # The larger arrays hold the scenes' rows at other places, so copy the old lists again.
            self._keep_old(np.flatnonzero(stale))
            launches = self._launches(sort)
        self._entries[stale] = wanted[stale]
        if b.features.half_list:
            b.in_parts(launches.transfer)
        else:
            self._run(launches, self._fill)
        if len(self._finds) < longest <= MOST_KEPT:
            self._finds = wp.empty((MOST_KEPT, b.sphere_count), dtype=wp.int32, device=b.device)
            self._version = ()  # record all launches anew at the next build, with the enlarged array
            if b.ahead.rebuilds_itself:
                b.invalidate_graphs()
        if b.features.meshes:
            begin, fill = launches.fill_faces
            for stage in (*launches.count_faces, begin):
                stage()
            wanted, _ = self._found_of(self._face_total, "mesh candidates", "faces")
            if np.any(wanted > b.face_capacity):
                b.reserve_faces(wanted)
                launches = self._launches(sort)
                _, fill = launches.fill_faces
            fill()
        b.subcycles.locate()
        self._run(launches, self._after)
        b.device_changed()

    def _run(self, launches: _Launches, part: Callable[[_Launches], None]) -> None:
        """Run one part of a rebuild; on a GPU as a graph from the second time on.

        Most of the time of a rebuild on a GPU is spent waiting for launches, which a graph avoids.
        """
        name, device = part.__name__, self.batch.device
        if name not in launches.ran or not device.is_cuda:
            part(launches)
            launches.ran.add(name)
            return
        if name not in launches.graphs:
            launches.graphs[name] = captured(device, lambda: part(launches))
        wp.capture_launch(launches.graphs[name])

    def _before(self, launches: _Launches) -> None:
        wp.copy(self._old.start, self.batch.pairs.start)
        launches.centres()
        if self.batch.features.bonds and self.batch.features.half_list:
            self._stretched.zero_()
            launches.stretch()
        self._cells.grid.held.zero_()
        for stage in launches.cells:
            stage()

    def _search_all(self, launches: _Launches) -> None:
        self._find_all(launches)
        launches.starts()

    def _find_all(self, launches: _Launches) -> None:
        self._count.zero_()
        self._total.zero_()
        for stage in (*launches.search, *launches.scan):
            stage()

    def _fill(self, launches: _Launches) -> None:
        for stage in (*launches.fill, *launches.transfer):
            stage()
        self._link(launches)

    def _after(self, launches: _Launches) -> None:
        launches.drift()
        launches.clear_stale()
        for stage in launches.near:
            stage()

    def _link(self, launches: _Launches) -> None:
        if launches.links:
            clear, count, fill = launches.links
            for stage in (clear, count, *launches.scan, fill):
                stage()

    # The following methods serve rebuilds inside a CUDA graph, for a batch of one scene; see `rebuilding`.

    def lay_out_cells(self) -> None:
        """Lay out grid cells for scenes whose lists were loaded, so that the host has built none for them."""
        width = self._cells.width()
        self._cells.fit(width, np.zeros(self.batch.count, dtype=bool))
        self._cells.use_width(width)

    def device_stages(self) -> list[Stage]:
        """Return all stages that a rebuild inside a graph launches, bound to the arrays that exist now."""
        self._searchers = self._searchers_for(self.batch.sphere_count)
        self._keep_old(np.arange(self.batch.count))
        each = self._launches(False)
        return [
            *self.batch.sync_stages(), each.centres, *each.cells, *each.search, *each.scan, *each.count_faces,
            each.starts, *each.fill, *each.transfer, *each.links, *each.fill_faces, *self.batch.subcycles.locating(),
            each.drift, each.clear_stale, *each.near,
        ]  # fmt: skip

    def search_on_device(self) -> None:
        """Run the first half of a rebuild inside a graph: search, and count the entries of each row."""
        launches = self._launches(False)
        for stage in self.batch.sync_stages():
            stage()
        for name in self._kept:
            wp.copy(getattr(self._old, name), getattr(self.batch.pairs, name))
        self._before(launches)
        self._find_all(launches)
        for stage in launches.count_faces:
            stage()

    def complete_on_device(self) -> None:
        """Run the second half of a rebuild inside a graph: fill the rows, transfer history, choose near links."""
        launches = self._launches(False)
        launches.starts()
        self._fill(launches)
        for stage in (*launches.fill_faces, *self.batch.subcycles.locating()):
            stage()
        self._after(launches)

    def link(self, s: int) -> None:
        """Build the links of scene `s`, whose lists came from a checkpoint; does nothing for half lists."""
        if self.batch.features.half_list:
            return
        before = self.batch.flags.numpy().copy()
        flags = before.copy()
        flags[:, int(STALE)] = np.arange(self.batch.count) == s
        self.batch.flags.assign(flags)
        launches = self._launches(False)
        self._link(launches)
        self.batch.flags.assign(before)
        for stage in launches.near:
            stage()

    def kernels(self) -> list[Any]:
        """Return the kernels and stages of everything that a rebuild launches, so that they can be compiled."""
        b = self.batch
        self._keep_old(np.arange(b.count))
        each = self._launches(False)
        few = []
        # A rebuild of only some scenes of the batch may involve so few spheres that eight threads search for each.
        if b.parallel and self._searchers == 1 and b.count > 1:
            other = self._launches(False, OCTANTS)
            few = [*other.search, *other.fill]
        stretch = [each.stretch] if b.features.bonds and b.features.half_list else []
        return [
            each.centres, *each.cells, *each.scan, each.starts, each.drift, each.clear_stale, *few, *each.search,
            *each.fill, *each.transfer, *each.links, *each.near, *each.count_faces, *each.fill_faces, *stretch,
            *sorting_kernels(b),
        ]  # fmt: skip

    def _search(self, sort: bool) -> _Launches:
        """Search half lists chunk by chunk into buffers, and repeat with larger buffers if one was too small."""
        b = self.batch
        if b.threads > 1:
            places = self._centre.numpy()
            nowhere = [np.full(3, np.inf), np.full(3, -np.inf)]
            chunks = [places[first:last] for first, last in pairwise(b.sphere_chunks.tolist())]
            self._boxes.assign(np.array([[c.min(0), c.max(0)] if len(c) else nowhere for c in chunks]))
        while True:
            launches = self._launches(sort)
            b.in_parts(launches.search)
            wanted = self._wanted.numpy().astype(np.int64)
            if np.all((wanted >= 0) & (wanted <= self._room)):
                return launches
            room = np.maximum(self._room, wanted + wanted // 4)
            if np.any(wanted < 0) or room.sum() > MAXIMUM_ENTRIES:
                raise CapacityError(
                    f"neighbour list of {b.sphere_count} spheres has more pairs than 32 bits can "
                    "count; use fewer or larger aggregates"
                )
            self._room = room
            self._found = wp.empty(int(self._room.sum()), dtype=wp.int32, device=b.device)
            self._recorded.clear()

    def _keep_old(self, scenes: np.ndarray) -> None:
        """Copy the current lists of `scenes`, from which their new lists take over contact history."""
        b = self.batch
        # Copy whole arrays for a single scene on a GPU, since only the device may know the number of its entries.
        whole = 4 * len(scenes) > b.count > 1 or (b.count == 1 and b.parallel)
        for name in PAIR_ARRAYS:
            array, kept = getattr(b.pairs, name), getattr(self._old, name)
            if name not in self._kept:  # no kernel reads this array of the old lists, so a reference is enough
                if kept is not array:
                    setattr(self._old, name, array)
                    self._recorded.clear()
                continue
            if kept is None or len(kept) != len(array):
                kept = wp.empty(len(array), dtype=array.dtype, device=b.device)
                setattr(self._old, name, kept)
                self._recorded.clear()
            if whole:
                wp.copy(kept, array)
                continue
            for s in scenes:
                first, count = int(b.rows["pairs"][s]), int(self._entries[s])
                if count:  # for a count of 0 `wp.copy` would copy the whole array
                    wp.copy(kept, array, first, first, count)

    def _launches(self, sorted_now: bool, searchers: int | None = None) -> _Launches:
        """Return the recorded launches of a rebuild on the batch's current arrays, with or without a re-sorting.

        `searchers` is the number of threads that search for one sphere's neighbours; default: as many as now.
        """
        version = self.batch.version, self._cells.made
        if self._version != version:
            self._recorded.clear()
            self._version = version
        key = sorted_now, searchers or self._searchers
        if key not in self._recorded:
            self._recorded[key] = self._record(*key)
        return self._recorded[key]

    def _record(self, sorted_now: bool, searchers: int) -> _Launches:
        b, f, n = self.batch, self.batch.features, self.batch.sphere_count
        old_place = self._old_place if sorted_now else self._identity
        new_place = self._new_place if sorted_now else self._identity
        found = self._found if f.half_list else b.pairs.other
        edges = np.concatenate([[0], np.cumsum(self._room)]).tolist()
        chunks = list(pairwise(b.sphere_chunks.tolist()))
        lists = list_kernels(b.scalar)
        lanes = 1 if f.half_list else OCTANTS
        transfer = transfer_kernel(b.scalar, f.half_list, f.history, f.pair_law.rolls, f.bonds, f.healing, lanes)
        cells = {"grid": self._cells.grid, "shift": self._cells.shift}
        before = {"old_pairs": self._old, "old_place": old_place, "stretched": self._stretched}
        if f.half_list:
            kernel = half_search_kernel(b.scalar, f.bonds)
            search = [
                b.stage(
                    kernel, 1, first=first, last=last, part=part, boxes=self._boxes, count=self._count,
                    place=self._place, room=wp.vec2i(edges[part], edges[part + 1]), wanted=self._wanted, other=found,
                    **cells, **before,
                )
                for part, (first, last) in enumerate(chunks)
            ]  # fmt: skip
            fill = []
        else:
            search_kernel, fill_kernel = full_search_kernels(b.scalar, f.bonds, searchers)
            finds = {"count": self._count, "finds": self._finds, "new_place": new_place, **cells, **before}
            search = [b.stage(search_kernel, n * searchers, total=self._total, **finds)]
            fill = [b.stage(fill_kernel, n * searchers, **finds)]

        def starts(scanned: wp.array, start: wp.array, total: wp.array) -> Stage:
            return b.stage(lists.starts, n + b.count, scanned=scanned, start=start, total=total)

        launches = _Launches(
            centres=b.stage(lists.centres, n, shift=self._cells.shift, centre=self._centre),
            stretch=b.stage(
                lists.stretch, n, old_pairs=self._old, old_place=old_place, new_place=new_place,
                stretched=self._stretched,
            ),
            cells=self._cells.stages(self._centre),
            search=search,
            fill=fill,
            scan=scan_stages(self._count, self.scanned),
            starts=starts(self.scanned, b.pairs.start, self._total),
            transfer=[
                b.stage(
                    transfer, lanes * tasks(b, last - first), first=first, last=last, old_pairs=self._old,
                    old_place=old_place, place=self._place, found=found,
                )
                for first, last in chunks
            ],
            drift=b.stage(lists.drift, (b.count, DRIFT_LANES), lanes=self._lanes),
            clear_stale=b.stage(lists.clear_stale, b.count, lanes=self._lanes),
        )  # fmt: skip
        if not f.half_list:
            linking = linking_kernels(b.scalar, f.history, f.pair_law.rolls, f.bonds, rows_of(f), OCTANTS)
            launches.links = [
                b.stage(linking.clear_links, len(b.links.link)),
                b.stage(linking.count_own, n, count=self._count),
                b.stage(linking.fill_links, OCTANTS * n, scanned=self.scanned),
            ]
            launches.near = near_stages(b)
        if f.meshes:
            count_faces, fill_faces = candidate_kernels(b.scalar)
            launches.count_faces = [
                b.stage(count_faces, n, count=self._face_count),
                *scan_stages(self._face_count, self.face_scanned),
            ]
            launches.fill_faces = [
                starts(self.face_scanned, b.candidates.start, self._face_total),
                b.stage(fill_faces, n, count=self._face_count),
            ]
        return launches

    def _found_of(self, total: wp.array, what: str, entries: str) -> tuple[np.ndarray, int]:
        """Return the number of list entries of each scene, shape (scenes,), and the last element of `total`."""
        (found,) = self.batch.exchange.read(total)
        found = found.astype(np.int64)
        wanted, longest = found[:-1], int(found[-1])
        if np.any(wanted < 0) or wanted.sum() > MAXIMUM_ENTRIES:
            raise CapacityError(
                f"{what} of {self.batch.sphere_count} spheres has more than 2^31 {entries}; use fewer "
                "or larger aggregates"
            )
        return wanted, longest
