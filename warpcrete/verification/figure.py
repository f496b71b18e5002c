"""Figure of the verification: errors of all cases, two published curves, and stability limits of contact laws."""

from __future__ import annotations

import numpy as np

from ..core.drawing.style import MEASURED, RUN, SECOND, legend_beside, rgb
from .case import Case, Row


def draw(results: list[tuple[Case, list[Row]]]):
    """Return a Matplotlib figure of the errors of all results, and of the curves that the cases have computed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9), layout="constrained")
    (errors, oblique), (normalised, stability) = figure.subplots(2, 2)
    by_name = {case.name: case for case, _ in results}
    _errors(errors, results)
    if "oblique impact" in by_name:
        _oblique(oblique, by_name["oblique impact"].curves)
    if "oblique impact, normalised" in by_name:
        _normalised(normalised, by_name["oblique impact, normalised"].curves)
    if "stability limit" in by_name:
        _stability(stability, by_name["stability limit"].curves)
    for axes in (errors, oblique, normalised, stability):
        axes.spines[["top", "right"]].set_visible(False)
        if not axes.has_data():
            axes.set_axis_off()
    return figure


def _errors(axes, results) -> None:
    rows = [(case, row) for case, rows in results for row in rows if row.tolerance > 0]
    groups = list(dict.fromkeys(case.name for case, _ in rows))
    for case, row in rows:
        axes.plot(
            max(row.error, 1e-16), len(groups) - groups.index(case.name), "o", markersize=4,
            color=rgb(RUN) if row.passed else "tab:red", alpha=0.7,
        )  # fmt: skip
    axes.set(xscale="log", xlabel="relative error", yticks=range(len(groups), 0, -1), title="errors of all cases")
    axes.set_yticklabels(groups, fontsize=8)
    axes.grid(axis="x", color="0.9")


def _oblique(axes, curves) -> None:
    from .impacts import TEST_4

    axes.plot(TEST_4[:, 0], TEST_4[:, 1], ".", color=rgb(MEASURED), label="tangential restitution,\npublished")
    axes.plot(curves["angle"], curves["tangential"], color=rgb(RUN), label="this program")
    axes.plot(TEST_4[:, 0], TEST_4[:, 2] / -1000, "x", color=rgb(MEASURED), label="-spin [1000 rad/s],\npublished")
    axes.plot(curves["angle"], curves["spin"] / -1000, color=rgb(SECOND), label="this program")
    axes.set(xlabel="incident angle [degrees]", title="Chung & Ooi 2011, test 4: aluminium oxide")
    legend_beside(axes)


def _normalised(axes, curves) -> None:
    for (name, values), colour in zip(curves.items(), (rgb(RUN), rgb(SECOND)), strict=True):
        x, ours, published, rigid = values
        axes.plot(x, published, "k.")
        axes.plot(x, ours, color=colour, label=f"rebound {name},\nhalf the tangent stiffness")
        axes.plot(x, rigid, ":", color=colour, label="rigid plane")
    axes.set(xlabel="normalised incident angle", xlim=(0, 13.5), title="Chung & Ooi 2011, test 5: steel (dots)")
    legend_beside(axes)


def _stability(axes, curves) -> None:
    from .stability import FRACTIONS

    for label, curve in curves.items():
        finite = np.where(np.isfinite(curve), np.clip(curve, 1e-3, 1e6), 1e6)
        axes.plot(FRACTIONS, finite, ".-", label=label, linewidth=1)
    axes.axvspan(0, 0.8, color="tab:green", alpha=0.08, linewidth=0)
    axes.axhline(2.0, color="0.6", linewidth=0.8, linestyle="--")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="time step over the estimate (default: 0.8)",
        ylabel="energy, last fifth over first (1e6: unstable)",
        xlim=(0.57, 8.4),
        title="stability limit of each contact law",
    )
    axes.set_xticks([0.6, 0.8, 1, 1.4, 2, 3, 4, 6, 8], labels=["0.6", "0.8", "1", "1.4", "2", "3", "4", "6", "8"])
    axes.minorticks_off()  # fmt: skip
    legend_beside(axes)
