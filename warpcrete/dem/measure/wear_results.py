"""Results and figures of the wear of walls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ...core.drawing.style import RUN, SECOND, THIRD, legend_above, new_figure, open_frame, rgb
from ...core.run.method import Quantity
from ...core.units import number
from .wear import HOUR, MeshPatches, PipePatches, PlanePatch, WearMap, WornWall

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class WornRun(Protocol):
    """Members of a discrete element run that describe the wear of its walls."""

    scene: Any
    series: Mapping[str, np.ndarray]
    """Columns of the time series, by name."""
    result: Mapping[str, Any]
    """Quantities of the whole run, by name."""
    wear: WearMap | None
    """Wear of the walls; None if the run did not measure it."""


def _of(of: Callable[[WornWall, Any], float | None]) -> Callable[[Any], float | None]:
    """Return a function that takes the data of a run and evaluates the function `of` for the run's most worn wall.

    The result of the returned function is None if the run measured no wear.
    """

    def found(known: Any) -> float | None:
        wall = known.wear.main if known.wear is not None else None
        return None if wall is None or not known.series["time"][-1] > 0 else of(wall, known)

    return found


def _worst(wall: WornWall) -> int:
    return int(np.argmax(wall.depth))


def _hourly(depth: float, known: Any) -> float:
    return HOUR * depth / known.series["time"][-1]


def _by_volume(wall: WornWall, known: Any) -> float | None:
    scene = known.scene
    if scene.pipe is None or scene.pressure is None or not known.series["travel"][-1] > 0:
        return None
    return wall.mean_depth(covered(wall, scene)) / (np.pi * scene.pipe.radius**2 * known.series["travel"][-1])


def covered(wall: WornWall, scene: Any) -> np.ndarray | slice:
    """Return a mask or slice that selects the patches over which the wear of a wall is averaged.

    In a pipe, or a mesh around a pipe's axis, these are the patches in the range of arc lengths that aggregates
    touched. Patches on the outside of a mesh are left out, unless an aggregate touched them. In other walls, and in
    walls that were never touched, all patches are selected.
    """
    positions = places(wall, scene)
    touched = wall.done[:, 2] > 0
    if positions is None or not touched.any():
        return slice(None)
    s = positions[0]
    return (s >= s[touched].min()) & (s <= s[touched].max()) & (inside(wall, scene) | touched)


def inside(wall: WornWall, scene: Any) -> np.ndarray:
    """Return a mask of the patches that concrete can touch, shape (patches,).

    In a mesh, these are the patches that are visible from the axis of the pipe. In other walls, these are all patches.
    """
    if not isinstance(wall.patches, MeshPatches):
        return np.ones(len(wall.done), bool)
    return wall.patches.seen_from(scene.pipe.axis)


def _mean(wall: WornWall, known: Any, column: int) -> float:
    chosen = covered(wall, known.scene)
    return float(wall.done[chosen, column].sum() / wall.patches.areas[chosen].sum())


def places(wall: WornWall, scene: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Return arc length [m] and angle about the axis [rad] of the middle of each patch of a pipe.

    A mesh in a scene with a pipe is treated like a pipe. For all other walls the result is None.
    """
    patches = wall.patches
    if isinstance(patches, PipePatches):
        return np.repeat(patches.along, patches.around), np.tile(patches.angles, patches.stations)
    surface = patches.surface()
    if scene.pipe is None or isinstance(patches, PlanePatch) or surface is None:
        return None
    vertices, faces, _ = surface
    points, axis = vertices[faces].mean(1), scene.pipe.axis
    s = axis.along(points)
    centre, _, normal, side = axis.frame(s)
    offset = points - centre
    return s, np.arctan2(np.sum(offset * side, 1), np.sum(offset * normal, 1)) % (2 * np.pi)


def _place(wall: WornWall, known: Any, which: int, factor: float) -> float | None:
    positions = places(wall, known.scene)
    return None if positions is None else factor * float(positions[which][_worst(wall)])


