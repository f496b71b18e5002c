"""Figure of a parameter study."""

from __future__ import annotations

import itertools
import math
import textwrap
import warnings
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.drawing.style import MEASURED, SERIES, THEORY, legend_above, new_figure, open_frame, rgb
from ..core.errors import SceneError, known_names, one_of, refuse
from ..core.inputs.amounts import UNITS
from ..core.inputs.concretes import is_file
from ..core.records import Record
from ..core.run.method import Quantity
from ..core.units import rounded, shown
from ..methods import method_of
from ..mps.common.mixes import CONSTANTS
from ..scenes import modules

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = ("o", "s", "^", "D", "v")
TITLE = ("unit", "diameter", "concrete", "flow", "velocity")
"""Names of scene parameters that the title of a study's figure states if they are the same in all cases."""
LABEL_WIDTH = 34
"""Number of characters after which the label of an axis continues on a new line."""
HEIGHT = 3.2  # height of a panel with its legend [inch]
LEGEND_ROW = 0.21  # height of a row of a legend [inch]
USUAL_ROWS = 2  # number of legend rows that fit into a panel of height HEIGHT
MOST_TICKS = 6  # number of values of a numeric parameter up to which each value has a tick
TICKS = 4  # maximum number of intervals between labelled values of a numeric parameter
THEORY_POINTS = 21  # number of points of a theoretical curve
MARKS = (("failed", "a case failed", "x", 0.04), ("suspect", "a check failed", "1", 0.1))
"""Marks at the bottom of a panel of the figure. Each entry holds the name of the column that counts failed runs or
failed checks, the label in the legend, the Matplotlib marker, and the height of the mark as a fraction of the panel's
height."""


PARTIAL = "some runs have no value"
"""Label in the legend for the rings around mean values. A ring marks a mean that leaves out some of the finished runs,
because they have no value of the quantity."""


def draw(
    study: Any, quantity: str | None = None, x: str | None = None, unit: str | None = None, y_unit: str | None = None
) -> Any:
    """Return a Matplotlib figure of each compared quantity as a function of each varied parameter.

    Error bars show the scatter between seeds. Quantities of the same unit share a panel. Each quantity has its own
    marker, and each set of values of the other varied parameters its own colour. Points of a numeric parameter are
    joined by lines. Closed-form predictions are dashed grey lines. Marks at the bottom show values of the parameter at
    which a case or a check failed. Rings mark those means to which only some of the runs contribute.
    :meth:`warpcrete.studies.study_result.Study.plot` explains `quantity`, `x`, `unit` and `y_unit`.
    """
    names = study.varied or ["seed"]
    if x is not None:
        one_of("x", x, names)
        names = [x]
    elif quantity is None and len(names) > 1 and _has_all_combinations(study, names):
        # One panel with series shows all cases.
        names = [max(names, key=lambda name: len({str(case.varied[name]) for case in study.cases}))]
    compared = study.compared
    if quantity is not None:
        known = _measured(study)
        if quantity not in known:
            refuse(
                "quantity",
                quantity,
                "is not the name of a number in the results of this study",
                known_names(quantity, known),
            )
        compared = [known[name] for name in (quantity, f"{quantity}_theory") if name in known]
    else:
        # A figure that shows the theoretical values needs no panel of deviations from theory.
        drawn = {each.name for each in compared}
        compared = [
            each
            for each in compared
            if not each.name.endswith("_error") or f"{each.name.removesuffix('_error')}_theory" not in drawn
        ]
        predicted = [f"{each.name}_theory" for each in compared]
        compared += [each for name, each in _measured(study).items() if name in predicted and name not in drawn]
    if unit is not None and x is None and len(study.varied) > 1:
        refuse("unit", unit, "needs 'x', because several parameters are varied", f"add, for example, x={names[0]!r}")
    scales = {name: _scale("unit", unit, study.units.get(name, ""), _unit(study, name)) for name in names}
    units = list(dict.fromkeys(each.unit for each in compared))
    # Panels stand below each other, because the text of panels side by side is too small on a page.
    count = len(units) * len(names)
    figure = new_figure(", ".join([study.scene, *_common(study)]), *[HEIGHT] * count)
    panels = iter(figure.subplots(count, 1, squeeze=False)[:, 0])
    rows, theory = study.rows(compared), _TheoryCurves(study)
    for each_unit in units:
        drawn = [each for each in compared if each.unit == each_unit]
        y_scale = _scale("y_unit", y_unit, each_unit, shown(each_unit))
        for name in names:
            axes = next(panels)
            _panel(axes, study, rows, name, drawn, scales[name], y_scale, theory)
            axes.set_visible(bool(axes.lines or axes.containers))
    _make_room(figure)
    return figure


