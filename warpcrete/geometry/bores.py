"""How wide a round pipe is along its axis: straight pieces and cones, their volumes and surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.errors import refuse
from .axis import Arc, Axis

FACETS = 32
"""Round a pipe that is made of triangles."""
FINE = 400
"""Places at which a volume is inverted."""


@dataclass(frozen=True)
class Bores:
    """Inner radii of a pipe at arc lengths, and cones between; before the first and behind the last it goes on."""

    places: tuple[float, ...]
    """Arc lengths, rising [m]."""
    radii: tuple[float, ...]
    """[m]"""

    def __post_init__(self) -> None:
        if len(self.places) != len(self.radii) or not self.places or np.any(np.diff(self.places) <= 0):
            refuse("bores", self.places, "must be rising arc lengths, each with a radius")
        if min(self.radii) <= 0:
            refuse("bores", min(self.radii), "must be above 0 m")

    @property
    def smallest(self) -> float:
        """[m]"""
        return min(self.radii)

    @property
    def largest(self) -> float:
        """[m]"""
        return max(self.radii)

    @property
    def is_straight(self) -> bool:
        """Is it as wide everywhere?"""
        return self.smallest == self.largest

    def at(self, s: np.ndarray | float) -> np.ndarray:
        """Radii at arc lengths [m], shape as `s`."""
        return np.asarray(np.interp(s, self.places, self.radii))

    def _edges(self, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the cones from one arc length to another, and the radii there [m]."""
        places = np.array(self.places)
        s = np.concatenate([[begin], places[(places > begin) & (places < end)], [end]])
        return s, self.at(s)

    def volume(self, begin: float, end: float) -> float:
        """Between two arc lengths [m3]; a bend does not change it (Pappus)."""
        s, r = self._edges(begin, end)
        return float(np.pi / 3 * np.sum(np.diff(s) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2)))

    def surface(self, begin: float, end: float) -> float:
        """Of the wall between two arc lengths [m2], likewise."""
        s, r = self._edges(begin, end)
        return float(np.pi * np.sum((r[1:] + r[:-1]) * np.hypot(np.diff(s), np.diff(r))))

    def spread(self, parts: np.ndarray, length: float) -> np.ndarray:
        """Arc lengths [m] before which lie these `parts` (n,) of the volume of the first `length` [m]."""
        s = np.union1d(np.linspace(0, length, FINE), [p for p in self.places if 0 < p < length])
        slices = (
            np.pi / 3 * np.diff(s) * (self.at(s[1:]) ** 2 + self.at(s[1:]) * self.at(s[:-1]) + self.at(s[:-1]) ** 2)
        )
        total = np.concatenate([[0.0], np.cumsum(slices)])
        return np.interp(parts * total[-1], total, s)

    def mesh(
        self, axis: Axis, facets: int = FACETS, before: float = 0.0, after: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Triangle mesh of the wall, open at both ends, normals inward, of the round pipe's volume.

        It starts `before` [m] ahead of the axis and ends `after` [m] behind it. Returns vertices (v, 3) and faces
        (f, 3).
        """
        return self.mesh_between(axis, -before, axis.length + after, facets)

    def mesh_between(self, axis: Axis, start: float, stop: float, facets: int) -> tuple[np.ndarray, np.ndarray]:
        """The same from one arc length to another [m]."""
        rings = [[start], [stop]] + [[p] for p in self.places if 0 < p < axis.length]
        begin = 0.0
        for piece in axis.pieces:
            # As long as wide where it bends; elsewhere boxes of the search must not become long.
            width = 2 * np.pi * self.largest / facets if isinstance(piece, Arc) else 4 * self.largest
            rings.append(list(np.linspace(begin, begin + piece.length, max(2, 1 + int(np.ceil(piece.length / width))))))
            begin += piece.length
        s = np.unique(np.concatenate(rings))
        s = s[(s >= start) & (s <= stop)]
        s = s[np.concatenate([[True], np.diff(s) > 1e-3 * self.smallest])]
        s[-1] = stop
        # The area of a polygon whose corners are r away is n r^2 sin(2 pi / n) / 2.
        wider = np.sqrt(2 * np.pi / (facets * np.sin(2 * np.pi / facets)))
        return axis.swept(s, wider * self.at(s), facets)
