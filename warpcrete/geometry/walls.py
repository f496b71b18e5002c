"""Walls and their motions as frozen, validated dataclasses in SI units, for flows and for discrete elements."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..core.errors import PlausibilityWarning, between, positive, refuse, vector, warn
from ..core.inputs.fingerprints import EqualByContent
from ..kernels.common.walls import DRIVEN, FIXED, MESH, PIPE, PLANE, PRESCRIBED
from .axis import Axis, Line
from .cleaning import clean

SIDES = 48
"""Number of flat sides with which recorders draw a round wall."""
MOST_STOPS = 1_000_000
PARALLEL = 1e-6
"""Largest sine of the angle between a pipe's velocity and its axis for which the pipe counts as moving along
its axis."""


@dataclass(frozen=True, kw_only=True)
class Stops:
    """Repeated strokes of a prescribed motion, each from rest to rest and followed by a pause.

    After these strokes, the wall moves on without further pauses.
    """

    count: int
    """Number of the wall's strokes that end in a pause."""
    stroke_time: float
    """Duration of one stroke of the wall, including the ramps of its speed at both ends [s]."""
    pause: float
    """Duration of the pause after each stroke [s]."""

    def __post_init__(self) -> None:
        if isinstance(self.count, bool) or not isinstance(self.count, int) or not 1 <= self.count <= MOST_STOPS:
            refuse("stops", self.count, f"must be a whole number from 1 to {MOST_STOPS}")
        positive("stroke_time", self.stroke_time, "s")
        between("pause", self.pause, 0, np.inf, "s")

    @property
    def period(self) -> float:
        """Time from the start of one stroke to the start of the next [s]."""
        return self.stroke_time + self.pause


@dataclass(frozen=True, kw_only=True)
class Prescribed:
    """Motion of a wall with a prescribed speed, whatever forces act on the wall.

    The speed rises linearly from rest over `ramp_time` and is constant afterwards. With `stops`, the wall moves in
    strokes: between two strokes, the speed falls to zero, the wall rests, and the speed rises again. After the last
    stroke, the speed stays constant.
    """

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity (vx, vy, vz) of the wall at full speed, after the ramp [m/s]."""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Angular velocity (x, y, z) of the wall about the point `pivot` at full speed, after the ramp [rad/s]. If the wall
    also has a velocity, this point moves with the wall."""
    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point (x, y, z) about which the wall rotates, at the start of the motion [m]."""
    ramp_time: float = 0.0
    """Duration of the linear rise of the wall's speed from zero [s]."""
    start_time: float = 0.0
    """Simulated time at which the motion of the wall starts [s]."""
    stops: Stops | None = None

    def __post_init__(self) -> None:
        for name in ("velocity", "spin", "pivot"):
            object.__setattr__(self, name, vector(f"motion {name}", getattr(self, name)))
        between("ramp_time", self.ramp_time, 0, np.inf, "s")
        between("start_time", self.start_time, 0, np.inf, "s")
        if self.stops is not None and self.stops.stroke_time < 2 * self.ramp_time * (1 - 1e-12):
            problem = f"must be at least two ramps of {self.ramp_time:g} s"
            refuse("stroke_time", self.stops.stroke_time, problem, "reduce 'ramp_time', or increase 'stroke_time'")

    def fill(self, row: Any) -> None:
        """Write the parameters of the motion into `row`, the entry of the wall in a table on the device."""
        row.motion = int(PRESCRIBED)
        if self.stops is not None:
            row.stops, row.stroke_time, row.pause = self.stops.count, self.stops.stroke_time, self.stops.pause
        row.velocity, row.spin, row.pivot = self.velocity, self.spin, self.pivot
        row.ramp_time, row.start_time = self.ramp_time, self.start_time


