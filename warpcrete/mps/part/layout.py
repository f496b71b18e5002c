"""Cells around a part, its walls, and the concrete in it at the start.

The grid's last axis is the way that concrete leaves along, through an open side; it enters through a plane across the
axis, which goes with it. What has left comes in again.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.mps.grid.cells import Kind
from ..free.layout import fill_cells
from ..grid.geometry import BARE, MIRROR, PLATE, ROUGH, WALL, Distance, Room, geometry_of, nearest_wall
from ..grid.layout import GridLayout, Motion
from .scene import PartScene

INLET = ROUGH + 1
"""Number of the plane that concrete enters through."""
BEHIND, BESIDE = 2, 1.5
"""Cells of the room around the bore; how far the inlet's plane reaches, over the radius, and as many cells."""
ABREAST = 2
"""Particles of a cell along each axis."""
PLACES, A_RADIUS = 200, 8
"""Along the axis, at which the room that it needs is looked for: at least, and along a radius of the bore."""


class Frame:
    """The grid's axes in the scene's room: the last is the way out, the first lies in the plane of its bends, if they
    have one.
    """

    def __init__(self, scene: PartScene) -> None:
        self.end, out = (a[0] for a in scene.axis.at(scene.axis.length))
        _, into = (a[0] for a in scene.axis.at(0.0))
        across = into - (into @ out) * out
        if np.linalg.norm(across) < 1e-9:
            hinges = scene.axis.hinges()
            across = np.cross(hinges[0], out) if len(hinges) else np.eye(3)[np.argmin(np.abs(out))]
            across = across - (across @ out) * out
        across = across / np.linalg.norm(across)
        self.axes = np.stack([across, np.cross(out, across), out])
        """Rows are the grid's axes, shape (3, 3)."""

    def inward(self, x: np.ndarray) -> np.ndarray:
        """Places of the room on the grid, whose origin is the axis's end; shape (n, 3)."""
        return (x - self.end) @ self.axes.T

    def outward(self, x: np.ndarray) -> np.ndarray:
        """And back."""
        return x @ self.axes + self.end


def part_room(scene: PartScene) -> Room:
    """Cells around the part."""
    frame, size = Frame(scene), scene.radius
    h = size / max(3, round(size / scene.spacing))
    wide = scene.widest
    # As many as a turn needs that is the farthest the line goes, however long it is.
    count = max(PLACES, math.ceil(A_RADIUS * scene.axis.length / size))
    points, tangents = scene.axis.at(np.linspace(0, scene.axis.length, count))
    places = frame.inward(points)
    # A section reaches as far along an axis as it is not square to it.
    reach = wide * np.sqrt(np.maximum(1 - (tangents @ frame.axes.T) ** 2, 0.0))
    low, high = (places - reach).min(0) - BEHIND * h, (places + reach).max(0) + BEHIND * h
    if scene.is_half:
        low[1] = 0.0
    high[2] = 0.0
    counts = np.ceil((high - low) / h).astype(int)
    low[2] = -counts[2] * h
    front = MIRROR if scene.is_half else WALL
    sides = ((WALL, WALL), (front, WALL), (WALL, BARE))
    return Room(tuple(map(int, counts)), (h, h, h), tuple(map(float, low)), sides)


def bore_distance(scene: PartScene) -> Distance:
    """Distance of places on the grid from the wall of the bore [m]."""
    frame, axis = Frame(scene), scene.axis
    if scene.inner is not None:
        inner = scene.inner
        return lambda x: inner.distance(frame.outward(x))
    places, radii = np.array(scene.bores.places), np.array(scene.bores.radii)
    # Across a cone's wall is less far than across its axis.
    lean = np.concatenate([[1.0], np.sqrt(1 + (np.diff(radii) / np.diff(places)) ** 2), [1.0]])

    def distance(x: np.ndarray) -> np.ndarray:
        nearest, s = axis.projected(frame.outward(x))
        gap = scene.bore(s) - np.linalg.norm(frame.outward(x) - nearest, axis=1)
        return gap / lean[np.searchsorted(places, s)]

    return distance


def inlet_distance(scene: PartScene) -> Distance:
    """Distance of places on the grid from the plane that concrete enters through [m]; far from the pipe there is
    none.
    """
    frame = Frame(scene)
    start, tangent = (a[0] for a in scene.axis.at(0.0))
    x0, way = frame.inward(start[None])[0], frame.axes @ tangent
    wide = BESIDE * float(scene.bore(0.0)) + BEHIND * scene.spacing

    def distance(x: np.ndarray) -> np.ndarray:
        along = (x - x0) @ way
        aside = np.linalg.norm(x - x0 - along[:, None] * way, axis=1)
        return np.where(aside < wide, along, 1e3)

    return distance


def part_layout(scene: PartScene) -> GridLayout:
    """The part, full of concrete at rest."""
    room, frame = part_room(scene), Frame(scene)
    inlet = inlet_distance(scene)
    walls = [(bore_distance(scene), PLATE), (inlet, INLET)]
    geometry, nearest = geometry_of(room, walls), nearest_wall(room, walls)

    def concrete(points: np.ndarray) -> np.ndarray:
        return nearest(points)[0] > 0

    places, mass = fill_cells(room, ABREAST, concrete)
    _, tangent = scene.axis.at(0.0)
    way = frame.axes @ tangent[0]
    share = 0.5 if scene.is_half else 1.0
    speed = share * scene.flow / _area(geometry, room, way)
    velocity = tuple(float(speed * c) for c in way)
    depth = inlet(places)
    h = room.width[0]
    return GridLayout(
        kind=Kind(3, cut=True),
        room=room,
        solid=geometry.solid,
        fluid=places,
        mass=mass,
        mark_spacing=h / ABREAST,
        slip=(scene.concrete.slip_viscosity, scene.concrete.slip_yield),
        speed=scene.velocity,
        length=scene.radius,
        geometry=geometry,
        full=True,
        weightless=True,
        motions=(Motion(velocity, smooth=True),),
        inlet=places[(depth > 0.1 * h) & (depth < h)],
        inflow=velocity,
    )


def _area(geometry, room: Room, way: np.ndarray) -> float:
    """Of the plane, square to `way`, as the cells see it: flow in over the plane's speed [m2]."""
    liquid = np.zeros(geometry.solid.shape, bool)
    inner = (slice(1, -1),) * 3
    liquid[inner] = geometry.solid[inner] == 0
    total = 0.0
    for axis in range(3):
        area = room.width[0] ** 2
        shut = np.where(geometry.surface[axis] == INLET, 1 - geometry.part[axis], 0.0) * area * way[axis]
        above = np.roll(liquid, 1, 2 - axis)  # arrays have the last axis first
        total += float(np.sum(shut * liquid) - np.sum(shut * above))
    return total


def stations(scene: PartScene, room: Room, chosen: np.ndarray) -> np.ndarray:
    """Arc length of the middle of each of some cells [m]; `chosen` says which, shape as the state's cells, the last
    axis first.
    """
    cells = np.argwhere(chosen)[:, ::-1]
    return scene.axis.along(Frame(scene).outward(np.array(room.origin) + (cells + 0.5) * np.array(room.width)))
