"""Coarse aggregate of the two-phase model: groups of particles in a column that move as rigid grains."""

import math
from dataclasses import dataclass

import numpy as np

from ..core.errors import refuse
from .layout import Layout
from .scene import FluidScene


@dataclass(frozen=True)
class Grains:
    """Rigid grains of coarse aggregate; each grain is a group of particles."""

    order: np.ndarray
    """Indices of the particles in the initial layout, in the order in which the state stores the particles: first the
    particles of the grains, grain by grain, then the particles of the mortar."""
    group: np.ndarray
    """Grain number of each particle, -1 for mortar, in the order in which the state stores the particles, shape
    (n,)."""
    first: np.ndarray
    """Index of the first particle of each grain, followed by the number of particles of all grains, shape (grains +
    1,)."""
    size: np.ndarray
    """Size of each grain [m]: diameter of the disc or ball of equal volume, shape (grains,)."""

    @property
    def count(self) -> int:
        """Number of rigid grains in the column."""
        return len(self.size)


def place_grains(scene: FluidScene, layout: Layout) -> Grains:
    """Place grains of random size and shape at random positions, the largest size class first.

    Each size class is placed up to its volume fraction. A grain consists of the particles inside its outline, which is
    a circle or ball with a random waviness. The outline does not touch walls, piston or surface. In two dimensions at
    least one particle of mortar stays between two grains. In three dimensions, where random placing leaves less room,
    grains may touch. Raises :class:`SceneError` if the grains do not fit.
    """
    aggregates = scene.aggregates
    assert aggregates is not None
    rng = np.random.default_rng(scene.seed)
    places, spacing = layout.fluid, layout.spacing
    n, dimensions = places.shape
    owner = np.full(n, -1, np.int32)
    target = aggregates.fraction * n
    members: list[np.ndarray] = []
    total = sum(fraction for _, _, fraction in aggregates.sizes)
    if total <= 0:
        refuse("sizes", aggregates.sizes, "must contain at least one size with a share above 0")
    particles = 0
    rim_width = 1.05 * spacing if dimensions == 2 else 0.0
    for number, (smallest, largest, _) in enumerate(sorted(aggregates.sizes, key=lambda c: -c[1])):
        goal = target * sum(c[2] for c in sorted(aggregates.sizes, key=lambda c: -c[1])[: number + 1]) / total
        misses = 0
        while particles < goal - 0.5 and misses < 4000:
            size = rng.uniform(smallest, largest)
            centre = places[rng.integers(n)] + rng.uniform(-0.5, 0.5, dimensions) * spacing
            wave = _outline(rng, dimensions, aggregates.roundness)
            # The layout's particles are sorted by their distance from the piston. The particles at the heights of a
            # grain are therefore a contiguous range.
            widest = 0.5 * size * (2 - aggregates.roundness) + rim_width
            near = np.arange(*np.searchsorted(places[:, -1], [centre[-1] - widest, centre[-1] + widest]))
            offset = places[near] - centre
            distance = np.linalg.norm(offset, axis=1)
            reach = 0.5 * size * wave(offset / np.maximum(distance, 1e-12)[:, None])
            inside = near[distance < reach]
            rim = near[distance < reach + rim_width]
            touches_wall = np.linalg.norm(centre[:-1]) + 0.5 * size > scene.radius
            touches_end = not 0.5 * size < centre[-1] < layout.height - 0.5 * size
            if len(inside) < 2 or touches_wall or touches_end or (owner[rim] >= 0).any():
                misses += 1
                continue
            owner[inside] = len(members)
            members.append(inside)
            particles += len(inside)
            misses = 0
        if particles < goal - max(0.02 * target, 0.6 * (largest / spacing) ** dimensions):
            shortfall = (
                f"does not fit at a spacing of {spacing:g} m: only the volume fraction {particles / n:.3g} was placed"
            )
            refuse("aggregate fraction", aggregates.fraction, shortfall, "use a lower fraction, or a smaller 'spacing'")
    if not members:
        problem = "is too small for a single grain"
        refuse("aggregate fraction", aggregates.fraction, problem, "use a larger fraction, or a smaller 'spacing'")
    mortar = np.flatnonzero(owner < 0)
    order = np.concatenate([*members, mortar])
    first = np.concatenate([[0], np.cumsum([len(m) for m in members])]).astype(np.int32)
    volume = np.diff(first) * layout.volume
    size = np.sqrt(4 * volume / math.pi) if dimensions == 2 else np.cbrt(6 * volume / math.pi)
    return Grains(order, owner[order], first, size)


def _outline(rng: np.random.Generator, dimensions: int, roundness: float):
    """Return a function that gives the radius of a random shape in some directions, divided by the mean radius.

    The directions are unit vectors, shape (n, dimensions). With a `roundness` of 1, the shape is a circle or a ball.
    """
    strength = (1 - roundness) * rng.uniform(0.3, 1.0)
    axis = rng.normal(size=(3, dimensions))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    parts = rng.dirichlet(np.ones(3))

    def radius(direction: np.ndarray) -> np.ndarray:
        c = direction @ axis.T
        # The first term deforms the circle or ball into an oval, the second makes one end thicker as in an egg, and the
        # third gives it three corners.
        return 1 + strength * (
            parts[0] * (2 * c[:, 0] ** 2 - 1) + parts[1] * c[:, 1] + parts[2] * (4 * c[:, 2] ** 3 - 3 * c[:, 2])
        )

    return radius
