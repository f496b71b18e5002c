"""Rigid aggregates in a grid flow: their initial state, and their arrays on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ..core.errors import at_most, refuse
from ..kernels.suspension.bodies import body_structs
from ..kernels.suspension.leaving import PARKED
from ..kernels.suspension.pairs import CAPACITY, LOOKED_AT, pair_struct
from ..mps.common.allocation import allocate
from ..mps.grid.layout import GridLayout

MIN_CELLS = 3.0
"""Minimum number of cells across the smallest aggregate. With fewer cells, the drag is more than 10 % too small."""
MAX_GRID = 64
"""Maximum number of cells along an axis of the hash grid that finds neighbouring aggregates."""
STATE_ARRAYS = ("centre", "velocity", "spin", "turn")
"""Names of the arrays in `Bodies` on which the next step depends, so that a checkpoint contains them."""


@dataclass(frozen=True)
class Aggregates:
    """Spherical aggregates in a mortar at the start of a run."""

    centre: np.ndarray
    """Positions of the aggregates' centres in the coordinates of the grid [m], shape (n, 3)."""
    radius: np.ndarray
    """Radii of the aggregates [m], shape (n,)."""
    density: float
    """Density of the aggregates [kg/m3]."""
    velocity: np.ndarray | None = None
    """Velocities of the aggregates' centres [m/s], shape (n, 3); None if all aggregates are at rest."""

    def __post_init__(self) -> None:
        centre, radius = np.asarray(self.centre, float), np.asarray(self.radius, float)
        if centre.ndim != 2 or centre.shape[1] != 3 or radius.shape != centre.shape[:1]:
            refuse("centre", centre.shape, f"must have the shape (n, 3) for radii of shape {radius.shape}",
                   "give one centre and one radius for each aggregate")  # fmt: skip
        if not (np.isfinite(centre).all() and np.all(radius > 0)):
            refuse("radius", radius.tolist(), "must be above 0, and all centres must be finite",
                   "remove or correct aggregates with other values")  # fmt: skip
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "radius", radius)

    @property
    def count(self) -> int:
        """Number of aggregates."""
        return len(self.radius)


def is_inside(centres: np.ndarray) -> np.ndarray:
    """Return a mask of the aggregates that are at least partly in the simulated box; `centres` has the shape (n, 3)."""
    return np.abs(centres).max(1) < float(PARKED)


class BodyState:
    """State of the aggregates on a device: motion, neighbours, and the faces and cells of the grid that they cover."""

    def __init__(
        self, aggregates: Aggregates, layout: GridLayout, density: float, gravity: np.ndarray, scalar: Any, device: Any
    ) -> None:
        structs = body_structs(scalar)
        count, radius = aggregates.count, aggregates.radius
        width = min(layout.room.width)
        if 2 * radius.min() < MIN_CELLS * width:
            refuse("spacing", width, f"is too coarse: the smallest aggregate, {2 * radius.min():.3g} m, must be at "
                                     f"least {MIN_CELLS:g} cells wide",
                   f"use {at_most(2 * radius.min() / 4)} m or less, or count smaller aggregates as mortar")  # fmt: skip
        volume = 4 / 3 * np.pi * radius**3
        extra = (aggregates.density - density) * volume
        zero = np.zeros((count, 3))
        self.count, self.radius, self.extra_weight = count, radius, extra[:, None] * gravity
        self.excess = aggregates.density - density
        self.low = np.array(layout.room.origin)
        self.high = self.low + np.array(layout.room.cells) * np.array(layout.room.width)
        self.bodies = allocate(
            structs.Bodies, device, centre=aggregates.centre, spin=count,
            velocity=zero if aggregates.velocity is None else np.asarray(aggregates.velocity, float),
            turn=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), radius=radius, extra_mass=extra,
            extra_inertia=0.4 * extra * radius**2, force=self.extra_weight, torque=count, mobility=count,
            spin_mobility=count,
        )  # fmt: skip
        # Upper bound of the number of faces that a sphere covers: three faces for each cell, and as many cells as a
        # sphere contains whose radius is larger by two cells.
        room = np.ceil(3 * 4 / 3 * np.pi * (radius / width + 2) ** 3).astype(int)
        slots = int(np.prod(layout.shape))
        self.cover = allocate(
            structs.Cover, device, claims=3 * slots, owner=3 * slots, closing=3 * slots, closer=3 * slots, shared=slots,
            touches=3 * slots, toucher=3 * slots, covered=3 * slots, solid=4 * slots, count=count, touched=count,
            first=np.concatenate([[0], np.cumsum(room)]), faces=int(room.sum()), part=int(room.sum()),
            lever=int(room.sum()),
        )  # fmt: skip
        entries = count * int(CAPACITY)
        self.pairs = allocate(
            pair_struct(scalar), device, count=count, other=entries, normal=entries, gap=entries, rough=entries,
            still=entries, lubrication=entries, hold=entries, touching=entries, smallest_gap=count, full=1, changed=1,
        )  # fmt: skip

        # The hash grid finds neighbours from points in single precision, so the largest distance of two neighbours is
        # enlarged slightly to allow for rounding.
        room = layout.room
        self.span = 1.0001 * (2 * float(radius.max()) + float(LOOKED_AT) * max(room.width))
        lengths = np.array(room.cells) * np.array(room.width)
        self.grid = wp.HashGrid(*np.clip(lengths / self.span, 1, MAX_GRID).astype(int).tolist(), device=device)
        self.points = wp.zeros(count, dtype=wp.vec3f, device=device)

    def sort(self) -> None:
        """Sort the centres of the aggregates into the cells of the hash grid."""
        self.grid.build(self.points, self.span)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return centres, velocities, spins and orientations of the aggregates, by name."""
        return {name: getattr(self.bodies, name).numpy() for name in STATE_ARRAYS}

    def load_state_dict(self, found: dict[str, np.ndarray]) -> None:
        """Restore centres, velocities, spins and orientations of the aggregates from a `state_dict`."""
        for name in STATE_ARRAYS:
            getattr(self.bodies, name).assign(found[name])

    @property
    def inside(self) -> np.ndarray:
        """Mask of the aggregates that are at least partly in the simulated box, shape (n,)."""
        return is_inside(self.bodies.centre.numpy())

    def volume_inside(self, opens: int) -> float:
        """Return the fraction of the aggregates' volume that has not left the box through an open side.

        The bits of `opens` are 1 for open sides: bit 2 k for the lower side along axis k, and bit 2 k + 1 for the upper
        one.
        """
        centre, volume = self.bodies.centre.numpy().astype(float), self.radius**3
        left = np.zeros(self.count)
        for side in range(6):
            if opens >> side & 1:
                axis = side // 2
                depth = centre[:, axis] - self.low[axis] if side % 2 == 0 else self.high[axis] - centre[:, axis]
                h = np.clip(self.radius - depth, 0.0, 2 * self.radius)
                left += h**2 * (3 * self.radius - h) / 4
        return float(np.sum(np.maximum(volume - left, 0.0)) / np.sum(volume))

    def smallest_gap(self) -> float:
        """Return the smallest gap of any aggregate to a neighbour or wall, divided by the radius of that aggregate.

        The gaps are those at the start of the last step. A gap is negative for an overlap.
        """
        return float(self.pairs.smallest_gap.numpy().min())
