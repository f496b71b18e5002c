"""Random placement of aggregates without overlaps, for the start of a run."""

import numpy as np

from ..core.device.interrupts import stop_if_requested
from ..core.errors import at_most, refuse
from ..core.inputs.limits import warn
from ..mps.free.layout import free_walls, section_distance
from ..mps.grid.geometry import MIRROR, nearest_wall
from ..mps.grid.layout import GridLayout
from .aggregates import Aggregates
from .nearby import CLEARANCE, ITERATIONS, MARGIN, SWEEPS, Distance, Draw, close_pairs, draw_between
from .placing_clumps import placed_clumps
from .scene import SphereFields, SuspensionScene

MAX_DEVIATION = 0.1
"""Largest relative difference between the volume of the placed aggregates and the volume that the scene's fraction
requires, above which a warning is given."""
SHRINK = 0.95
"""Factor by which the number of aggregates is reduced repeatedly until all of them fit, if the required number does not
fit. The error message then states the volume fraction that fits."""


def placed_aggregates(scene: SuspensionScene, layout: GridLayout) -> Aggregates:
    """Return randomly placed aggregates with the volume fraction, the sizes and the shapes of a scene.

    Raises :class:`warpcrete.SceneError` if not all aggregates can be placed without overlaps.
    """
    nearest, outline = nearest_wall(layout.room, free_walls(scene)), section_distance(scene, scene.outline)
    origin, width = np.array(layout.room.origin), np.array(layout.room.width)
    top = origin + np.array(layout.room.cells) * width
    mirrors = [(axis, side) for axis, sides in enumerate(layout.room.sides) for side in (0, 1) if sides[side] == MIRROR]

    def distance(x: np.ndarray) -> np.ndarray:
        clearance = np.minimum(nearest(x)[0], -outline(x))
        for axis, side in mirrors:
            clearance = np.minimum(clearance, x[:, axis] - origin[axis] if side == 0 else top[axis] - x[:, axis])
        return clearance

    volume = float(np.sum(layout.mass)) * layout.volume
    return aggregates_within(scene, volume, distance, layout.fluid.min(0), layout.fluid.max(0), scene.seed)


def aggregates_within(
    scene: SphereFields, volume: float, distance: Distance, low: np.ndarray, high: np.ndarray, seed: int,
    periodic: bool = False, draw: Draw | None = None,
) -> Aggregates:  # fmt: skip
    """Return aggregates at random places between the corners `low` and `high` of a box [m], without overlaps.

    `volume` is the volume of the concrete [m3], of which the aggregates fill the fraction that the scene states.
    :func:`random_places` explains the other parameters. Raises :class:`warpcrete.SceneError` if not all aggregates can
    be placed without overlaps.
    """
    rng = np.random.default_rng(seed)
    radii = _radii(scene, volume, rng)
    aggregates = _placed(scene, radii, low, high, distance, rng, periodic, draw)
    if aggregates is None:
        whole, fewer = float(np.sum(radii**3)), rng.permutation(radii)
        while aggregates is None and len(fewer) > 1:
            fewer = fewer[: int(SHRINK * len(fewer))]
            aggregates = _placed(scene, fewer, low, high, distance, rng, periodic, draw)
        count, part = (0, 0.0) if aggregates is None else (len(fewer), float(np.sum(fewer**3)) / whole)
        refuse(
            "aggregate_fraction",
            scene.aggregate_fraction,
            f"is too large: only {count} of {len(radii)} aggregates could be placed without overlaps",
            f"use {at_most(part * scene.aggregate_fraction, 2)} or less"
            if count
            else "use smaller aggregates or a wider box",
        )
    return aggregates


def _placed(
    scene: SphereFields, radii: np.ndarray, low: np.ndarray, high: np.ndarray, distance: Distance,
    rng: np.random.Generator, periodic: bool, draw: Draw | None,
) -> Aggregates | None:  # fmt: skip
    """Return aggregates of a scene at random places without overlaps, or None if they do not fit.

    `radii` are the radii of spheres with the volumes of the aggregates [m]. :func:`random_places` explains the other
    parameters.
    """
    shapes = scene.templates
    if all(len(shape.radii) == 1 for shape in shapes):
        centres = random_places(radii, low, high, distance, rng, periodic, draw)
        return None if centres is None else Aggregates(centres, radii, scene.aggregate_density)
    kinds = rng.integers(len(shapes), size=len(radii))
    unplaced = Aggregates(np.zeros((len(radii), 3)), radii, scene.aggregate_density, shapes=shapes, shape=kinds)
    return placed_clumps(unplaced, low, high, distance, rng, periodic, draw)


def random_places(
    radii: np.ndarray, low: np.ndarray, high: np.ndarray, distance: Distance, rng: np.random.Generator,
    periodic: bool = False, draw: Draw | None = None,
) -> np.ndarray | None:  # fmt: skip
    """Return random centres of spheres without overlaps, shape (n, 3), or None if the spheres do not fit.

    The spheres with the `radii` [m] start at random places in the box between the corners `low` and `high` [m].
    Iterations push overlapping spheres apart. Random moves without overlaps then spread the spheres like the molecules
    of a fluid, because pushing leaves too many of them in narrow gaps. The function `distance` returns the distance of
    points from the nearest wall [m], and `rng` is a random number generator. If `periodic` is true, the space from
    `low` to `high` repeats itself along the last axis. The function `draw` draws the random places at the start. If
    `draw` is None, these places are uniformly distributed between the corners.
    """
    period = high[2] - low[2] if periodic else 0.0
    centres = _start(radii, draw or draw_between(low, high), distance, rng)
    if centres is None or not _separate(centres, radii, distance, period):
        return None
    _stir(centres, radii, distance, period, rng)
    return low + np.where([False, False, periodic], (centres - low) % (period or 1.0), centres - low)


