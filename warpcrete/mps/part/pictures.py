"""Matplotlib figures of flows through parts of a line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...core.run.run_loop import Run
from .scene import PartScene


def plot_part(run: Run) -> Any:
    """Return a figure of the frictional pressure along the part of the pump line, and of the pressure over time.

    The frictional pressure at a place is the loss between this place and the end of the part. The theoretical
    frictional pressure of straight pipes is drawn for comparison.
    """
    from matplotlib.figure import Figure

    scene = run.scene
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    along, course = figure.subplots(1, 2, width_ratios=[1.4, 1])
    s, pressure = (np.array(run.result["profile"][name]["value"]) for name in ("place", "friction_ahead"))
    along.plot(s, 1e-3 * pressure, label=f"after {run.series['time'][-1]:.3g} s")
    fine = np.linspace(0, scene.axis.length, 60)
    theory = [1e-3 * scene.friction(x, scene.axis.length) for x in fine[:-1]] + [0.0]
    along.plot(fine, theory, "k--", linewidth=0.9, label="straight pipes, theory")
    for name, begin, end in _shaded(scene):
        along.axvspan(begin, end, color="0.9", zorder=0.5, label=name)
    along.set(xlabel="position along the axis [m]", ylabel="friction ahead [kPa]", ylim=(0, None))
    along.legend(frameon=False, fontsize=8)
    course.plot(run.series["time"][1:], 1e-3 * run.series["pressure"][1:])
    course.set(xlabel="time [s]", ylabel="pressure at the start [kPa]")
    course.set_ylim(0, 1.1e-3 * float(np.max(run.series["pressure"])))
    for axes in (along, course):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _shaded(scene: PartScene) -> Iterator[tuple[str, float, float]]:
    """Yield name, begin and end of each stretch of the pipeline part that is not straight pipe.

    The names serve for the legend. The first name lists the kinds of all stretches, and the other names are empty.
    """
    odd = [section for section in scene.sections if not section.straight]
    if not odd and scene.middle[1] > scene.middle[0]:
        yield "other bore", *scene.middle
    kinds = ", ".join(dict.fromkeys(section.kind for section in odd))
    for number, section in enumerate(odd):
        yield "" if number else kinds, section.begin, section.end


def draw(simulation: Any, run: Run, colouring: str | None) -> Any:
    """Return the figure of a run folder, or None if the run has only its initial row."""
    return plot_part(run) if "profile" in run.result else None
