"""What is measured of concrete that flows through a part."""

from __future__ import annotations

import numpy as np

from ...kernels.mps.grid.cells import LIQUID
from ..grid.flow import GridFlow
from .layout import stations
from .scene import CLEAR, PartScene

UNITS = {
    "time": "s",
    "pressure": "Pa",
    "upstream_gradient": "Pa/m",
    "middle_loss": "Pa",
    "downstream_gradient": "Pa/m",
    "outflow_error": "1",
    "fastest": "m/s",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
}
"""Of the columns of a row."""


def loss_along(flow: GridFlow) -> tuple[np.ndarray, np.ndarray]:
    """Arc lengths [m] and the friction still ahead there, the mean over each section [Pa]; weight is left out."""
    scene: PartScene = flow.scene
    layout = flow.state.layout
    s, h = stations(scene, layout.room), layout.spacing
    room = flow.state.cells("room")
    weight = np.where((flow.state.cells("liquid") > 0) & (s > 0) & (s < scene.axis.length), room, 0.0)
    bins = np.clip((s / h).astype(int), 0, int(scene.axis.length / h))
    total, whole, place = (
        np.bincount(bins.ravel(), (weight * values).ravel())
        for values in (flow.state.cells("pressure"), np.ones_like(s), s)
    )
    there = whole > 0.3 * np.median(whole[whole > 0])
    return place[there] / whole[there], total[there] / whole[there]


def straight_lines(scene: PartScene, s: np.ndarray, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressure at the start and its slope, for each of the straight stretches before and behind the middle: lines
    through what lies a radius off its ends.
    """
    begin, end = scene.middle
    first, last = float(scene.bore(0.0)), float(scene.bore(scene.axis.length))
    lines = []
    for low, high in (
        (CLEAR * first, begin - CLEAR * first * (end > begin)),
        (end + CLEAR * last * (end > begin), scene.axis.length - CLEAR * last),
    ):
        chosen = (s > low) & (s < high)
        lines.append(np.polyfit(s[chosen], pressure[chosen], 1) if chosen.sum() > 2 else np.full(2, np.nan))
    return lines[0], lines[1]


def measured(flow: GridFlow) -> dict[str, float]:
    """A row of the series. `pressure` is that at the start of the part, with the concrete's weight over its rise."""
    scene: PartScene = flow.scene
    if not flow.steps:
        return dict.fromkeys(UNITS, 0.0)
    before, behind = straight_lines(scene, *loss_along(flow))
    begin, end = scene.middle
    outcomes = flow.outcomes()
    layout = flow.state.layout
    top = layout.shape[0] - 1
    out = flow.state.faces("velocity")[2][top] * flow.state.faces("volume")[2][top]
    open_side = flow.state.faces("kind")[2][top] == int(LIQUID)
    # A face of the open side stands for half a cell of concrete.
    whole = float(np.sum(out, where=open_side)) / (0.5 * layout.spacing)
    half = 0.5 if scene.wall is None else 1.0
    velocity = flow.state.faces("velocity")
    moving = flow.state.faces("kind") == int(LIQUID)
    weight = scene.concrete.density * scene.gravity * scene.rise
    return {
        "time": flow.time,
        "pressure": float(np.polyval(before, 0.0)) + weight,
        "upstream_gradient": -float(before[0]),
        "middle_loss": float(np.polyval(before, begin) - np.polyval(behind, end)),
        "downstream_gradient": -float(behind[0]),
        "outflow_error": whole / (half * scene.flow) - 1,
        "fastest": float(np.abs(np.where(moving, velocity, 0.0)).max()),
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
    }
