"""Room for what a GPU evaluates of each pair: a struct `Links`, beside the lists of a batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ..kernels.dem.linking import MORE
from ..kernels.dem.links import pull_rows
from ..kernels.dem.structs import links_struct
from .state import State, pair_bytes


def even_pairs(states: list[State]) -> None:
    """Give lists even room: a full one holds every pair twice, and links begin at half a scene's first entry."""
    for state in states:
        for name in pair_bytes(state.model):
            array = getattr(state.pairs, name)
            if len(array) % 2:
                even = wp.zeros(len(array) + 1, dtype=array.dtype, device=array.device)
                wp.copy(even, array)
                setattr(state.pairs, name, even)


def rows_of(features: Any) -> int:
    """Rows of four numbers that a link gives in a scene with these features."""
    return pull_rows(features.bonds, features.pair_law.rolls, features.dissipation)


def make_links(batch: Any) -> Any:
    """Links with as much room as the lists of a :class:`Batch` have; no pair is known yet. A CPU has none."""
    struct = links_struct(batch.scalar)
    lists = int(batch.capacity.sum()) if batch.parallel else 0
    few = {"near_count": 2, "outrun": batch.count, "seen_at": batch.count, "seen": batch.sphere_count}
    few["more"] = int(MORE) * batch.sphere_count
    sizes = {"pull": rows_of(batch.features) * lists // 2, "end": lists}
    sizes |= few if batch.parallel else dict.fromkeys(few, 0)
    links = struct()
    for name, variable in struct.vars.items():
        made = wp.zeros(sizes.get(name, lists // 2), dtype=variable.type.dtype, device=batch.device)
        setattr(links, name, made)
    if batch.parallel:
        links.link.fill_(-1)
        first = np.append(0, np.cumsum(batch.capacity // 2)).tolist()
        for s in range(1, batch.count):
            if first[s] < first[s + 1]:
                links.scene[first[s] : first[s + 1]].fill_(s)
        links.outrun.fill_(1)  # near links are chosen when lists have been built
        links.near_count.assign(np.array([0, 1], dtype=np.int32))
    return links


def carry_links(before: Any, old: np.ndarray, links: Any, capacity: np.ndarray) -> None:
    """Copy the pairs of each scene to where they are in lists of more room; `old` and `capacity` are entries each."""
    wp.copy(links.more, before.more)
    first, behind = (np.append(0, np.cumsum(each // 2)) for each in (capacity, old))
    for name, entries in (("link", 1), ("touched", 1), ("end", 2)):  # of each
        target, source = getattr(links, name), getattr(before, name)
        for s in np.flatnonzero(old):
            wp.copy(target, source, entries * int(first[s]), entries * int(behind[s]), entries * int(old[s]) // 2)
