"""Allocate the struct `Links`, in which a GPU stores one link for each pair of the neighbour lists.

The lists of a GPU contain every pair twice, once for each sphere. A link represents the pair, so that its contact
force is computed once and then read by both spheres.
"""

import numpy as np

from ...core.device.arrays import DeviceArray, copy_array, declared, zeros
from ...kernels.dem.linking import EXTRA_MASKS
from ...kernels.dem.links import result_rows
from ...kernels.dem.structs import links_struct
from .batch_protocol import BatchArrays
from .model import Features
from .state import State, pair_bytes
from .struct_types import Links


def make_even(states: list[State]) -> None:
    """Make the lengths of all pair arrays of `states` even, because one link represents two entries of them."""
    for state in states:
        for name in pair_bytes(state.model):
            array: DeviceArray = getattr(state.pairs, name)
            if len(array) % 2:
                even = zeros(len(array) + 1, dtype=array.dtype, device=array.device)
                copy_array(even, array)
                setattr(state.pairs, name, even)


def rows_of(features: Features) -> int:
    """Return the number of rows, each of four numbers, that store force and moment of one link (a listed pair)."""
    return result_rows(features.bonds, features.pair_law.rolls, features.dissipation)


def make_links(batch: BatchArrays) -> Links:
    """Return empty arrays for the links of a batch; a link stands for one listed pair, whose force is computed once.

    All links are unused at first. A CPU uses no links, so its arrays have the length 0.
    """
    struct = declared(links_struct(batch.scalar))
    lists = int(batch.capacity.sum()) if batch.parallel else 0
    few = {
        "near_count": 2,
        "near_list_exceeded": batch.count,
        "near_time": batch.count,
        "near_position": batch.sphere_count,
    }
    few["later_touching"] = int(EXTRA_MASKS) * batch.sphere_count
    sizes = {"result": rows_of(batch.features) * lists // 2, "end": lists}
    sizes |= few if batch.parallel else dict.fromkeys(few, 0)
    links: Links = struct()
    for name, variable in struct.vars.items():
        made = zeros(sizes.get(name, lists // 2), dtype=variable.type.dtype, device=batch.device)
        setattr(links, name, made)
    if batch.parallel:
        links.link.fill_(-1)
        first = np.append(0, np.cumsum(batch.capacity // 2)).tolist()
        for s in range(1, batch.count):
            if first[s] < first[s + 1]:
                links.scene[first[s] : first[s + 1]].fill_(s)
        # The kernels visit only near links (pairs that may touch soon). No near links are selected yet, so set the
        # flags that let the kernels visit all links instead.
        links.near_list_exceeded.fill_(1)
        links.near_count.assign(np.array([0, 1], dtype=np.int32))
    return links


def copy_links(before: Links, old: np.ndarray, links: Links, capacity: np.ndarray) -> None:
    """Copy the links of all scenes from `before` into the larger arrays of `links`; a link stands for one listed pair.

    `old` and `capacity` are the numbers of list entries for which each scene had memory before and has memory now,
    shape (scenes,).
    """
    copy_array(links.later_touching, before.later_touching)
    first, behind = (np.append(0, np.cumsum(each // 2)) for each in (capacity, old))
    # Each tuple contains the name of an array and the number of its elements for each link.
    for name, entries in (("link", 1), ("state", 1), ("end", 2)):
        target: DeviceArray = getattr(links, name)
        source: DeviceArray = getattr(before, name)
        for s in np.flatnonzero(old):
            copy_array(target, source, entries * int(first[s]), entries * int(behind[s]), entries * int(old[s]) // 2)
