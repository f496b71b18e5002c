"""Figure of the verification: errors of all cases, two published curves, and stability limits of contact laws."""

import numpy as np

from ..core.drawing.style import MEASURED, RUN, SECOND, legend_above, new_figure, open_frame, rgb
from .case import Case, Row


def draw(results: list[tuple[Case, list[Row]]]):
    """Return a Matplotlib figure of the errors of all results, and of the curves that the cases have computed."""
    curves = {case.name: case.curves for case, _ in results}
    rows = len({case.name for case, rows in results if any(row.tolerance > 0 for row in rows)})
    plots = [(_errors, results, 0.9 + 0.19 * rows)] if rows else []
    plots += [(plot, curves[name], height) for name, plot, height in CURVES if curves.get(name)]
    heights = [height for *_, height in plots]
    figure = new_figure("", *(heights or [1.0]))
    if plots:
        # Each plot has a separate layout, so that the long names in one plot do not make the other plots narrower.
        parts = figure.subfigures(len(plots), 1, squeeze=False, height_ratios=heights)[:, 0]
        for part, (plot, content, _) in zip(parts, plots, strict=True):
            axes = part.add_subplot()
            plot(axes, content)
            axes.title.set_size("medium")
            open_frame(axes)
    return figure


def _errors(axes, results) -> None:
    rows = [(case, row) for case, rows in results for row in rows if row.tolerance > 0]
    groups = list(dict.fromkeys(case.name for case, _ in rows))
    for passed, marker, size in ((True, "o", 4), (False, "x", 8)):
        chosen = [(case, row) for case, row in rows if row.passed == passed]
        axes.plot(
            [max(row.error, 1e-16) for _, row in chosen], [-groups.index(case.name) for case, _ in chosen], marker,
            markersize=size, color=rgb(RUN), alpha=0.7,
        )  # fmt: skip
    failed = ", crosses outside their tolerance" if any(not row.passed for _, row in rows) else ""
    axes.set(xscale="log", xlabel="relative error [1]", title=f"Errors of all results{failed}")
    axes.set_yticks(range(0, -len(groups), -1), labels=groups)
    axes.set_ylim(-len(groups) + 0.3, 0.7)
    axes.grid(axis="x", color="0.9")


def _oblique(axes, curves) -> None:
    from .impacts import TEST_4

    angle, restitution, spin = TEST_4.T[:3]
    lines = [
        axes.plot(curves["angle"], curves["tangential"], color=rgb(RUN), label="restitution, warpcrete"),
        axes.plot(angle, restitution, ".", color=rgb(MEASURED), label="restitution, published"),
        axes.plot(curves["angle"], curves["spin"] / -1000, color=rgb(SECOND), label="spin, warpcrete"),
        axes.plot(angle, spin / -1000, "x", color=rgb(MEASURED), label="spin, published"),
    ]
    axes.set(
        xlabel="incident angle [degrees]",
        ylabel="tangential restitution [1],\nspin [1000 rad/s]",
        title="Oblique impact of aluminium oxide (Chung & Ooi 2011, test 4)",
    )
    legend_above(axes, [line for (line,) in lines])


def _normalised(axes, curves) -> None:
    lines, dots = [], []
    for (name, values), colour in zip(curves.items(), (RUN, SECOND), strict=True):
        x, ours, published, rigid = values
        what = name.removesuffix(" velocity")
        lines += axes.plot(x, ours, color=rgb(colour), label=f"{what}, half stiffness")
        lines += axes.plot(x, rigid, ":", color=rgb(colour), label=f"{what}, rigid plane")
        dots = axes.plot(x, published, ".", color=rgb(MEASURED), label="both, published")
    axes.set(
        xlabel="normalised incident angle [1]",
        ylabel="normalised velocity\nof rebound [1]",
        xlim=(0, 13.5),
        title="Oblique impact of steel (Chung & Ooi 2011, test 5)",
    )
    legend_above(axes, [*lines, *dots])


def _stability(axes, curves) -> None:
    """Draw a row of marks for each contact law; each mark shows whether the energy grew with one of the time steps."""
    from .stability import FRACTIONS, GROWN

    steps = np.array(FRACTIONS)
    stable = {label: np.asarray(curve) < GROWN for label, curve in curves.items()}
    order = sorted(stable, key=lambda label: stable[label].sum(), reverse=True)
    for row, label in enumerate(order):
        holds = stable[label]
        axes.plot(steps[holds], np.full(holds.sum(), row), "o", color=rgb(RUN), markersize=5)
        axes.plot(steps[~holds], np.full((~holds).sum(), row), "x", color=rgb(RUN), markersize=5)
    axes.axvline(0.8, color="0.6", linestyle="--")
    axes.set(
        xscale="log",
        xlabel="time step over the estimated stable step [1]\n(dashed: default)",
        xlim=(0.57, 8.4),
        ylim=(-0.7, len(order) - 0.3),
        title="Energy grows (crosses) or does not (dots)",
    )
    axes.set_yticks(range(len(order)), labels=order)
    axes.set_xticks([0.6, 0.8, 1, 1.4, 2, 3, 4, 6, 8], labels=["0.6", "0.8", "1", "1.4", "2", "3", "4", "6", "8"])
    axes.minorticks_off()


CURVES = (
    ("oblique impact", _oblique, 3.3),
    ("oblique impact, normalised", _normalised, 3.5),
    ("stability limit", _stability, 3.4),
)
"""Cases for which the figure has a separate plot: name, function that draws the plot, and height of the plot [inch]."""
