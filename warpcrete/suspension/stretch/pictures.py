"""Matplotlib figure of mortar with aggregates in a stretch of pipe."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import RUN, SECOND, THEORY, legend_above, new_figure, open_frame, rgb
from ...core.run.run import Run
from .quantities import LATE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_stretch(run: Run) -> Figure:
    """Return a figure of velocity and fraction of aggregates over the radius at the end, and of the flow over time."""
    figure = new_figure(run.scene.caption, 2.8, 2.5, 2.8)
    speed, fraction, course = figure.subplots(3, 1)
    profile = {name: np.array(column["value"]) for name, column in run.result["profile"].items()}
    radius = 1e3 * profile["radius"]
    speed.plot(radius, profile["velocity"], color=rgb(RUN), label=f"this run at {run.series['time'][-1]:.3g} s")
    speed.plot(radius, profile["velocity_alone"], "--", color=rgb(THEORY), label="mortar alone, theory")
    speed.set(xlabel="distance from the axis [mm]", ylabel="velocity [m/s]", xlim=(0, None), ylim=(0, None))
    legend_above(speed)
    fraction.plot(radius, profile["fraction"], color=rgb(SECOND))
    fraction.set(xlabel="distance from the axis [mm]", ylabel="fraction of aggregates", xlim=(0, None), ylim=(0, None))
    fixed = run.scene.mean_velocity is not None
    name, factor, label = ("gradient", 1e-3, "friction [kPa/m]") if fixed else ("flow", 3600, "flow [m3/h]")
    course.plot(run.series["time"][1:], factor * run.series[name][1:], color=rgb(RUN))
    late = run.series["time"] >= (1 - LATE) * run.series["time"][-1]
    mean = factor * float(run.series[name][late].mean())
    course.plot(run.series["time"][late], np.full(late.sum(), mean), ":", color=rgb(RUN), label="mean in the report")
    legend_above(course)
    course.set(xlabel="time [s]", ylabel=label, ylim=(0, None))
    open_frame(speed, fraction, course)
    return figure
