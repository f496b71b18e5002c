"""Search directions of the coupled solve of mortar and aggregates, and their effects.

The effect of a direction is the product of the solve's matrix with the direction. The method of generalised conjugate
residuals makes the effects orthogonal to one another.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import warp as wp

from ..core.device.arrays import Scalar
from ..kernels.suspension.vectors import vector_struct
from ..mps.common.allocation import allocate

CHUNK = 8
"""Number of search directions for which arrays are allocated at once."""


class Directions:
    """Search directions of the coupled solve, and their effects.

    The effect of a direction is the matrix of the coupled equations times the direction. `sizes` are the lengths of the
    arrays of one vector, by name. Arrays are allocated when they are needed.
    """

    def __init__(self, scalar: Scalar, device: wp.Device, sizes: dict[str, int]) -> None:
        self._scalar, self._device, self._sizes = scalar, device, sizes
        self._chunks: list[tuple[Any, Any]] = []
        self._each: list[tuple[Any, Any]] = []
        self.known = 0
        """Number of search directions that are stored. The effect of each (the matrix times the direction) is stored,
        too."""
        self.orthogonal = 0
        """Number of search directions whose effects have been made orthogonal to one another. An effect is the product
        of the matrix with a direction."""
        self._norms = np.ones(0)

    def vector(self, count: int = 1) -> Any:
        """Return a struct of new arrays that hold `count` vectors of the coupled equations.

        Each array holds its part of the first vector, then its part of the second vector, and so on.
        """
        sizes = {name: count * size for name, size in self._sizes.items()}
        return allocate(vector_struct(self._scalar), self._device, **sizes)

    def __getitem__(self, number: int) -> tuple[Any, Any]:
        """Return the search direction `number` and its effect, the product of the matrix with the direction.

        If the arrays for this number do not exist yet, they are allocated first.
        """
        while number >= len(self._each):
            pair = self.vector(CHUNK), self.vector(CHUNK)
            self._chunks.append(pair)
            self._each += [tuple(self._part(whole, k) for whole in pair) for k in range(CHUNK)]
        return self._each[number]

    def _part(self, whole: object, number: int) -> Any:
        part = vector_struct(self._scalar)()
        for name, size in self._sizes.items():
            setattr(part, name, getattr(whole, name)[number * size : (number + 1) * size])
        return part

    def before(self, number: int) -> Iterator[tuple[int, int, Any, Any]]:
        """Yield the arrays of all search directions whose numbers are below `number`, chunk by chunk.

        Each item consists of the number of the chunk's first direction, the number of directions, the directions, and
        their effects (products with the matrix).
        """
        for first, (change, effect) in zip(range(0, number, CHUNK), self._chunks, strict=False):
            yield first, min(CHUNK, number - first), change, effect

    def factors(self, first: int, products: np.ndarray) -> np.ndarray:
        """Return the factors of earlier search directions that must be subtracted from a new search direction.

        The effect of a direction is the matrix times the direction. After the subtraction, the new direction's effect
        is orthogonal to the effects of the earlier directions with the indices `first` and above. `products` are the
        inner products of the new direction's effect with each of their effects.
        """
        return products / self._norms[first : first + len(products)]

    def add_norm(self, square: float) -> None:
        """Store the squared norm of the newest direction's effect (matrix times direction).

        This effect must be orthogonal to the effects of all earlier directions.
        """
        self._norms = np.append(self._norms[: self.orthogonal], square)
        self.orthogonal += 1
