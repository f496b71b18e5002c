"""Cells of the grid, laid out for the place that the scenes of a batch take."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ..core.launching import Stage
from ..core.scan import scan_stages
from ..kernels.common.types import types
from ..kernels.dem.grid import grid_kernels, grid_struct

LOOKED_AT = 4_000
"""Spheres of a scene that tell how far it reaches, about."""
FARTHEST = 1e6
"""Widths of a cell from the middle of a scene from which on it does not matter how far a sphere is."""
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
    grid: Any
    """A struct `Grid`."""
    made: int
    """How often it has been laid out: launches hold its arrays."""

    def __init__(self, batch: Any) -> None:
        self.batch = batch
        self.shift = wp.zeros(batch.count, dtype=types(batch.scalar).vec3, device=batch.device)
        self._bounds = np.zeros((batch.count, 2, 3))
        self._fitted = np.zeros(batch.count, dtype=bool)
        self._full = np.array([state.sphere_count > 0 for state in batch.states])
        self._mean_radius = np.array([state.mean_radius for state in batch.states])
        """Of a scene's spheres at full size [m]."""
        self._dims = np.ones(3, dtype=int)
        self._width = 0.0
        self.made = 0
        self._make()

    def _make(self) -> None:
        device, n, cells = self.batch.device, self.batch.sphere_count, int(self._dims.prod())
        grid = grid_struct(self.batch.scalar)()
        grid.dims = wp.vec3i(*self._dims.tolist())
        grid.per_width = wp.array([1 / self._width if self._width else 1.0], dtype=self.batch.scalar, device=device)
        for name, size in (("held", cells + 1), ("start", cells + 1), ("cell", n), ("rank", n), ("point", n)):
            setattr(grid, name, wp.zeros(size, dtype=wp.int32, device=device))
        self.grid = grid
        self.made += 1

    def width(self) -> float:
        """Of a cell [m]: for the many small spheres; the few large ones look through more of them."""
        b = self.batch
        scale = b.scenes.scale.numpy() if b.features.growth else 1.0
        return float(np.max((2 * self._mean_radius * scale + b.rows["skin"])[self._full]))

    def fit(self, width: float, due: np.ndarray) -> None:
        """Lay out cells of a `width` [m] for the spheres of scenes that are `due` as they are now."""
        due = (due | ~self._fitted) & self._full
        if not due.any():
            return
        for s in np.flatnonzero(due):
            self._bounds[s] = self._reach(s, width)
        self._fitted |= due
        low, high = np.floor(self._bounds / width).astype(int).transpose(1, 0, 2)
        sizes = high - low + 2  # one between it and the next scene's
        axis = int(np.argmin(sizes.max(0)))
        dims = sizes.max(0)
        dims[axis] = sizes[:, axis].sum()
        if self.batch.count > 1:
            low[:, axis] -= np.concatenate([[0], np.cumsum(sizes[:-1, axis])])
            self.shift.assign(-low * width)
        most = min(
            max(CELLS * self.batch.sphere_count, FEWEST_CELLS), MOST_CELLS["cuda" if self.batch.parallel else "cpu"]
        )
        while np.prod(dims, dtype=float) > most:
            dims[np.argmax(dims)] = (dims.max() + 1) // 2
        if np.all(dims <= self._dims):
            return
        # What spreads is to find room for a while.
        grown = np.maximum(self._dims, dims + dims // 4)
        self._dims = grown if np.prod(grown, dtype=float) <= most and np.any(self._dims > 1) else dims
        self._make()

    def _reach(self, s: int, width: float) -> np.ndarray:
        """Lowest and highest corner of where nearly all spheres of a scene are [m], shape (2, 3)."""
        state = self.batch.states[s]
        stride = max(1, state.sphere_count // LOOKED_AT)
        some = state.spheres.position[::stride]
        looked_at = state.scratch("looked_at", some.shape, some.dtype)
        wp.copy(looked_at, some)
        (places,) = self.batch.exchange.read(looked_at)
        places = places[:, :3].astype(float)
        places = places[np.isfinite(places).all(axis=1)]
        if not len(places):
            return np.zeros((2, 3))
        middle = np.median(places, axis=0)
        near = np.clip(places - middle, -FARTHEST * width, FARTHEST * width)
        return middle + np.percentile(near, [AMONG, 100 - AMONG], axis=0)

    def use_width(self, width: float) -> None:
        """Have cells of a `width` [m] from the next building on."""
        if width != self._width:
            self._width = width
            self.grid.per_width.fill_(self.batch.scalar(1 / width))

    def stages(self, centre: wp.array) -> list[Stage]:
        """What puts points, shifted already, into cells; `held` is to be zero."""
        b, kernels = self.batch, grid_kernels(self.batch.scalar)
        return [
            b.stage(kernels.count, b.sphere_count, centre=centre, grid=self.grid),
            *scan_stages(self.grid.held, self.grid.start),
            b.stage(kernels.put, b.sphere_count, grid=self.grid),
        ]