@dataclass(frozen=True, kw_only=True)
class Driven:
    """Motion of a wall in one direction, driven by a force against the wall's inertia and damping.

    Examples are a loaded plate and a servo drive.
    """

    direction: tuple[float, float, float]
    """Direction (x, y, z) in which the wall can move, a vector of any length."""
    force: float
    """Driving force on the wall along `direction` [N]; a negative force acts in the opposite direction."""
    mass: float
    """Mass of the wall [kg]."""
    damping: float = 0.0
    """Coefficient of viscous damping of the wall's motion [N s/m]."""
    start_time: float = 0.0
    """Simulated time at which the motion of the wall starts [s]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", vector("direction", self.direction))
        if not np.any(self.direction):
            refuse("direction", self.direction, "must not be zero")
        between("driving force", self.force, -np.inf, np.inf, "N")
        positive("driven mass", self.mass, "kg")
        between("driven damping", self.damping, 0, np.inf, "N s/m")
        between("start_time", self.start_time, 0, np.inf, "s")

    def fill(self, row: Any) -> None:
        """Write the parameters of the motion into `row`, the entry of the wall in a table on the device."""
        row.motion = int(DRIVEN)
        row.velocity = self.direction
        row.mass, row.drive_force, row.drive_damping = self.mass, self.force, self.damping
        row.start_time = self.start_time


Motion = Prescribed | Driven

AddAxis = Callable[[Axis], tuple[int, int]]
"""Function that adds a pipe's axis to the table of axis pieces on the device. It returns the range of table entries
that the axis occupies."""


class _Wall:
    """Base class of walls of all shapes, which have a name, a coordinate frame and an optional motion."""

    name: str
    motion: Motion | None

    @property
    def origin(self) -> np.ndarray:
        """Origin of the wall's own coordinate frame at the start of the simulation [m], shape (3,)."""
        return np.zeros(3)

    @property
    def reference_points(self) -> np.ndarray:
        """Points of the wall [m] at which `top_speed` evaluates the wall's speed, shape (n, 3)."""
        return self.origin[None]

    def top_speed(self) -> float:
        """Return the largest speed [m/s] that a prescribed motion gives to the points `reference_points`.

        The speed is 0 if the wall has no prescribed motion.
        """
        motion = self.motion
        if not isinstance(motion, Prescribed):
            return 0.0
        lever = float(np.linalg.norm(self.reference_points - np.array(motion.pivot), axis=1).max())
        return float(np.linalg.norm(motion.velocity)) + lever * float(np.linalg.norm(motion.spin))

    def fill(self, row: Any, add_axis: AddAxis) -> None:
        """Write the wall's shape and motion into `row`, the entry of the wall in a table on the device.

        A pipe adds its axis to the table of axis pieces with `add_axis`.
        """
        row.motion = int(FIXED)
        if self.motion is not None:
            self.motion.fill(row)


@dataclass(frozen=True, kw_only=True)
class PlaneWall(_Wall):
    """Infinite plane wall; material lies on the side to which its normal points."""

    name: str
    point: tuple[float, float, float]
    """A point (x, y, z) of the plane at the start of the simulation [m]."""
    normal: tuple[float, float, float]
    """Normal (x, y, z) of the plane, of any length; it points to the material."""
    material: str = "wall"
    """Name of the material that determines the contacts of the wall."""
    motion: Motion | None = None
    drawn_radius: float = 0.0
    """Radius of the disc that recorders draw for the plane [m]; with 0, no disc is drawn."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", vector(f"{self.name}.point", self.point))
        normal = np.array(vector(f"{self.name}.normal", self.normal))
        length = float(np.linalg.norm(normal))
        if length == 0:
            refuse(f"{self.name}.normal", self.normal, "must not be zero")
        object.__setattr__(self, "normal", tuple(normal / length))

    @property
    def origin(self) -> np.ndarray:
        return np.array(self.point)

    def fill(self, row: Any, add_axis: AddAxis) -> None:
        super().fill(row, add_axis)
        row.kind = int(PLANE)
        row.normal = self.normal

    def drawn(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return vertices [m] (v, 3) and faces (f, 3) of a thin disc that shows the plane, or None.

        The coordinates refer to the wall's own frame. An infinite plane, with `drawn_radius` 0, is not drawn.
        """
        if self.drawn_radius <= 0:
            return None
        normal = np.array(self.normal)
        side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        side /= np.linalg.norm(side)
        angle = np.linspace(0, 2 * np.pi, SIDES + 1)[:-1]
        up = np.cross(normal, side)
        ring = self.drawn_radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up)
        # Give the disc a thickness, so that a piston is visible from both sides. The disc's front lies in the plane of
        # the wall; the disc's back lies behind this plane.
        back = ring - 0.25 * self.drawn_radius * normal
        vertices = np.concatenate([np.zeros((1, 3)), ring, back, back.mean(0, keepdims=True)])
        n = len(angle)
        k = np.arange(n)
        following = (k + 1) % n
        faces = np.concatenate(
            [
                np.stack([0 * k, 1 + k, 1 + following], 1),
                np.stack([1 + k, 1 + n + k, 1 + following], 1),
                np.stack([1 + following, 1 + n + k, 1 + n + following], 1),
                np.stack([0 * k + 2 * n + 1, 1 + n + following, 1 + n + k], 1),
            ]
        )
        return vertices, faces


