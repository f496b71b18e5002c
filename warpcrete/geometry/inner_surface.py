"""Inner surface of a pipe, extracted from a triangle mesh that may also have an outer skin, lids or several skins."""

import functools

import numpy as np

from ..core.errors import refuse
from .axis import Axis
from .cleaning import clean, default_tolerance, merged_corners
from .meshes import FARTHEST_WALL, SurfaceQueries, fan

MAX_RADIUS_ERROR = 0.1
"""Largest accepted difference between the radius of a mesh's bore and the radius of its pipe, as a fraction of the
pipe's radius."""
DIRECTIONS_AROUND = 24
"""Number of directions around a pipe's axis in which the distance to the wall is measured at each cross-section."""
MAX_SECTIONS, MAX_AROUND = 1000, 240
"""Largest numbers of cross-sections, and of points around each, at which a bore is compared with its mirror image."""
INSET = 1e-3
"""Smallest distance from a rim or lid of the mesh at which a cross-section is measured, divided by the pipe's radius.
Measuring rays exactly at a rim or lid may miss the wall."""
MAX_SHORTFALL = 0.02
"""Largest accepted length by which a mesh is shorter than its pipeline part, divided by the pipe's radius."""
LID_COSINE, LID_DISTANCE = 0.9, 0.1
"""Limits by which a triangle counts as part of a lid on an end of the pipe.

The cosine of the angle between the triangle's normal and the pipe's axis must exceed the first number. The triangle
must also lie beyond the end of the pipe, or before the end at a distance of at most the second number times the pipe's
radius.
"""
VISIBILITY_TOLERANCE = 1e-3
"""Distance up to which a surface in front of a facet does not count as hiding the facet from the axis, divided by the
pipe's radius."""
OFFSET = 1e-4
"""Distance between a facet and each of the two points, one on either side, from which its visibility is tested.

The distance is divided by the pipe's radius.
"""
CORNER_WEIGHT = 0.8
"""Weight of a corner in the weighted mean of this corner and the triangle's centre. The visibility of a triangle is
tested at its centre, and at the weighted means for its three corners."""


