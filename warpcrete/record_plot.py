"""Pressure against piston travel as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .simulation import Simulation
from .spine import Recorder, Run
from .state import rotate


def plot_pressure(runs: dict[str, Run] | Run, paper: dict[str, float] | None = None):
    """Matplotlib figure of pumping pressure [kPa] against piston travel [m] of one run, or of several by name.

    `paper` adds the published `peak`, `plateau` [Pa] and `peak_travel` [m] as marks.
    """
    from matplotlib.figure import Figure

    many = runs if isinstance(runs, dict) else {"": runs}
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for name, run in many.items():
        axes.plot(run.series["travel"], run.series["pressure"] / 1e3, label=name or "this run", linewidth=1.6)
    run = next(iter(many.values()))
    ramp = run.scene.notes.get("ramp")
    if ramp and ramp < run.series["travel"].max():
        axes.axvline(ramp, color="0.7", linewidth=0.8)
        axes.annotate("steady from here", (ramp, 0.02), xycoords=("data", "axes fraction"), xytext=(4, 0),
                      textcoords="offset points", color="0.45", fontsize=8)  # fmt: skip
    if paper:
        if "plateau" in paper:
            axes.axhline(paper["plateau"] / 1e3, color="0.4", linestyle=":", label="plateau, Zhan et al. 2019")
        if "peak_travel" in paper:
            axes.plot(paper["peak_travel"], paper["peak"] / 1e3, "k+", markersize=10, label="peak, Zhan et al. 2019")
        elif "peak" in paper:
            axes.axhline(
                paper["peak"] / 1e3, color="k", linestyle="--", linewidth=0.8, label="maximum, Zhan et al. 2019"
            )
    axes.set(xlabel="piston travel [m]", ylabel="pressure on the piston [kPa]", ylim=(0, None))
    axes.set_xlim(0, float(np.max([r.series["travel"].max() for r in many.values()])) or 1)
    if len(many) > 1 or paper:
        axes.legend(frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def plot_aggregates(runs: dict[str, Run] | Run, vertical: int = 2, across: int = 0):
    """Matplotlib figure of the aggregates at the end of one or several runs, seen from the side, coloured by speed.

    Every sphere of every clump is drawn, the near ones last; `vertical` and `across` are the drawn axes.
    """
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

    many = runs if isinstance(runs, dict) else {"": runs}
    figure = Figure(figsize=(2.6 * len(many) + 1.2, 6), layout="constrained", dpi=65)
    all_axes = figure.subplots(1, len(many), sharex=True, sharey=True, squeeze=False)[0]
    speeds = [np.linalg.norm(run.bodies.velocity, axis=1) for run in many.values()]
    upper = 1.2 * max(float(np.median(s)) for s in speeds) or 1.0
    drawn = None
    for axes, (name, run), speed in zip(all_axes, many.items(), speeds, strict=True):
        centres, diameters, values = [], [], []
        for number, template in enumerate(run.bodies.templates):
            chosen = run.bodies.template == number
            size, q = run.bodies.size[chosen], run.bodies.orientation[chosen]
            for offset, radius in zip(template.offsets, template.radii, strict=True):
                centres.append(run.bodies.position[chosen] + rotate(q, size[:, None] * offset))
                diameters.append(2 * radius * size)
                values.append(speed[chosen])
        place, width, value = (np.concatenate(part) for part in (centres, diameters, values))
        depth = 3 - vertical - across
        order = np.argsort(-place[:, depth])
        drawn = EllipseCollection(
            width[order], width[order], np.zeros(len(order)), units="xy", offsets=place[order][:, [across, vertical]],
            offset_transform=axes.transData, array=value[order], cmap="viridis", clim=(0, upper),
            edgecolors="black", linewidths=0.15,
        )  # fmt: skip
        axes.add_collection(drawn)
        axes.set(aspect="equal", title=name, xlabel=f"{'xyz'[across]} [m]")
        axes.autoscale_view()
    all_axes[0].set_ylabel(f"{'xyz'[vertical]} [m]")
    figure.colorbar(drawn, ax=list(all_axes), label="speed [m/s]", shrink=0.6)
    return figure


class PlotRecorder(Recorder):
    """Writes pressure.png when the run ends."""

    def __init__(self, path: Path, paper: dict[str, float] | None = None) -> None:
        self.path, self.paper = path, paper

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Draw, if the scene has a pumping pressure."""
        if "pressure" in run.series:
            partial = self.path.with_name(self.path.name + ".partial")
            plot_pressure(run, self.paper).savefig(partial, dpi=150, format="png")
            partial.replace(self.path)
