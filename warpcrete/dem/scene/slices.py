"""Slices of a pipe in which a run measures stresses, solid fraction and velocities."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...core.errors import between, refuse
from ...geometry.axis import Axis
from ...geometry.bores import Bores

CLEAR, FEWEST = 1.0, 2
"""Limits for line fits of measurements along a straight section of pipe.

`CLEAR` is the distance from the ends of the section, in pipe radii, within which slices are ignored. `FEWEST` is the
minimum number of slices for a fit.
"""


@dataclass(frozen=True, kw_only=True)
class Stations:
    """Slices of a pipe between given arc lengths, in which a run measures stresses, solid fraction and velocities.

    A slice is measured only while concrete fills it.
    """

    axis: Axis
    bores: Bores
    edges: tuple[float, ...]
    """Arc lengths of the slices' ends, rising [m], shape (slices + 1,)."""
    wall: str = "pipe"
    """Name of the wall on which the shear stress is measured."""
    origin: float = 0.0
    """Arc length along the pipe that counts as zero in the results of the slices [m]."""
    middle: tuple[float, float] | None = None
    """Arc lengths between which the pipe is not straight (bend or taper) [m]; None if it is straight everywhere."""
    each_row: bool = True
    """True if each row of the time series contains the values of all slices. If False, the slices are measured only for
    pictures and recordings."""

    def __post_init__(self) -> None:
        if len(self.edges) < 2 or np.any(np.diff(self.edges) <= 0):
            refuse("station edges", self.edges, "must be two or more numbers, each above the one before")
        between("stations", len(self.edges) - 1, 1, 100_000)

    @property
    def places(self) -> np.ndarray:
        """Arc lengths of the slices' middles [m], shape (slices,)."""
        edges = np.array(self.edges)
        return 0.5 * (edges[1:] + edges[:-1])

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volumes of the slices [m3], shape (slices,); a cached array that must not be changed."""
        return np.array([self.bores.volume(a, b) for a, b in pairwise(self.edges)])

    def surfaces(self) -> np.ndarray:
        """Return the area of the pipe's wall in each slice [m2], shape (slices,)."""
        return np.array([self.bores.surface(a, b) for a, b in pairwise(self.edges)])

    def clear(self, low: float, high: float) -> np.ndarray:
        """Return a mask of the slices between the arc lengths `low` and `high` [m], shape (slices,).

        A slice is left out if its middle is closer than CLEAR times the pipe's radius to either arc length.
        """
        off = CLEAR * self.bores.at([low, high])
        return (self.places > low + off[0]) & (self.places < high - off[1])

    @property
    def straights(self) -> tuple[tuple[float, float], ...]:
        """Arc lengths of both ends of each straight section [m]: before and behind `middle`, or the whole pipe."""
        if self.middle is None:
            return ((self.edges[0], self.edges[-1]),)
        return (self.edges[0], self.middle[0]), (self.middle[1], self.edges[-1])

    @property
    def can_fit_losses(self) -> bool:
        """True if every straight section has enough slices to fit a line through its measurements."""
        return all(np.count_nonzero(self.clear(*ends)) >= FEWEST for ends in self.straights)


def varying_bores(stations: Stations | None) -> Bores | None:
    """Return the radii of a bore that varies along the axis; None if it does not vary or if `stations` is None."""
    return None if stations is None or stations.bores.is_straight else stations.bores
