"""Style of most curves and figures: colours with a fixed meaning, and legends beside the plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

RGB = tuple[int, int, int]
RUN: RGB = (215, 95, 30)
"""Colour of the main simulated quantity in a plot."""
SECOND: RGB = (70, 110, 175)
"""Colour of a second simulated quantity in the same plot."""
THIRD: RGB = (60, 140, 100)
"""Colour of a third simulated quantity in the same plot."""
THEORY: RGB = (130, 130, 130)
"""Colour of values from closed-form theory."""
MEASURED: RGB = (20, 20, 20)
"""Colour of measured or published values."""
BEND: RGB = (247, 214, 165)
"""Background colour of a plot along a line where the line has a bend."""
NOT_STRAIGHT: RGB = (216, 228, 196)
"""Background colour of a plot along a line at other parts that are not straight pipe, such as a reducer."""
SERIES: tuple[RGB, ...] = (
    RUN, SECOND, THIRD, (150, 80, 150), (200, 160, 30), (80, 170, 190), (150, 90, 60), (190, 110, 140),
)  # fmt: skip
"""Colours of several series of one quantity, in the order of their use."""
NAMES: dict[RGB, str] = {RUN: "orange", SECOND: "blue", THIRD: "green", THEORY: "grey", MEASURED: "black"}
"""Names of the colours, for titles of plots that have no room for a legend."""


def rgb(colour: RGB) -> tuple[float, float, float]:
    """Return a colour with components from 0 to 1, as Matplotlib requires it."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255


def pumping_caption(name: str, radius: float, concrete: str, flow: float) -> str:
    """Return a caption with scene, diameter, concrete and flow; `radius` is in m, and `flow` in m3/s."""
    words = [name, f"diameter {2e3 * radius:.4g} mm", *([f"concrete {concrete}"] if concrete else ())]
    return ", ".join([*words, f"{3600 * flow:.3g} m3/h"])


def explained(title: str, curves: Sequence[tuple[str, RGB]]) -> str:
    """Return the title of a plot, followed by the name and the colour of each curve if there are several."""
    if len(curves) < 2:
        return title
    return f"{title}: {', '.join(f'{name} {NAMES[colour]}' for name, colour in curves)}"


def legend_beside(axes: Any, fontsize: float = 8, **settings: Any) -> None:
    """Place the legend to the right of a plot, with the curves in the order of their last values, largest first."""
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(handles)), key=lambda k: -_end(handles[k]))
    axes.legend(
        [handles[k] for k in order], [labels[k] for k in order], loc="center left", bbox_to_anchor=(1.01, 0.5),
        frameon=False, fontsize=fontsize, **settings,
    )  # fmt: skip


def _end(handle: Any) -> float:
    """Return the last finite value of a curve, or minus infinity for other items, which sorts them last."""
    if isinstance(handle, tuple):  # A curve with error bars is a tuple, and its line comes first.
        handle = handle[0]
    if not hasattr(handle, "get_ydata") or handle.get_linestyle() == "None":
        return -np.inf
    y = np.asarray(handle.get_ydata(), float)
    y = y[np.isfinite(y)]
    return float(y[-1]) if len(y) > 1 else -np.inf


def open_frame(*plots: Any) -> None:
    """Hide the top and the right edge of the frame of each plot."""
    for axes in plots:
        axes.spines[["top", "right"]].set_visible(False)
