"""Figure of the pressure along a pump line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import (
    BEND,
    MEASURED,
    NOT_STRAIGHT,
    RUN,
    SECOND,
    THEORY,
    legend_above,
    new_figure,
    open_frame,
    rgb,
)
from ...core.inputs.customary import CUSTOMARY_SIZES
from .answers import time_text
from .pressures import LinePressures
from .taps import Tap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MIN_STRIPE = 0.004
"""Minimum width of the stripe that marks a bend in the figure, as a fraction of the length of the pump line."""
RESTART_PLACE = 0.015
"""Position of the bar that shows a restart in the figure, as a fraction of the length of the pump line."""


def draw(result: LinePressures) -> Figure:
    """Return a Matplotlib figure of the pressure along a pump line, with its uncertainty band and the closed form."""
    figure = new_figure(_title(result), 4.4)
    axes = figure.add_subplot()
    us = result.line.customary
    metre, size = (CUSTOMARY_SIZES["ft"], CUSTOMARY_SIZES["psi"]) if us else (1.0, 1e5)

    def scaled(course: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return course[0] / metre, course[1] / size

    places, bands = result.bands()
    places = places / metre
    low, ours, high = (np.array([getattr(each, end) for each in bands]) for end in ("low", "value", "high"))
    low, ours, high = low / size, ours / size, high / size
    main = RUN if result.simulated else SECOND
    axes.fill_between(places, low, high, color=rgb(main), alpha=0.15, linewidth=0, label="likely range")
    axes.plot(places, ours, color=rgb(main), label="simulated" if result.simulated else "by theory")
    if result.simulated:
        theory = scaled(result.course(lambda x: x.theory + x.weight))
        axes.plot(*theory, "--", color=rgb(THEORY), label="theory, as straight pipe")
    if any(x.weight for x in result.losses):
        weight = scaled(result.course(lambda x: x.weight))
        axes.plot(*weight, color=rgb(MEASURED), linestyle=":", label="weight alone")
    begin = 0.0
    for x in result.losses:
        if not x.part.is_by_length or x.part.kind == "hose":
            name = x.part.kind
            first = name not in axes.get_legend_handles_labels()[1]
            # A bend is short compared with the line, so draw the stripe that marks it with a visible minimum width.
            middle = (begin + 0.5 * x.part.length) / metre
            half = 0.5 * max(x.part.length / metre, MIN_STRIPE * places[-1])
            axes.axvspan(middle - half, middle + half, color=rgb(BEND if name == "bend" else NOT_STRAIGHT), linewidth=0,
                         alpha=0.45 if name == "hose" else None, zorder=0, label=name if first else "")  # fmt: skip
        begin += x.part.length
    if result.line.recorded is not None:
        axes.plot(
            0,
            result.line.recorded / size,
            "+",
            color=rgb(MEASURED),
            markersize=12,
            markeredgewidth=2,
            clip_on=False,
            label="recorded",
        )
    _draw_pump(axes, result, RESTART_PLACE * places[-1], size)
    if result.fit is not None:
        at_flow, others = _taps(result)
        for taps, fill, name in (at_flow, rgb(MEASURED), "gauges"), (others, "white", "gauges at other flows"):
            if taps:
                axes.plot([tap.place / metre for tap in taps], [tap.pressure / size for tap in taps], "o", markersize=5,
                          color=rgb(MEASURED), markerfacecolor=fill, clip_on=False, label=name)  # fmt: skip
    axes.set(xlabel=f"position along the line [{'ft' if us else 'm'}]", ylabel=f"pressure [{'psi' if us else 'bar'}]",
             xlim=(0, places[-1]), ylim=(0, None))  # fmt: skip
    legend_above(axes)
    open_frame(axes)
    return figure


def _draw_pump(axes: Axes, result: LinePressures, place: float, size: float) -> None:
    """Draw the largest pressure of the pump and the pressure of a restart at full flow, in units of `size` [Pa].

    The restart is drawn at the horizontal position `place`, a little to the right of the vertical axis, which would
    otherwise hide it.
    """
    if result.line.pump is not None:
        axes.axhline(result.line.pump.pressure / size, color=rgb(THEORY), linestyle="-.", label="pump")
    if result.stop is not None:
        band = result.restart(result.flow)
        label = f"restart after {time_text(result.stop.rest)}"
        value, low, high = (x / size for x in (band.value, band.low, band.high))
        axes.errorbar([place], [value], [[value - low], [high - value]], fmt="s", capsize=4, clip_on=False,
                      color=rgb(RUN if result.simulated else SECOND), label=label)  # fmt: skip


def _taps(result: LinePressures) -> tuple[list[Tap], list[Tap]]:
    """Split the readings of gauges into those at the flow of the line (within 2 %) and those at other flows."""
    assert result.fit is not None
    taps = result.fit.taps
    at_flow = [tap for tap in taps if abs(tap.flow - result.flow) <= 0.02 * result.flow]
    return at_flow, [tap for tap in taps if tap not in at_flow]


def _title(result: LinePressures) -> str:
    """Return the title of the figure: line, bores from the pump to the end, concrete and flow."""
    us = result.line.customary
    bores = [result.losses[0].part.diameter]
    for x in result.losses:
        bores += [bore for bore in (x.part.diameter, x.part.outlet) if bore != bores[-1]]
    shown = " to ".join(f"{bore / (CUSTOMARY_SIZES['in'] if us else 1e-3):.4g}" for bore in bores)
    rate = result.flow / (CUSTOMARY_SIZES["yd3/h"] if us else 1 / 3600)
    return (
        f"{result.line.name}, diameter {shown} {'in' if us else 'mm'}, concrete {result.concrete.name}, "
        f"{rate:.3g} {'yd3/h' if us else 'm3/h'}"
    )
