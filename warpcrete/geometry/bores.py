"""Inner radius of a round pipe along its axis, and the volumes and wall areas that follow from it.

The pipe may consist of several cylinders and truncated cones.
"""

from dataclasses import dataclass

import numpy as np

from ..core.errors import refuse
from .axis import Arc, Axis

FACETS = 32
"""Default number of facets around the circumference of a pipe whose wall is a mesh of triangles."""
VOLUME_SAMPLES = 400
"""Number of entries in a table of the pipe's volume from its start up to an arc length. :meth:`Bores.spread` uses the
table to find the arc length up to which the pipe contains a given fraction of its volume."""


@dataclass(frozen=True)
class Bores:
    """Inner radius of a pipe along its axis: linear between the arc lengths `places`, and constant beyond them."""

    places: tuple[float, ...]
    """Arc lengths along the axis at which the inner radii are given, in increasing order [m]."""
    radii: tuple[float, ...]
    """Inner radii of the pipe at the arc lengths `places` [m]."""

    def __post_init__(self) -> None:
        if len(self.places) != len(self.radii) or not self.places or np.any(np.diff(self.places) <= 0):
            problem = "must be rising distances along the axis, with one radius for each distance"
            refuse("bores", self.places, problem)
        if min(self.radii) <= 0:
            refuse("bores", min(self.radii), "must be above 0 m")

    @property
    def smallest(self) -> float:
        """Smallest inner radius of the pipe [m]."""
        return min(self.radii)

    @property
    def largest(self) -> float:
        """Largest inner radius of the pipe [m]."""
        return max(self.radii)

    @property
    def is_straight(self) -> bool:
        """True if the pipe has the same radius everywhere."""
        return self.smallest == self.largest

    def at(self, s: np.ndarray | float) -> np.ndarray:
        """Return the inner radii of the pipe at arc lengths `s` [m], with the shape of `s`."""
        return np.asarray(np.interp(s, self.places, self.radii))

    def _edges(self, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Divide the pipe between the arc lengths `begin` and `end` [m] into truncated cones and cylinders.

        Return the arc lengths [m] at which these pieces meet, with `begin` and `end`, and the inner radii there [m].
        """
        places = np.array(self.places)
        s = np.concatenate([[begin], places[(places > begin) & (places < end)], [end]])
        return s, self.at(s)

    def volume(self, begin: float, end: float) -> float:
        """Return the volume [m3] of the pipe between the arc lengths `begin` and `end` [m].

        In a bend, the volume is the same as in straight pipe of the same length (Pappus's theorem).
        """
        s, r = self._edges(begin, end)
        return float(np.pi / 3 * np.sum(np.diff(s) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2)))

    def surface(self, begin: float, end: float) -> float:
        """Return the area [m2] of the pipe's wall between the arc lengths `begin` and `end` [m].

        In a bend, the area is the same as in straight pipe of the same length (Pappus's theorem).
        """
        s, r = self._edges(begin, end)
        return float(np.pi * np.sum((r[1:] + r[:-1]) * np.hypot(np.diff(s), np.diff(r))))

    def spread(self, parts: np.ndarray, length: float) -> np.ndarray:
        """Return the arc lengths [m], shape (n,), up to which the pipe contains the fractions `parts` of its volume.

        The fractions, shape (n,), refer to the volume between the arc lengths 0 and `length` [m].
        """
        s = np.union1d(np.linspace(0, length, VOLUME_SAMPLES), [p for p in self.places if 0 < p < length])
        slices = (
            np.pi / 3 * np.diff(s) * (self.at(s[1:]) ** 2 + self.at(s[1:]) * self.at(s[:-1]) + self.at(s[:-1]) ** 2)
        )
        total = np.concatenate([[0.0], np.cumsum(slices)])
        return np.interp(parts * total[-1], total, s)

    def mesh(
        self, axis: Axis, facets: int = FACETS, before: float = 0.0, after: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a triangle mesh of the wall that encloses the same volume as the round pipe.

        The mesh has `facets` facets around the circumference, is open at both ends, and its normals point inward. It
        extends `before` [m] beyond the start of the axis and `after` [m] beyond the end of the axis. The result holds
        vertices [m], shape (v, 3), and faces, shape (f, 3).
        """
        return self.mesh_between(axis, -before, axis.length + after, facets)

    def mesh_between(self, axis: Axis, start: float, stop: float, facets: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a triangle mesh of the wall between the arc lengths `start` and `stop` [m].

        The mesh has `facets` facets around the circumference, is open at both ends, and its normals point inward. It
        encloses the volume of the round pipe. The result holds vertices [m], shape (v, 3), and faces, shape (f, 3).
        """
        rings = [[start], [stop]] + [[p] for p in self.places if 0 < p < axis.length]
        begin = 0.0
        for piece in axis.pieces:
            # In bends, facets are as long as they are wide. In straight pipe, facets are at most four pipe radii long,
            # because the bounding boxes of longer triangles would slow down mesh queries.
            width = 2 * np.pi * self.largest / facets if isinstance(piece, Arc) else 4 * self.largest
            rings.append(list(np.linspace(begin, begin + piece.length, max(2, 1 + int(np.ceil(piece.length / width))))))
            begin += piece.length
        s = np.unique(np.concatenate(rings))
        s = s[(s >= start) & (s <= stop)]
        s = s[np.concatenate([[True], np.diff(s) > 1e-3 * self.smallest])]
        s[-1] = stop
        # A regular polygon whose n corners have the distance r from its centre has the area n r^2 sin(2 pi / n) / 2.
        # The radius is scaled so that the polygon has the area of the circle.
        wider = np.sqrt(2 * np.pi / (facets * np.sin(2 * np.pi / facets)))
        return axis.swept(s, wider * self.at(s), facets)
