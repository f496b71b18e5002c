"""Figure of the pressure along a pump line."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.drawing.style import BEND, MEASURED, NOT_STRAIGHT, RUN, SECOND, THEORY, legend_beside, open_frame, rgb
from .pressures import LinePressures

MIN_STRIPE = 0.004
"""Smallest width of the stripe that marks a bend in the figure, divided by the length of the pump line."""


def draw(result: LinePressures) -> Any:
    """Return a Matplotlib figure of the pressure along a pump line, with its uncertainty band and the closed form."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2), layout="constrained")
    axes = figure.add_subplot()
    places, bands = result.bands()
    low, ours, high = (np.array([getattr(each, end) for each in bands]) for end in ("low", "value", "high"))
    low, high = low / 1e5, high / 1e5
    main = RUN if result.simulated else SECOND
    axes.fill_between(places, low, high, color=rgb(main), alpha=0.15, linewidth=0, label="likely range")
    axes.plot(
        places,
        ours / 1e5,
        color=rgb(main),
        linewidth=1.8,
        label="simulated" if result.simulated else "by theory",
    )
    if result.simulated:
        theory = _scaled(result.course(lambda x: x.theory + x.weight))
        axes.plot(*theory, "--", color=rgb(THEORY), linewidth=1.4, label="theory, as straight pipe")
    axes.plot(
        *_scaled(result.course(lambda x: x.weight)),
        color=rgb(MEASURED),
        linestyle=":",
        linewidth=1.2,
        label="weight alone",
    )
    begin = 0.0
    for x in result.losses:
        if not x.part.is_by_length:
            name = x.part.kind
            first = name not in axes.get_legend_handles_labels()[1]
            # A bend is short beside a line of hundreds of metres. Give the stripe that marks it a width that remains
            # visible.
            middle, half = begin + 0.5 * x.part.length, 0.5 * max(x.part.length, MIN_STRIPE * places[-1])
            axes.axvspan(middle - half, middle + half, color=rgb(BEND if name == "bend" else NOT_STRAIGHT), linewidth=0,
                         zorder=0, label=name if first else "")  # fmt: skip
        begin += x.part.length
    if result.line.recorded is not None:
        axes.plot(
            0,
            result.line.recorded / 1e5,
            "+",
            color=rgb(MEASURED),
            markersize=12,
            markeredgewidth=2,
            clip_on=False,
            label="recorded",
        )
    axes.set(xlabel="position along the line [m]", ylabel="pressure [bar]", xlim=(0, places[-1]), ylim=(0, None))
    widths = sorted({1e3 * x.part.diameter for x in result.losses})
    diameter = "diameter " + (f"{widths[0]:.4g} mm" if len(widths) == 1 else f"{widths[0]:.4g} to {widths[-1]:.4g} mm")
    axes.set_title(
        f"{result.line.name}, {diameter}, concrete {result.concrete.name}, {3600 * result.flow:.3g} m3/h", fontsize=10
    )
    legend_beside(axes, 9)
    open_frame(axes)
    return figure


def _scaled(course: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return course[0], course[1] / 1e5
