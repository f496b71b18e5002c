"""Functions that read the pairs of spheres in the neighbour lists from the device, each pair once."""

import numpy as np

from .state import State


def listed_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the two sphere indices of every pair in the neighbour list, and the index of the pair's list entry.

    Each pair is returned once, even if the list contains it at both spheres.
    """
    return pairs_of(state.pairs.start.numpy(), state.pairs.other.numpy(), chunks_of(state))


def chunks_of(state: State) -> list[int] | None:
    """Return the bounds of the ranges of spheres that the CPU threads compute, as sphere indices.

    The list contains the first sphere of each range and ends with the number of spheres. The result is None for the
    full lists of a GPU.
    """
    return list(state.chunks) if state.model.features.half_list else None


def pairs_of(
    start: np.ndarray, other: np.ndarray, chunks: list[int] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the two sphere indices of every pair in a copied neighbour list, and the index of the pair's list entry.

    Each pair is returned once. `start` and `other` are host copies of the neighbour list's arrays with these names.
    `chunks` comes from :func:`chunks_of`.
    """
    other = other[: start[-1]]
    i = np.repeat(np.arange(len(start) - 1), np.diff(start))
    j = np.where(other >= 0, other, -1 - other)
    once = other >= 0
    if chunks is not None:
        # A pair that is listed at both spheres has two entries in the array `other`, one of them negative. The line
        # above selects the entry that is not negative. A half list contains a pair only once if both spheres belong to
        # the same CPU thread. Select this single entry, whatever its sign is.
        once |= np.searchsorted(chunks, i, "right") == np.searchsorted(chunks, j, "right")
    return i[once], j[once], np.flatnonzero(once)
