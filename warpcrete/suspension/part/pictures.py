"""Matplotlib figures of parts of pump lines with aggregates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import SECOND, rgb
from ...core.run.run import Run
from ...mps.part.pictures import plot_part

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_part_with_aggregates(run: Run) -> Figure:
    """Return the figure that `plot_part` draws of the pressures, and add the fraction of aggregates along the axis.

    The pressure loss and the fraction along the axis are means over the last half of the run.
    """
    figure = plot_part(run)
    along = figure.axes[0]
    fraction = along.twinx()
    place, values = (np.array(run.result["profile"][name]["value"]) for name in ("place", "fraction"))
    fraction.plot(place, values, color=rgb(SECOND))
    fraction.set(ylim=(0, max(0.7, 1.05 * float(values.max()))))
    fraction.set_ylabel("fraction of aggregates", color=rgb(SECOND))
    return figure
