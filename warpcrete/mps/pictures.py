"""Matplotlib figures of pipe flows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.drawing.style import MEASURED, RUN, SERIES, THEORY, legend_above, new_figure, open_frame, rgb
from ..core.run.run import Run
from ..core.units import number
from ..theory.pipe import velocity
from .common.run import FlowRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEFT = 0.65
"""Fraction of a figure's width that the panels with curves take up, if the figure shows particles on its right side."""


def plot_flow(
    run: Run,
    particles: tuple[np.ndarray, np.ndarray, float] | None = None,
    scale: tuple[str, float, float] | None = None,
    materials: Mapping[str, np.ndarray] | None = None,
) -> Figure:
    """Return a figure of the pressure over time and of velocity profiles, each compared with theory.

    `particles` are drawn next to the curves: their positions [m], their colours as RGB bytes, and their spacing [m].
    `scale` is the label, lowest and highest value of the particles' colour bar. `materials` are the names and RGB bytes
    of colours that show materials instead of a quantity.
    """
    figure = new_figure(run.scene.caption, 3.0, 3.0)
    places = [["pressure"], ["profile"]] if particles is None else [["pressure", "particles"], ["profile", "particles"]]
    axes = figure.subplot_mosaic(places, width_ratios=None if particles is None else [LEFT, 1 - LEFT])
    for draw_panel, panel in ((_pressure, axes["pressure"]), (_profiles, axes["profile"])):
        draw_panel(panel, run)
        legend_above(panel, width=1.0 if particles is None else LEFT)
    open_frame(axes["pressure"], axes["profile"])
    if particles is not None:
        _particles(axes["particles"], *particles, scale, materials or {})
    return figure


def _pressure(axes: Axes, run: Run) -> None:
    theory = number(run.result["pressure_theory"]) / 1e3
    axes.plot(run.series["time"], run.series["pressure"] / 1e3, color=rgb(RUN), label="this run")
    axes.axhline(theory, color=rgb(THEORY), linestyle="--", label="theory")
    if "pressure" in run.scene.published:
        axes.axhline(
            run.scene.published["pressure"] / 1e3,
            color=rgb(MEASURED),
            linestyle=":",
            label="printed (Xu et al.)",
        )
    axes.set(xlabel="time [s]", ylabel=_pressure_label(run.scene))
    # Exclude the first two pressures, which are far below all later ones, when the limits of the pressure axis are
    # computed.
    shown = np.append(run.series["pressure"][2:] / 1e3, theory)
    lowest, highest = np.nanmin(shown), np.nanmax(shown)
    if np.isfinite(lowest + highest):
        margin = max(0.2 * (highest - lowest), 0.05 * abs(highest), 1e-9)
        axes.set_ylim(lowest - margin, highest + margin)


def _pressure_label(scene: Any) -> str:
    place = "on the piston" if scene.ends == "piston" else "over the stretch"
    return f"pressure {place}\n{'with weight ' if scene.weight else ''}[kPa]"


def _profiles(axes: Axes, run: Run) -> None:
    scene = run.scene
    piston = scene.ends == "piston"
    # In a periodic pipe the profiles at all heights are equal, so only the first one is drawn.
    for part, colour in zip(run.result["profiles"][: None if piston else 1], SERIES):
        axes.plot(
            100 * np.array(part["radius"]["value"]), 100 * np.array(part["velocity"]["value"]), ".", markersize=5,
            color=rgb(colour),
            label=f"{100 * part['height']['value']:.0f} cm above the piston" if piston else "this run",
        )  # fmt: skip
    radius = np.linspace(0, scene.radius, 200)
    theory = velocity(scene.concrete, scene.line, scene.theory(), radius)
    axes.plot(100 * radius, 100 * theory, color=rgb(THEORY), linestyle="--", label="theory")
    axes.set(xlabel="distance from the middle [cm]", ylabel="velocity [cm/s]")


def _particles(
    axes: Axes, places: np.ndarray, shades: np.ndarray, spacing: float, scale: tuple[str, float, float] | None,
    materials: Mapping[str, np.ndarray],
) -> None:  # fmt: skip
    """Draw the particles behind a vertical plane through the axis, so that the inside of the flow is visible.

    `places` are the positions [m] and `shades` the colours of the particles. :func:`plot_flow` describes the other
    arguments.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import EllipseCollection
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D

    behind = places[:, 1] > -0.25 * spacing
    places, shades = 100 * places[behind], shades[behind]
    order = np.argsort(-places[:, 1])
    width = np.full(len(places), 100 * spacing)
    axes.add_collection(
        EllipseCollection(
            width,
            width,
            np.zeros(len(places)),
            units="xy",
            offsets=places[order][:, [0, 2]],
            offset_transform=axes.transData,
            facecolors=shades[order] / 255,
            edgecolors="none",
        )
    )
    axes.set(aspect="equal", xlabel="x [cm]", ylabel="height [cm]")
    axes.autoscale_view()
    reach = float(np.abs(places[:, 0]).max()) + 50 * spacing
    axes.set_xticks([-reach, 0.0, reach], [f"{place:.2g}" for place in (-reach, 0.0, reach)])
    if scale is not None:
        label, lower, upper = scale
        axes.figure.colorbar(ScalarMappable(Normalize(lower, upper), "viridis"), ax=axes, label=label)
    if materials:
        style = dict(marker="o", linestyle="")
        marks = [Line2D([], [], color=shade / 255, label=name, **style) for name, shade in materials.items()]
        legend_above(axes, curves=marks, width=1 - LEFT)


def draw(simulation: FlowRun, run: Run, colouring: str | None) -> Figure | None:
    """Return the figure for a run folder; None if the run has only its initial row, which leaves nothing to draw."""
    if "profiles" not in run.result:
        return None
    display = simulation.display(colouring)
    particles = display.centres(), display.colours(), simulation.state.particle_spacing
    return plot_flow(run, particles, display.scale(), display.categories())