def _start(radii: np.ndarray, draw: Draw, distance: Distance, rng: np.random.Generator) -> np.ndarray | None:
    """Return random centres of spheres that overlap no walls, but may overlap each other."""
    centres, left = np.zeros((len(radii), 3)), np.arange(len(radii))
    for _ in range(ITERATIONS):
        stop_if_requested()
        x = draw(rng, len(left))
        free = distance(x) > (1 + CLEARANCE) * radii[left]
        centres[left[free]] = x[free]
        left = left[~free]
        if not len(left):
            return centres
    return None


def _separate(centres: np.ndarray, radii: np.ndarray, distance: Distance, period: float) -> bool:
    """Push overlapping spheres apart, and return whether no overlap is left.

    The function moves `centres` [m] in place. `period` is the length after which the space repeats itself [m].
    """
    goal, needed = 1 + 0.5 * CLEARANCE + MARGIN, 1 + 0.5 * CLEARANCE
    reach = 2 * goal * float(radii.max())
    for _ in range(ITERATIONS):
        stop_if_requested()
        i, j, d = close_pairs(centres, reach, period)
        away = np.linalg.norm(d, axis=1)
        sum = radii[i] + radii[j]
        room = distance(centres)
        if np.all(away >= needed * sum) and np.all(room >= (1 + CLEARANCE) * radii):
            return True
        push = 0.5 * np.maximum(goal * sum - away, 0.0)[:, None] * d / np.maximum(away, 1e-12 * reach)[:, None]
        for axis in range(3):
            centres[:, axis] -= np.bincount(i, push[:, axis], len(radii)) - np.bincount(j, push[:, axis], len(radii))
        _leave_walls(centres, radii, distance)
    return False


def _leave_walls(centres: np.ndarray, radii: np.ndarray, distance: Distance) -> None:
    """Move each sphere that overlaps a wall away from this wall."""
    depth = (1 + CLEARANCE + MARGIN) * radii - distance(centres)
    close = np.flatnonzero(depth > 0)
    if not len(close):
        return
    step = 1e-3 * float(radii.min())
    shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
    around = distance((centres[close, None] + shifts).reshape(-1, 3)).reshape(-1, 2, 3)
    slope = (around[:, 0] - around[:, 1]) / (2 * step)
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    centres[close] += depth[close, None] * slope / np.maximum(steep, 1e-3)


def _stir(centres: np.ndarray, radii: np.ndarray, distance: Distance, period: float, rng: np.random.Generator) -> None:
    """Move each sphere several times at random, without overlaps (Metropolis et al. 1953).

    Moves are proposed for all spheres at once. The move of a sphere is rejected if its new place overlaps the old or
    the new place of another sphere. All other moves can then be made together without any overlap.
    """
    count, needed = len(radii), 1 + 0.5 * CLEARANCE
    size = 0.2 * float(radii.mean())
    for _ in range(SWEEPS):
        stop_if_requested()
        new = centres + rng.uniform(-size, size, centres.shape)
        blocked = distance(new) < (1 + CLEARANCE) * radii
        both = np.concatenate([centres, new])
        i, j, d = close_pairs(both, 2 * needed * float(radii.max()), period)
        a, b = i % count, j % count
        overlap = (np.linalg.norm(d, axis=1) < needed * (radii[a] + radii[b])) & (a != b)
        # The old places do not overlap one another, so each overlap involves one or two new places. Reject the moves to
        # these places.
        for place in (i, j):
            moved = overlap & (place >= count)
            blocked[place[moved] - count] = True
        centres[~blocked] = new[~blocked]
        # Adapt the length of the moves, so that about half of them are accepted.
        size = min(size * (1.1 if np.mean(blocked) < 0.5 else 0.9), float(radii.mean()))


def _radii(scene: SphereFields, volume: float, rng: np.random.Generator) -> np.ndarray:
    """Return random radii [m], largest first, of as many aggregates as the scene's volume fraction requires.

    The radii belong to spheres with the volumes of the aggregates. From a sieve curve, only sizes that the cells
    resolve are drawn. There is at least one aggregate. Warn if the volume of the aggregates differs from the required
    volume by more than the fraction `MAX_DEVIATION`.
    """
    target_volume = scene.simulated_fraction * volume
    curve = None if scene.sieve is None else scene.sieve.above(scene.diameters[0])
    radii, filled = [], 0.0
    while True:
        size = rng.uniform(*scene.diameters) if curve is None else float(curve.sample(1, rng)[0])
        radius = 0.5 * size
        own = 4 / 3 * np.pi * radius**3
        if filled + 0.5 * own > target_volume and radii:
            if abs(filled / target_volume - 1) > MAX_DEVIATION:
                placed = scene.simulated_fraction * filled / target_volume
                goal = f" instead of {scene.simulated_fraction:.3g}, which the cells resolve" if curve else ""
                warn(
                    f"aggregate_fraction = {scene.aggregate_fraction:g}: only whole aggregates can be placed; their "
                    f"number is {len(radii)}, with a volume fraction of {placed:.3g}{goal}"
                )
            return np.sort(np.array(radii))[::-1]
        radii.append(radius)
        filled += own
