"""What recorders draw: walls as meshes, colours of aggregates, a place for the eye."""

from __future__ import annotations

import functools

import numpy as np

from .probes import largest_forces
from .scene import MeshWall, PipeWall, PlaneWall, Prescribed
from .simulation import Simulation
from .state import State

COLOURINGS = ("speed", "size", "force")


def wall_mesh(wall: PlaneWall | PipeWall | MeshWall, drawn_length: float | None = None):
    """Vertices (v, 3) and faces (f, 3) of a wall in its own frame, or None for an endless plane."""
    if isinstance(wall, MeshWall):
        return wall.vertices, wall.faces
    if isinstance(wall, PipeWall):
        return wall.axis.tube(wall.radius, 48)
    if wall.drawn_radius <= 0:
        return None
    normal = np.array(wall.normal)
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    side /= np.linalg.norm(side)
    angle = np.linspace(0, 2 * np.pi, 49)[:-1]
    up = np.cross(normal, side)
    ring = wall.drawn_radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up)
    # A thin cap, its face in the wall's plane: a piston has a front and a back.
    back = ring - 0.25 * wall.drawn_radius * normal
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


def wall_pose(simulation: Simulation, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] (3,) and orientation (x, y, z, w) of a wall now."""
    state = simulation.state
    return (
        state.wall_position.numpy().reshape(-1, 3)[number].astype(float),
        state.wall_orientation.numpy().reshape(-1, 4)[number].astype(float),
    )


def body_values(simulation: Simulation, colouring: str) -> np.ndarray:
    """Speed [m/s], size [m] or largest contact force [N] of every body, in order of permanent numbers."""
    state = simulation.state
    order = np.argsort(state.body_id.numpy())
    if colouring == "size":
        return state.body_size.numpy()[order].astype(float)
    if colouring == "speed":
        return np.linalg.norm(state.body_velocity.numpy()[order].astype(float), axis=1)
    return largest_forces(simulation.model, state)[order]


def colours(values: np.ndarray, upper: float, lower: float = 0.0) -> np.ndarray:
    """RGB bytes (n, 3) of values from `lower` to `upper`, on matplotlib's perceptually even viridis map."""
    scaled = np.clip((values - lower) / max(upper - lower, 1e-300), 0, 1)
    return _palette()[(255 * scaled).astype(int)]


@functools.cache
def _palette() -> np.ndarray:
    from matplotlib import colormaps

    return (255 * colormaps["viridis"](np.arange(256))[:, :3]).astype(np.uint8)


def colour_limit(simulation: Simulation, colouring: str) -> float:
    """Value at the top of the colour scale: twice the steady speed, the largest size, a strong contact force."""
    if colouring == "size":
        return float(simulation.state.body_size.numpy().max(initial=0.0))
    if colouring == "speed":
        motions = [w.motion for w in simulation.scene.walls if isinstance(w.motion, Prescribed)]
        speeds = [float(np.linalg.norm(motion.velocity)) for motion in motions]
        nominal = simulation.scene.notes.get("velocity", max(speeds, default=0.0))
        return 1.5 * float(nominal) if nominal else 1.0
    size = float(simulation.state.body_size.numpy().max(initial=0.0))
    return 0.05 * simulation.scene.contact.stress_scale * size**2


def view(simulation: Simulation, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """A place for the eye and the point to look at, both (3,) [m]: from one side, at `distance` scene sizes."""
    axis = simulation.scene.notes.get("axis")
    if axis is not None:
        points, _ = axis.at(np.linspace(0, axis.length, 50))
    else:
        points = state_extent(simulation.state)
    lower, upper = points.min(0), points.max(0)
    centre = 0.5 * (lower + upper)
    size = max(float(np.linalg.norm(upper - lower)), 0.1)
    return centre + distance * size * np.array([0.2, -0.95, 0.24]), centre


def state_extent(state: State) -> np.ndarray:
    """Lowest and highest corner of all spheres, shape (2, 3) [m]."""
    position = state.sphere_position.numpy().astype(float)
    if len(position) == 0:
        return np.zeros((2, 3))
    return np.stack([(position[:, :3] - position[:, 3:]).min(0), (position[:, :3] + position[:, 3:]).max(0)])
