"""Matplotlib figures of free-surface flows."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import SERIES, THEORY, legend_above, new_figure, open_frame, rgb
from ...core.run.run import Run
from ...core.units import number, shown
from ...theory.vessels import heap_depth
from .scene import FreeScene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LENGTHS = "position or depth"
"""Label of the vertical axis of a plot with more than two curves, all of which show lengths."""


def plot_free(run: Run) -> Figure:
    """Return a figure of the final shape with the mould's outline, and of spread and height over time."""
    scene = run.scene
    figure = new_figure(scene.caption, 3.0, 2.7)
    shape, course = figure.subplots(2, 1)
    if "surface" in run.result:
        place, base, height = (
            1e3 * np.array(run.result["surface"][name]["value"]) for name in ("place", "base", "height")
        )
        if scene.about_axis:
            place, base, height = -np.r_[place[::-1], -place], np.r_[base[::-1], base], np.r_[height[::-1], height]
        shape.fill_between(place, base, base + height, color="0.75", label=f"after {run.series['time'][-1]:.3g} s")
    corners = 1e3 * np.clip(np.array([*scene.outline, scene.outline[0]]), 0.0, [scene.width, scene.height])
    # The edge on the axis of symmetry is no part of the vessel.
    along_axis = (corners[1:, 0] == 0) & (corners[:-1, 0] == 0) & scene.about_axis
    corners = np.insert(corners, np.flatnonzero(along_axis) + 1, np.nan, axis=0)
    for side in (1, -1) if scene.about_axis else (1,):
        shape.plot(
            side * corners[:, 0],
            corners[:, 1],
            color="0.4",
            linestyle=":",
            label="at the start" if side == 1 else None,
        )
    if "spread_heap" in run.result:
        half, concrete = 0.5 * number(run.result["spread_heap"]), scene.concrete
        r = np.linspace(0, half, 100)
        depth = heap_depth(half - r, concrete.yield_stress, concrete.density, scene.gravity)
        for side in (1, -1):
            shape.plot(1e3 * side * np.r_[r, half], 1e3 * np.r_[depth, 0.0], "--", color=rgb(THEORY),
                       label="heap, closed form" if side == 1 else None)  # fmt: skip
    shape.set(
        aspect="equal",
        adjustable="box",
        anchor="W",
        xlabel="distance from the axis [mm]" if scene.about_axis else "position [mm]",
        ylabel="height [mm]",
    )
    blocks = (*scene.blocks, *((scene.gate,) if scene.gate and not scene.about_axis else ()))
    for number_of_block, block in enumerate(blocks):
        corners = 1e3 * np.clip(np.array([*block, block[0]]), 0.0, [scene.width, scene.height])
        shape.fill(corners[:, 0], corners[:, 1], color="0.9", zorder=0, label=None if number_of_block else "wall")
    legend_above(shape)
    unit = "m"
    for (name, label), colour in zip(_curves(scene).items(), SERIES):
        unit = run.units[name]
        course.plot(run.series["time"], shown(unit)[0] * run.series[name], color=rgb(colour), label=label)
    # The legend names the curves; more than two names would not fit beside the axis.
    names = list(_curves(scene).values())
    words = textwrap.fill(" and ".join(names), 24) if len(names) < 3 else LENGTHS
    course.set(xlabel="time [s]", ylabel=f"{words} [{shown(unit)[1]}]")
    legend_above(course)
    open_frame(shape, course)
    return figure


def _curves(scene: FreeScene) -> Mapping[str, str]:
    """Return the columns of the time series that are drawn over time, each with its label."""
    if scene.test and scene.test.curves:
        return scene.test.curves
    return {"spread": "spread" if scene.about_axis else "position of the front", "top": "highest point"}
