"""Cell grid of the neighbour search, fitted to the space that the scenes of a batch occupy."""

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, HostArray, copy_array, zeros
from ...core.device.launching import Stage
from ...core.device.scan import scan_stages
from ...kernels.common.types import types
from ...kernels.dem.grid import grid_kernels, grid_struct
from .batch import Batch
from .struct_types import Grid

SAMPLED_SPHERES = 4_000
"""Approximate number of spheres sampled to estimate the extent of a scene."""
FARTHEST_CELL = 1e6
"""Largest distance of a sphere from the middle of its scene, in cell widths, that affects the size of the grid. Spheres
farther away are treated as if they were at this distance."""
OUTSIDE_PERCENT = 0.1
"""Percentage of a scene's spheres that may lie beyond each end of the scene's block of cells, along each axis."""
CELLS = 8
"""Maximum number of cells per sphere. Every rebuild clears all cells, so many empty cells would cost time."""
FEWEST_CELLS = 4096
MOST_CELLS = {"cpu": 2**18, "cuda": 2**24}


class Cells:
    """Grid with adjacent blocks of cells, one block for each scene.

    Positions wrap around periodically, so every position belongs to a cell. The search finds all neighbours even if
    spheres lie outside their scene's block or if the grid has too few cells, but it then takes longer. The blocks are
    fitted to the scenes, because in a cubic grid distant parts of a long pipe would share cells, which would slow down
    the search.
    """

    shift: DeviceArray
    """Displacement that moves each scene's positions into its block of cells [m], shape (scenes,)."""
    grid: Grid
    """Cell grid, in a struct `Grid` of device arrays."""
    made: int
    """Number of times that the grid's arrays were allocated. If it has changed, launches that were recorded before
    refer to old arrays."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.shift = zeros(batch.count, dtype=types(batch.scalar).vec3, device=batch.device)
        self._bounds = np.zeros((batch.count, 2, 3))
        self._fitted: HostArray = np.zeros(batch.count, dtype=bool)
        self._full = np.array([state.sphere_count > 0 for state in batch.states])
        self._mean_radius = np.array([state.mean_radius for state in batch.states])
        """Mean radius of each scene's spheres when they are fully grown [m], shape (scenes,)."""
        self._dims = np.ones(3, dtype=int)
        self._width = 0.0
        self.made = 0
        self._make()

    def _make(self) -> None:
        device, n, cells = self.batch.device, self.batch.sphere_count, int(self._dims.prod())
        grid: Grid = grid_struct(self.batch.scalar)()
        grid.dims = wp.vec3i(*self._dims.tolist())
        grid.per_width = DeviceArray([1 / self._width if self._width else 1.0], dtype=self.batch.scalar, device=device)
        for name, size in (("held", cells + 1), ("start", cells + 1), ("cell", n), ("rank", n), ("point", n)):
            setattr(grid, name, zeros(size, dtype=wp.int32, device=device))
        self.grid = grid
        self.made += 1

    def width(self) -> float:
        """Return the width of a grid cell [m]: the mean sphere diameter plus the skin of the neighbour lists.

        All scenes of a batch share one width, the largest that any scene needs. The search around a sphere
        larger than the mean visits more than the adjacent cells.
        """
        b = self.batch
        scale = b.scenes.scale.numpy() if b.features.growth else 1.0
        return float(np.max((2 * self._mean_radius * scale + b.rows["skin"])[self._full]))

    def fit(self, width: float, due: np.ndarray) -> None:
        """Fit the grid cells of each scene marked in `due` to the scene's spheres; `width` is the cell width [m]."""
        due = (due | ~self._fitted) & self._full
        if not due.any():
            return
        for s in np.flatnonzero(due).tolist():
            self._bounds[s] = self._extent(s, width)
        self._fitted |= due
        low, high = np.floor(self._bounds / width).astype(int).transpose(1, 0, 2)
        # Along each axis, a block contains the cells from index `low` to index `high`, and one additional empty cell
        # that separates the block from the next scene's block.
        sizes = high - low + 2
        # Place the blocks of all scenes side by side along one axis. Choose the axis along which the longest block has
        # the fewest cells.
        axis = int(np.argmin(sizes.max(0)))
        dims = sizes.max(0)
        dims[axis] = sizes[:, axis].sum()
        if self.batch.count > 1:
            low[:, axis] -= np.concatenate([[0], np.cumsum(sizes[:-1, axis])])
            self.shift.assign(-low * width)
        most = min(
            max(CELLS * self.batch.sphere_count, FEWEST_CELLS), MOST_CELLS["cuda" if self.batch.parallel else "cpu"]
        )
        # Halve the longest side of the grid while the grid has too many cells. Positions wrap around at the ends of the
        # grid, so the search still finds every neighbour.
        while np.prod(dims, dtype=float) > most:
            dims[np.argmax(dims)] = (dims.max() + 1) // 2
        if np.all(dims <= self._dims):
            return
        # Make the grid a quarter larger than needed, so that it stays large enough while spheres spread further.
        grown = np.maximum(self._dims, dims + dims // 4)
        self._dims = grown if np.prod(grown, dtype=float) <= most and np.any(self._dims > 1) else dims
        self._make()

    def _extent(self, s: int, width: float) -> np.ndarray:
        """Return the lowest and highest corner of a box around the spheres of scene `s` [m], shape (2, 3).

        A few spheres far from the others may lie outside the box, so that they cannot make the grid too large.
        """
        state = self.batch.states[s]
        stride = max(1, state.sphere_count // SAMPLED_SPHERES)
        some = state.spheres.position[::stride]
        sampled = state.scratch("sampled", some.shape, some.dtype)
        copy_array(sampled, some)
        (places,) = self.batch.exchange.read(sampled)
        places = places[:, :3].astype(float)
        places = places[np.isfinite(places).all(axis=1)]
        if not len(places):
            return np.zeros((2, 3))
        middle = np.median(places, axis=0)
        near = np.clip(places - middle, -FARTHEST_CELL * width, FARTHEST_CELL * width)
        return middle + np.percentile(near, [OUTSIDE_PERCENT, 100 - OUTSIDE_PERCENT], axis=0)

    def use_width(self, width: float) -> None:
        """Set the width of the cells [m] for the next rebuild of the neighbour lists."""
        if width != self._width:
            self._width = width
            self.grid.per_width.fill_(self.batch.scalar(1 / width))

    def stages(self, centre: DeviceArray) -> list[Stage]:
        """Return the launches that sort the points `centre` into the cells of the grid.

        `grid.held`, the number of points in each cell, must contain zeros before these launches.
        """
        b, kernels = self.batch, grid_kernels(self.batch.scalar)
        return [
            b.stage(kernels.count, b.sphere_count, centre=centre, grid=self.grid),
            *scan_stages(self.grid.held, self.grid.start),
            b.stage(kernels.put, b.sphere_count, grid=self.grid),
        ]
