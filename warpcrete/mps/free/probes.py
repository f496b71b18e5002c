"""Measurements of concrete with a free surface."""

import numpy as np

from ...standards import Specimen
from ...standards.standard_test import MOST
from ..grid.flow import GridFlow
from ..grid.layout import GridLayout

HALF = 0.5
"""Minimum filled fraction of a cell in which the speed of the concrete is measured."""
UNITS = {
    "time": "s",
    "top": "m",
    "spread": "m",
    "inside": "1",
    "fastest": "m/s",
    "mean_speed": "m/s",
    "volume_error": "1",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
    "time_step": "s",
    "steps": "1",
    MOST: "m/s",
}
"""Units of the columns of the time series. The last column exists only for standard tests whose `slow_share` is below
1. It contains the speed that the fraction `slow_share` of the concrete does not exceed."""


def surface(flow: GridFlow) -> tuple[np.ndarray, np.ndarray]:
    """Return the horizontal positions of all vertical columns of cells [m], and the depth of concrete in each [m].

    In three dimensions the depth is averaged over y, or around the axis of a round vessel.
    """
    layout = flow.state.layout
    across = layout.left + (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    full = (flow.state.cells("fill") * flow.state.cells("room")).sum(0) * layout.step
    if flow.scene.round:
        return across, _means_of_rings(layout, full)
    return across, full if layout.axes == 2 else full.mean(0)


def _means_of_rings(layout: GridLayout, values: np.ndarray) -> np.ndarray:
    """Return means over rings about the axis of a round vessel, from one value for each vertical column of cells.

    `values` has the shape (..., ny, nx), and the result the shape (..., nx). Each ring is as wide as a cell and
    contains the columns whose middles lie in it.
    """
    ring = np.floor(radii(layout) / layout.spacing).astype(int)
    return np.stack([values[..., ring == k].mean(-1) for k in range(layout.cells[0])], -1)


def radii(layout: GridLayout) -> np.ndarray:
    """Return the distance of each column of cells from the axis of a round vessel [m], shape (ny, nx)."""
    x, y = ((np.arange(n) + 0.5) * h for n, h in zip(layout.cells[:2], layout.room.width[:2], strict=True))
    return np.hypot(x, y[:, None])


def _filled_walls(flow: GridFlow, fill: np.ndarray) -> np.ndarray:
    """Return the filled fraction of each cell of a round vessel; cells in walls, such as bars, get estimates.

    A cell inside a wall gets the mean fraction of the other cells at its distance from the axis. Both arrays have the
    shape (nz, ny, nx).
    """
    layout, free = flow.state.layout, flow.state.cells("room") > 0
    count, sum = (_means_of_rings(layout, each) for each in (free.astype(float), fill * free))
    means = np.divide(sum, count, out=np.zeros_like(sum), where=count > 0)
    ring = np.floor(radii(layout) / layout.spacing).astype(int)
    means = np.pad(means, [(0, 0), (0, int(ring.max()) + 1 - means.shape[1])])
    return np.where(free, fill, means[:, ring])


def beyond(flow: GridFlow, radius: float) -> float:
    """Return the fraction of the concrete that is farther from the axis of a round vessel than `radius` [m]."""
    x, mass = (getattr(flow.state.particles, name).numpy().astype(float) for name in ("position", "mass"))
    return float(mass[np.hypot(x[:, 0], x[:, 1]) > radius].sum() / mass.sum())


def bases(flow: GridFlow) -> np.ndarray:
    """Return the lowest height of the concrete in each vertical column of cells [m]; 0 in columns without concrete.

    In a cell that a wall cuts, the volume inside the wall is assumed to lie below the concrete.
    """
    step, room = flow.state.layout.step, flow.state.cells("room")
    full = flow.state.cells("fill") * room
    if flow.scene.round:
        full, room = (_means_of_rings(flow.state.layout, values) for values in (full, room))
    elif full.ndim == 3:
        full, room = full.mean(1), room.mean(1)
    lowest = np.argmax(full > 0, axis=0)
    return np.where((full > 0).any(0), (lowest + ((1 - room) * (full > 0)).sum(0)) * step, 0.0)


def reach(flow: GridFlow) -> float:
    """Return how far the concrete reaches from the axis or the left side [m], at the height where it is widest."""
    layout, fill = flow.state.layout, flow.state.cells("fill")
    if flow.scene.round:
        if flow.scene.walls:
            fill = _filled_walls(flow, fill)
        # Only a quarter of a round vessel is simulated. At each height, take the radius of a quarter disc with the area
        # of the concrete, and return the largest of these radii.
        return float(np.sqrt(4 / np.pi * fill.sum((1, 2)) * layout.spacing * layout.room.width[1]).max())
    if not layout.axial:
        return float((fill.sum(-1) * layout.spacing).max())
    radius = (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(np.sqrt(2 * (fill * radius).sum(1) * layout.spacing).max())


def volume(flow: GridFlow) -> float:
    """Return the concrete's volume [m3]: in plane flow per metre of depth, in axisymmetric flow per radian."""
    layout = flow.state.layout
    full = flow.state.cells("fill") * flow.state.cells("room")
    if layout.axial:
        full = full * (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(full.sum()) * float(np.prod(layout.room.width))


def speeds(flow: GridFlow) -> np.ndarray:
    """Return the speeds in cells that are mostly full of concrete and mostly free of walls [m/s].

    Cells with little concrete are left out, because isolated drops in the air fall freely.
    """
    state, inner = flow.state, slice(1, -1)
    velocity, axes = state.faces("velocity"), flow.state.layout.axes
    square = np.zeros(())
    for axis in range(axes):
        lower, upper = [inner] * axes, [inner] * axes
        upper[axes - 1 - axis] = slice(2, None)
        square = square + (0.5 * (velocity[axis][tuple(lower)] + velocity[axis][tuple(upper)])) ** 2
    return np.sqrt(square)[(state.cells("fill") > HALF) & (state.cells("room") > HALF)]


def _at_start(layout: GridLayout, about_axis: bool) -> Specimen:
    """Return the quantities that a standard test measures, for the initial particles before the first step.

    `about_axis` is True if the vessel is a body of revolution.
    """
    top, end = (float(layout.fluid[:, axis].max()) + 0.5 * layout.particle_spacing for axis in (-1, 0))
    return Specimen(
        top=lambda radius: top,
        spread=lambda: 2 * end if about_axis else end,
        height_around=lambda inner, outer: top if inner < end else 0.0,
        depth=lambda low, high, width: top if low < end else 0.0,
        front=lambda: 0.0,
        screen=lambda width, breadth: 1.0,
        inside=1.0,
    )


def specimen(flow: GridFlow) -> Specimen:
    """Return the quantities that a standard test measures, from the filled fractions of cells and the particles."""
    layout, (across, height) = flow.state.layout, surface(flow)
    top, far, fill = float((bases(flow) + height).max()), reach(flow), flow.state.cells("fill")
    mass = flow.state.particles.mass.numpy().astype(float)
    return Specimen(
        top=lambda radius: top,
        spread=lambda: 2 * far if flow.scene.about_axis else far,
        height_around=lambda inner, outer: float(np.mean(height[(across >= inner) & (across <= outer)])),
        # Concrete clings to the vertical walls of a vessel and stands higher at them. The median ignores these few
        # heights.
        depth=lambda low, high, width: float(np.median(height[(across > low) & (across < high)])),
        front=lambda: float(across[height > 0.5 * layout.spacing].max(initial=0.0)) + 0.5 * layout.spacing,
        # The outlet lies below the first column of cells. The part of the outlet that concrete covers, as seen from
        # above, is the largest filled fraction of a cell in this column.
        screen=lambda width, breadth: float(fill.reshape(fill.shape[0], -1)[:, 0].max()),
        inside=float(np.sum(mass) / np.sum(layout.mass)),
    )


def measured(flow: GridFlow, whole: float) -> dict[str, float]:
    """Measure a flow and return a row of the time series.

    `whole` is the initial volume of the concrete, in the unit of :func:`volume`. The volume error is the fraction of
    this volume that the flow gains (positive) or loses at its surface by numerical errors. Concrete that has left
    through an open side is not counted as lost.
    """
    concrete = specimen(flow) if flow.steps else _at_start(flow.state.layout, flow.scene.about_axis)
    test = flow.scene.test
    most = test.slow_share if test else 1.0
    row = dict.fromkeys([name for name in UNITS if name != MOST or most < 1], 0.0)
    row |= {"top": concrete.top(0.0), "spread": concrete.spread(), "inside": concrete.inside}
    if flow.steps:
        speed, outcomes = speeds(flow), flow.outcomes()
        row |= {
            "time": flow.time,
            "fastest": float(speed.max()) if len(speed) else 0.0,
            "mean_speed": float(np.sqrt(np.mean(speed**2))) if len(speed) else 0.0,
            "volume_error": volume(flow) / whole - row["inside"],
            "viscosity_iterations": outcomes["viscosity"]["iterations"],
            "pressure_iterations": outcomes["pressure"]["iterations"],
            "time_step": flow.next_step,
            "steps": float(flow.steps),
        }
        if most < 1 and len(speed):
            row[MOST] = float(np.quantile(speed, most))
    return row | test.measure(concrete, flow.scene.dimensions) if test else row
