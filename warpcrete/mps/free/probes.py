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
    "fastest": "m/s",
    "mean_speed": "m/s",
    "volume_error": "1",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
}
"""Of the columns of a row."""


def surface(flow: GridFlow) -> tuple[np.ndarray, np.ndarray]:
    """Height of the concrete over each column of cells [m], and the columns' middles [m]."""
    layout = flow.state.layout
    across = layout.left + (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return across, flow.state.cells("fill").sum(0) * layout.step


def reach(flow: GridFlow) -> float:
    """How far the concrete has come from the axis or the left side, wherever it is widest [m]."""
    layout, fill = flow.state.layout, flow.state.cells("fill")
    if not layout.axial:
        return float((fill.sum(1) * layout.spacing).max())
    radius = (np.arange(layout.cells[0]) + 0.5) * layout.spacing
    return float(np.sqrt(2 * (fill * radius).sum(1) * layout.spacing).max())


def measured(flow: GridFlow, volume: float) -> dict[str, float]:
    """A row of the series; `volume` is that of the concrete, of a metre's depth or a radian."""
    state, layout = flow.state, flow.state.layout
    if not flow.steps:
        top = float(layout.fluid[:, 1].max()) + 0.5 * layout.mark_spacing
        far = float(layout.fluid[:, 0].max()) + 0.5 * layout.mark_spacing
        return dict.fromkeys(UNITS, 0.0) | {"top": top, "spread": 2 * far if layout.axial else far}
    across, height = surface(flow)
    weight = across if layout.axial else np.ones_like(across)
    found = float((state.cells("fill") * weight).sum()) * layout.spacing * layout.step
    u, w = state.faces("velocity")
    across_cell, along_cell = 0.5 * (u[1:-1, 1:-1] + u[1:-1, 2:]), 0.5 * (w[1:-1, 1:-1] + w[2:, 1:-1])
    # A little concrete in a cell of air falls, and says nothing of the heap.
    speed = np.hypot(across_cell, along_cell)[state.cells("fill") > HALF]
    outcomes = flow.outcomes()
    far = reach(flow)
    return {
        "time": flow.time,
        "top": float(height.max()),
        "spread": 2 * far if layout.axial else far,
        "fastest": float(speed.max()) if len(speed) else 0.0,
        "mean_speed": float(np.sqrt(np.mean(speed**2))) if len(speed) else 0.0,
        "volume_error": found / volume - 1,
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
    }
