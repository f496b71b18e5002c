"""Layout of a part of a pump line on a grid: cells, walls, and the concrete in the part at the start.

Concrete leaves along the last axis of the grid, through an open side. It enters through a plane across the pipe's axis,
which is a wall that moves with the velocity of the flow. Particles that have left the grid enter it again at this
plane.
"""

import math

import numpy as np

from ...kernels.mps.grid.cells import GridKind
from ..grid.distances import Distance
from ..grid.filling import fill_cells
from ..grid.geometry import MIRROR, OPEN_SIDE, PLATE, ROUGH, WALL, Room, geometry_of, nearest_wall, octants
from ..grid.layout import GridLayout, Motion
from .scene import PartScene

INLET = ROUGH + 1
"""Kind number of the wall that represents the plane through which concrete enters."""
MARGIN_CELLS, INLET_RADIUS = 2, 1.5
"""MARGIN_CELLS is the number of cells between the bore and the sides of the grid. The radius of the inlet plane is
INLET_RADIUS times the radius of the bore, plus MARGIN_CELLS cells."""
PARTICLES_PER_AXIS = 2
"""Number of particles per cell along each axis."""
MIN_AXIS_POINTS, POINTS_PER_RADIUS = 200, 8
"""Number of points along the axis from which the extent of a part is computed: POINTS_PER_RADIUS for each radius of the
bore, but at least MIN_AXIS_POINTS."""
ROUNDING = 1e-6
"""Largest deviation from a whole number of cells, in cell widths, that counts as a rounding error of a length."""


class Frame:
    """Grid axes in the coordinates of the scene.

    The last axis is the direction in which concrete leaves. The first axis lies in the plane of the bends, if they have
    a common plane.
    """

    def __init__(self, scene: PartScene) -> None:
        self.end = scene.axis.at(scene.axis.length)[0][0]
        self.axes = scene.orientation.axes
        """Axes of the grid as rows, in the coordinates of the scene, shape (3, 3)."""

    def to_grid(self, x: np.ndarray) -> np.ndarray:
        """Convert points of the scene to grid coordinates, shape (n, 3).

        The origin of the grid coordinates is the downstream end of the pipe's axis.
        """
        return (x - self.end) @ self.axes.T

    def to_scene(self, x: np.ndarray) -> np.ndarray:
        """Convert points from grid coordinates to coordinates of the scene, shape (n, 3)."""
        return x @ self.axes + self.end


def part_room(scene: PartScene) -> Room:
    """Return the box of cells around the simulated part of the pump line."""
    frame, size, h = Frame(scene), scene.radius, scene.rounded_spacing
    wide = scene.widest
    # The number of sample points grows with the length of the part, so that a sample point lies near the farthest point
    # of every bend.
    count = max(MIN_AXIS_POINTS, math.ceil(POINTS_PER_RADIUS * scene.axis.length / size))
    points, tangents = scene.axis.at(np.linspace(0, scene.axis.length, count))
    places = frame.to_grid(points)
    # The cross-section of the pipe is a disc normal to the tangent of its axis. Along a grid axis, this disc extends by
    # its radius times the sine of the angle between the tangent and the grid axis.
    reach = wide * np.sqrt(np.maximum(1 - (tangents @ frame.axes.T) ** 2, 0.0))
    low, high = (places - reach).min(0) - MARGIN_CELLS * h, (places + reach).max(0) + MARGIN_CELLS * h
    if scene.is_half:
        low[1] = 0.0
    high[2] = 0.0
    # Allow for rounding errors, because sines and cosines are rounded differently on different processors: a box that
    # is a whole number of cells wide must not get an additional cell on some of them.
    counts = np.ceil((high - low) / h - ROUNDING).astype(int)
    low[2] = -counts[2] * h
    front = MIRROR if scene.is_half else WALL
    sides = ((WALL, WALL), (front, WALL), (WALL, OPEN_SIDE))
    return Room(tuple(map(int, counts)), (h, h, h), tuple(map(float, low)), sides)


