"""Figure of predictions over measurements, with the bands of the predictions, on logarithmic axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .comparison import Comparison
from .kinds import KINDS

COLUMNS = 4
"""Number of panels in a row of the figure."""


def draw(comparisons: Sequence[Comparison]) -> Any:
    """Return a Matplotlib figure with one panel for each kind; held-out cases have filled markers."""
    from matplotlib.figure import Figure

    kinds = [kind for kind in KINDS if any(each.case.kind == kind for each in comparisons)]
    rows = -(-len(kinds) // COLUMNS)
    figure = Figure(figsize=(3.2 * min(len(kinds), COLUMNS), 3.3 * rows), layout="constrained")
    for place, kind in enumerate(kinds):
        axes = figure.add_subplot(rows, min(len(kinds), COLUMNS), place + 1)
        own = [each for each in comparisons if each.case.kind == kind]
        values = [x for each in own for x in (each.measured, each.band.value)]
        low, high = min(values) / 1.6, max(values) * 1.6
        axes.plot([low, high], [low, high], color="0.4", linewidth=1)
        axes.fill_between([low, high], [low / 2, high / 2], [low * 2, high * 2], color="0.92", linewidth=0)
        for each in own:
            down, up = each.band.value - each.band.low, each.band.high - each.band.value
            axes.errorbar(each.measured, each.band.value, [[max(down, 0.0)], [max(up, 0.0)]], fmt="o", color="C0",
                          markerfacecolor="C0" if each.held_out else "white", markersize=5, linewidth=0.8)  # fmt: skip
        unit = KINDS[kind].unit
        shown = "" if unit == "1" else f" [{unit}]"
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low / 1.3, high * 1.3))
        axes.set_title(KINDS[kind].label, fontsize=9)
        axes.set_xlabel(f"measured{shown}", fontsize=8)
        axes.set_ylabel(f"predicted{shown}", fontsize=8)
        axes.tick_params(labelsize=7)
    return figure
