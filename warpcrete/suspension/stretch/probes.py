"""Measurements of mortar with aggregates in a stretch of pipe."""

from functools import cache

import numpy as np

from ...kernels.mps.grid.cells import LAST_FORCE
from ...theory.laws import BINGHAM
from ..balance import wall_friction
from ..flow import SuspensionFlow
from .scene import StretchScene

POINTS = 12
"""Number of sample points along the diameter of an aggregate, from which its volume in each ring follows."""
CORE_RINGS = 4
"""Minimum number of cells from the axis to the edge of the core. The core is the region around the axis in which a
parabola is fitted to the velocities."""
UNITS = {
    "time": "s",
    "flow": "m3/s",
    "gradient": "Pa/m",
    "axis_velocity": "m/s",
    "aggregate_velocity": "m/s",
    "aggregate_radius": "1",
    "wall_stress": "Pa",
    "relative_viscosity": "1",
    "slip_velocity": "m/s",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
    "steps": "1",
}
"""Units of the columns of the time series, except for the columns that every flow of mortar with aggregates has."""


@cache
def _points() -> np.ndarray:
    """Return points that fill a sphere of radius 1 evenly, shape (p, 3)."""
    along = (2 * np.arange(POINTS) + 1) / POINTS - 1
    cube = np.stack(np.meshgrid(along, along, along), -1).reshape(-1, 3)
    return cube[np.linalg.norm(cube, axis=1) < 1]


def _columns(flow: SuspensionFlow) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of each column of cells from the axis [m] and the number of its ring around the axis.

    Both arrays have the shape (ny, nx).
    """
    room = flow.state.layout.room
    x, y = (o + (np.arange(n) + 0.5) * h for o, n, h in zip(room.origin, room.cells[:2], room.width, strict=False))
    radius = flow.scene.aside(x, y[:, None])
    return radius, np.floor(radius / room.width[0]).astype(int)


def _ring_count(flow: SuspensionFlow) -> int:
    """Return the number of rings one cell wide from the axis to the wall."""
    return round(flow.scene.radius / flow.state.layout.room.width[0])


def velocity_profile(flow: SuspensionFlow) -> tuple[np.ndarray, np.ndarray]:
    """Return mean distances from the axis [m] and mean velocities along the pipe [m/s], for rings one cell wide.

    Each velocity is the mean over mortar and aggregates in its ring.
    """
    (radius, ring), count = _columns(flow), _ring_count(flow)
    (speed, part), inside = _along(flow), ring < count
    weight = np.bincount(ring[inside], part.sum(0)[inside], count)
    middle = np.bincount(ring[inside], (part.sum(0) * radius)[inside], count) / weight
    return middle, np.bincount(ring[inside], (speed * part).sum(0)[inside], count) / weight


def _along(flow: SuspensionFlow) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities and open fractions of the faces perpendicular to the pipe, each of shape (nz, ny, nx).

    The velocities are the components along the pipe [m/s]. The open fraction is the part of a face's area that lies
    inside the pipe.
    """
    inner = (slice(1, -1),) * 3
    part = flow.geometry.part.numpy().astype(float).reshape(3, *flow.state.shape)[2]
    return flow.state.faces("velocity")[2][inner], part[inner]


def fraction_profile(flow: SuspensionFlow) -> np.ndarray:
    """Return the volume fraction of the aggregates in rings one cell wide, counted from the axis."""
    room, scene, count = flow.state.layout.room, flow.scene, _ring_count(flow)
    bodies, parts = flow.aggregates.bodies, flow.aggregates.parts
    centre = parts.centres(bodies.centre.numpy().astype(float), bodies.turn.numpy().astype(float))
    radius, points = parts.radius, _points()
    aside = scene.aside(
        centre[:, 0, None] + radius[:, None] * points[:, 0], centre[:, 1, None] + radius[:, None] * points[:, 1]
    )
    own = np.repeat(parts.share / len(points), len(points))
    ring = np.clip((aside.ravel() / room.width[0]).astype(int), 0, count - 1)
    edges = room.width[0] * np.arange(count + 1)
    areas = 2 * scene.depth * np.diff(edges) if scene.depth else np.pi * np.diff(edges**2)
    return np.bincount(ring, own, count) / (areas * scene.length)