class InnerSurface:
    """Inner wall of a pipe that is given as a mesh: the facets that are visible from the pipe's axis.

    The mesh of a real pipe has more surfaces than the inner wall: an outer skin, rims and lids. A facet belongs to the
    inner wall if nothing lies between the facet and the nearest point of the axis, and if the facet is not part of a
    lid.

    The mesh must enclose the axis within `span`, up to a small tolerance at its ends. The attributes `begin` and `end`
    limit the arc lengths within which the mesh does enclose the axis. Measurements at arc lengths outside of this
    range, or outside of `span`, use the last cross-section inside both.

    Args:
        vertices: Corners of the mesh [m], shape (v, 3).
        faces: Corner indices of each triangle, shape (f, 3).
        axis: The pipe's axis, straight at both ends.
        radius: Approximate radius of the bore [m].
        field: Name of the field that error messages show.
        name: Value of that field in error messages.
        span: Arc lengths [m] between which the mesh must enclose the axis; None stands for the whole axis.

    Raises:
        SceneError: The mesh has gaps around the axis, ends before the axis does, or a surface crosses the axis.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        axis: Axis,
        radius: float,
        field: str,
        name: str,
        span: tuple[float, float] | None = None,
    ) -> None:
        given = vertices, faces
        vertices, faces, origin = clean(vertices, faces)
        if len(faces) == 0:
            refuse(
                field, name, "contains only triangles without area", "check the file, and the unit of its coordinates"
            )
        self.axis, self._radius = axis, radius
        self._low, self._high = span or (0.0, axis.length)
        self._all = SurfaceQueries(vertices, faces)
        self.begin, self.end = self._enclosed_lengths(vertices, field, name)
        """Arc lengths between which the mesh encloses the axis [m]."""
        self._check_free(field, name)
        kept = self._visible_facets(vertices, faces)
        self._check_closed(field, name, *given, origin, origin[kept])
        used, corners = np.unique(faces[kept], return_inverse=True)
        self.vertices = vertices[used]
        """Corners of the inner surface [m], shape (n, 3)."""
        self.faces = corners.reshape(-1, 3)
        """Triangles of the inner surface, shape (m, 3)."""
        self.origin = origin[kept]
        """Index in the original mesh of each triangle of the inner surface, shape (m,)."""
        self._queries = SurfaceQueries(self.vertices, self.faces)

    def sections(self, s: np.ndarray, around: int = DIRECTIONS_AROUND) -> np.ndarray:
        """Return the distances [m] from the axis to the wall at arc lengths `s` (n,), shape (n, around).

        The rays point in `around` equally spaced directions; directions k and k + around / 2 are opposite. The distance
        is -1 where a ray meets no wall.
        """
        return self._wall_distances(self._inside(s), around)

    def distance(self, points: np.ndarray, margin: float = np.inf) -> np.ndarray:
        """Return the distance of `points` (n, 3) from the wall [m], positive inside the bore, shape (n,).

        For a point that is farther from the axis than the whole wall, by more than `margin` [m], the result is only the
        difference of these distances from the axis. This saves time in a box around a bend.
        """
        s = self.axis.along(points)
        inner = self._inside(s)
        nearest, tangents = self.axis.at(inner)
        # The mesh may end where the axis ends. A point beyond an end is moved back along the straight axis to the last
        # cross-section that the mesh encloses.
        points = points + ((inner - s)[:, None] * tangents if np.any(inner != s) else 0.0)
        offset = points - nearest
        apart = np.linalg.norm(offset, axis=1)
        if np.isfinite(margin):
            result, close = self._farthest - apart, apart <= self._farthest + margin
            result[close] = self._signed(points[close], nearest[close], offset[close], apart[close])
            return result
        return self._signed(points, nearest, offset, apart)

    def _signed(self, points: np.ndarray, nearest: np.ndarray, offset: np.ndarray, apart: np.ndarray) -> np.ndarray:
        """Return the distance of `points` from the wall [m], positive inside the bore, shape (n,).

        `nearest` are the nearest points of the axis, `offset` the vectors from them to `points`, shape (n, 3), and
        `apart` their lengths [m].
        """
        ways = offset / np.maximum(apart, 1e-12)[:, None]
        hits = self._queries.rays(nearest, ways, float(apart.max(initial=1e-12)) * 1.001)
        inside = (hits < 0) | (hits >= apart)
        return np.where(inside, 1.0, -1.0) * self._queries.distances(points)

    @functools.cached_property
    def _farthest(self) -> float:
        """Largest distance of the wall from the axis [m], at the corners, edges and centres of its triangles."""
        corners = self.vertices[self.faces]
        edges = 0.5 * (corners + np.roll(corners, 1, axis=1))
        points = np.concatenate([self.vertices, edges.reshape(-1, 3), corners.mean(axis=1)])
        return float(np.linalg.norm(points - self.axis.nearest(points), axis=1).max())

    def asymmetry(self, normal: np.ndarray, apart: float) -> float:
        """Return the largest distance between the wall and its mirror image [m].

        The mirror is the plane through the end of the axis that is perpendicular to the unit vector `normal` (3,). The
        axis must lie in this plane. The distance is computed at points of the wall that are about `apart` [m] apart,
        but at no more than `MAX_SECTIONS` cross-sections with `MAX_AROUND` points each.
        """
        low, high = self._inside(np.array([self._low, self._high]))
        count = int(np.clip((high - low) / apart, 8, MAX_SECTIONS))
        around = int(np.clip(2 * np.pi * self._radius / apart, DIRECTIONS_AROUND, MAX_AROUND))
        points, _, one, other = self.axis.frame(np.linspace(low, high, count))
        ways = fan(one, other, around).reshape(-1, 3)
        starts = np.repeat(points, around, axis=0)
        hits = self._queries.rays(starts, ways, FARTHEST_WALL * self._radius)
        # Leave out rays that pass between two facets because of rounding errors.
        hit = (starts + hits[:, None] * ways)[hits >= 0]
        beside = (hit - self.axis.at(self.axis.length)[0]) @ normal
        return float(self._queries.distances(hit - 2 * beside[:, None] * normal).max(initial=0.0))

    def _inside(self, s: np.ndarray) -> np.ndarray:
        """Return the arc lengths `s` [m], moved to a small distance from the ends of the mesh if they are nearer.

        Arc lengths beyond an end of the mesh are moved as well. Measuring rays exactly at a rim or a lid may miss the
        wall.
        """
        low, high = max(self.begin, self._low), min(self.end, self._high)
        inset = min(INSET * self._radius, 0.25 * (high - low))
        return np.clip(s, low + inset, high - inset)

    def _wall_distances(self, s: np.ndarray, around: int = DIRECTIONS_AROUND) -> np.ndarray:
        points, _, normal, side = self.axis.frame(s)
        return self._all.around(points, normal, side, around, FARTHEST_WALL * self._radius)

    def _enclosed_lengths(self, vertices: np.ndarray, field: str, name: str) -> tuple[float, float]:
        """Return the arc lengths [m] between which the mesh encloses the axis.

        A mesh that has an open cross-section between these two lengths is refused.
        """
        low, high, short = self._low, self._high, MAX_SHORTFALL * self._radius
        s = np.linspace(low + short, high - short, max(8, 2 + int(2 * (high - low) / self._radius)))
        missed = np.any(self._wall_distances(s) < 0, axis=1)
        along = self.axis.along(vertices)
        closed = np.flatnonzero(~missed)
        reaches = along.min() <= low + short and along.max() >= high - short
        if len(closed) == 0 or np.any(missed[closed[0] : closed[-1]]) or (reaches and np.any(missed)):
            spans = " x ".join(f"{x:.4g}" for x in np.ptp(vertices, axis=0))
            refuse(field, name, f"has gaps along the axis: {np.count_nonzero(missed)} of {len(s)} cross-sections are "
                                "open "
                   f"(the mesh spans {spans} m)", "close the holes of the mesh, move the mesh so that it surrounds the "
                                                  "axis, or check "
                   "its unit (the scale is 0.001 for millimetres)")  # fmt: skip
        begin = self._rim(s[closed[0]], min(float(along.min()), low))
        end = self._rim(s[closed[-1]], max(float(along.max()), high))
        if begin > low + short or end < high - short:
            refuse(field, name, f"encloses the axis from {begin:.4g} to {end:.4g} m, but the part extends from "
                   f"{low:.4g} to {high:.4g} m", "make the mesh longer, or the part shorter")  # fmt: skip
        return begin, end

    def _rim(self, closed: float, beyond: float) -> float:
        """Return the arc length [m] of the rim at which the mesh ends, by bisection between two arc lengths.

        The rim lies between the two arc lengths: at `closed` [m], the wall surrounds the axis completely, and `beyond`
        [m] lies at the rim or outside the mesh.
        """
        if not np.any(self._wall_distances(np.array([beyond])) < 0):
            return beyond
        opened = beyond
        while abs(opened - closed) > 0.1 * INSET * self._radius:
            middle = 0.5 * (opened + closed)
            if np.any(self._wall_distances(np.array([middle])) < 0):
                opened = middle
            else:
                closed = middle
        return closed

    def _closes(self, middles: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return whether each facet is part of a lid, which closes an end of the pipe, shape (f,), bool.

        A facet is part of a lid if it is roughly perpendicular to the axis, and lies near an end of the pipe or beyond
        it. `middles` are the centres of the facets [m], and `normals` are their unit normals, shape (f, 3) each.
        """
        s = self.axis.along(middles)
        tangents = self.axis.at(s)[1]
        near = LID_DISTANCE * self._radius
        across = np.abs(np.sum(normals * tangents, axis=1)) > LID_COSINE
        low, high = max(self.begin, self._low), min(self.end, self._high)
        return across & ((s < low + near) | (s > high - near))

    def _check_free(self, field: str, name: str) -> None:
        """Refuse a mesh with a surface that crosses the pipe's axis, except for lids at the ends of the pipe."""
        inset = MAX_SHORTFALL * self._radius
        low, high = max(self.begin, self._low) + inset, min(self.end, self._high) - inset
        s = np.linspace(low, high, max(8, 2 + int(8 * (high - low) / self._radius)))
        points, _ = self.axis.at(s)
        step = np.diff(points, axis=0)
        length = np.linalg.norm(step, axis=1)
        hits = self._all.rays(points[:-1], step / length[:, None], float(length.max()))
        hit = (hits >= 0) & (hits <= length)
        if np.any(hit):
            problem = f"is blocked: a surface crosses the axis {s[:-1][hit][0]:.3g} m from its start"
            refuse(field, name, problem, "remove this surface; only flat lids at the two ends are allowed")

    def _check_closed(
        self, field: str, name: str, vertices: np.ndarray, faces: np.ndarray, whole: np.ndarray, kept: np.ndarray
    ) -> None:
        """Refuse an inner surface with open edges between its ends.

        An open edge belongs to only one triangle of the inner surface. It is either the border of a hole in the mesh,
        or the edge of an undercut (a part of the wall that is not visible from the axis). `vertices` and `faces`
        describe the original mesh. `whole` holds the indices of the original triangles that have an area, and `kept`
        holds the indices of the inner surface's triangles. Triangles without area are counted too, because they close
        edges that CAD programs have split.
        """
        corners = np.sort(merged_corners(vertices, default_tolerance(vertices))[faces], axis=1)
        _, first = np.unique(corners, axis=0, return_index=True)
        flat = np.setdiff1d(first[np.all(np.diff(corners[first], axis=1) > 0, axis=1)], whole)
        edges, of = np.unique(corners[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=0, return_inverse=True)
        of = of.reshape(-1, 3)

        def count(*chosen: np.ndarray) -> np.ndarray:
            return np.bincount(of[np.concatenate(chosen)].ravel(), minlength=len(edges))

        low, high = max(self.begin, self._low), min(self.end, self._high)
        inset = MAX_SHORTFALL * self._radius
        along = self.axis.along(vertices[edges].reshape(-1, 3)).reshape(-1, 2)
        open_ = np.any((along > low + inset) & (along < high - inset), axis=1) & (count(kept) == 1)
        holes = open_ & (count(whole, flat) == 1)
        if np.any(holes):
            refuse(field, name, f"is not closed: {np.count_nonzero(holes)} edges between its ends belong to one "
                                "triangle only",
                   "close the holes of the mesh in a CAD program or with trimesh.repair.fill_holes")  # fmt: skip
        hidden = open_ & (count(kept, flat) == 1)
        if np.any(hidden):
            refuse(field, name, f"has an undercut (wall that is not visible from the axis) {along[hidden].min():.3g} m "
                   "from its start", "fill the undercut in a CAD program")  # fmt: skip

    def _visible_facets(self, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Return the indices of the facets that are visible from the axis and not part of a lid: the inner surface."""
        corners = vertices[faces]
        middles = corners.mean(axis=1)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = normals / np.linalg.norm(normals, axis=1)[:, None]
        waiting = np.flatnonzero(~self._closes(middles, normals))
        seen = np.zeros(len(faces), bool)
        places = [middles, *((CORNER_WEIGHT * corners[:, k] + (1 - CORNER_WEIGHT) * middles) for k in range(3))]
        for place in places:
            for side in (1.0, -1.0):
                points = place[waiting] + side * OFFSET * self._radius * normals[waiting]
                nearest = self.axis.nearest(points)
                apart = np.linalg.norm(points - nearest, axis=1)
                ways = (points - nearest) / np.maximum(apart, 1e-12)[:, None]
                hits = self._all.rays(nearest, ways, float(apart.max(initial=1e-12)) * 1.001)
                free = (hits < 0) | (hits > apart - VISIBILITY_TOLERANCE * self._radius)
                seen[waiting[free]] = True
                waiting = waiting[~free]
        return np.flatnonzero(seen)


def equal_radii(sections: np.ndarray) -> np.ndarray:
    """Return the radii [m] of the circles that have the same areas as n cross-sections, shape (n,).

    `sections` holds the distances [m] from the axis to the wall at equal angles, one row for each cross-section.
    """
    return np.sqrt(np.mean(sections**2, axis=1))


def pipe_in(
    vertices: np.ndarray, faces: np.ndarray, field: str, name: str, axis: Axis, radius: float, length: float
) -> InnerSurface:
    """Return the inner surface of a mesh, after checking that the mesh is a pipe of about `radius` [m].

    The check covers the first `length` [m] of the pipe. Raises :class:`SceneError` if the mesh is not a pipe around
    `axis`, or if the distance between axis and wall differs from `radius` by more than 10 % at any place.
    """
    surface = InnerSurface(vertices, faces, axis, radius, field, name, (0.0, length))
    reach = surface.sections(np.linspace(0.0, length, max(8, int(length / radius))))
    if np.any(np.abs(reach / radius - 1) > MAX_RADIUS_ERROR):
        refuse(field, name, f"has a bore {2e3 * reach.min():.4g} to {2e3 * reach.max():.4g} mm wide, but the pipe "
               f"is {2e3 * radius:g} mm wide", "check the position of the mesh and its unit ('wall_scale' is 0.001 for "
                                               "millimetres)")  # fmt: skip
    return surface
