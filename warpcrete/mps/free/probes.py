"""What is measured of concrete with a free surface."""

from __future__ import annotations

import numpy as np

from ..grid.flow import GridFlow

HALF = 0.5
"""Part of a cell that must be full for its velocity to count."""
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
}
"""Of the columns of a row."""
MORE = {
    "funnel": {"screen": "1"},
    "lbox": {"near_depth": "m", "far_depth": "m", "front": "m"},
}
"""Columns that a test has besides, with their units."""
FAR_END = 0.05
"""Length of a box over which the depth at its far end is a mean [m]."""


def surface(flow: GridFlow) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the columns of cells [m], and the concrete's height over each, its mean over any depth [m]."""
    layout = flow.state.layout
    across = layout.left + (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    full = (flow.state.cells("fill") * flow.state.cells("room")).sum(0) * layout.step
    return across, full if layout.axes == 2 else full.mean(0)


def bases(flow: GridFlow) -> np.ndarray:
    """Where the concrete over each column of cells begins [m], 0 where there is none; what is wall in a wet cell counts
    as below the concrete.
    """
    step, room = flow.state.layout.step, flow.state.cells("room")
    full = flow.state.cells("fill") * room
    if full.ndim == 3:
        full, room = full.mean(1), room.mean(1)
    lowest = np.argmax(full > 0, axis=0)
    return np.where((full > 0).any(0), (lowest + ((1 - room) * (full > 0)).sum(0)) * step, 0.0)


def reach(flow: GridFlow) -> float:
    """How far the concrete has come from the axis or the left side, wherever it is widest [m]."""
    layout, fill = flow.state.layout, flow.state.cells("fill")
    if not layout.axial:
        return float((fill.sum(-1) * layout.spacing).max())
    radius = (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(np.sqrt(2 * (fill * radius).sum(1) * layout.spacing).max())


def volume(flow: GridFlow) -> float:
    """Of the concrete that the cells hold, of a metre's depth, of a radian or in all."""
    layout = flow.state.layout
    full = flow.state.cells("fill") * flow.state.cells("room")
    if layout.axial:
        full = full * (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(full.sum()) * float(np.prod(layout.room.width))


def speeds(flow: GridFlow) -> np.ndarray:
    """Of cells that are mostly full [m/s]: a little concrete in a cell of air falls, and says nothing of the rest."""
    state, inner = flow.state, slice(1, -1)
    velocity, axes = state.faces("velocity"), flow.state.layout.axes
    square = np.zeros(())
    for axis in range(axes):
        lower, upper = [inner] * axes, [inner] * axes
        upper[axes - 1 - axis] = slice(2, None)
        square = square + (0.5 * (velocity[axis][tuple(lower)] + velocity[axis][tuple(upper)])) ** 2
    return np.sqrt(square)[(state.cells("fill") > HALF) & (state.cells("room") > HALF)]


def screen(flow: GridFlow) -> float:
    """How full the fullest cell is of those in the middle of a funnel, from the outlet to the brim: below a half, light
    is seen through it.
    """
    fill = flow.state.cells("fill")
    return float(fill.reshape(fill.shape[0], -1)[:, 0].max())


def box_depths(flow: GridFlow) -> dict[str, float]:
    """Depth just behind the gate and at the far end of an L-box, and how far the front has come from the gate [m]."""
    across, height = surface(flow)
    scene, half = flow.scene, 0.5 * flow.state.layout.spacing
    gate = scene.dimensions["column_width"]
    behind = (across < gate) & (across > 0.5 * gate)
    came = across[height > half]
    return {
        # What clings to the walls of the column is no depth.
        "near_depth": float(np.median(height[behind])),
        "far_depth": float(np.median(height[across > scene.width - FAR_END])),
        "front": max(float(came.max(initial=0.0)) + half - gate, 0.0),
    }


def measured(flow: GridFlow, whole: float) -> dict[str, float]:
    """A row of the series; `whole` is the concrete's volume at the start, of a metre's depth, of a radian or in all.

    Volume is lost or won by the surface; what has left through an open side is neither.
    """
    state, layout = flow.state, flow.state.layout
    if not flow.steps:
        top = float(layout.fluid[:, -1].max()) + 0.5 * layout.mark_spacing
        far = float(layout.fluid[:, 0].max()) + 0.5 * layout.mark_spacing
        none = dict.fromkeys(UNITS | MORE.get(flow.scene.test, {}), 0.0)
        start = {"top": top, "spread": 2 * far if layout.axial else far, "inside": 1.0}
        start |= {"screen": 1.0} if flow.scene.test == "funnel" else {}
        start |= {"near_depth": top} if flow.scene.test == "lbox" else {}
        return none | start
    _, height = surface(flow)
    speed, outcomes = speeds(flow), flow.outcomes()
    far = reach(flow)
    more = {"screen": screen(flow)} if flow.scene.test == "funnel" else {}
    if flow.scene.test == "lbox":
        more = box_depths(flow)
    inside = float(np.sum(state.particles.mass.numpy().astype(float)) / np.sum(layout.mass))
    return {
        "time": flow.time,
        "top": float((bases(flow) + height).max()),
        "spread": 2 * far if layout.axial else far,
        "inside": inside,
        "fastest": float(speed.max()) if len(speed) else 0.0,
        "mean_speed": float(np.sqrt(np.mean(speed**2))) if len(speed) else 0.0,
        "volume_error": volume(flow) / whole - inside,
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
        "time_step": flow.next_step,
        "steps": float(flow.steps),
    } | more
