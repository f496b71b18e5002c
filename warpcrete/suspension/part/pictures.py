"""Matplotlib figures of parts of pump lines with aggregates."""

from typing import Any

import numpy as np

from ...core.drawing.style import SECOND, rgb
from ...core.run.run import Run
from ...mps.part.pictures import plot_part

RIGHT_OF_AXIS = 1.2
"""Horizontal position of the legend beside the second axis, in widths of the first pair of axes."""


def plot_part_with_aggregates(run: Run) -> Any:
    """Return a figure of the pressures, as `plot_part` draws it, with the fraction of aggregates along the axis.

    The loss and the fraction along the axis are means over the last half of the run.
    """
    figure = plot_part(run)
    along = figure.axes[0]
    fraction = along.twinx()
    place, values = (np.array(run.result["profile"][name]["value"]) for name in ("place", "fraction"))
    fraction.plot(place, values, color=rgb(SECOND), linewidth=1)
    fraction.set(ylim=(0, max(0.7, 1.05 * float(values.max()))))
    fraction.set_ylabel("fraction of aggregates", color=rgb(SECOND))
    if (legend := along.get_legend()) is not None:
        # Move the legend aside, because the numbers and the label of the second vertical axis lie at its usual place.
        legend.set_bbox_to_anchor((RIGHT_OF_AXIS, 0.5), transform=along.transAxes)
    return figure
