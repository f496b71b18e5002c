"""Tests of the plots of runs: legends, captions and sizes."""

import re
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from warpcrete import scenes
from warpcrete.core.drawing.style import legend_above, new_figure
from warpcrete.mps.free.pictures import plot_free
from warpcrete.studies.validation import figure as validation


def test_a_legend_lists_curves_by_their_ends_with_and_without_error_bars():
    axes = Figure().add_subplot()
    for label, end in (("lowest", 1.0), ("highest", 4.0), ("third", 2.0)):
        axes.errorbar([0, 1], [3.0, end], [0.1, 0.1], label=label)
    axes.plot([0, 1], [0.0, 3.0], label="second")
    axes.axvspan(0, 1, label="area")
    legend_above(axes)
    found = [text.get_text() for text in axes.get_legend().get_texts()]
    assert found == ["highest", "second", "third", "lowest", "area"]


@pytest.mark.parametrize(
    "labels",
    [
        ["coarse-graining", "time step", "combined", "front", "as given", "settling", "scatter of the finest"],
        ["simulated", "theory, as straight pipe", "weight alone", "likely range", "bend", "restart after 10 min"],
        ["around 0 degrees, a quarter of the circumference", "all round", "180 degrees"],
        ["plateau, Zhan et al. 2019", "this run", "peak, Zhan et al. 2019"],
    ],
)
def test_caption_legend_and_plot_share_the_width_of_a_figure(labels):
    """A legend that is too wide would leave the edge of the figure or take the width of the plot."""
    figure = new_figure("part-dem bend-to-horizontal, diameter 100 mm, concrete zhan, 5.4 m3/h")
    axes = figure.add_subplot(xlabel="time [s]", ylabel="pressure [kPa]")
    for label in labels:
        axes.plot([0, 1], [0, 100], label=label)
    legend_above(axes)
    FigureCanvasAgg(figure).draw()
    parts = [figure.texts[0], axes.get_legend(), axes]
    caption, legend, plot = (part.get_window_extent() for part in parts)
    assert min(caption.x0, legend.x0) >= 0 and max(caption.x1, legend.x1) <= figure.bbox.width
    assert legend.y0 >= plot.y1 - 1 and caption.y0 >= legend.y1
    assert plot.width > 0.8 * figure.bbox.width


def test_figures_of_the_package_have_the_standard_sizes():
    """Sizes of their own would make the text of some figures too small for a phone."""
    own = re.compile(r"figsize=|fontsize=[\d.]|labelsize=")
    allowed = {"style.py", "legend.py"}  # The style itself, and the legend of a recording in the viewer.
    for path in sorted((Path(__file__).parents[2] / "warpcrete").rglob("*.py")):
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if own.search(line)]
        # Pictures of the aggregates of several runs have a panel of equal size for each run.
        lines = [line for line in lines if "len(many)" not in line]
        assert path.name in allowed or not lines, (path.name, lines)


def test_figures_use_the_colours_of_the_style():
    """Matplotlib's own colours have other meanings than those of the style."""
    own = re.compile(r"""["']C(\d|\{)|["']k[-+.:xo]|color="k"|tab:""")
    root = Path(__file__).parents[2]
    for folder in ("warpcrete", "notebooks", "tests/bench"):
        for path in sorted((root / folder).rglob("*.py")):
            lines = [line for line in path.read_text(encoding="utf-8").splitlines() if own.search(line)]
            assert not lines, (path.name, lines)


def test_the_outline_of_a_mould_has_no_line_on_its_axis():
    """The outline of a vessel about an axis is the polygon of one half, which is closed along the axis."""
    scene = scenes.slump()
    rising = np.linspace(0, 1, 3)
    series = {"time": rising, "spread": rising, "top": rising}
    run = SimpleNamespace(scene=scene, result={}, series=series, units={"spread": "m", "top": "m"})
    shape = plot_free(run).axes[0]
    mould = [line.get_xydata() for line in shape.lines if line.get_linestyle() == ":"]
    assert len(mould) == 2 and all(np.nanmax(line[:, 1]) == 300 for line in mould)
    for line in mould:
        assert not any((start[0] == 0) and (end[0] == 0) for start, end in pairwise(line))
    # The panel ends where the vessel ends, although both of its axes have one scale.
    FigureCanvasAgg(shape.figure).draw()
    assert shape.get_xlim()[0] > -120 and shape.get_xlim()[1] < 120


@pytest.mark.parametrize(("low", "high"), [(5, 290), (100, 290)])
def test_values_along_an_axis_of_the_validation_stand_apart(low, high):
    """A panel of slumps ranges from 5 to 290 mm."""
    band = [SimpleNamespace(value=1e-3 * each, low=0.5e-3 * each, high=2e-3 * each) for each in (low, high)]
    cases = [
        SimpleNamespace(
            case=SimpleNamespace(kind="slump", basis="measured"),
            measured=each.value,
            band=each,
            simulated=False,
            held_out=False,
        )
        for each in band
    ]
    drawing = validation.draw(
        cases
        + [SimpleNamespace(**vars(each) | {"case": SimpleNamespace(kind="spread", basis="measured")}) for each in cases]
    )
    FigureCanvasAgg(drawing).draw()
    for axes in drawing.axes:
        ends = [label.get_window_extent() for label in axes.get_xticklabels() if label.get_text()]
        shown = sorted((end.x0, end.x1) for end in ends if axes.bbox.x0 <= end.x0 + end.width / 2 <= axes.bbox.x1)
        assert len(shown) >= 2
        assert all(after[0] > before[1] + 10 for before, after in pairwise(shown)), shown
