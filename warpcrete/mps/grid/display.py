"""Colours and fields of the particles of a flow on a grid, for displays."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from ...core.drawing.display import Display
from ...core.drawing.paint import palette_colours


class GridDisplay(Display):
    """Display of a flow on a grid by some of its particles and, in symmetric flows, by their mirror images."""

    noun: ClassVar = "concrete"

    @property
    @abstractmethod
    def drawn_particles(self) -> np.ndarray:
        """Indices of the particles that are displayed, shape (n,)."""

    @property
    @abstractmethod
    def copies(self) -> int:
        """Number of images of each displayed particle: the particle itself and its mirror images."""

    def fields(self) -> dict[str, np.ndarray]:
        """Return speed [m/s] and pressure [Pa] of the drawn particles."""
        found = {"speed": self._speed(), "pressure": self.read("particles.pressure").astype(float)}
        return {name: np.tile(values[self.drawn_particles], self.copies) for name, values in found.items()}

    def colours(self) -> np.ndarray:
        """Return RGB bytes of all drawn particles, shape (n, 3)."""
        if self.colouring == "pressure":
            values = self.read("particles.pressure").astype(float) / 1e3
        elif self.colouring == "speed":
            values = self._speed()
        else:
            slope = self.read("particles.gradient").astype(float)
            values = np.sqrt(0.5 * np.sum((slope + slope.transpose(0, 2, 1)) ** 2, axis=(1, 2)))
        scale = self.scale()
        assert scale is not None
        _, lower, upper = scale
        return np.tile(palette_colours(values[self.drawn_particles], upper, lower), (self.copies, 1))

    def _speed(self) -> np.ndarray:
        return np.linalg.norm(self.read("particles.velocity").astype(float), axis=1)
