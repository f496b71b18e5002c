"""Cells of Warp's hash grid, laid out for the place that the scenes of a batch take."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ..kernels.common.types import types

LOOKED_AT = 4_000
"""Spheres of a batch that tell how far its scenes reach, about."""
AMONG = 0.1
"""Percent of a scene's spheres at either end of each axis that may lie beyond its cells."""
CELLS = 8
"""Cells a sphere, at most: all are cleared with every build."""
FEWEST_CELLS = 4096
MOST_CELLS = {"cpu": 2**18, "cuda": 2**24}


class Cells:
    """A grid with a block of cells for each scene, one beside another.

    Positions wrap around the grid, so any place is in a cell: to lie beyond a scene's block, or to have too few cells,
    costs time and changes nothing. A cube of cells for a pipe, as long as eight of its diameters, has its spheres lie
    over one another several times.
    """

    shift: wp.array
    """From a scene's own place to that of its block [m], shape (scenes,)."""

    def __init__(self, batch: Any) -> None:
        self.batch = batch
        self.shift = wp.zeros(batch.count, dtype=types(batch.scalar).vec3, device=batch.device)
        self.fitted = False
        self._dims = np.ones(3, dtype=int)
        self._make()

    def _make(self) -> None:
        dims = [int(d) for d in self._dims]
        self.grid = wp.HashGrid(*dims, device=self.batch.device, dtype=self.batch.scalar)

    def fit(self, width: float) -> bool:
        """Lay out cells of a `width` [m] for the spheres as they are now; returns whether the grid is another one."""
        b = self.batch
        position = b.spheres.position.numpy()
        sizes = np.ones((b.count, 3), dtype=int)
        low = np.zeros((b.count, 3), dtype=int)
        stride = max(1, b.sphere_count // LOOKED_AT)
        for s in range(b.count):
            first = int(b.rows["spheres"][s])
            places = position[first : first + int(b.rows["sphere_count"][s]) : stride, :3].astype(float)
            places = places[np.all(np.abs(places) < 1e6 * width, axis=1)]
            if len(places):
                low[s], high = np.floor(np.percentile(places, [AMONG, 100 - AMONG], axis=0) / width).astype(int)
                sizes[s] = high - low[s] + 2  # one between it and the next scene's
        axis = int(np.argmin(sizes.max(0)))
        place = -low
        place[:, axis] += np.concatenate([[0], np.cumsum(sizes[:-1, axis])])
        if b.count > 1:
            self.shift.assign((place * width).astype(np.float64))
        dims = sizes.max(0)
        dims[axis] = sizes[:, axis].sum()
        most = min(max(CELLS * b.sphere_count, FEWEST_CELLS), MOST_CELLS["cuda" if b.parallel else "cpu"])
        while np.prod(dims, dtype=float) > most:
            dims[np.argmax(dims)] = (dims.max() + 1) // 2
        again, self.fitted = self.fitted, True
        if np.all(dims <= self._dims):
            return False
        # What spreads is to find room for a while.
        self._dims = np.maximum(self._dims, dims + dims // 4 if again else dims)
        while np.prod(self._dims, dtype=float) > most:
            self._dims[np.argmax(self._dims)] = (self._dims.max() + 1) // 2
        self._make()
        return True

    def build(self, centre: wp.array, width: float) -> None:
        """Sort points, shifted already, into cells of a `width` [m]."""
        self.grid.build(centre, radius=width)
