"""Style of most curves and figures: each colour has one meaning, and legends lie next to the plots, not inside."""

from collections.abc import Sequence
from typing import Any

import numpy as np

RGB = tuple[int, int, int]
RUN: RGB = (215, 95, 30)
"""Colour of the simulated values that a plot is about."""
SECOND: RGB = (70, 110, 175)
"""Colour of a second simulated quantity in the same plot."""
THIRD: RGB = (60, 140, 100)
"""Colour of a third simulated quantity in the same plot."""
THEORY: RGB = (130, 130, 130)
"""Colour of values that a closed-form solution predicts."""
MEASURED: RGB = (20, 20, 20)
"""Colour of measured or published values."""
BEND: RGB = (247, 214, 165)
"""Background colour of the section of a bend, in plots over the distance along a pipeline."""
NOT_STRAIGHT: RGB = (216, 228, 196)
"""Background colour of the section of a part that is neither a straight pipe nor a bend, such as a reducer, in plots
over the distance along a pipeline."""
SERIES: tuple[RGB, ...] = (
    RUN, SECOND, THIRD, (150, 80, 150), (200, 160, 30), (80, 170, 190), (150, 90, 60), (190, 110, 140),
)  # fmt: skip
"""Colours for several curves that show the same quantity in one plot, in the order of the curves."""
NAMES: dict[RGB, str] = {RUN: "orange", SECOND: "blue", THIRD: "green", THEORY: "grey", MEASURED: "black"}
"""Names of the colours, for titles of plots that have no room for a legend."""


def rgb(colour: RGB) -> tuple[float, float, float]:
    """Return a colour as Matplotlib takes it: red, green and blue from 0 to 1."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255


def pumping_caption(name: str, radius: float, concrete: str, flow: float) -> str:
    """Return the caption of a pumping test: its name, pipe diameter, concrete (if named) and volume flow.

    `radius` is the radius of the pipe [m], and `flow` is the volume flow [m3/s].
    """
    words = [name, f"diameter {2e3 * radius:.4g} mm", *([f"concrete {concrete}"] if concrete else ())]
    return ", ".join([*words, f"{3600 * flow:.3g} m3/h"])


def explained(title: str, curves: Sequence[tuple[str, RGB]]) -> str:
    """Return the title of a plot; if it has several curves, add the name of each curve and the word for its colour."""
    if len(curves) < 2:
        return title
    return f"{title}: {', '.join(f'{name} {NAMES[colour]}' for name, colour in curves)}"


def legend_beside(axes: Any, fontsize: float = 8, curves: Sequence[Any] | None = None, **settings: Any) -> None:
    """Put the legend to the right of a plot.

    Its entries are the `curves` in their order. Without them, the entries are all curves that have a label, sorted by
    the value at the right end of each curve.
    """
    handles, labels = axes.get_legend_handles_labels()
    order: Sequence[int] = sorted(range(len(handles)), key=lambda k: -_end(handles[k]))
    if curves is not None:
        handles, labels, order = curves, [each.get_label() for each in curves], range(len(curves))
    axes.legend(
        [handles[k] for k in order], [labels[k] for k in order], loc="center left", bbox_to_anchor=(1.01, 0.5),
        frameon=False, fontsize=fontsize, **settings,
    )  # fmt: skip


def _end(handle: Any) -> float:
    """Return the value of a curve at its right end; -infinity for a legend entry that is not a curve."""
    # A curve with error bars is a container whose first line is the curve itself.
    line = getattr(handle, "lines", (handle,))[0]
    if not hasattr(line, "get_ydata"):
        return -np.inf
    y = np.asarray(line.get_ydata(), float)
    y = y[np.isfinite(y)]
    return float(y[-1]) if len(y) > 1 else -np.inf


def open_frame(*plots: Any) -> None:
    """Hide the upper and the right edge of the frame that Matplotlib draws around each plot."""
    for axes in plots:
        axes.spines[["top", "right"]].set_visible(False)