@dataclass(frozen=True, kw_only=True)
class PipeWall(_Wall):
    """Exact inner surface of a round pipe, without facets, along an axis of lines and arcs.

    The surface continues beyond both ends of its axis without limit. For a tube that is lifted, use a MeshWall with
    `axis.tube(radius)` instead. A prescribed motion along a straight axis does not change the surface, so it causes a
    :class:`PlausibilityWarning`.
    """

    name: str
    axis: Axis
    radius: float
    """Inner radius of the pipe [m]."""
    material: str = "wall"
    motion: Motion | None = None

    def __post_init__(self) -> None:
        positive(f"{self.name}.radius", self.radius, "m")
        if self.motion is not None and isinstance(self.motion, Prescribed) and any(self.motion.spin):
            problem = "must be zero, because a PipeWall cannot rotate"
            refuse(f"{self.name}.motion", "spin", problem, "use a MeshWall instead")
        if self._slides_within_itself():
            warn(
                f"{self.name}.motion: moves the pipe along its own straight axis, but a PipeWall continues beyond both "
                "ends without limit, so that the motion only changes friction and other shear forces at the wall; for "
                "a tube that is lifted use MeshWall with axis.tube(radius)",
                PlausibilityWarning,
            )

    def _slides_within_itself(self) -> bool:
        """Return whether the wall moves along its own straight axis, so that its surface does not change."""
        if not isinstance(self.motion, Prescribed) or not all(isinstance(piece, Line) for piece in self.axis.pieces):
            return False
        velocity = np.array(self.motion.velocity)
        across = np.cross(velocity, self.axis.tangent)
        return bool(np.any(velocity) and np.linalg.norm(across) <= PARALLEL * np.linalg.norm(velocity))

    @property
    def reference_points(self) -> np.ndarray:
        # All points of a pipe wall have the same speed, because a pipe wall may translate but not rotate.
        return np.array([self.motion.pivot if isinstance(self.motion, Prescribed) else (0.0, 0.0, 0.0)])

    def fill(self, row: Any, add_axis: AddAxis) -> None:
        super().fill(row, add_axis)
        row.kind = int(PIPE)
        row.radius = self.radius
        row.first, row.last = add_axis(self.axis)

    def drawn(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return vertices [m] (v, 3) and faces (f, 3) of the pipe in the wall's own coordinate frame."""
        return self.axis.tube(self.radius, SIDES)


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshWall(EqualByContent, _Wall):
    """Rigid triangle mesh; material may lie on either side.

    Coincident corners are merged, and triangles that repeat others in either orientation are removed.
    """

    name: str
    vertices: np.ndarray
    """Corners of the mesh in the wall's own coordinate frame [m], shape (v, 3). This frame moves with the wall. At the
    start it coincides with the coordinate frame of the scene."""
    faces: np.ndarray
    """Corner indices of each triangle, shape (f, 3)."""
    material: str = "wall"
    motion: Motion | None = None

    def __post_init__(self) -> None:
        try:
            vertices = np.asarray(self.vertices, dtype=float)
            faces = np.asarray(self.faces, dtype=np.int32)
        except (TypeError, ValueError):
            problem = "must be finite numbers of shape (v, 3), with faces of shape (f, 3)"
            refuse(f"{self.name}.vertices", "not numbers", problem)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
            refuse(f"{self.name}.vertices", f"shape {vertices.shape}", "must be finite numbers of shape (v, 3)")
        if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
            refuse(f"{self.name}.faces", f"shape {faces.shape}", "must have shape (f, 3) with f > 0")
        if faces.min() < 0 or faces.max() >= len(vertices):
            problem = f"must be indices of vertices, from 0 to {len(vertices) - 1}"
            refuse(f"{self.name}.faces", f"{faces.min()} to {faces.max()}", problem)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        if len(self.surface[1]) == 0:
            problem = "must include triangles with an area"
            refuse(f"{self.name}.faces", f"{len(faces)} triangles", problem, "check the vertices and their unit")

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Surface used for contacts: cleaned corners and triangles of the mesh.

        The three arrays are the corners [m], shape (w, 3), the triangles, shape (g, 3), and the index of each triangle
        in `faces`, shape (g,).
        """
        return clean(self.vertices, self.faces)

    @property
    def reference_points(self) -> np.ndarray:
        return self.vertices

    def fill(self, row: Any, add_axis: AddAxis) -> None:
        super().fill(row, add_axis)
        row.kind = int(MESH)
        row.extent = float(np.linalg.norm(self.vertices, axis=1).max())

    def drawn(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return vertices [m] (v, 3) and faces (f, 3) of the mesh in the wall's own coordinate frame."""
        return self.vertices, self.faces

    def __repr__(self) -> str:
        moves = f", motion={self.motion!r}" if self.motion is not None else ""
        return f"MeshWall(name={self.name!r}, {len(self.vertices)} vertices, {len(self.faces)} faces{moves})"


Wall = PlaneWall | PipeWall | MeshWall
