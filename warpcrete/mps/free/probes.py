"""Measurements of concrete with a free surface."""

from __future__ import annotations

import numpy as np

from ..grid.flow import GridFlow

HALF = 0.5
"""Minimum filled fraction of a cell whose velocity counts."""
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
"""Units of the columns of the time series."""
MORE = {
    "funnel": {"screen": "1"},
    "lbox": {"near_depth": "m", "far_depth": "m", "front": "m"},
}
"""Units of the additional columns of each test."""
FAR_END = 0.05
"""Length at the far end of an L-box over which the depth is averaged [m]."""


def surface(flow: GridFlow) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles of the cell columns [m] and the concrete's height in each [m], averaged over the depth."""
    layout = flow.state.layout
    across = layout.left + (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    full = (flow.state.cells("fill") * flow.state.cells("room")).sum(0) * layout.step
    return across, full if layout.axes == 2 else full.mean(0)


def bases(flow: GridFlow) -> np.ndarray:
    """Return the height at which the concrete in each column of cells begins [m], 0 where there is none.

    The part of a partly filled cell that is wall counts as lying below the concrete.
    """
    step, room = flow.state.layout.step, flow.state.cells("room")
    full = flow.state.cells("fill") * room
    if full.ndim == 3:
        full, room = full.mean(1), room.mean(1)
    lowest = np.argmax(full > 0, axis=0)
    return np.where((full > 0).any(0), (lowest + ((1 - room) * (full > 0)).sum(0)) * step, 0.0)


def reach(flow: GridFlow) -> float:
    """Return how far the concrete reaches from the axis or the left side [m], at the height where it is widest."""
    layout, fill = flow.state.layout, flow.state.cells("fill")
    if not layout.axial:
        return float((fill.sum(-1) * layout.spacing).max())
    radius = (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(np.sqrt(2 * (fill * radius).sum(1) * layout.spacing).max())


def volume(flow: GridFlow) -> float:
    """Return the volume of the concrete in the cells [m3], in a plane per metre of depth, about an axis per radian."""
    layout = flow.state.layout
    full = flow.state.cells("fill") * flow.state.cells("room")
    if layout.axial:
        full = full * (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(full.sum()) * float(np.prod(layout.room.width))


def speeds(flow: GridFlow) -> np.ndarray:
    """Return the speeds in cells that are mostly full [m/s].

    A little concrete in a cell of air falls freely and says nothing about the flow.
    """
    state, inner = flow.state, slice(1, -1)
    velocity, axes = state.faces("velocity"), flow.state.layout.axes
    square = np.zeros(())
    for axis in range(axes):
        lower, upper = [inner] * axes, [inner] * axes
        upper[axes - 1 - axis] = slice(2, None)
        square = square + (0.5 * (velocity[axis][tuple(lower)] + velocity[axis][tuple(upper)])) ** 2
    return np.sqrt(square)[(state.cells("fill") > HALF) & (state.cells("room") > HALF)]


def screen(flow: GridFlow) -> float:
    """Return the filled fraction of the fullest cell in the middle of a funnel, from the outlet to the brim.

    Below a half, light is seen through the funnel.
    """
    fill = flow.state.cells("fill")
    return float(fill.reshape(fill.shape[0], -1)[:, 0].max())


def box_depths(flow: GridFlow) -> dict[str, float]:
    """Return depths behind the gate and at the far end of an L-box, and the front's distance from the gate [m]."""
    across, height = surface(flow)
    scene, half = flow.scene, 0.5 * flow.state.layout.spacing
    gate = scene.dimensions["column_width"]
    behind = (across < gate) & (across > 0.5 * gate)
    came = across[height > half]
    return {
        # The median ignores concrete that clings to the walls of the column.
        "near_depth": float(np.median(height[behind])),
        "far_depth": float(np.median(height[across > scene.width - FAR_END])),
        "front": max(float(came.max(initial=0.0)) + half - gate, 0.0),
    }


def measured(flow: GridFlow, whole: float) -> dict[str, float]:
    """Return a row of the series; `whole` is the initial volume of the concrete, as :func:`volume` gives it.

    The volume error is what the surface loses or gains. Concrete that has left through an open side is not an error.
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
