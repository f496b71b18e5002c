"""Layout of a vessel on a grid: its cells, its walls, and the concrete in it at the start."""

import numpy as np

from ...core.errors import refuse
from ...kernels.mps.flow_laws import BINGHAM
from ...kernels.mps.grid.cells import GridKind
from ..grid.distances import Distance, polygon_distance, wall_distance
from ..grid.filling import fill_cells
from ..grid.geometry import GATE, MIRROR, OPEN_SIDE, ROUGH, WALL, Geometry, Room, geometry_of, nearest_wall
from ..grid.layout import GridLayout
from ..grid.state import NO_SLIP_VISCOSITY
from .scene import SIDES, FreeScene, Points

PARTICLES_PER_AXIS = {2: 3, 3: 2}
"""Number of particles per cell along each axis, by number of axes.

A flow with a free surface needs more particles than a pipe flow.
"""
NEVER_OPENS = 1e30
"""Number that stands for "never" as the opening time of a cell's walls [s]."""


def free_cells(scene: FreeScene) -> tuple[int, ...]:
    """Return the number of cells of the grid along each axis for a scene with a free surface."""
    nx = max(4, round(scene.width / scene.spacing))
    h = scene.width / nx
    deep = (max(2, round(scene.depth / h)),) if scene.depth else ()
    return nx, *deep, max(4, round(scene.height / h))


def free_layout(scene: FreeScene) -> GridLayout:
    """Return grid, walls and initial particles of a flow in a vessel.

    If the scene has a gate, the gate is one of the walls. The grid also covers the air above and around the concrete.
    """
    cells = free_cells(scene)
    axes = len(cells)
    extent = (scene.width, *((scene.depth,) if scene.depth else ()), scene.height)
    width = tuple(length / n for length, n in zip(extent, cells, strict=True))
    room = Room(cells, width, (0.0,) * axes, _sides(scene, axes))
    walls, shut = _standing_walls(scene), free_walls(scene)
    geometry = geometry_of(room, shut, scene.axial)
    opened, opens = None, np.zeros(0)
    if scene.gate:
        opened = geometry_of(room, walls, scene.axial)
        height = (np.arange(-1, cells[-1] + 1) + 0.5) * width[-1]
        when = np.maximum(height, 0.0).reshape(-1, *[1] * (axes - 1)) / scene.lift_speed
        opens = np.where(_differing_cells(geometry, opened), when, NEVER_OPENS)
    per_axis = PARTICLES_PER_AXIS[axes]
    outline, nearest = section_distance(scene, scene.outline), nearest_wall(room, shut)

    def concrete(points: np.ndarray) -> np.ndarray:
        inside = outline(points) < 0
        inside[inside] = nearest(points[inside])[0] > 0
        return inside

    places, mass = fill_cells(room, per_axis, concrete)
    layer, none = (scene.concrete.slip_viscosity, scene.concrete.slip_yield), (NO_SLIP_VISCOSITY, 0.0)
    if len(places) == 0:
        problem = "leaves no room for concrete, because walls fill the whole outline"
        refuse("outline", scene.outline, problem, "move the outline, or the walls")
    size = float(np.ptp(scene.extent, axis=0).min())
    slips = scene.plate_slips or scene.walls_slip
    slip_law = scene.concrete.layer_law.name if slips else BINGHAM
    return GridLayout(
        kind=GridKind(axes, axial=scene.axial, cut=True, law=scene.concrete.bulk_law.name, slip_law=slip_law),
        room=room,
        solid=geometry.solid,
        fluid=places,
        mass=mass * places[:, 0] / places[:, 0].mean() if scene.axial else mass,
        particle_spacing=width[0] / per_axis,
        slip=layer if scene.plate_slips else none,
        rough=layer if scene.walls_slip else none,
        slips=scene.plate_slips,
        rough_slips=scene.walls_slip,
        speed=0.1 * float(np.sqrt(scene.gravity * size)),
        length=size,
        geometry=geometry,
        opened=opened,
        opens=opens,
    )


def _standing_walls(scene: FreeScene) -> list[tuple[Distance, int]]:
    """Return the signed distance function [m] and the kind number of each wall that never moves.

    The gate, which is lifted, is not among these walls.
    """
    walls: list[tuple[Distance, int]] = [(section_distance(scene, block), ROUGH) for block in scene.blocks]
    return walls + [(wall_distance(wall, np.array(scene.amid)), ROUGH) for wall in scene.walls]


def free_walls(scene: FreeScene) -> list[tuple[Distance, int]]:
    """Return the signed distance function [m] and the kind number of each wall at the start, including the gate."""
    walls = _standing_walls(scene)
    return [*walls, (section_distance(scene, scene.gate), GATE)] if scene.gate else walls


def section_distance(scene: FreeScene, polygon: Points) -> Distance:
    """Return a function of points that gives the signed distance [m] from a body, negative inside.

    The body has `polygon` as its vertical cross-section, and is a body of revolution if `scene.round` is true.
    """
    distance = polygon_distance(polygon)
    if scene.round:
        return lambda points: distance(np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], 1))
    return distance


def _sides(scene: FreeScene, axes: int) -> tuple[tuple[str, str], ...]:
    """Return, for each axis of the simulated space, the kinds of its two sides: wall, mirror or open side."""
    usual = {"left": MIRROR if scene.axial else WALL, "top": OPEN_SIDE} | dict(scene.sides)
    pairs = SIDES if axes == 3 else (SIDES[0], SIDES[2])
    return tuple((usual.get(lower, WALL), usual.get(upper, WALL)) for lower, upper in pairs)


def _differing_cells(one: Geometry, two: Geometry) -> np.ndarray:
    """Return a mask with one value per cell: True where any array of the two geometries differs."""
    faces = (one.part != two.part) | (one.gap != two.gap) | (one.shut != two.shut) | (one.surface != two.surface)
    return (
        faces.any(0)
        | (one.room != two.room)
        | (one.weighted_volume != two.weighted_volume)
        | (one.depth != two.depth).any(-1)
        | (one.quarter_fraction != two.quarter_fraction).any((-1, -2))
        | (one.solid != two.solid)
    )
