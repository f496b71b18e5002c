"""Pictures of flows through parts, by Matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.run_loop import Run
from .scene import PartScene


def plot_part(run: Run) -> Any:
    """Figure of the friction that is still ahead along the part, beside straight pipes by theory, and of the pressure
    over time.
    """
    from matplotlib.figure import Figure

    scene = run.scene
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    along, course = figure.subplots(1, 2, width_ratios=[1.4, 1])
    s, pressure = (np.array(run.result["profile"][name]["value"]) for name in ("place", "friction_ahead"))
    along.plot(s, 1e-3 * pressure, label=f"after {run.series['time'][-1]:.3g} s")
    fine = np.linspace(0, scene.axis.length, 60)
    theory = [1e-3 * scene.friction(x, scene.axis.length) for x in fine[:-1]] + [0.0]
    along.plot(fine, theory, "k--", linewidth=0.9, label="as straight pipes, theory")
    begin, end = scene.middle
    if end > begin:
        along.axvspan(begin, end, color="0.92", zorder=0, label=_middle(scene))
    along.set(xlabel="along the axis [m]", ylabel="friction ahead [kPa]", ylim=(0, None))
    along.legend(frameon=False, fontsize=8)
    course.plot(run.series["time"][1:], 1e-3 * run.series["pressure"][1:])
    course.set(xlabel="time [s]", ylabel="pressure at the start [kPa]")
    course.set_ylim(0, 1.1e-3 * float(np.max(run.series["pressure"])))
    for axes in (along, course):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _middle(scene: PartScene) -> str:
    """What lies between the straight stretches."""
    names = ["bend"] * (len(scene.axis.pieces) > 1) + ["taper"] * (scene.taper is not None)
    return ", ".join(names) or "other bore"


def draw(simulation: Any, run: Run, colouring: str | None) -> Any:
    """The picture of a run folder, if there is more than the start."""
    return plot_part(run) if "profile" in run.result else None
