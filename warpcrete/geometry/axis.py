"""Pipe axes made of straight lines and circular arcs, and triangle meshes of the tubes around them."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.errors import between, positive, refuse, vector
from ..core.records import Record


@dataclass(frozen=True)
class Line:
    """Straight piece of a pipe's axis."""

    length: float
    """Length of the straight piece of a pipe's axis [m]."""

    def __post_init__(self) -> None:
        positive("length", self.length, "m")


@dataclass(frozen=True)
class Arc:
    """Circular bend of a pipe's axis."""

    radius: float
    """Radius of the centreline of the bend [m]."""
    angle: float
    """Angle by which the bend turns the axis [rad]."""
    towards: tuple[float, float, float]
    """Vector from the start of the bend towards its centre, shape (3,), of any length.

    Only the component perpendicular to the axis is used.
    """

    def __post_init__(self) -> None:
        positive("elbow radius", self.radius, "m")
        between("angle", self.angle, 1e-6, np.pi, "rad")
        object.__setattr__(self, "towards", vector("towards", self.towards))

    @property
    def length(self) -> float:
        """Length of the bend's centreline [m]."""
        return self.radius * self.angle


@dataclass(frozen=True)
class Axis:
    """Centreline of a pipe: a start point [m], a unit tangent at this point, and a sequence of lines and arcs.

    Beyond each end, the axis continues as an unlimited straight line. A :class:`.PipeWall` along the axis therefore has
    no end caps.
    """

    start: tuple[float, float, float]
    tangent: tuple[float, float, float]
    pieces: tuple[Line | Arc, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", vector("axis start", self.start))
        tangent = np.array(vector("axis tangent", self.tangent))
        if not np.any(tangent) or not self.pieces:
            refuse("axis", self.pieces, "must have a tangent other than (0, 0, 0), and at least one piece")
        object.__setattr__(self, "tangent", tuple(tangent / np.linalg.norm(tangent)))

    @property
    def length(self) -> float:
        """Length of the centreline from its start to its end [m]."""
        return sum(piece.length for piece in self.pieces)

    def segments(self) -> list[dict]:
        """Return every piece of the axis as a dictionary that contains its start [m] and its unit tangent at the start.

        The key `outward` holds the unit vector from an arc's centre to the arc's start; for a line, it is zero.
        """
        x, tangent = np.array(self.start), np.array(self.tangent)
        result = []
        for piece in self.pieces:
            if isinstance(piece, Line):
                result.append(dict(piece=piece, start=x, tangent=tangent, outward=np.zeros(3)))
                x = x + piece.length * tangent
            else:
                towards = np.array(piece.towards)
                towards = towards - (towards @ tangent) * tangent
                if np.linalg.norm(towards) < 1e-9:
                    refuse("towards", piece.towards, "must not be parallel to the direction in which the bend begins")
                outward = -towards / np.linalg.norm(towards)
                result.append(dict(piece=piece, start=x, tangent=tangent, outward=outward))
                centre = x - piece.radius * outward
                c, s = np.cos(piece.angle), np.sin(piece.angle)
                x = centre + piece.radius * (c * outward + s * tangent)
                tangent = c * tangent - s * outward
        return result

    def hinges(self) -> np.ndarray:
        """Return the direction of the rotation axis of each arc, which is a normal of its plane, shape (arcs, 3)."""
        found = [np.cross(x["outward"], x["tangent"]) for x in self.segments() if isinstance(x["piece"], Arc)]
        return np.reshape(found, (-1, 3))

    @property
    def is_plane(self) -> bool:
        """True if the whole axis lies in one plane."""
        hinges = self.hinges()
        return bool(np.all(np.abs(np.cross(hinges[:1], hinges)) < 1e-9))

    def flattened(self, allowed: float) -> "Axis":
        """Return this axis with all bends in one plane, if this moves no point by more than `allowed` [m].

        If a point would move further, the result is the unchanged axis. The function serves axes that were measured
        from a mesh: their bends lie in slightly different planes, even if the real pipe bends in one plane only.
        """
        hinges, tangent = self.hinges(), np.array(self.tangent)
        if len(hinges) == 0:
            return self
        angles = np.array([piece.angle for piece in self.pieces if isinstance(piece, Arc)])
        signs = np.where(hinges @ hinges[np.argmax(angles)] < 0, -1.0, 1.0)
        normal = (signs * angles) @ hinges
        normal = normal - (normal @ tangent) * tangent
        normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
        pieces, turns = [], iter(signs)
        for piece in self.pieces:
            if isinstance(piece, Arc):
                towards = next(turns) * np.cross(normal, tangent)
                piece = replace(piece, towards=tuple(towards.tolist()))
                tangent = np.cos(piece.angle) * tangent + np.sin(piece.angle) * towards
            pieces.append(piece)
        flat, s = replace(self, pieces=tuple(pieces)), np.linspace(0.0, self.length, 200)
        return flat if np.linalg.norm(flat.at(s)[0] - self.at(s)[0], axis=1).max() <= allowed else self

    def at(self, s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return points and unit tangents at arc lengths `s` [m], shape (n, 3) each.

        The axis is straight beyond its ends.
        """
        s = np.atleast_1d(np.asarray(s, dtype=float))
        points, tangents = np.empty((len(s), 3)), np.empty((len(s), 3))
        begin = 0.0
        segments = self.segments()
        if len(segments) == 1 and isinstance(segments[0]["piece"], Line):
            tangents[:] = segments[0]["tangent"]
            return segments[0]["start"] + s[:, None] * tangents, tangents
        for number, segment in enumerate(segments):
            piece = segment["piece"]
            lower = -np.inf if number == 0 else begin
            upper = np.inf if number == len(segments) - 1 else begin + piece.length
            here = (s >= lower) & (s <= upper)
            along = s[here] - begin
            if isinstance(piece, Line):
                points[here] = segment["start"] + along[:, None] * segment["tangent"]
                tangents[here] = segment["tangent"]
            else:
                # If the axis begins or ends with an arc, its extension beyond that end is straight.
                inside = np.clip(along, 0.0, piece.length)
                angle = inside[:, None] / piece.radius
                outward, tangent = segment["outward"], segment["tangent"]
                centre = segment["start"] - piece.radius * outward
                tangents[here] = np.cos(angle) * tangent - np.sin(angle) * outward
                points[here] = centre + piece.radius * (np.cos(angle) * outward + np.sin(angle) * tangent)
                points[here] += (along - inside)[:, None] * tangents[here]
            begin += piece.length
        return points, tangents

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """Return the point of the axis that is nearest to each of `points` [m], shape (n, 3).

        The straight extensions beyond the ends belong to the axis.
        """
        return self.projected(points)[0]

    def along(self, points: np.ndarray) -> np.ndarray:
        """Return the arc length [m] of the point of the axis nearest to each of `points` (n, 3), shape (n,).

        The arc length is counted from the start of the axis. Both ends of the axis are extended by unlimited straight
        lines. A point nearest to the line before the start therefore has a negative arc length.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        rows = self.parametrised()
        if len(rows) == 1 and not rows[0]["arc"]:
            return rows[0]["begin"] + (points - rows[0]["start"]) @ rows[0]["tangent"]
        length, distance = np.zeros(len(points)), np.full(len(points), np.inf)
        for row in rows:
            # Compute three components as separate numbers: along the axis, away from the arc's centre, and
            # perpendicular to these two directions. For many points, this takes a third of the time of operations on
            # vectors.
            local = points - (row["start"] - row["radius"] * row["outward"])
            a, b = local @ row["tangent"], local @ row["outward"]
            if row["arc"]:
                angle = np.clip(np.arctan2(a, b), row["lower"], row["upper"])
                s = row["begin"] + row["radius"] * angle
                a, b = a - row["radius"] * np.sin(angle), b - row["radius"] * np.cos(angle)
                apart = a * a + b * b + (local @ np.cross(row["tangent"], row["outward"])) ** 2
            else:
                along = np.clip(a, row["lower"], row["upper"])
                s = row["begin"] + along
                apart = np.einsum("ij,ij->i", local, local) - a * a + (a - along) ** 2
            nearer = apart < distance
            length, distance = np.where(nearer, s, length), np.where(nearer, apart, distance)
        return length

    def projected(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of the axis nearest to `points` (n, 3), and their arc lengths.

        The points have the shape (n, 3) [m], as in :meth:`nearest`, and the arc lengths have the shape (n,) [m], as in
        :meth:`along`.
        """
        s = self.along(points)
        return self.at(s)[0], s

    def frame(self, s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return points, tangents and two unit normals at arc lengths `s` [m], shape (n, 3) each.

        From one arc length to the next, the normals do not rotate about the axis (no twist).
        """
        points, tangents = self.at(s)
        bends = [segment["outward"] for segment in self.segments() if isinstance(segment["piece"], Arc)]
        first = bends[0] if bends else np.eye(3)[np.argmin(np.abs(self.tangent))]
        side = np.cross(self.tangent, first)
        side = side / np.linalg.norm(side)
        sides = np.broadcast_to(side, points.shape).copy()
        if len({tuple(np.round(np.abs(np.cross(self.tangent, b)), 9)) for b in bends}) > 1:
            sides = self.carried(s, side)
        return points, tangents, np.cross(sides, tangents), sides

    def carried(self, s: np.ndarray | float, side: np.ndarray) -> np.ndarray:
        """Return unit normals of the axis at the arc lengths `s` [m], shape (n, 3).

        The unit vector `side` is the normal at the start of the axis. The other normals result from moving it along the
        axis without twist.
        """
        s = np.atleast_1d(np.asarray(s, dtype=float))
        found, begin = np.empty((len(s), 3)), 0.0
        for segment in self.segments():
            piece = segment["piece"]
            # Each piece of the axis writes results for all arc lengths beyond its start. Later pieces then overwrite
            # the results for the arc lengths that belong to them.
            beyond = s >= begin if begin > 0 else np.ones(len(s), bool)
            turn = np.zeros(np.count_nonzero(beyond))
            hinge = np.zeros(3)
            if isinstance(piece, Arc):
                turn = np.clip(s[beyond] - begin, 0.0, piece.length) / piece.radius
                hinge = np.cross(segment["outward"], segment["tangent"])
            found[beyond] = _turned(side, hinge, turn)
            side = _turned(side, hinge, np.array([piece.angle if isinstance(piece, Arc) else 0.0]))[0]
            begin += piece.length
        return found

    def parametrised(self) -> list[Record]:
        """Return the pieces of the axis as dictionaries, each with the range of the coordinate along the piece.

        The coordinate is the length [m] along a line or the angle [rad] along an arc. The axis continues straight
        beyond both of its ends: the coordinate of a line at an end has no limit there, and if there is an arc at an
        end, an unlimited line is added beyond it.
        """
        rows = []
        segments = self.segments()
        begin = 0.0
        for number, segment in enumerate(segments):
            piece = segment["piece"]
            arc = isinstance(piece, Arc)
            upper = piece.angle if arc else piece.length
            radius = piece.radius if arc else 0.0
            rows.append(dict(segment, arc=arc, lower=0.0, upper=upper, radius=radius, begin=begin))
            begin += piece.length
            if not arc and number == 0:
                rows[-1]["lower"] = -np.inf
            if not arc and number == len(segments) - 1:
                rows[-1]["upper"] = np.inf
        straight = dict(arc=False, outward=np.zeros(3), radius=0.0)
        if rows[0]["arc"]:
            first = dict(straight, start=rows[0]["start"], tangent=rows[0]["tangent"], begin=0.0)
            rows.insert(0, dict(first, lower=-np.inf, upper=0.0))
        if rows[-1]["arc"]:
            points, tangents = self.at(self.length)
            last = dict(straight, start=points[0], tangent=tangents[0], begin=self.length)
            rows.append(dict(last, lower=0.0, upper=np.inf))
        return rows

    def tube(
        self, radius: float, facets: int = 64, before: float = 0.0, after: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a triangle mesh of the pipe's inner surface, open at both ends, with normals inward.

        The cross-section is a regular polygon whose `facets` corners lie on a circle of `radius` [m]. Along bends the
        facets are as long as they are wide. The tube extends `before` [m] beyond the start of the axis and `after` [m]
        beyond the end of the axis. The result holds vertices [m], shape (v, 3), and faces, shape (f, 3).
        """
        between("facets", facets, 3, 100_000)
        width = 2 * np.pi * radius / facets
        stations = [-before] if before > 0 else []
        begin = 0.0
        for piece in self.pieces:
            count = 1 if isinstance(piece, Line) else max(2, int(np.ceil(piece.length / width)))
            stations.extend(begin + piece.length * np.arange(count) / count)
            begin += piece.length
        stations.append(begin)
        if after > 0:
            stations.append(begin + after)
        return self.swept(np.array(stations), radius, facets)

    def swept(self, stations: np.ndarray, radius: np.ndarray | float, facets: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a triangle mesh through rings of vertices around the axis, open at both ends, with normals inward.

        The rings lie at the arc lengths `stations` [m], shape (n,), and have `facets` vertices each. Their `radius` [m]
        is one number, or one number for each ring. The result holds vertices [m], shape (v, 3), and faces, shape (f,
        3).
        """
        points, _, normal, side = self.frame(stations)
        angle = 2 * np.pi * np.arange(facets) / facets
        wide = np.reshape(radius, (-1, 1, 1))
        ring = wide * (np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None])
        vertices = (points[:, None] + ring).reshape(-1, 3)
        row, column = np.meshgrid(np.arange(len(stations) - 1), np.arange(facets), indexing="ij")
        a = (row * facets + column).ravel()
        b = (row * facets + (column + 1) % facets).ravel()
        c, d = a + facets, b + facets
        faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
        centres = vertices[faces].mean(1)
        plain = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
        inward = np.repeat(points[:-1], facets, 0) - centres[: len(a)]
        if np.sum(plain[: len(a)] * inward) < 0:
            faces = faces[:, ::-1]
        return vertices, np.ascontiguousarray(faces)


def _turned(vector: np.ndarray, about: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotate a vector (3,) about a unit vector by angles (n,) [rad] with Rodrigues' formula; return shape (n, 3)."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return c * vector + s * np.cross(about, vector) + (1 - c) * (about @ vector) * about
