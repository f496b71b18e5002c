"""Figure of predicted against measured values on logarithmic axes, with the uncertainty bands of the predictions."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import RUN, SECOND, new_figure, rgb
from .cases import BASES
from .comparison import Comparison
from .kinds import KINDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 2
"""Number of panels in a row of the figure."""
TITLE = 28
"""Maximum number of characters in a line of a panel's title, before the title continues on a new line."""
MOST_LABELLED = 100
"""Ratio of the largest to the smallest value of an axis above which the axis labels powers of ten only."""
COLOUR, WHITE = {"color": rgb(SECOND)}, {"color": rgb(SECOND), "markerfacecolor": "white"}
STYLES = {
    "measured, others": {"marker": "o", **WHITE},
    "measured, held out": {"marker": "o", **COLOUR},
    "by a model or guideline, others": {"marker": "D", **WHITE},
    "by a model or guideline, held out": {"marker": "D", **COLOUR},
    "simulated as a flow": {"marker": "s", "color": rgb(RUN)},
}
"""Groups of cases in the figure, each with the keyword arguments of Matplotlib for its markers. Held-out cases were not
used to fit constants."""
SHOWN = {"pipe": (1e-3, "kPa/m"), "line": (1e-5, "bar"), "slump": (1e3, "mm"), "spread": (1e3, "mm")}
"""Displayed unit for each kind of measurement: the factor from the SI unit to this unit, and its name. Kinds that are
not listed are shown in SI units."""


def draw(comparisons: Sequence[Comparison]) -> Figure:
    """Return a Matplotlib figure with one panel for each kind of measurement; held-out cases have filled markers."""
    kinds = [kind for kind in KINDS if any(each.case.kind == kind for each in comparisons)]
    rows = -(-len(kinds) // COLUMNS)
    figure = new_figure("", *[2.4] * rows)
    for place, kind in enumerate(kinds):
        axes = figure.add_subplot(rows, min(len(kinds), COLUMNS), place + 1)
        _panel(axes, kind, [each for each in comparisons if each.case.kind == kind])
    shown = {}
    for axes in figure.axes:
        shown |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _group(comparison: Comparison) -> str:
    """Return the group of cases to which a comparison belongs, a key of :data:`STYLES`."""
    if comparison.simulated:
        return "simulated as a flow"
    basis = "measured" if comparison.case.basis == BASES[0] else "by a model or guideline"
    return f"{basis}, {'held out' if comparison.held_out else 'others'}"


def _panel(axes: Axes, kind: str, own: Sequence[Comparison]) -> None:
    """Draw all comparisons of one kind of measurement into one panel of the figure."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    factor, unit = SHOWN.get(kind, (1.0, KINDS[kind].unit))
    measured = [factor * each.measured for each in own]
    values = [*measured, *(factor * each.band.value for each in own)]
    left, right = min(measured) / 1.6, max(measured) * 1.6
    low, high = min(values) / 2, max(values) * 2
    line = np.array([left, right])
    axes.plot(line, line, color="0.4", label="prediction equals measurement")
    axes.fill_between(line, line / 2, line * 2, color="0.92", linewidth=0, label="within a factor of two")
    for group, style in STYLES.items():
        chosen = [each for each in own if _group(each) == group]
        if not chosen:
            continue
        ends = [
            [max(x.band.value - x.band.low, 0.0) for x in chosen],
            [max(x.band.high - x.band.value, 0.0) for x in chosen],
        ]
        axes.errorbar([factor * x.measured for x in chosen], [factor * x.band.value for x in chosen],
                      [[factor * x for x in end] for end in ends], linestyle="none",
                      markersize=5, label=group, **style)  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=(left, right), ylim=(low, high))
    for axis, ratio in ((axes.xaxis, right / left), (axes.yaxis, high / low)):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ratio < MOST_LABELLED else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    shown = "" if unit == "1" else f" [{unit}]"
    axes.set(xlabel=f"measured{shown}", ylabel=f"predicted{shown}")
    axes.set_title(textwrap.fill(KINDS[kind].label, TITLE), fontsize="medium")
