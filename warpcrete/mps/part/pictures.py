"""Matplotlib figures of flows through parts of a pump line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import BEND, NOT_STRAIGHT, RUN, THEORY, legend_above, new_figure, open_frame, rgb
from ...core.run.run import Run
from .scene import PartScene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_part(run: Run) -> Figure:
    """Return a figure of the frictional pressure along the part of the pump line, and of the pressure over time.

    The frictional pressure at an arc length is the loss from this arc length to the end of the part. The theoretical
    frictional pressure of straight pipes is drawn for comparison.
    """
    scene = run.scene
    figure = new_figure(scene.caption, 3.0, 2.4)
    along, course = figure.subplots(2, 1, height_ratios=[3.0, 2.4])
    s, pressure = (np.array(run.result["profile"][name]["value"]) for name in ("place", "friction_ahead"))
    along.plot(s, 1e-3 * pressure, color=rgb(RUN), label=f"this run, after {run.series['time'][-1]:.3g} s")
    fine = np.linspace(0, scene.axis.length, 60)
    theory = [1e-3 * scene.friction_loss(x, scene.axis.length) for x in fine[:-1]] + [0.0]
    along.plot(fine, theory, "--", color=rgb(THEORY), label="straight pipes, theory")
    for name, begin, end in _shaded(scene):
        colour = rgb(BEND if name == "bend" else NOT_STRAIGHT)
        first = name not in along.get_legend_handles_labels()[1]
        along.axvspan(begin, end, color=colour, linewidth=0, zorder=0.5, label=name if first else "")
    along.set(xlabel="position along the axis [m]", ylabel="friction ahead [kPa]", ylim=(0, None))
    legend_above(along)
    course.plot(run.series["time"][1:], 1e-3 * run.series["pressure"][1:], color=rgb(RUN))
    course.set(xlabel="time [s]", ylabel="pressure at\nthe start [kPa]")
    course.set_ylim(0, 1.1e-3 * float(np.max(run.series["pressure"])))
    open_frame(along, course)
    return figure


def _shaded(scene: PartScene) -> Iterator[tuple[str, float, float]]:
    """Yield name, begin [m] and end [m] of each stretch of the part that is not straight pipe of constant bore."""
    odd = [section for section in scene.sections if not section.straight]
    if not odd and scene.middle[1] > scene.middle[0]:
        yield "other bore", *scene.middle
    for section in odd:
        yield section.kind, section.begin, section.end
