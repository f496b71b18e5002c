"""Figures of discrete element runs, drawn with Matplotlib."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..core.drawing.style import (
    MEASURED,
    NOT_STRAIGHT,
    RUN,
    SECOND,
    SERIES,
    THIRD,
    legend_above,
    new_figure,
    open_frame,
    rgb,
)
from ..core.errors import refuse
from ..core.units import number
from ..geometry.rotation import rotate
from .scene.strokes import strokes_of
from .simulation import ElementRun, ElementSimulation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_pressure(runs: Mapping[str, ElementRun] | ElementRun) -> Figure | None:
    """Return a figure of pumping pressure [kPa] against piston travel [m], for one run or several runs by name.

    The figure marks the travel at which the piston reaches its final speed, and the published pressures of the scene of
    the first run. For a single run it also marks the plateau.
    """
    many = runs if isinstance(runs, Mapping) else {"": runs}
    run = next(iter(many.values()))
    captions = {each.scene.caption for each in many.values()}
    figure = new_figure(run.scene.caption if len(captions) == 1 else run.scene.name)
    axes = figure.add_subplot()
    for (name, each), colour in zip(many.items(), itertools.cycle(SERIES)):
        axes.plot(each.series["travel"], each.series["pressure"] / 1e3, label=name or "this run", color=rgb(colour))
    longest = max(float(r.series["travel"].max()) for r in many.values()) or 1.0
    _mark_travel(axes, run, longest)
    if len(many) == 1 and "plateau_pressure" in run.result:
        begin, level = number(run.result["plateau_from_travel"]), number(run.result["plateau_pressure"]) / 1e3
        axes.plot([begin, longest], [level, level], color=rgb(SECOND), linewidth=2.5, alpha=0.7, label="plateau, mean")
    published = run.scene.published
    if published is not None:
        if published.plateau is not None:
            axes.axhline(
                published.plateau / 1e3, color=rgb(MEASURED), linestyle=":", label=f"plateau, {published.source}"
            )
        if published.peak is not None and published.peak_travel is not None:
            axes.plot(published.peak_travel, published.peak / 1e3, "+", color=rgb(MEASURED), markersize=10,
                      label=f"peak, {published.source}")  # fmt: skip
        elif published.peak is not None:
            axes.axhline(
                published.peak / 1e3, color=rgb(MEASURED), linestyle="--", label=f"maximum, {published.source}"
            )
    axes.set(xlabel="piston travel [m]", ylabel="pressure on the piston [kPa]", ylim=(0, None), xlim=(0, longest))
    if len(axes.lines) > 1:
        legend_above(axes)
    open_frame(axes)
    return figure


def _mark_travel(axes: Axes, run: ElementRun, longest: float) -> None:
    """Draw a vertical line at the travel at which the piston reaches its constant speed.

    Nothing is drawn if the piston has no ramp, or if the ramp is not shorter than `longest`, the largest travel [m].
    """
    ramp = run.scene.pipe.ramp if run.scene.pipe is not None else 0.0
    if 0 < ramp < longest:
        axes.axvline(ramp, color="0.7")
        axes.annotate("piston at full speed", (ramp, 0.02), xycoords=("data", "axes fraction"), xytext=(4, 0),
                      textcoords="offset points", color="0.45")  # fmt: skip


def plot_stations(run: ElementRun) -> Figure | None:
    """Return a figure of the quantities that were measured in slices (stations) along a pipe.

    Four panels show stresses [kPa], solid fraction, velocity profiles over the radius [cm/s], and the pressure on the
    piston [kPa] against its travel [m].
    """
    table = run.tables["stations"].columns
    figure = new_figure(run.scene.caption, 2.9, 2.3, 2.9, 2.3)
    stresses, solid, profile, piston = figure.subplots(4, 1, height_ratios=[2.9, 2.3, 2.9, 2.3])
    for name, label, colour in (
        ("axial_stress", "along the pipe", RUN),
        ("pressure", "mean normal", SECOND),
        ("wall_stress", "on the wall", THIRD),
    ):
        stresses.plot(table["place"], table[name] / 1e3, ".-", label=label, color=rgb(colour))
    stresses.set(xlabel="position along the part [m]", ylabel="stress [kPa]", ylim=(0, None))
    piston.plot(run.series["travel"], run.series["pressure"] / 1e3, color=rgb(RUN))
    piston.set(xlabel="piston travel [m]", ylabel="pressure on\nthe piston [kPa]", ylim=(0, None))
    solid.plot(table["place"], table["solid_fraction"], ".-", color=rgb(RUN))
    solid.set(xlabel="position along the part [m]", ylabel="solid fraction\n(overlaps counted twice)", ylim=(0, None))
    rings = [name for name in table if name.endswith("R")]
    middles = [float(name.removeprefix("velocity_").removesuffix("R")) for name in rings]
    full = np.flatnonzero(np.isfinite(table["velocity"]))
    shown = full[np.unique(np.linspace(0, len(full) - 1, 5).astype(int))] if len(full) else ()
    for place, colour in zip(shown, SERIES):
        profile.plot(
            middles, [100 * table[name][place] for name in rings], ".-", color=rgb(colour),
            label=f"{table['place'][place]:.2f} m",
        )  # fmt: skip
    profile.set(xlabel="radius over pipe radius", ylabel="velocity [cm/s]", ylim=(0, None), xlim=(0, 1))
    if len(full):
        legend_above(profile, title="position along the part")
    middle = run.scene.stations.middle
    for axes in (stresses, solid):
        if middle is not None:
            ends = (end - run.scene.stations.origin for end in middle)
            axes.axvspan(*ends, color=rgb(NOT_STRAIGHT), linewidth=0, zorder=0, label="middle of the part")
    legend_above(stresses)
    open_frame(stresses, piston, solid, profile)
    return figure


def draw(simulation: ElementSimulation, run: ElementRun, colouring: str | None) -> Figure | None:
    """Return the figure of a run folder: profiles along the pipe if the run measured them, else a plot of the pressure.

    The pressure is plotted over time if the piston stops between strokes, and otherwise over the piston's travel. The
    result is None if the run measured no pressure.
    """
    if "stations" in run.tables:
        return plot_stations(run)
    if "pressure" not in run.series:
        return None
    return plot_strokes(run) if run.scene.pipe is not None and run.scene.pipe.stops is not None else plot_pressure(run)


def plot_strokes(run: ElementRun) -> Figure | None:
    """Return a figure of pumping pressure [kPa] over time [s], for a piston that stops and starts again.

    The pauses between two strokes of the piston are shaded. A vertical line marks the rest, if the scene has one. A
    rest represents minutes in which the concrete does not move and its yield stress grows. The simulation raises the
    yield stress at once, so a rest takes no simulated time.
    """
    stops = run.scene.pipe.stops if run.scene.pipe is not None else None
    if stops is None:
        hint = "use the scene pipe with 'strokes', or plot_pressure for the pressure over the travel"
        refuse("scene", run.scene.name, "must have a piston that stops and starts again", hint)
    time, pressure = run.series["time"], run.series["pressure"] / 1e3
    figure = new_figure(run.scene.caption)
    axes = figure.add_subplot()
    axes.plot(time, pressure, label="this run", color=rgb(RUN))
    for stop in range(stops.count):
        begin = stop * stops.period + stops.stroke_time
        if begin < time[-1]:
            axes.axvspan(begin, min(begin + stops.pause, time[-1]), color="0.92", zorder=0)
            axes.text(
                begin + 0.5 * stops.pause, 0.02, "stop", color="0.45", ha="center", transform=axes.get_xaxis_transform()
            )
    for stroke, each in enumerate(strokes_of(run.scene.pipe, run.series["time"])):
        top = int(np.flatnonzero(each.moving)[np.argmax(pressure[each.moving])])
        axes.plot(time[top], pressure[top], "+", color=rgb(SECOND), markersize=11, markeredgewidth=2,
                  label=None if stroke else "peak of a stroke")  # fmt: skip
    rest = run.scene.rest
    if rest is not None and rest.at < time[-1]:
        stood = f"{rest.duration:g} s at rest, yield stress grown by {rest.gained:.4g} Pa"
        axes.axvline(rest.at, color=rgb(SECOND), label=stood)
    axes.set(
        xlabel="time without the rest [s]" if rest is not None else "time [s]",
        ylabel="pressure on the piston [kPa]",
        ylim=(0, None),
        xlim=(0, time[-1] or 1.0),
    )
    legend_above(axes)
    open_frame(axes)
    return figure


def plot_aggregates(runs: Mapping[str, ElementRun] | ElementRun, vertical: int = 2, across: int = 0) -> Figure | None:
    """Return a figure of the aggregates at the end of one or several runs, seen from the side, coloured by speed.

    Every sphere of every clump is drawn, the nearest spheres last. `across` and `vertical` are the axes of the figure
    (0, 1, 2 for x, y, z).
    """
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

    many = runs if isinstance(runs, Mapping) else {"": runs}
    figure = Figure(figsize=(2.6 * len(many) + 1.2, 6), layout="constrained", dpi=90)
    all_axes = figure.subplots(1, len(many), sharex=True, sharey=True, squeeze=False)[0]
    speeds = [np.linalg.norm(run.bodies.velocity, axis=1) for run in many.values()]
    upper = 1.2 * max(float(np.median(s)) for s in speeds) or 1.0
    drawn = None
    for axes, (name, run), speed in zip(all_axes, many.items(), speeds, strict=True):
        centres, diameters, values = [], [], []
        for shape, template in enumerate(run.bodies.templates):
            chosen = run.bodies.template == shape
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
