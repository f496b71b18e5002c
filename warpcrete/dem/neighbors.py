"""Verlet lists: built on a grid of cells, carried over exactly, of bodies that are re-sorted now and then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from ..core.errors import CapacityError
from ..core.graphs import captured
from ..core.launching import Stage
from ..core.scan import scan_stages
from ..kernels.common.control import STALE, STEPS
from ..kernels.common.types import types
from ..kernels.dem.linking import linking_kernels
from ..kernels.dem.lists import list_kernels, transfer_kernel
from ..kernels.dem.mesh_contacts import candidate_kernels
from ..kernels.dem.search import full_search_kernels, half_search_kernel
from .batch import Batch
from .cells import Cells
from .joint import MAXIMUM_ENTRIES
from .links import rows_of
from .sorting import sort_bodies, sorting_kernels
from .stages import MANY, near_stages, tasks
from .state import PAIR_ARRAYS, pair_bytes

DRIFT_LANES = 64
OCTANTS = 8
"""Threads of a GPU that search for the neighbours of a sphere, and fill its row, where there are few."""
KEPT = 32
"""Neighbours of a sphere that are kept from a search; one that has more is searched for twice."""
MOST_KEPT = 64
"""As many as that, once there were spheres that have more, but none more than these."""


@dataclass
class _Launches:
    """Recorded launches of a rebuild, and graphs of them."""

    centres: Stage
    stretch: Stage
    cells: list[Stage]
    """Puts the spheres' centres into the grid."""
    search: list[Stage]
    fill: list[Stage]
    """Of a GPU: puts into rows what the search found."""
    scan: list[Stage]
    """Counts of rows into where they begin."""
    starts: Stage
    transfer: list[Stage]
    drift: Stage
    clear_stale: Stage
    links: list[Stage] = field(default_factory=list)
    """Clearing, count and fill of a GPU's links."""
    near: list[Stage] = field(default_factory=list)
    """What chooses those of them that are near."""
    graphs: dict[str, Any] = field(default_factory=dict)
    """Of parts of a rebuild, on a GPU."""
    ran: set[str] = field(default_factory=set)
    """Parts that have been launched once."""
    count_faces: list[Stage] = field(default_factory=list)
    """Counts mesh candidates."""
    fill_faces: list[Stage] = field(default_factory=list)
    """Starts and fill of them."""


