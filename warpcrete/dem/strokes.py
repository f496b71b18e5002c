"""What pressure does from one stroke of a piston to the next: peaks, what is held at a stop, the restart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.units import quantity
from ..geometry.walls import Stops
from .scene import PipeUnit

HELD = 0.5
"""Part of a pause, at its end, over which the pressure that stays is averaged."""


@dataclass(frozen=True)
class Stroke:
    """Samples of one stroke, and of the pause behind it, by a series' rows."""

    moving: np.ndarray
    """Shape (samples,), True where the piston has begun this stroke and not yet stopped."""
    held: np.ndarray
    """True in the last part of the pause behind it; nowhere where there is none."""


def strokes_of(pipe: PipeUnit | None, time: np.ndarray) -> list[Stroke]:
    """Strokes that have begun at the samples `time` [s], shape (samples,); none where the piston never stops."""
    if pipe is None or pipe.stops is None:
        return []
    stops, found = pipe.stops, []
    for number in range(stops.count + 1):
        begin = number * stops.period
        stop, end = _stop(stops, number)
        # A row's pressure is the mean since the row before: that at the stop belongs to the stroke.
        moving = (time > begin + 1e-9) & (time <= stop + 1e-9)
        if number == 0:
            moving |= time == 0
        if moving.any():
            found.append(Stroke(moving, (time > end - HELD * (end - stop)) & (time <= end + 1e-9)))
    return found


def _stop(stops: Stops, number: int) -> tuple[float, float]:
    """When the piston stops after a stroke, and when it starts again [s]."""
    if number == stops.count:
        return np.inf, np.inf
    begin = number * stops.period
    return begin + stops.stroke_time, begin + stops.period


def peaks(pipe: PipeUnit | None, series: Mapping[str, np.ndarray]) -> list[float]:
    """Largest pressure of each stroke [Pa]."""
    return [float(series["pressure"][each.moving].max()) for each in strokes_of(pipe, series["time"])]


def held(pipe: PipeUnit | None, series: Mapping[str, np.ndarray]) -> list[float]:
    """Mean pressure over the last half of each pause [Pa]; NaN for one that has no sample there."""
    pressure = series["pressure"]
    return [
        float(pressure[each.held].mean()) if each.held.any() else float("nan")
        for each in strokes_of(pipe, series["time"])[: pipe.stops.count if pipe and pipe.stops else 0]
    ]


def stroke_table(pipe: PipeUnit, series: Mapping[str, np.ndarray]) -> dict[str, dict[str, Any]]:
    """Peak of each stroke that has begun, by its number, and the pressure held in the pause behind it."""
    table: dict[str, dict[str, Any]] = {}
    tops, holds = peaks(pipe, series), held(pipe, series)
    for number, top in enumerate(tops):
        table[str(number + 1)] = {"peak_pressure": quantity(top, "Pa")}
        if number < len(holds) and np.isfinite(holds[number]):
            table[str(number + 1)]["held_pressure"] = quantity(holds[number], "Pa")
    return table