def bore_distance(scene: PartScene) -> Distance:
    """Return a function of grid points that gives their distance from the wall of the bore [m], positive inside."""
    frame, axis = Frame(scene), scene.axis
    if scene.inner is not None:
        inner, margin = scene.inner, MARGIN_CELLS * scene.rounded_spacing
        return lambda x: inner.distance(frame.to_scene(x), margin)
    places, radii = np.array(scene.bores.places), np.array(scene.bores.radii)
    # In a cone, the distance to the wall is the distance normal to the pipe's axis, times the cosine of the cone's
    # slope.
    lean = np.concatenate([[1.0], np.sqrt(1 + (np.diff(radii) / np.diff(places)) ** 2), [1.0]])

    def distance(x: np.ndarray) -> np.ndarray:
        nearest, s = axis.projected(frame.to_scene(x))
        gap = scene.bore(s) - np.linalg.norm(frame.to_scene(x) - nearest, axis=1)
        return gap / lean[np.searchsorted(places, s)]

    return distance


def inlet_distance(scene: PartScene) -> Distance:
    """Return a function of grid points that gives their distance from the plane through which concrete enters [m].

    The distance is positive on the side of the pipe. The plane is a disc around the pipe's axis; beside the disc, the
    function returns a large distance.
    """
    frame = Frame(scene)
    start, tangent = (a[0] for a in scene.axis.at(0.0))
    x0, way = frame.to_grid(start[None])[0], frame.axes @ tangent
    wide = INLET_RADIUS * float(scene.bore(0.0)) + MARGIN_CELLS * scene.spacing

    def distance(x: np.ndarray) -> np.ndarray:
        along = (x - x0) @ way
        aside = np.linalg.norm(x - x0 - along[:, None] * way, axis=1)
        return np.where(aside < wide, along, 1e3)

    return distance


def part_layout(scene: PartScene) -> GridLayout:
    """Return grid, walls and initial particles of the flow through a pipe part that is full of concrete."""
    room, frame = part_room(scene), Frame(scene)
    inlet = inlet_distance(scene)
    walls = [(bore_distance(scene), PLATE), (inlet, INLET)]
    geometry, nearest = geometry_of(room, walls), nearest_wall(room, walls)

    def concrete(points: np.ndarray) -> np.ndarray:
        return nearest(points)[0] > 0

    places, mass = fill_cells(room, PARTICLES_PER_AXIS, concrete, octants(geometry) > 0)
    _, tangent = scene.axis.at(0.0)
    way = frame.axes @ tangent[0]
    share = 0.5 if scene.is_half else 1.0
    speed = share * scene.flow / _area(geometry, room, way)
    velocity = tuple(float(speed * c) for c in way)
    depth = inlet(places)
    h = room.width[0]
    return GridLayout(
        kind=GridKind(3, cut=True, law=scene.concrete.bulk_law.name, slip_law=scene.concrete.layer_law.name),
        room=room,
        solid=geometry.solid,
        fluid=places,
        mass=mass,
        particle_spacing=h / PARTICLES_PER_AXIS,
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
    """Return the area of the inlet plane as represented by cells [m2].

    The volume flow divided by this area is the speed of the plane. The unit vector `way` is its normal.
    """
    liquid = np.zeros(geometry.solid.shape, bool)
    inner = (slice(1, -1),) * 3
    liquid[inner] = geometry.solid[inner] == 0
    total = 0.0
    for axis in range(3):
        area = room.width[0] ** 2
        closed_area = geometry.swept[axis] * area * way[axis]
        # Arrays of cells store the axes in reverse order, so grid axis `axis` is the array axis 2 - axis.
        above = np.roll(liquid, 1, 2 - axis)
        total += float(np.sum(closed_area * liquid) - np.sum(closed_area * above))
    return total


def stations(scene: PartScene, room: Room, chosen: np.ndarray) -> np.ndarray:
    """Return the arc length along the pipe's axis at the middle of each chosen cell [m].

    `chosen` is a mask with one value for each cell of the grid, last axis first.
    """
    cells = np.argwhere(chosen)[:, ::-1]
    return scene.axis.along(Frame(scene).to_scene(np.array(room.origin) + (cells + 0.5) * np.array(room.width)))
