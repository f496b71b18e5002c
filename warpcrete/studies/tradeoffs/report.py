"""Output files of a trade-off study: tables, numbers and a figure."""

from __future__ import annotations

import csv
import itertools
import math
from typing import TYPE_CHECKING, Any

from ...core.drawing.style import RUN, SERIES, legend_above, new_figure, open_frame, rgb
from ...core.records import Record
from ...core.run.files import atomic_file, write_json
from ...core.units import shown
from .fronts import Error, front
from .points import COMBINED, GIVEN, REFERENCE, Setting
from .state import Trade

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def percent(error: Error | None) -> str:
    """Return an error with its confidence interval as text, in percent."""
    if error is None or not math.isfinite(error.shift):
        return "-"
    interval = f" +- {100 * error.interval:.2g}" if math.isfinite(error.interval) and error.interval > 0 else ""
    word = " (within scatter)" if error.within_scatter else ""
    return f"{100 * error.shift:+.2g}{interval} %{word}"


def on_front(trade: Trade) -> list[Setting]:
    """Return the settings on the Pareto front of wall time and error, by rising wall time."""
    points = [p for p in trade.measured if not p.suspect]
    return [points[k] for k in front([(p.cost, p.worst.size) for p in points if p.worst is not None])]


def table(trade: Trade) -> str:
    """Return Markdown with the cost and errors of every setting, and the best settings for each error limit."""
    against = "the closed form" if trade.exact else "the finest setting reached"
    best = on_front(trade)
    head = ["setting", "time [s]", "relative time", "work [million particle-steps]", "memory [MB]"]
    head += [f"{each.title} [{shown(each.unit)[1]}]" for each in trade.quantities]
    head += [f"error of {each.title}" for each in trade.quantities] + ["runs", "remarks"]
    remarks = f"Errors against {against}.{own_error(trade)}{_beside(trade)}"
    lines = [remarks, "", "| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for point in sorted(trade.points, key=lambda p: p.cost if math.isfinite(p.cost) else math.inf):
        name = trade.label(point) + (f" ({REFERENCE})" if point.origin == REFERENCE else "")
        cells = [
            name,
            _number(point.cost),
            _number(point.cost / trade.given.cost),
            _number(point.work / 1e6),
            _number(point.memory / 1e6),
        ]
        by_name = {error.quantity: error for error in point.errors}
        for each in trade.quantities:
            values = point.values(each.name, trade.seeds)
            cells.append(f"{shown(each.unit)[0] * sum(values) / len(values):.4g}" if values else "-")
        cells += [percent(by_name.get(each.name)) for each in trade.quantities]
        remarks = [point.failure] if point.failure else []
        remarks += [f"checks failed: {', '.join(point.suspect)}"] if point.suspect else []
        remarks += ["front"] if any(point is one for one in best) else []
        lines.append("| " + " | ".join([*cells, str(len(point.results)), "; ".join(remarks)]) + " |")
    return "\n".join([*lines, "", *promises(trade)])


def own_error(trade: Trade) -> str:
    """Return a sentence on the estimated errors of the reference setting itself; empty if they are not known."""
    found = [f"{100 * error:.2g} % ({name})" for name, error in trade.reference_errors.items() if math.isfinite(error)]
    if not found:
        return ""
    error = f"Its own error, estimated by extrapolation to infinitely fine cells, is {', '.join(found)}"
    return f" {error}; the guaranteed errors include it."


def _beside(trade: Trade) -> str:
    """Return a sentence that states how many runs took place at the same time; empty if it was one at a time."""
    most = trade.record.get("abreast", 1)
    if most == 1:
        return ""
    return f" Up to {most} runs were made at the same time, each on its own worker: {trade.machine}."


def promises(trade: Trade) -> list[str]:
    """Return the lines of a Markdown table with the best settings for each error limit in `WANTED_ERRORS`."""
    lines = [
        "| error wanted | setting | relative time | guaranteed error | error with fresh seeds | in other scenes |",
        "|---|---|---|---|---|---|",
    ]
    for promise in trade.promises:
        point = promise.point
        if point is None:
            lines.append(f"| {100 * promise.target:g} % | no measured setting meets it | - | - | - | - |")
            continue
        found = percent(promise.found) if promise.found else "not tried" if trade.has_seeds else "nothing is random"
        ratio = point.cost / trade.given.cost
        cells = [
            f"{100 * promise.target:g} %",
            trade.label(point),
            f"{ratio:.3g}",
            f"{100 * promise.bound:.2g} %",
            found,
            "; ".join(
                f"{name}: {percent(error) if error else 'does not run'}" for name, error in promise.carried.items()
            )
            or "not tried",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def write(trade: Trade) -> None:
    """Write the results so far to trade.md, trade.csv, trade.json and trade.png."""
    if not trade.points or not trade.given.results:
        return
    with atomic_file(trade.folder / "trade.md") as partial:
        partial.write_text(f"# Speed against accuracy: {trade.scene_name}\n\n{table(trade)}\n", encoding="utf-8")
    _write_csv(trade)
    write_json(
        trade.folder / "trade.json",
        {
            **trade.record,
            "machine": trade.machine,
            "reference_errors": trade.reference_errors,
            "points": [_recorded(trade, p) for p in trade.points],
            "promises": [_promised(trade, p) for p in trade.promises],
        },
    )
    if trade.measured:
        with atomic_file(trade.folder / "trade.png") as partial:
            draw(trade).savefig(partial, dpi=150, format="png")


def _recorded(trade: Trade, point: Setting) -> Record:
    return {
        "setting": trade.label(point),
        "origin": point.origin,
        "parameters": point.parameters,
        "time": {"value": point.cost, "unit": "s"},
        "particle_steps": point.work,
        "memory": {"value": point.memory, "unit": "B"},
        "values": {each.name: point.values(each.name, trade.seeds) for each in trade.quantities},
        "errors": {e.quantity: {"shift": e.shift, "interval": e.interval} for e in point.errors},
        "front": any(point is one for one in on_front(trade)),
        "failure": point.failure,
        "suspect": point.suspect,
    }


def _promised(trade: Trade, promise: Any) -> dict[str, Any]:
    point, found = promise.point, promise.found
    return {
        "target": promise.target,
        "setting": None if point is None else trade.label(point),
        "levels": None if point is None else trade.keys_of(point),
        "ratio": None if point is None else point.cost / trade.given.cost,
        "time": None if point is None else point.cost,
        "parameters": None if point is None else point.parameters,
        "promised": None if point is None else promise.bound,
        "found": None if found is None else {"shift": found.shift, "interval": found.interval},
        "carried": {
            name: None if e is None else {"quantity": e.quantity, "shift": e.shift}
            for name, e in promise.carried.items()
        },
    }


def _write_csv(trade: Trade) -> None:
    with atomic_file(trade.folder / "trade.csv") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = [f"{each.name}{part}" for each in trade.quantities for part in ("", "_error", "_interval")]
        units = {each.name: each.unit for each in trade.quantities}
        head = [f"{c} [{units[c]}]" if c in units else c for c in columns]
        writer.writerow(["setting", "origin", "time [s]", "particle_steps", "memory [B]", *head, "runs", "failure"])
        for point in trade.points:
            by_name = {error.quantity: error for error in point.errors}
            row: list[Any] = [trade.label(point), point.origin, point.cost, point.work, point.memory]
            for each in trade.quantities:
                values, error = point.values(each.name, trade.seeds), by_name.get(each.name)
                row.append(sum(values) / len(values) if values else "")
                row += [error.shift, error.interval] if error else ["", ""]
            writer.writerow([*row, len(point.results), point.failure])


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"


FLOOR = 1e-4  # Smallest error that the figure shows. Smaller errors are drawn here, because a log axis has no zero.
STYLES = tuple(zip("osv^<>h", map(rgb, SERIES[1:])))
"""Marker and colour of the settings that vary one accuracy parameter, in the order of the parameters."""
FRONT = "0.5"
"""Colour of the Pareto front and of the settings that vary several parameters, to which most of the front belongs."""
RIGHT = 0.88  # Horizontal position, as a fraction of the plot, beyond which a label stands on the left of its point.
NEAR = 0.07  # Smallest vertical distance of two labels, as a fraction of the plot; horizontally, it is twice as large.


def draw(trade: Trade) -> Figure:
    """Return a Matplotlib figure of error against wall time for all measured settings, with the Pareto front.

    A setting is a choice of values for all parameters that trade accuracy for run time, and it is drawn as a point.
    Settings with a failed check have hollow markers. A grey band shows the scatter of the reference setting between
    seeds.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = new_figure(f"{trade.scene_name}: {', '.join(each.title for each in trade.quantities)}", 4.8)
    axes = figure.subplots()
    shown = {GIVEN: ("*", rgb(RUN))}
    shown |= {knob.name: style for knob, style in zip(trade.knobs, itertools.cycle(STYLES))}
    shown |= {COMBINED: ("D", FRONT), REFERENCE: ("P", rgb(RUN))}
    for origin, (marker, colour) in shown.items():
        mine = [(p, p.worst) for p in trade.measured if p.origin == origin and p.worst is not None]
        if mine:
            _series(axes, origin, mine, marker, colour)
    if any(p.suspect for p in trade.measured if p.worst is not None):
        axes.plot([], [], "o", color="0.4", markerfacecolor="white", markersize=6, label="hollow: a check failed")
    best = [(p.cost, 100 * max(p.worst.size, FLOOR)) for p in on_front(trade) if p.worst is not None]
    if best:
        axes.plot(*zip(*best), color=FRONT, drawstyle="steps-post", zorder=0, label="front")
    sizes = [max(p.worst.size, FLOOR) for p in trade.measured if p.worst is not None]
    bottom = 60 * min(sizes)
    reference = None if trade.reference is None else trade.reference.worst
    if reference is not None and reference.interval > 0:
        axes.axhspan(bottom, 100 * reference.interval, color="0.92", zorder=-1, label="scatter of the finest")
    axes.set(
        xscale="log", yscale="log", xlabel=f"time of a run [s] on {trade.machine}", ylabel="largest error [%]",
    )  # fmt: skip
    axes.set_ylim(bottom=bottom)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    _name_levels(axes, trade)
    open_frame(axes)
    legend_above(axes)
    return figure


def _series(axes: Axes, origin: str, mine: list[tuple[Setting, Error]], marker: str, colour: object) -> None:
    """Draw the settings of one `origin`, such as those that vary one accuracy parameter, with confidence intervals.

    `mine` holds these settings with their errors. Settings with a failed check have hollow markers.
    """
    costs = [point.cost for point, _ in mine]
    sizes = [100 * max(error.size, FLOOR) for _, error in mine]
    spans = [100 * error.interval if math.isfinite(error.interval) else 0.0 for _, error in mine]
    below = [min(span, 0.9 * size) for span, size in zip(spans, sizes)]
    size = 11 if origin == GIVEN else 6
    axes.errorbar(costs, sizes, [below, spans], fmt="none", ecolor=colour, capsize=2)
    label: str | None = origin
    for suspect in (False, True):
        chosen = [(x, y) for (point, _), x, y in zip(mine, costs, sizes) if bool(point.suspect) is suspect]
        face = "white" if suspect else colour
        if chosen:
            axes.plot(*zip(*chosen), marker, color=colour, markerfacecolor=face, markersize=size, label=label)
            label = None


def _name_levels(axes: Axes, trade: Trade) -> None:
    """Write the value of the parameter beside each point whose setting changes only one accuracy parameter.

    A label that would overlap another one is left out, because the table lists all values.
    """
    from matplotlib.patheffects import withStroke

    placed: list[Any] = []
    into_figure = axes.transData + axes.transAxes.inverted()
    for point in trade.measured:
        if point.origin in (GIVEN, COMBINED, REFERENCE) or point.worst is None:
            continue
        at = (point.cost, 100 * max(point.worst.size, FLOOR))
        x, y = into_figure.transform(at)
        # Near the right edge, a label stands left of its point.
        side, apart = ("right", -4) if x > RIGHT else ("left", 4)
        x -= 2 * NEAR if side == "right" else 0.0
        if all(abs(x - u) > 2 * NEAR or abs(y - v) > NEAR for u, v in placed):
            text = trade.label(point).removeprefix(f"{point.origin} ")
            label = axes.annotate(text, at, (apart, 4), textcoords="offset points", color="0.35", ha=side)
            # The line of the Pareto front may pass behind the label, so give the text a white outline.
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
            placed.append((x, y))
