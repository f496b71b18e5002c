"""Coarse grid of cubes for the preconditioner in `kernels/mps/coarse.py`.

Each cube contains several particles. The unknowns of the coarse grid are constant in each cube (Nicolaides 1987). They
transmit the smooth part of a solution along the whole column of concrete, so the number of iterations hardly grows with
the number of particles.
"""

import math
from typing import Any

import numpy as np
import warp as wp

from ..core.device.device import parallel

WIDTH = 4.0
"""Width of a cube of the coarse grid, in particle spacings. With a width of 6, the linear solves would need a quarter
more iterations. With a width of 3, they would need only a tenth fewer iterations, but the grid would have twice as many
cubes."""
LEAST = 12.0
"""Minimum height of a column of concrete, in cubes of the coarse grid, for which the coarse grid is used. For lower
columns, the coarse grid does not speed up the linear solves."""
ABOVE = 1.1
"""Height of the coarse grid, divided by the initial height of the column of concrete. Particles that rise above the
grid are assigned to its topmost cubes."""


class CoarseGrid:
    """Grid of cubes around a column of particles.

    All neighbours of a particle lie in the particle's own cube or in an adjacent cube.
    """

    def __init__(self, structs: Any, layout: Any, radius: float, reach: float, device: Any) -> None:
        """Build the cubes around a column of concrete in a pipe with the `radius` [m].

        `structs` contains the struct types of the kernels. `layout` holds the initial positions of the particles. Two
        particles are neighbours if their distance is at most `reach` [m].
        """
        self.width, self.radius, axes = max(WIDTH * layout.spacing, reach), radius, layout.fluid.shape[1]
        wide, tall = (max(3, math.ceil(size / self.width)) for size in (2 * radius, ABOVE * layout.height))
        self.cells = (*[wide] * (axes - 1), tall)
        count, n = math.prod(self.cells), len(layout.fluid)
        self.count = count
        self.arrays = structs.Coarse()
        self.arrays.count, self.arrays.wide = count, wide
        sizes = {"of": n, "first": count + 1, "member": n, "diagonal": count, "pair": 3**axes * n * parallel(device)}
        for name, variable in structs.Coarse.vars.items():
            if name not in ("count", "wide", "neighbour"):
                size = sizes.get(name, 3**axes * count)
                setattr(self.arrays, name, wp.zeros(size, dtype=variable.type.dtype, device=device))
        self.arrays.neighbour = wp.array(self._neighbours().ravel(), dtype=wp.int32, device=device)

    def _neighbours(self) -> np.ndarray:
        """Return for each cube the indices of the cube itself and of all cubes around it, shape (3^axes, cubes).

        Each entry of the first dimension belongs to one offset from the cube, which is -1, 0 or 1 along each axis; the
        offset along the first axis varies fastest. If the grid ends before the cube at an offset, the index is -1.
        """
        axes, columns = len(self.cells), []
        at = np.stack(np.unravel_index(np.arange(self.count), self.cells, order="F"), 1)
        for step in np.ndindex((3,) * axes):
            beside = at + np.array(step[::-1]) - 1
            inside = np.all((beside >= 0) & (beside < self.cells), axis=1)
            number = np.ravel_multi_index(tuple(np.clip(beside, 0, np.array(self.cells) - 1).T), self.cells, order="F")
            columns.append(np.where(inside, number, -1))
        return np.stack(columns).astype(np.int32)

    def gather(self, places: np.ndarray) -> None:
        """Assign the particles at `places` [m], shape (n, axes), to the cubes of the grid, and sort them by cube."""
        lowest = np.array([*[-self.radius] * (len(self.cells) - 1), 0.0])
        at = np.clip(((places - lowest) / self.width).astype(int), 0, np.array(self.cells) - 1)
        of = np.ravel_multi_index(tuple(at.T), self.cells, order="F").astype(np.int32)
        self.arrays.of.assign(of)
        self.arrays.member.assign(np.argsort(of, kind="stable").astype(np.int32))
        self.arrays.first.assign(
            np.concatenate([[0], np.cumsum(np.bincount(of, minlength=self.count))]).astype(np.int32)
        )
