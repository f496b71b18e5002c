"""Figure of a mortar with aggregates in a vessel: the shape of the concrete with the aggregates in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.drawing.style import legend_above
from ..core.run.run import Run
from ..mps.free.pictures import plot_free
from .display import STONE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_with_aggregates(run: Run) -> Figure:
    """Return the figure of a flow with a free surface, with a circle for each simulated aggregate.

    In a test about an axis, the horizontal position of a circle is the distance of the aggregate from the axis. A run
    from a folder has no table of aggregates, so that its figure has no circles.
    """
    from matplotlib.collections import EllipseCollection

    figure = plot_free(run)
    bodies = getattr(run, "bodies", None)
    if bodies is None or not bodies.inside.any():
        return figure
    shape, scene = figure.axes[0], run.scene
    place, size = 1e3 * bodies.position[bodies.inside], 1e3 * bodies.size[bodies.inside]
    along = np.hypot(place[:, 0], place[:, 1]) if scene.about_axis or scene.round else place[:, 0]
    colour = tuple(value / 255 for value in STONE)
    shape.add_collection(
        EllipseCollection(
            size, size, np.zeros(len(size)), units="xy", offsets=np.stack([along, place[:, 2]], 1),
            offset_transform=shape.transData, facecolor=(*colour, 0.5), edgecolor=colour, linewidth=0.5,
        )
    )  # fmt: skip
    # A legend has no symbol for a collection of circles, so an empty curve supplies the symbol.
    shape.plot([], [], "o", color=colour, label=f"{len(size)} simulated aggregates")
    legend_above(shape)
    return figure
