"""Slices of a pipe in which a run measures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..core.errors import between, refuse
from ..geometry.axis import Axis
from ..geometry.bores import Bores

CLEAR, FEWEST = 1.0, 2
"""Length beside an end or the middle that fitted lines leave out, over the radius there; slices that they need."""


@dataclass(frozen=True, kw_only=True)
class Stations:
    """Slices of a pipe between arc lengths, in which a run measures; a slice counts while concrete fills it."""

    axis: Axis
    bores: Bores
    edges: tuple[float, ...]
    """Arc lengths of the slices' ends, rising [m]."""
    wall: str = "pipe"
    """Name of the wall whose shear is measured."""
    origin: float = 0.0
    """Arc length from which places are told [m]."""
    middle: tuple[float, float] | None = None
    """Arc lengths between which the pipe is no straight one; None: it is, all along [m]."""
    each_row: bool = True
    """Measured with every row of the series; else only where a recording draws it."""

    def __post_init__(self) -> None:
        if len(self.edges) < 2 or np.any(np.diff(self.edges) <= 0):
            refuse("station edges", self.edges, "must be two or more numbers that increase")
        between("stations", len(self.edges) - 1, 1, 100_000)

    @property
    def places(self) -> np.ndarray:
        """Middles of the slices [m]."""
        edges = np.array(self.edges)
        return 0.5 * (edges[1:] + edges[:-1])

    @cached_property
    def volumes(self) -> np.ndarray:
        """Not to be written to [m3]."""
        return np.array([self.bores.volume(a, b) for a, b in pairwise(self.edges)])

    def surfaces(self) -> np.ndarray:
        """Of the wall [m2]."""
        return np.array([self.bores.surface(a, b) for a, b in pairwise(self.edges)])

    def clear(self, low: float, high: float) -> np.ndarray:
        """Which slices lie between two arc lengths [m], and a radius off both, shape (slices,)."""
        off = CLEAR * self.bores.at([low, high])
        return (self.places > low + off[0]) & (self.places < high - off[1])

    @property
    def straights(self) -> tuple[tuple[float, float], ...]:
        """Arc lengths of straight stretches: before and behind the middle, or all of it [m]."""
        if self.middle is None:
            return ((self.edges[0], self.edges[-1]),)
        return (self.edges[0], self.middle[0]), (self.middle[1], self.edges[-1])

    @property
    def tells_losses(self) -> bool:
        """Are there slices enough in all of them for lines through what they measure?"""
        return all(np.count_nonzero(self.clear(*ends)) >= FEWEST for ends in self.straights)
