"""Pictures of flows with a free surface, by Matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.run_loop import Run
from ...core.units import number


def plot_free(run: Run) -> Any:
    """Figure of the shape at the end, beside the mould's, and of spread and height over time."""
    from matplotlib.figure import Figure

    scene = run.scene
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    shape, course = figure.subplots(1, 2, width_ratios=[1.4, 1])
    if "surface" in run.result:
        place, height = (1e3 * np.array(run.result["surface"][name]["value"]) for name in ("place", "height"))
        if scene.axial:
            place, height = np.concatenate([-place[::-1], place]), np.concatenate([height[::-1], height])
        shape.fill_between(place, height, color="0.75", label=f"after {run.series['time'][-1]:.3g} s")
    corners = 1e3 * np.array([*scene.outline, scene.outline[0]])
    for side in (1, -1) if scene.axial else (1,):
        shape.plot(side * corners[:, 0], corners[:, 1], color="0.4", linewidth=0.8, linestyle=":")
    if scene.axial and "spread_theory" in run.result and scene.concrete.yield_stress > 0:
        half = 0.5e3 * number(run.result["spread_theory"])
        r = np.linspace(0, half, 100)
        slope = 2 * scene.concrete.yield_stress / (scene.concrete.density * scene.gravity) * 1e3
        for side in (1, -1):
            shape.plot(side * r, np.sqrt(slope * (half - r)), color="k", linestyle="--", linewidth=0.8,
                       label="long heap, closed form" if side == 1 else None)  # fmt: skip
    shape.set(aspect="equal", xlabel="[mm]", ylabel="height [mm]")
    shape.legend(frameon=False, fontsize=8)
    course.plot(run.series["time"], 1e3 * run.series["spread"], label="spread" if scene.axial else "way of the front")
    course.plot(run.series["time"], 1e3 * run.series["top"], label="highest point")
    course.set(xlabel="time [s]", ylabel="[mm]")
    course.legend(frameon=False, fontsize=8)
    for axes in (shape, course):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def draw(simulation: Any, run: Run, colouring: str) -> Any:
    """The picture of a run folder, if there is more than the start."""
    return plot_free(run) if "surface" in run.result else None
