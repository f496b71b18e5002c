"""Figure of a parameter study."""

from __future__ import annotations

import itertools
import textwrap
from typing import Any

import numpy as np

from ..core.drawing.style import MEASURED, SERIES, legend_beside, open_frame, rgb
from ..core.run.method import Quantity
from ..core.units import shown

MARKERS = ("o", "s", "^", "D", "v")
TITLE = ("unit", "diameter", "concrete", "flow", "velocity")
"""Parameters that the title states if they are the same in all cases."""
LABEL_WIDTH = 34
"""Number of characters after which the label of an axis continues on a new line."""
ACROSS = 3  # maximum number of panels in a row of the figure


def draw(study: Any) -> Any:
    """Return a Matplotlib figure of each compared quantity as a function of each varied parameter.

    Error bars show the scatter between seeds. Quantities of the same unit share a panel. Each quantity has its own
    marker, and each set of values of the other varied parameters its own colour. Points of a numeric parameter are
    joined by lines. Marks at the bottom show values of the parameter at which a case or a check failed.
    """
    from matplotlib.figure import Figure

    names = study.varied or ["seed"]
    units = list(dict.fromkeys(each.unit for each in study.compared))
    across = min(len(names), ACROSS)
    down = len(units) * -(-len(names) // ACROSS)
    figure = Figure(figsize=(5.6 * across + 0.6, 3.4 * down), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False)
    rows = study.rows()
    for block, unit in enumerate(units):
        drawn = [each for each in study.compared if each.unit == unit]
        for place, name in enumerate(names):
            axes = grid[block * (down // len(units)) + place // ACROSS, place % ACROSS]
            _panel(axes, study, rows, name, drawn)
    for axes in grid.ravel():
        axes.set_visible(bool(axes.lines or axes.containers))
    figure.suptitle(", ".join([study.scene, *_common(study)]), fontsize=10)
    return figure


def _common(study: Any) -> list[str]:
    """Return the parameters in TITLE that are equal in all cases, with their values, as texts for the title."""
    first = study.cases[0].parameters
    same = [name for name in TITLE if name in first and all(c.parameters.get(name) == first[name] for c in study.cases)]
    return [_worded(study, name, first[name]) for name in same if first[name] is not None]


def _worded(study: Any, name: str, value: Any) -> str:
    """Return the name, the value and the physical unit of a parameter as text, such as "yield stress 100 Pa"."""
    number = f"{value:g}" if isinstance(value, float) else str(value)
    return f"{name.replace('_', ' ')} {number} {study.units.get(name, '')}".strip()


def _panel(axes: Any, study: Any, rows: list[dict[str, Any]], name: str, drawn: list[Quantity]) -> None:
    """Draw all quantities of one physical unit, as functions of one parameter, into one panel of the figure."""
    mine = [row for row in rows if name in row] or rows
    values = list(dict.fromkeys(row.get(name, 0) for row in mine))
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    factor, unit = shown(drawn[0].unit)
    lines: dict[str, list[dict[str, Any]]] = {}
    for row in mine:
        label = ", ".join(_worded(study, n, row[n]) for n in study.varied if n != name and n in row)
        lines.setdefault(label, []).append(row)
    for (k, (label, part)), colour in zip(enumerate(lines.items()), itertools.cycle(SERIES)):
        part = sorted(part, key=lambda row: row.get(name, 0)) if numeric else part
        # Words have positions 0, 1, 2 ... on the axis. A small horizontal offset of each series keeps the error bars of
        # different series apart.
        x = [row.get(name, 0) if numeric else values.index(row.get(name, 0)) + 0.08 * k for row in part]
        for each, marker in zip(drawn, MARKERS):
            y = np.array([row[each.name] for row in part]) * factor
            scatter = np.nan_to_num([row[f"{each.name}_scatter"] for row in part]) * factor
            series = each.title if len(drawn) > 1 or not label else ""
            axes.errorbar(
                x, y, scatter, fmt=marker, linestyle="-" if numeric else "none", color=rgb(colour), capsize=3,
                markersize=5, linewidth=1.4, label=", ".join(filter(None, (series, label))),
            )  # fmt: skip
    if not numeric:
        axes.set_xticks(range(len(values)), [str(v) for v in values])
        axes.margins(x=0.2)
    titles = textwrap.fill(" and ".join(each.title for each in drawn), LABEL_WIDTH)
    axes.set(xlabel=study.heading(name).replace("_", " "), ylabel=f"{titles} [{unit}]")
    lower, upper = axes.get_ylim()
    if lower > 0:  # let the axis start at zero, unless a quantity has both signs
        axes.set_ylim(0, upper)
    for count, label, marker in (("failed", "a case failed", "x"), ("suspect", "a check failed", "1")):
        at = [row.get(name, 0) if numeric else values.index(row.get(name, 0)) for row in mine if row[count]]
        if at:
            axes.plot(at, np.full(len(at), 0.03), marker, color=rgb(MEASURED), markersize=9, markeredgewidth=2,
                      transform=axes.get_xaxis_transform(), label=label)  # fmt: skip
    open_frame(axes)
    if len(axes.get_legend_handles_labels()[1]) > 1:
        legend_beside(axes)