QUANTITIES = (
    Quantity("wear_sliding_energy", "J/m2", _of(lambda wall, known: _mean(wall, known, 0)),
             meaning="Energy of sliding friction per area, as a mean over the part of the most worn wall that "
                     "aggregates touched"),
    Quantity("wear_largest_sliding_energy", "J/m2", _of(lambda wall, known: wall.sliding.max()),
             meaning="Energy of sliding friction per area of the patch where it is largest"),
    Quantity("wear_impact_energy", "J/m2", _of(lambda wall, known: _mean(wall, known, 1)),
             meaning="Energy of impacts per area, as a mean over the part of the wall that aggregates touched"),
    Quantity("wear_depth_per_hour", "m/h",
             _of(lambda wall, known: _hourly(wall.mean_depth(covered(wall, known.scene)), known)),
             meaning="Depth of wear per hour of pumping, as a mean over the part of the wall that aggregates touched"),
    Quantity("wear_largest_depth_per_hour", "m/h", _of(lambda wall, known: _hourly(wall.depth.max(), known)),
             meaning="Depth of wear per hour of pumping of the most worn patch"),
    Quantity("wear_depth_per_volume", "m/m3", _of(_by_volume),
             meaning="Depth of wear per volume of pumped concrete, as a mean over the part of the wall that "
                     "aggregates touched"),
    Quantity("wear_worst_along", "m", _of(lambda wall, known: _place(wall, known, 0, 1.0)),
             meaning="Arc length of the most worn patch along the axis of the pipe"),
    Quantity("wear_worst_angle", "deg", _of(lambda wall, known: _place(wall, known, 1, 180 / np.pi)),
             meaning="Angle of the most worn patch about the axis of the pipe"),
)  # fmt: skip
"""Wear results of the most worn wall since t = 0: means over the part of the wall that aggregates touched, and the
values of the most worn patch."""


def report(run: WornRun) -> Iterator[tuple[str, str]]:
    """Yield a line that describes the wear of the walls, or nothing if the run did not measure it."""
    result = run.result
    wall = run.wear.main if run.wear is not None else None
    if wall is None or "wear_depth_per_hour" not in result:
        return
    mean, worst = (1e6 * number(result[name]) for name in ("wear_depth_per_hour", "wear_largest_depth_per_hour"))
    where = ""
    if "wear_worst_along" in result:
        along, angle = number(result["wear_worst_along"]), number(result["wear_worst_angle"])
        where = f" at {along:.3g} m along the pipe, {angle:.0f} degrees around it"
    by_volume = ""
    if "wear_depth_per_volume" in result:
        by_volume = f"; {1e6 * number(result['wear_depth_per_volume']):.3g} mm per 1000 m3 pumped"
    yield (
        f"wear of {wall.name}",
        f"{mean:.3g} um/h on average, {worst:.3g} um/h on the worst patch{where}{by_volume} (k = {wall.coefficient:g} "
        "m2/N, uncertain by a factor of ten)",
    )


def plot_wear(run: WornRun, wall: WornWall | None = None) -> Figure | None:
    """Return a figure of the worn depth of a pipe per hour [um/h].

    The upper panel shows the depth over arc length and angle. The lower panel shows means of the depth along the pipe.
    `wall` is one of `run.wear.walls`; by default it is the most worn wall. Returns None if there is nothing to draw.
    """
    wall = wall or (run.wear.main if run.wear is not None else None)
    time = float(run.series["time"][-1])
    positions = places(wall, run.scene) if wall is not None else None
    if wall is None or positions is None or not time > 0:
        return None
    shown = inside(wall, run.scene)
    s, angle = positions[0][shown], positions[1][shown]
    areas = wall.patches.areas[shown]
    hourly = 1e6 * HOUR / time * wall.depth[shown]
    figure = new_figure(run.scene.caption, 2.8, 2.8)
    axes, below = figure.subplots(2, 1, sharex=True)
    if isinstance(wall.patches, PipePatches):
        shape = wall.patches.stations, wall.patches.around
        edges = np.linspace(0, wall.patches.axis.length, shape[0] + 1), (np.arange(shape[1] + 1) - 0.5) * 360 / shape[1]
        drawn = axes.pcolormesh(*edges, hourly.reshape(shape).T, cmap="magma_r", vmin=0)
    else:
        drawn = axes.scatter(s, np.degrees(angle), 14, hourly, marker="s", cmap="magma_r", vmin=0, linewidths=0)
    figure.colorbar(drawn, ax=axes, label="worn depth [um/h]")
    axes.set(ylabel="angle around\nthe pipe [degrees]", yticks=[0, 90, 180, 270])
    axes.set_title("Angle 0 is the outside of a bend.", fontsize="medium", loc="left")
    edges = np.linspace(s.min(), s.max() + 1e-9, 25)
    row = np.clip(np.digitize(s, edges) - 1, 0, 23)
    middle = 0.5 * (edges[1:] + edges[:-1])
    cosine = np.cos(angle)
    for colour, name, chosen in (
        (RUN, "all round", cosine < 2),
        (SECOND, "around 0 degrees, a quarter of the circumference", cosine > np.sqrt(0.5)),
        (THIRD, "180 degrees", cosine < -np.sqrt(0.5)),
    ):
        total = np.bincount(row[chosen], (hourly * areas)[chosen], 24)
        area = np.bincount(row[chosen], areas[chosen], 24)
        below.plot(middle[area > 0], total[area > 0] / area[area > 0], label=name, color=rgb(colour))
    below.set(xlabel="position along the pipe [m]", ylabel="mean worn depth [um/h]", ylim=(0, None))
    legend_above(below)
    open_frame(below)
    return figure
