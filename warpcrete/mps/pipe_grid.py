"""Layout of a periodic pipe on a grid at the start: cells, walls and particles."""

import math
from typing import Any

import numpy as np

from ..kernels.mps.grid.cells import GridKind
from ..theory.pipe import steady
from .grid.geometry import MIRROR, OPEN_SIDE, PLATE, SMOOTH, WALL, Room
from .grid.layout import GridLayout
from .scene import FluidScene

PARTICLES_PER_AXIS = 2
"""Number of particles per cell along each axis in a pipe."""


def pipe_cells(scene: FluidScene) -> tuple[int, int]:
    """Return the number of cells across a pipe and the number of cells along it.

    A whole number of cells fits across a channel, or into the radius of a tube. This number is chosen such that the
    width of a cell is nearest to the scene's `spacing`. A periodic grid needs three cells along the pipe, so that no
    two neighbours of a cell are the same.
    """
    across = scene.radius if scene.dimensions == 3 else 2 * scene.radius
    nx = max(2, round(across / scene.spacing))
    return nx, max(3, round(scene.length * nx / across))


def pipe_layout(scene: FluidScene) -> GridLayout:
    """Return grid, walls and initial particles of a periodic pipe.

    In two dimensions the cells reach from wall to wall. In three dimensions they reach from the pipe's axis to its
    wall.
    """
    axial = scene.dimensions == 3
    nx, nz = pipe_cells(scene)
    dx, dz = (scene.radius if axial else 2 * scene.radius) / nx, scene.length / nz
    left = 0.0 if axial else -scene.radius
    solid = np.zeros((nz + 2, nx + 2), np.int32)
    solid[:, 0] = SMOOTH if axial else PLATE
    solid[:, -1] = PLATE
    i, k = np.meshgrid(
        (np.arange(nx * PARTICLES_PER_AXIS) + 0.5) / PARTICLES_PER_AXIS,
        (np.arange(nz * PARTICLES_PER_AXIS) + 0.5) / PARTICLES_PER_AXIS,
    )
    fluid = np.stack([left + i.ravel() * dx, k.ravel() * dz], 1)
    concrete = scene.concrete
    return GridLayout(
        kind=GridKind(
            axial=axial,
            periodic=True,
            thixotropic=scene.is_structured,
            rebuilding=scene.rebuild_rate > 0,
            law=concrete.bulk_law.name,
            slip_law=concrete.layer_law.name,
        ),
        gained=scene.gained,
        room=Room((nx, nz), (dx, dz), (left, 0.0), ((MIRROR if axial else WALL, WALL), (OPEN_SIDE, OPEN_SIDE))),
        solid=solid,
        fluid=fluid,
        mass=fluid[:, 0] / fluid[:, 0].mean() if axial else np.ones(len(fluid)),
        particle_spacing=dx / PARTICLES_PER_AXIS,
        slip=(concrete.slip_viscosity, concrete.slip_yield),
        speed=scene.velocity,
        length=scene.radius,
        frame=scene.velocity,
        drive=concrete.density * scene.gravity,
        resistance=resistance(scene, scene.velocity),
    )


def resistance(scene: Any, mean: float) -> float:
    """Return the derivative of the wall's force per volume with respect to the mean velocity `mean` [kg/m3/s].

    The derivative is taken at the steady state of `scene`, which has the attributes `concrete`, `line`, `form`,
    `radius` and `length`. The driving force of a periodic pipe uses the derivative to anticipate how the wall's force
    changes with the velocity.
    """
    little, flow = 1e-3, math.pi * scene.radius**2 * mean
    now, more = (steady(scene.concrete, scene.line, flow * (1 + part), scene.form) for part in (0.0, little))
    return (more.pressure - now.pressure) / (scene.length * little * mean)
