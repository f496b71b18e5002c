"""Search directions of the coupled solve, with effects that the method makes orthogonal to one another."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..kernels.suspension.vectors import vector_struct
from ..mps.common.allocation import allocate

CHUNK = 8
"""Number of search directions whose arrays are allocated together."""


class Directions:
    """Search directions, and their effects: the products of the matrix of the coupled equations and the directions.

    `sizes` are the sizes of the arrays of a vector. Arrays are allocated when they are needed.
    """

    def __init__(self, scalar: Any, device: Any, sizes: dict[str, int]) -> None:
        self._scalar, self._device, self._sizes = scalar, device, sizes
        self._chunks: list[tuple[Any, Any]] = []
        self._each: list[tuple[Any, Any]] = []
        self.known = 0
        """Number of directions that are stored with their effects."""
        self.orthogonal = 0
        """Number of directions whose effects are orthogonal to one another."""
        self._norms = np.ones(0)

    def vector(self, count: int = 1) -> Any:
        """Return one vector whose arrays have room for those of `count` vectors, one after the other."""
        sizes = {name: count * size for name, size in self._sizes.items()}
        return allocate(vector_struct(self._scalar), self._device, **sizes)

    def __getitem__(self, number: int) -> tuple[Any, Any]:
        """Return a direction and its effect; if the direction does not exist, allocate its arrays."""
        while number >= len(self._each):
            pair = self.vector(CHUNK), self.vector(CHUNK)
            self._chunks.append(pair)
            self._each += [tuple(self._part(whole, k) for whole in pair) for k in range(CHUNK)]
        return self._each[number]

    def _part(self, whole: Any, number: int) -> Any:
        part = vector_struct(self._scalar)()
        for name, size in self._sizes.items():
            setattr(part, name, getattr(whole, name)[number * size : (number + 1) * size])
        return part

    def before(self, number: int) -> Iterator[tuple[int, int, Any, Any]]:
        """Yield all directions before a given one, chunk by chunk.

        Each item has the number of the first direction, the number of directions, and their arrays.
        """
        for first, (change, effect) in zip(range(0, number, CHUNK), self._chunks, strict=False):
            yield first, min(CHUNK, number - first), change, effect

    def factors(self, first: int, products: np.ndarray) -> np.ndarray:
        """Return the factors by which directions must be subtracted, from the inner products with their effects."""
        return products / self._norms[first : first + len(products)]

    def add_norm(self, square: float) -> None:
        """Store the squared norm of the effect of the next direction, which is now orthogonal to those before it."""
        self._norms = np.append(self._norms[: self.orthogonal], square)
        self.orthogonal += 1
