"""Style of curves and figures: one width and text size, one meaning for each colour, and legends above the plots."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

WIDTH = 5.8
"""Width of a figure [inch]. Matplotlib's default text of 10 pt is then 17 pixels high on a page that shows the figure
700 pixels wide, and 9 pixels on a phone with 390 pixels."""
CAPTION, LEGEND, MARK = 72, 70, 7
"""Widths of a figure's caption, of its legend, and of the mark in front of a text of the legend [characters]."""
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
    """Return a colour in the form that Matplotlib requires: red, green and blue from 0 to 1."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255


def pumping_caption(name: str, radius: float, concrete: str, flow: float) -> str:
    """Return the caption of a pumping test: its name, pipe diameter, concrete (if named) and volume flow.

    `radius` is the radius of the pipe [m], and `flow` is the volume flow [m3/s].
    """
    words = [name, f"diameter {2e3 * radius:.4g} mm", *([f"concrete {concrete}"] if concrete else ())]
    return ", ".join([*words, f"{3600 * flow:.3g} m3/h"])


def explained(title: str, curves: Sequence[tuple[str, RGB]]) -> str:
    """Return the title of a plot; for several curves, add the name of each curve and the word for its colour."""
    if len(curves) < 2:
        return title
    return f"{title}: {', '.join(f'{name} {NAMES[colour]}' for name, colour in curves)}"


def new_figure(caption: str = "", *heights: float) -> Any:
    """Return an empty Matplotlib figure of the standard width for panels below each other, with a caption at the top.

    `heights` are the heights of the panels with their labels and legends [inch]. The default is one panel of 3.5 inch.
    The width suits Matplotlib's default sizes of text and lines, so plots should not change these sizes.
    """
    from matplotlib.figure import Figure

    lines = textwrap.fill(caption, CAPTION)
    height = sum(heights or (3.5,)) + 0.2 * len(lines.splitlines())
    figure: Any = Figure(figsize=(WIDTH, height), layout="constrained")
    figure.suptitle(lines, fontsize="medium")
    return figure


def legend_above(axes: Any, curves: Sequence[Any] | None = None, width: float = 1.0, **settings: Any) -> None:
    """Put the legend above a plot, between the plot and its title.

    The entries of the legend are the `curves` in their order. Without `curves`, the entries are all curves that have a
    label, sorted by the last value of each curve. `width` is the width of the plot relative to the width of the figure.
    """
    handles, labels = axes.get_legend_handles_labels()
    order: Sequence[int] = sorted(range(len(handles)), key=lambda k: -_end(handles[k]))
    if curves is not None:
        handles, labels, order = curves, [each.get_label() for each in curves], range(len(curves))
    sizes = [MARK + len(labels[k]) for k in order]
    # Matplotlib fills a legend column by column and makes each column as wide as its longest text.
    fitting = (n for n in (4, 3, 2) if sum(max(part, default=0) for part in np.array_split(sizes, n)) <= width * LEGEND)
    columns = min(next(fitting, 1), len(labels))
    axes.legend(
        [handles[k] for k in order], [labels[k] for k in order], loc="lower left", bbox_to_anchor=(-0.02, 1.0),
        frameon=False, borderaxespad=0.2, ncols=columns, columnspacing=1.2, **settings,
    )  # fmt: skip
    rows = -(-len(labels) // columns) + ("title" in settings)
    axes.set_title(axes.get_title(), pad=10 + 15 * rows)  # 15 pt is the height of a row of the legend.


def _end(handle: Any) -> float:
    """Return the last finite value of a curve; -infinity if the legend entry `handle` is no curve of several points."""
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
