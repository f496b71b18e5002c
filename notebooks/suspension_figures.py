"""Figures of the slip layer and of the migration of aggregates, for `suspension_tables.py`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from warpcrete.core.drawing.style import MEASURED, SERIES, THEORY, legend_above, new_figure, rgb
from warpcrete.theory.pipe import CONCRETES

FRACTIONS = (0.2, 0.3, 0.4)
"""Volume fractions of the aggregates, in the order of their colours."""


class Layer(NamedTuple):
    """Slip layer that formed in mortar with aggregates."""

    fraction: float
    """Volume fraction of aggregates in the whole pipe."""
    distance: np.ndarray
    """Distances from the wall [m]."""
    profile: np.ndarray
    """Volume fraction of aggregates at these distances, at the largest stress."""
    slip: np.ndarray
    """Slip velocities [m/s]."""
    stress: np.ndarray
    """Stresses at the wall at these slip velocities [Pa]."""
    slope: float
    """Viscosity of the layer over its thickness [Pa s/m]."""
    start: float
    """Yield stress of the layer [Pa]."""


def layer_figure(layers: Iterable[Layer]) -> Figure:
    """Return a figure with the fraction over the distance from the wall, and with the laws of the layers."""
    figure = new_figure("pipe, diameter 100 mm, mortar of concrete no1 that sticks to the wall", 3.3, 3.1)
    top, bottom = figure.subplots(2, 1, height_ratios=[3.3, 3.1])
    for layer in layers:
        colour = rgb(SERIES[FRACTIONS.index(layer.fraction)])
        top.plot(1e3 * layer.distance, layer.profile, color=colour)
        line = np.geomspace(layer.slip.min(), layer.slip.max())
        bottom.loglog(1e3 * line, layer.slope * line + layer.start, color=colour)
        bottom.loglog(1e3 * layer.slip, layer.stress, "o", color=colour, markersize=5,
                      label=f"aggregates {layer.fraction:g}")  # fmt: skip
    own, line = CONCRETES["no1"], np.geomspace(1e-3, 0.8)
    bottom.loglog(1e3 * line, own.slip_viscosity * line + own.slip_yield, "--", color=rgb(MEASURED),
                  label="Xu et al.")  # fmt: skip
    top.set(xlabel="distance from the wall [mm]", ylabel="volume fraction\nof aggregates", xlim=(0, 25),
            ylim=(0, 0.65), title="aggregates near the wall, wall stress 4000 Pa")  # fmt: skip
    bottom.set(xlabel="slip velocity [mm/s]", ylabel="stress at the wall [Pa]", title="law of the slip layer",
               xticks=(1, 10, 100, 1000), yticks=(300, 1000, 4000))  # fmt: skip
    for axis in (bottom.xaxis, bottom.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    legend_above(top, bottom.get_legend_handles_labels()[0], width=0.9)
    return figure


def migration_figure(curves: Iterable[tuple[Mapping[str, Any], np.ndarray, np.ndarray]]) -> Figure:
    """Return a figure with the change of the inner fraction [points] over time [s] in sheared and in pumped mortar.

    Each of the `curves` has the values that distinguish its case, times and changes.
    """
    figure = new_figure("pipe, diameter 100 mm, aggregates in mortar", 3.4, 3.4)
    sheared, pumped = figure.subplots(2, 1)
    for varied, time, change in curves:
        kind, fraction, seed = varied["kind"], varied.get("fraction"), varied["seed"]
        axes, line = (sheared if kind == "sheared" else pumped), ("-", "--")[seed % 2]
        label = f"fraction {fraction:g}, seed {seed}" if fraction else f"concrete {kind}"
        colour = SERIES[FRACTIONS.index(fraction) if fraction else int(kind[2:]) - 1]
        axes.plot(time, change, line, color=rgb(colour), label=label)
    titles = {sheared: "mortar of no1 sticks to the wall, wall stress 2000 Pa", pumped: "concretes slip, 1500 cm3/s"}
    for axes, title in titles.items():
        axes.set(xlabel="time [s]", ylabel="change of the inner fraction\n[percentage points]", title=title)
        axes.axhline(0.0, color=rgb(THEORY), linewidth=1, zorder=0)
        legend_above(axes, width=0.9)
    return figure
