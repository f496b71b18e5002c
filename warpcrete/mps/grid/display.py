"""Surface, colours and fields of the concrete of a flow on a grid, for displays."""

from typing import ClassVar

import numpy as np

from ...core.drawing.paint import palette_colours
from ...core.drawing.surfaces import Cut, Level, Surface, revolved, smoothed, surface_of
from ..common.display import FlowRunDisplay
from .layout import GridLayout

HALF_CELL = 0.5
"""Largest magnitude, in cell widths, of the level-set function whose zero is the surface of the concrete."""
MAX_PARTICLES = 12000
"""Maximum number of particles in files for ParaView, mirror images included."""
FIELDS = {"shear": "shear_rate", "speed": "speed", "pressure": "pressure"}
"""Name of the field that the colours of the concrete show, by the value of the display's attribute `colouring`."""


class GridDisplay(FlowRunDisplay):
    """Display of a flow on a grid: the surface of the concrete, and some of its particles with their mirror images.

    The surface is where the cells are half full. Each colour on the surface is a mean over the particles in the nearest
    cells. Recordings in files for ParaView contain the particles as well.
    """

    noun: ClassVar = "concrete"
    has_surface: ClassVar = True
    relative_radius: ClassVar[float] = 0.45
    """Radius of a drawn particle divided by the particle spacing, if all particles are drawn."""

    @property
    def _layout(self) -> GridLayout:
        return self.simulation.state.layout

    @property
    def palette(self) -> str:
        """Name of the colour map: "concrete" (from grey to darker colours) for shear rates, else "viridis"."""
        return "concrete" if self.colouring == "shear" else "viridis"

    @property
    def copies(self) -> int:
        """Number of images of each displayed particle: the particle itself and its mirror images."""
        return 1

    @property
    def drawn_particles(self) -> np.ndarray:
        """Indices of the particles that are displayed, shape (n,)."""
        count = self.simulation.state.count
        return np.arange(0, count, max(1, -(-count * self.copies // MAX_PARTICLES)))

    def radii(self) -> np.ndarray:
        """Return the radii of drawn particles [m]; they are larger if fewer are drawn, to fill the same volume."""
        drawn = len(self.drawn_particles)
        fewer = (self.simulation.state.count / max(drawn, 1)) ** (1 / self._layout.axes)
        return np.full(drawn * self.copies, self.relative_radius * self._layout.particle_spacing * fewer, np.float32)

    def fields(self) -> dict[str, np.ndarray]:
        """Return shear rate [1/s], speed [m/s] and pressure [Pa] of the drawn particles."""
        return {name: np.tile(values[self.drawn_particles], self.copies) for name, values in self._values().items()}

    def _values(self) -> dict[str, np.ndarray]:
        """Return shear rate [1/s], speed [m/s] and pressure [Pa] of all particles."""
        slope = self.read("particles.gradient").astype(float)
        return {
            "shear_rate": np.sqrt(0.5 * np.sum((slope + slope.transpose(0, 2, 1)) ** 2, axis=(1, 2))),
            "speed": np.linalg.norm(self.read("particles.velocity").astype(float), axis=1),
            "pressure": self.read("particles.pressure").astype(float),
        }

    def colours(self) -> np.ndarray:
        """Return RGB bytes of all drawn particles, shape (n, 3)."""
        scale = self.scale()
        assert scale is not None
        values = self._shown(self.fields()[FIELDS[self.colouring]])
        return palette_colours(values, scale[2], scale[1], self.palette)

    def _shown(self, values: np.ndarray) -> np.ndarray:
        """Convert values of the field that colours the display from SI units to the unit of the colour scale."""
        return values / 1e3 if self.colouring == "pressure" else values

    def surface_values(self, surface: Surface) -> np.ndarray:
        """Return the quantity that the surface's colours show, at each vertex, in the unit of the colour scale."""
        return self._shown(surface.fields[FIELDS[self.colouring]])

    def surface(self, cut: bool = False) -> Surface:
        """Return the closed surface of the concrete, or only its part behind the cutting plane."""
        return self.derived(("surface", cut), lambda: self._surface(cut))

    def _surface(self, cut: bool) -> Surface:
        level = self._level()
        if self._layout.axial:
            return revolved(level, half=cut)
        return surface_of(level, self._cutting_plane() if cut else None)

    def _cutting_plane(self) -> Cut | None:
        """Return the cutting plane in grid coordinates; None for a flow that is not cut open."""
        return None if self.cut is None else Cut(np.array([0.0, 1.0, 0.0]), self.cut)

    def _level(self) -> Level:
        """Return the data for drawing the surface of the concrete: a level-set function and fields in the cells.

        The level-set function is zero on the surface. The fields colour the surface.
        """
        layout = self._layout
        places = tuple(
            layout.room.origin[k] + (np.arange(n) + 0.5) * layout.room.width[k] for k, n in enumerate(layout.cells)
        )
        return Level(places, self._cell_levels(), self._cell_fields())

    def _cell_levels(self) -> np.ndarray:
        """Return the fraction of each cell that concrete fills, minus one half, shape (nx, ..., nz).

        The result is zero on the drawn surface of the concrete, where cells are half full.
        """
        return self._filled() - HALF_CELL

    def _filled(self) -> np.ndarray:
        """Return the fraction of each cell that concrete fills, shape (nx, ..., nz).

        A step of the flow computes the fractions. Before the first step, and in a state that was read from a file, they
        follow from the volume of the particles in each cell.
        """
        room = self._of_cells("geometry.room")
        fill = self._of_cells("mesh.fill")
        if fill.any():
            return fill * room
        layout, mass = self._layout, self.read("particles.mass").astype(float)
        volume = np.bincount(self._cells_of_particles(), mass * layout.volume, room.size).reshape(room.shape)
        if layout.axial:
            volume /= (np.arange(layout.cells[0])[:, None] + 0.5) * layout.spacing
        volume /= np.prod(layout.room.width)
        return np.clip(volume if self.time == 0 else smoothed(volume) / smoothed(np.ones(room.shape)), 0.0, 1.0)

    def _of_cells(self, path: str) -> np.ndarray:
        """Return an array of the state with one value per cell, shape (nx, ..., nz).

        `path` names the array, such as "mesh.fill". The layer of cells around the grid is left out.
        """
        values = self.read(path).astype(float).reshape(self._layout.shape)
        return values[(slice(1, -1),) * values.ndim].transpose()

    def _cells_of_particles(self) -> np.ndarray:
        """Return the index of the cell that contains each particle, shape (n,)."""
        room = self._layout.room
        index = np.floor((self.read("particles.position").astype(float) - room.origin) / room.width).astype(int)
        return np.asarray(np.ravel_multi_index(tuple(index.T), room.cells, mode="clip"))

    def _cell_fields(self) -> dict[str, np.ndarray]:
        """Return shear rate [1/s], speed [m/s] and pressure [Pa] of cells; means over a cell and its neighbours."""
        cells, shape = self._cells_of_particles(), self._layout.cells
        mass, size = self.read("particles.mass").astype(float), int(np.prod(shape))
        weight = smoothed(np.bincount(cells, mass, size).reshape(shape))
        return {
            name: smoothed(np.bincount(cells, mass * values, size).reshape(shape)) / np.maximum(weight, 1e-30)
            for name, values in self._values().items()
        }