class NeighborLists:
    """(Re)builds pair lists and mesh candidates of the scenes of a batch that are stale.

    A list holds the pairs within a skin [m] of each other. It stays complete until some sphere has moved by half
    the skin against a common drift (its scene's mean velocity at the build), or by the mesh skin against a mesh.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self._builds = np.zeros(batch.count, dtype=int)
        self.by_device = wp.zeros(1, dtype=wp.int32, device=batch.device)
        """Builds that the device decided on, of a scene alone."""
        f, t = batch.features, types(batch.scalar)
        n, scenes = batch.sphere_count, batch.count
        self._cells = Cells(batch)

        def zeros(shape: Any, dtype: Any = wp.int32) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=batch.device)

        self._centre = zeros(n, t.vec3)
        self._count, self.scanned = zeros(n + scenes), zeros(n + scenes)
        slots = n + scenes if f.meshes else 0
        self._face_count, self.face_scanned = zeros(slots), zeros(slots)
        # Half lists: what a search finds, in a room for each chunk, and where a sphere's part of that begins.
        self._room = np.full(batch.threads, 8 * n // batch.threads)
        self._found = zeros(int(self._room.sum()) if f.half_list else 0)
        self._place = zeros(n if f.half_list else 0)
        self._wanted = zeros(batch.threads)
        self._searchers = self._searchers_for(n)
        self._finds = zeros((0, 0) if f.half_list else (KEPT, n))
        self._boxes = zeros((batch.threads, 2), t.vec3)
        # The last is the longest row that could not be kept.
        self._total, self._face_total = zeros(scenes + 1), zeros(scenes + 1)
        self._identity = wp.array(np.arange(n), dtype=wp.int32, device=batch.device)
        self._old_place, self._new_place = zeros(n), zeros(n)
        self._lanes = zeros((scenes, DRIFT_LANES), wp.vec3d)
        self._stretched = zeros(n if f.bonds and f.half_list else 0, batch.scalar)
        # The list before, which the new one takes history from.
        self._old = batch.structs.Pairs()
        self._old.start = zeros(n + scenes)
        self._entries = np.array([state.pair_total for state in batch.states])
        self._kept = [name for name in pair_bytes(batch.models[0]) if name != "other" or f.history or f.bonds]
        self._recorded: dict[tuple[bool, int], _Launches] = {}
        self._version: tuple[int, ...] = ()

    @property
    def builds(self) -> np.ndarray:
        """Of each scene, since it came to this batch, shape (scenes,)."""
        return self._builds + int(self.by_device.numpy()[0])

    def _searchers_for(self, spheres: int) -> int:
        """Threads for each of so many spheres that are searched for at a time."""
        return OCTANTS if self.batch.parallel and spheres < MANY else 1

    def __call__(self) -> None:
        """Rebuild the lists of every scene that is marked stale."""
        b = self.batch
        b.device_changed()
        flags, sort_every = b.host_flags(), b.rows["sort_every"]
        if b.sphere_count == 0:
            b.ahead.built(flags)
            self._launches(False).clear_stale()
            b.device_changed()
            return
        stale = flags[:, int(STALE)] != 0
        # By steps: when lists are built besides is nobody's business, and changes no bits.
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
            self._keep_old(np.flatnonzero(stale))  # the scenes' places in the pair arrays are others now
            launches = self._launches(sort)
        self._entries[stale] = wanted[stale]
        if b.features.half_list:
            b.in_parts(launches.transfer)
        else:
            self._run(launches, self._fill)
        if len(self._finds) < longest <= MOST_KEPT:
            self._finds = wp.empty((MOST_KEPT, b.sphere_count), dtype=wp.int32, device=b.device)
            self._version = ()  # from the next build on
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
        """A part of a rebuild; on a GPU a graph from the second time on: most of a rebuild is waiting for launches."""
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

    # In a graph, of a scene alone: see `rebuilding`.

    def lay_out_cells(self) -> None:
        """Have cells for scenes that came with their lists, of which the host has built none."""
        width = self._cells.width()
        self._cells.fit(width, np.zeros(self.batch.count, dtype=bool))
        self._cells.use_width(width)

    def device_stages(self) -> list[Stage]:
        """Stages that a rebuild in a graph launches, on arrays that are there from now on."""
        self._searchers = self._searchers_for(self.batch.sphere_count)
        self._keep_old(np.arange(self.batch.count))
        each = self._launches(False)
        return [
            *self.batch.sync_stages(), each.centres, *each.cells, *each.search, *each.scan, *each.count_faces,
            each.starts, *each.fill, *each.transfer, *each.links, *each.fill_faces, *self.batch.subcycles.locating(),
            each.drift, each.clear_stale, *each.near,
        ]  # fmt: skip

    def search_on_device(self) -> None:
        """Up to where it is known how many entries rows have."""
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
        """From there on."""
        launches = self._launches(False)
        launches.starts()
        self._fill(launches)
        for stage in (*launches.fill_faces, *self.batch.subcycles.locating()):
            stage()
        self._after(launches)

    def link(self, s: int) -> None:
        """Find the links of a scene whose lists came from a checkpoint."""
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
        """Kernels and stages of all that it launches."""
        b = self.batch
        self._keep_old(np.arange(b.count))
        each = self._launches(False)
        few = []
        if b.parallel and self._searchers == 1 and b.count > 1:  # some of the scenes may have few spheres
            other = self._launches(False, OCTANTS)
            few = [*other.search, *other.fill]
        stretch = [each.stretch] if b.features.bonds and b.features.half_list else []
        return [
            each.centres, *each.cells, *each.scan, each.starts, each.drift, each.clear_stale, *few, *each.search,
            *each.fill, *each.transfer, *each.links, *each.near, *each.count_faces, *each.fill_faces, *stretch,
            *sorting_kernels(b),
        ]  # fmt: skip

    def _search(self, sort: bool) -> _Launches:
        """Half lists: search chunk by chunk into buffers, once more where one was too short."""
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
        """Copy of the lists of some scenes, that their new ones take history from."""
        b = self.batch
        # How many entries a scene alone on a GPU has, its device may know only.
        whole = 4 * len(scenes) > b.count > 1 or (b.count == 1 and b.parallel)
        for name in PAIR_ARRAYS:
            array, kept = getattr(b.pairs, name), getattr(self._old, name)
            if name not in self._kept:  # nobody reads it
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
                if count:  # else `copy` takes all
                    wp.copy(kept, array, first, first, count)

    def _launches(self, sorted_now: bool, searchers: int | None = None) -> _Launches:
        """Recorded launches of a rebuild, after a re-sorting or without one, on the arrays that the batch has now; by
        so many threads a sphere, or as many as search now."""
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
        """How many entries each scene now has, and the last of `total`."""
        (found,) = self.batch.exchange.read(total)
        found = found.astype(np.int64)
        wanted, longest = found[:-1], int(found[-1])
        if np.any(wanted < 0) or wanted.sum() > MAXIMUM_ENTRIES:
            raise CapacityError(
                f"{what} of {self.batch.sphere_count} spheres has more than 2^31 {entries}; use fewer "
                "or larger aggregates"
            )
        return wanted, longest
