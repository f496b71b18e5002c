"""Pairs of spheres in the neighbour lists, read from the device: each pair once, for full and for half lists."""

from __future__ import annotations

import numpy as np

from .state import State


def listed_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return both sphere indices of every listed pair, each pair once, and the index of the pair's list entry."""
    return pairs_of(state.pairs.start.numpy(), state.pairs.other.numpy(), chunks_of(state))


def chunks_of(state: State) -> list[int] | None:
    """Return the first sphere of each CPU thread's chunk and the end of the last chunk; None for full lists (GPU)."""
    return list(state.chunks) if state.model.features.half_list else None


def pairs_of(
    start: np.ndarray, other: np.ndarray, chunks: list[int] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what :func:`listed_pairs` returns, computed from host copies of the arrays of a neighbour list."""
    other = other[: start[-1]]
    i = np.repeat(np.arange(len(start) - 1), np.diff(start))
    j = np.where(other >= 0, other, -1 - other)
    once = other >= 0
    if chunks is not None:
        # A pair has two entries, and the one with a positive index counts. In half lists, a pair inside a chunk has
        # only one entry, which therefore counts with either sign.
        once |= np.searchsorted(chunks, i, "right") == np.searchsorted(chunks, j, "right")
    return i[once], j[once], np.flatnonzero(once)