def mean_radius(flow: SuspensionFlow) -> float:
    """Return the mean distance of the aggregates from the axis, weighted by volume and divided by the pipe's radius."""
    centre, volume = flow.aggregates.bodies.centre.numpy().astype(float), flow.aggregates.radius**3
    aside = flow.scene.aside(centre[:, 0], centre[:, 1])
    return float(np.sum(aside * volume) / volume.sum() / flow.scene.radius)


def section_of_cells(flow: SuspensionFlow) -> float:
    """Return the cross-sectional area of a cell [m2], by which velocities are multiplied to get the volume flow.

    For a flow between planes, the area is scaled so that the result is the volume flow through a round pipe with the
    same mean velocity. The radius of this pipe is half the distance of the planes.
    """
    scene, width = flow.scene, flow.state.layout.room.width
    ratio = np.pi * scene.radius / (2 * scene.depth) if scene.depth else 1.0
    return width[0] * width[1] * ratio


def has_core(scene: StretchScene) -> bool:
    """Return whether the velocity in the core is a parabola that the cells resolve.

    The mortar must be a Newtonian fluid, and the core at least `CORE_RINGS` cells wide.
    """
    wide = scene.radius - scene.mean_diameter >= CORE_RINGS * scene.spacing
    return wide and scene.concrete.bulk_law.name == BINGHAM and scene.concrete.yield_stress == 0


def core(scene: StretchScene, radius: np.ndarray, velocity: np.ndarray, gradient: float) -> tuple[float, float]:
    """Return the relative viscosity of the suspension around the axis, and its apparent slip velocity [m/s].

    Both follow from a parabola that is fitted to the velocities in the core, weighted by area. The core is the region
    whose distance from the wall exceeds the mean diameter of the aggregates. The slip velocity is the value of the
    parabola at the wall. `velocity` holds the velocities [m/s] at the distances `radius` from the axis [m], and
    `gradient` is the pressure gradient that balances friction [Pa/m].
    """
    inside = radius < scene.radius - scene.mean_diameter
    weight = np.ones(inside.sum()) if scene.depth else np.sqrt(radius[inside])
    curve, wall = np.polyfit(radius[inside] ** 2 - scene.radius**2, velocity[inside], 1, w=weight)
    return float(-gradient / (2 * scene.ways * curve * scene.concrete.viscosity)), float(wall)


def measured(flow: SuspensionFlow) -> dict[str, float]:
    """Measure a stretch of pipe and return the values of one row of the time series, by column name."""
    scene: StretchScene = flow.scene
    row = dict.fromkeys(UNITS, 0.0)
    row["aggregate_radius"], row["gradient"] = mean_radius(flow), scene.gradient
    if not has_core(scene):
        del row["relative_viscosity"], row["slip_velocity"]
    if not flow.steps:
        return row
    layout, (speed, part), outcomes = flow.state.layout, _along(flow), flow.outcomes()
    radius, velocity = velocity_profile(flow)
    along, volume = flow.aggregates.bodies.velocity.numpy().astype(float)[:, 2], flow.aggregates.radius**3
    # The driving force at the start is the pressure gradient plus the weight of the aggregates minus their buoyancy.
    drive = float(flow.state.mesh.drive.numpy()[int(LAST_FORCE)])
    gradient = scene.gradient if scene.mean_velocity is None else drive - (layout.drive - scene.gradient)
    row |= {
        "time": flow.time,
        "flow": float((speed * part).sum()) * section_of_cells(flow) / layout.room.cells[2],
        "gradient": gradient,
        "axis_velocity": float(velocity[0]),
        "aggregate_velocity": float(np.sum(along * volume) / volume.sum()),
        "wall_stress": float(wall_friction(flow)[0][2].sum()) / scene.wall_area,
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
        "steps": float(flow.steps),
    }
    if has_core(scene):
        row["relative_viscosity"], row["slip_velocity"] = core(scene, radius, velocity, gradient)
    return row
