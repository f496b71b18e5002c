"""Particles that fill the cells of a grid with concrete at the start."""

from collections.abc import Callable

import numpy as np

from .geometry import SAMPLES_PER_CELL, Room

THREE_POINTS = 0.125, 0.5, 0.875
"""Positions of three particles along a cell, in cell widths from its lower end.

Each particle shares its mass among cells by hat functions, which fall from 1 at a cell's centre to 0 at the centres of
its neighbours. At these positions, the three particles give the same shares as an evenly filled cell: 0.75 for the cell
itself and 0.125 for each neighbour.
"""
MAX_MASS = 3.0
"""Maximum mass of a particle, divided by the mass of a particle in a full cell. The minimum of this ratio is 1 /
MAX_MASS."""


def fill_cells(
    room: Room, per_axis: int, concrete: Callable[[np.ndarray], np.ndarray], there: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of particles in the concrete [m], shape (n, axes), and their relative masses, shape (n,).

    A full cell gets `per_axis` particles along each axis, each of mass 1. `concrete` is a function that returns for
    each point, shape (n, axes), whether it lies in the concrete. The particles of a partly filled cell share the mass
    of the concrete in it equally, but each mass is limited to the range from 1 / MAX_MASS to MAX_MASS.

    `there` tells which particles of each cell lie in the concrete, shape (cells..., per_axis^axes), with the last axis
    of the particles fastest. If `there` is omitted, it is computed with the function `concrete`.
    """
    axes = len(room.cells)
    each = _sample_points(room, per_axis)
    if there is None:
        there = concrete(each.reshape(-1, axes)).reshape(each.shape[:-1])
    count = there.sum(-1)
    part = count / per_axis**axes
    # The surface of the concrete may cross cells that are partly full, and cells with concrete on one side only.
    # Compute the filled fractions of these cells from a finer set of sample points.
    edge = (part > 0) & (part < 1)
    for axis in range(axes):
        step = np.diff((part > 0).astype(int), axis=axis) != 0
        for side in (slice(None, -1), slice(1, None)):
            at = [slice(None)] * axes
            at[axis] = side
            edge[tuple(at)] |= step
    chosen = np.argwhere(edge)
    fine = _sample_points(room, SAMPLES_PER_CELL[axes], chosen)
    part[edge] = concrete(fine.reshape(-1, axes)).reshape(fine.shape[:-1]).mean(-1)
    mass = np.where(count > 0, part * per_axis**axes / np.maximum(count, 1), 0.0)
    which = np.broadcast_to(mass[..., None], there.shape)[there]
    return each[there], np.clip(which, 1 / MAX_MASS, MAX_MASS)


def _sample_points(room: Room, per_axis: int, chosen: np.ndarray | None = None) -> np.ndarray:
    """Return sample points in each cell, `per_axis` along each axis, shape (cells..., points, axes) [m].

    If `chosen` contains indices of cells, shape (n, axes), only these cells get points.
    """
    axes = len(room.cells)
    if chosen is None:
        chosen = np.moveaxis(np.indices(room.cells), 0, -1)
    along = np.array(THREE_POINTS) if per_axis == 3 else (np.arange(per_axis) + 0.5) / per_axis
    inner = along[np.moveaxis(np.indices((per_axis,) * axes), 0, -1).reshape(-1, axes)]
    return np.array(room.origin) + (chosen[..., None, :] + inner) * np.array(room.width)