def _has_all_combinations(study: Any, names: list[str]) -> bool:
    """Return whether the cases of a study are all combinations of the values of the parameters `names`."""
    if any(len(case.varied) < len(names) for case in study.cases):
        return False
    combinations = {tuple(str(case.varied[name]) for name in names) for case in study.cases}
    return len(combinations) == math.prod(len(set(values)) for values in zip(*combinations))


def _make_room(figure: Any) -> None:
    """Increase the height of panels whose legends have many rows, so that enough room remains for the curves."""
    heights = []
    for axes in figure.axes:
        legend = axes.get_legend()
        rows = 0 if legend is None else -(-len(legend.get_texts()) // legend._ncols)
        heights.append(HEIGHT + LEGEND_ROW * max(0, rows - USUAL_ROWS))
    figure.set_figheight(figure.get_figheight() + sum(heights) - HEIGHT * len(heights))
    if heights:
        figure.axes[0].get_gridspec().set_height_ratios(heights)


def _measured(study: Any) -> dict[str, Quantity]:
    """Return all quantities of a study by name: the compared quantities, and all other numbers in its results.

    A plain number in a result has no unit.
    """
    quantities = {each.name: each for each in study.compared}
    for result in study.results.values():
        for name, entry in result.items():
            unit = str(entry["unit"]) if isinstance(entry, dict) and set(entry) == {"value", "unit"} else ""
            value = entry["value"] if unit else entry
            if isinstance(value, int | float) and not isinstance(value, bool):
                quantities.setdefault(name, Quantity(name, unit, lambda known: None))
    return quantities


def _scale(called: str, wanted: str | None, unit: str, usual: tuple[float, str]) -> tuple[float, str]:
    """Return the factor that converts values from the SI `unit` of a quantity to the unit of the figure, and that unit.

    `wanted` is the unit of the figure, which the caller of :func:`draw` stated in the argument `called`. If it is None,
    the result is `usual`.
    """
    if wanted is None:
        return usual
    known = list(UNITS.get(unit, ())) or [unit]
    if wanted not in known:
        axis = "horizontal axis; 'y_unit' is that of the quantity" if called == "unit" else "vertical axis"
        refuse(called, wanted, f"must be one of {', '.join(known)}", f"{called!r} is the unit of the {axis}")
    return (1 / UNITS[unit][wanted] if unit in UNITS else 1.0), wanted


def _unit(study: Any, name: str) -> tuple[float, str]:
    """Return the factor that converts SI values of a parameter to the unit in which it is drawn, and this unit.

    Flows that the user stated without a unit are drawn in m3/h.
    """
    factor_and_unit = study.unit(name)
    return (3600.0, "m3/h") if factor_and_unit[1] == "m3/s" and name not in study.written else factor_and_unit


def _common(study: Any) -> list[str]:
    """Return the parts of the figure's title: parameters of :data:`TITLE` with the same value in all cases, as text."""
    first = study.cases[0].parameters
    same = [name for name in TITLE if name in first and all(c.parameters.get(name) == first[name] for c in study.cases)]
    texts = {name: _worded(study, name, first[name]) for name in same if first[name] is not None}
    # If the study replaces a constant of a named concrete, such as its yield stress, the title must say so. If the
    # concrete comes from a file, the parameters of a case contain all constants, so replaced constants are not
    # recognisable. The title then mentions only constants that the study varies.
    given = (
        () if is_file(str(first.get("concrete"))) else [k for c in study.cases for k, v in c.parameters.items() if v]
    )
    changed = [name for name in CONSTANTS if name in study.varied or name in given]
    if "concrete" in texts and changed and first["concrete"] != "own":
        texts["concrete"] += f" with other {' and '.join(changed).replace('_', ' ')}"
    return list(texts.values())


def _worded(study: Any, name: str, value: Any) -> str:
    """Return the name, the value and the unit of a parameter as text, such as "yield stress 100 Pa"."""
    factor, unit = _unit(study, name)
    return f"{name.replace('_', ' ')} {study.worded(name, value, factor)} {unit}".strip()


def _series(study: Any, rows: list[Record], name: str) -> dict[str, list[Record]]:
    """Split the rows of a study's table into series in which only the parameter `name` varies.

    The rows of a series have the same values of all other varied parameters. The result maps a label with these values
    to the rows of the series. The series are sorted by these values, numerically if they are numbers.
    """
    others = [other for other in study.varied if other != name]

    def place(row: Record) -> list[tuple[bool, float, str]]:
        return [
            (isinstance(value, str), 0.0, value) if isinstance(value, str) else (False, float(value or 0), "")
            for value in (row.get(other) for other in others)
        ]

    series: dict[str, list[Record]] = {}
    for row in sorted(rows, key=place):
        series.setdefault(", ".join(_worded(study, n, row[n]) for n in others if n in row), []).append(row)
    return series


def _panel(
    axes: Any, study: Any, rows: list[Record], name: str, drawn: list[Quantity],
    x_scale: tuple[float, str], y_scale: tuple[float, str], theory: _TheoryCurves,
) -> None:  # fmt: skip
    """Draw all quantities of one physical unit, as functions of the parameter `name`, into one panel of the figure.

    `x_scale` and `y_scale` each hold the factor from the SI unit to the displayed unit, and the displayed unit.
    """
    mine = [row for row in rows if name in row] or rows
    values = list(dict.fromkeys(row.get(name, 0) for row in mine))
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    series = list(zip(_series(study, mine, name).items(), itertools.cycle(SERIES)))

    def at(row: Record) -> float:
        """Return the horizontal position of a row's parameter value; words have the positions 0, 1, 2 and so on."""
        return row.get(name, 0) * x_scale[0] if numeric else values.index(row.get(name, 0))

    curves: list[Any] = []
    theories = {each.name for each in drawn if each.name.endswith("_theory")}
    several = len(drawn) - len(theories) > 1 and len(series) > 1
    if several:  # Colours show the series, and markers the quantities; one entry for each keeps the legend short.
        curves += [_entry(label, color=rgb(colour), linewidth=4) for (label, _), colour in series]
        curves += [_entry(each.title, marker=marker, color="0.4", linestyle="none")
                   for each, marker in zip(drawn, itertools.cycle(MARKERS)) if each.name not in theories]  # fmt: skip
    for each, marker in zip(drawn, itertools.cycle(MARKERS)):
        for k, ((label, part), colour) in enumerate(series):
            part = sorted((row for row in part if np.isfinite(row[each.name])), key=at)
            if not part:
                continue
            # A small horizontal offset of each series keeps the error bars of different series apart.
            x = [at(row) + (0.0 if numeric else 0.08 * k) for row in part]
            y = np.array([row[each.name] for row in part]) * y_scale[0]
            if each.name in theories:
                between = theory.between(part, name, each) if numeric else None
                if numeric and between is None and each.name not in theory.tabulated:
                    between = [row.get(name, 0) for row in part], [row[each.name] for row in part]
                line = _draw_theory(axes, x, y, between and tuple(np.array(between) * [[x_scale[0]], [y_scale[0]]]))
                if not any(curve.get_label() == each.title for curve in curves):
                    line.set_label(each.title)
                    curves.append(line)
                continue
            scatter = np.nan_to_num([row[f"{each.name}_scatter"] for row in part]) * y_scale[0]
            title = each.title if len(drawn) > 1 or not label else ""
            # Join the points by lines, unless the panel already shows the theoretical curve of this quantity.
            joined = numeric and f"{each.name}_theory" not in theories
            name_of_series = ", ".join(filter(None, (title, label)))
            partial = [k for k, row in enumerate(part) if f"{each.name}_runs" in row]
            points = axes.errorbar(
                x, y, scatter if scatter.any() else None, fmt=marker, linestyle="-" if joined else "none",
                color=rgb(colour), capsize=3, markersize=5, label=name_of_series,
            )  # fmt: skip
            curves += [] if several else [points]
            if partial:
                hollow = axes.plot(
                    [x[k] for k in partial], y[partial], marker, color=rgb(colour), markersize=9, label=PARTIAL,
                    markerfacecolor="none",
                )  # fmt: skip
                if not any(curve.get_label() == PARTIAL for curve in curves):
                    curves += hollow
    if numeric:
        places = sorted({at(row) for row in mine})
        if len(places) <= MOST_TICKS:
            axes.set_xticks(places, [rounded(place) for place in places])
        else:
            axes.locator_params(axis="x", nbins=TICKS)
    else:
        axes.set_xticks(range(len(values)), [study.worded(name, v, x_scale[0]) for v in values])
        axes.margins(x=0.2)
    simulated = [each.title for each in drawn if each.name not in theories] or [each.title for each in drawn]
    if len(simulated) == 1:
        # The short title of a quantity, such as "end", does not tell what is drawn. Use the whole name of the quantity.
        simulated = [next(each for each in drawn if each.title == simulated[0]).name.replace("_", " ")]
    titles = textwrap.fill(" and ".join(simulated), LABEL_WIDTH)
    x_title = f"{name} [{x_scale[1]}]" if x_scale[1] else name
    axes.set(xlabel=x_title.replace("_", " "), ylabel=f"{titles} [{y_scale[1]}]" if y_scale[1] else titles)
    _set_height(axes)
    for count, label, marker, height in MARKS:
        places = [at(row) for row in mine if row[count]]
        if places:
            curves += axes.plot(places, np.full(len(places), height), marker, color=rgb(MEASURED), markersize=9,
                                markeredgewidth=2, transform=axes.get_xaxis_transform(), label=label)  # fmt: skip
    open_frame(axes)
    if len(curves) > 1:
        legend_above(axes, curves=curves)


def _entry(label: str, **style: Any) -> Any:
    """Return an entry of a legend that explains a colour or a marker, which several curves may share."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


class _TheoryCurves:
    """Closed-form predictions of a study's quantities, at parameter values between those of the simulated cases."""

    def __init__(self, study: Any) -> None:
        self.study, self.module = study, modules().get(study.scene)
        self.tabulated = {each.name for each in study.compared}
        """Names of the quantities in the study's table. Lines join the values of all other predictions."""
        self._known: dict[tuple[Any, ...], list[tuple[float, Mapping[str, float]]]] = {}
        """Points of the theoretical curves, by case and varied parameter. A point is a pair: a value of this parameter,
        and all quantities that theory predicts for it.

        A closed form returns all quantities of a scene at once, so they are stored for the other panels of the figure.
        """

    def between(
        self, part: list[dict[str, Any]], name: str, quantity: Quantity
    ) -> tuple[list[float], list[float]] | None:
        """Return parameter values between those of the simulated cases, and closed-form values of a quantity there.

        The rows in `part` describe the cases, which differ only in the parameter `name`. The result is None if there is
        only one case or no closed form. It is also None for a whole number without a unit, which has no values between
        the cases.
        """
        values = [row[name] for row in part if name in row]
        continuous = bool(self.study.units.get(name)) or any(isinstance(value, float) for value in values)
        if self.module is None or len(set(values)) < 2 or not continuous:
            return None
        case = next(case for case in self.study.cases if all(part[0].get(k) == v for k, v in case.varied.items()))
        places = np.linspace(min(values), max(values), THEORY_POINTS).tolist()
        key, wanted = (case.name, name, *places), quantity.name.removesuffix("_theory")
        if key not in self._known:
            self._known[key] = [(place, self._expected(case.parameters | case.varied, name, place)) for place in places]
        curve = [(place, expected[wanted]) for place, expected in self._known[key] if wanted in expected]
        return ([place for place, _ in curve], [value for _, value in curve]) if curve else None

    def _expected(self, given: Mapping[str, object], name: str, place: float) -> Mapping[str, float]:
        """Return the closed-form predictions of all quantities of a scene, by name; empty if the scene is invalid.

        The scene has the parameters `given`, except that the parameter `name` has the value `place`.
        """
        assert self.module is not None, "the study has no scene of this package"
        with suppress(SceneError, KeyError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = self.module.scene(**{**given, name: place})
            return method_of(scene).expected(scene)
        return {}


def _draw_theory(axes: Any, x: list[float], y: np.ndarray, between: Any) -> Any:
    """Draw closed-form predictions into a panel of the figure, and return the Matplotlib line, which has no label yet.

    If `between` holds the coordinates of a curve, the curve is drawn as a dashed line. If `between` is None, a short
    dash marks each prediction in `y` at the position of its case in `x`.
    """
    style = dict(color=rgb(THEORY), markersize=14, markeredgewidth=2, zorder=1.5)
    (line,) = axes.plot(x, y, "_", **style) if between is None else axes.plot(*between, "--", **style)
    return line


def _set_height(axes: Axes) -> None:
    """Set the range of the vertical axis: leave room for markers, and begin at zero if all values are positive."""
    lower, upper = axes.dataLim.intervaly
    if not np.isfinite(lower + upper):
        return
    if lower > 0:
        axes.set_ylim(0, 1.06 * upper)
    else:
        axes.margins(y=0.15)
