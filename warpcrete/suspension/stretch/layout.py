"""Grid, wall, mortar and aggregates of a stretch of pipe at the start."""

from dataclasses import replace

import numpy as np

from ...kernels.mps.flow_laws import BINGHAM
from ...kernels.mps.grid.cells import GridKind
from ...mps.grid.filling import fill_cells
from ...mps.grid.geometry import MIRROR, NO_SLIP_VISCOSITY, OPEN_SIDE, PLATE, WALL, Room, geometry_of
from ...mps.grid.layout import GridLayout
from ...mps.pipe_grid import resistance
from ..aggregates import Aggregates
from ..placing import aggregates_within
from .scene import StretchScene

PARTICLES_PER_AXIS = 2
"""Number of particles of mortar per cell along each axis."""
MARGIN = 2
"""Number of cells between the pipe and the sides of the grid."""


def stretch_room(scene: StretchScene) -> Room:
    """Return the box of cells around the stretch. A whole number of cells fits into radius, depth and length."""
    rings = round(scene.radius / scene.spacing)
    if scene.depth:
        counts = 2 * rings, round(scene.depth / scene.spacing), round(scene.length / scene.spacing)
        sizes = 2 * scene.radius, scene.depth, scene.length
        sides = ((WALL, WALL), (MIRROR, MIRROR), (OPEN_SIDE, OPEN_SIDE))
        widths = tuple(size / count for size, count in zip(sizes, counts, strict=True))
        return Room(counts, widths, (-scene.radius, 0.0, 0.0), sides)
    width, layers = scene.radius / rings, round(scene.length / scene.spacing)
    across = 2 * (rings + MARGIN)
    low = -0.5 * across * width
    sides = ((WALL, WALL), (WALL, WALL), (OPEN_SIDE, OPEN_SIDE))
    return Room((across, across, layers), (width, width, scene.length / layers), (low, low, 0.0), sides)


def stretch_layout(scene: StretchScene) -> tuple[GridLayout, Aggregates]:
    """Return the layout of a stretch and its aggregates.

    The driving force also carries the weight of the aggregates minus the weight of an equal volume of mortar, so that
    the friction at the wall balances the pressure gradient of the scene.
    """
    room, concrete = stretch_room(scene), scene.concrete

    def distance(x: np.ndarray) -> np.ndarray:
        return scene.radius - scene.aside(x[:, 0], x[:, 1])

    def clear(x: np.ndarray) -> np.ndarray:
        clearance = distance(x)
        return np.minimum(clearance, np.minimum(x[:, 1], scene.depth - x[:, 1])) if scene.depth else clearance

    geometry = geometry_of(room, [] if scene.depth else [(distance, PLATE)])
    places, mass = fill_cells(room, PARTICLES_PER_AXIS, lambda x: distance(x) > 0)
    layer = (concrete.slip_viscosity, concrete.slip_yield) if scene.slips else (NO_SLIP_VISCOSITY, 0.0)
    layout = GridLayout(
        kind=GridKind(
            3,
            cut=True,
            periodic=True,
            law=concrete.bulk_law.name,
            slip_law=concrete.layer_law.name if scene.slips else BINGHAM,
        ),
        room=room,
        solid=geometry.solid,
        fluid=places,
        mass=mass,
        particle_spacing=room.width[0] / PARTICLES_PER_AXIS,
        slip=layer,
        slips=scene.slips,
        speed=scene.mortar_alone.flow / (np.pi * scene.radius**2),
        length=scene.radius,
        geometry=geometry,
        full=True,
        weightless=True,
        mean_velocity_fixed=scene.mean_velocity is not None,
        frame=scene.mean_velocity or 0.0,
        resistance=0.0 if scene.mean_velocity is None else resistance(scene, scene.mean_velocity),
    )
    low = np.array([-scene.radius, 0.0 if scene.depth else -scene.radius, 0.0])
    high = np.array([scene.radius, scene.depth or scene.radius, scene.length])
    filled = float(np.sum(mass)) * layout.volume
    aggregates = aggregates_within(scene, filled, clear, low, high, scene.seed, True)
    # The driving force acts on the open volume of the cells, which differs a little from the volume of the pipe.
    volume = float(geometry.room[1:-1, 1:-1, 1:-1].sum()) * float(np.prod(room.width))
    part = 4 / 3 * np.pi * float(np.sum(aggregates.radius**3)) / volume
    weight = part * (scene.aggregate_density - concrete.density) * scene.gravity
    return replace(layout, drive=scene.gradient + weight), aggregates
