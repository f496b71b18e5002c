"""Pressure over the strokes of a piston: peaks, the pressure held at a stop, and the restart."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...core.records import Record
from ...core.units import quantity
from ...geometry.walls import Stops
from .scene import PipeUnit

HELD = 0.5
"""Fraction of each pause of the piston, at its end, over which the pressure is averaged.

The mean is reported as the pressure held in the pause.
"""


@dataclass(frozen=True)
class Stroke:
    """Selection of the samples that belong to one stroke of the piston and to the pause after it."""

    moving: np.ndarray
    """Mask of the samples, shape (samples,): True from the start of the stroke to its stop."""
    held: np.ndarray
    """Mask of the samples in the final part of the pause after the stroke, shape (samples,); False without a pause."""


def strokes_of(pipe: PipeUnit | None, time: np.ndarray) -> list[Stroke]:
    """Return a :class:`Stroke` for each stroke of the piston that began within the run; an empty list without stops.

    Each :class:`Stroke` selects samples of the run. `time` contains the times of all samples [s], shape (samples,).
    """
    if pipe is None or pipe.stops is None:
        return []
    stops, strokes = pipe.stops, []
    for number in range(stops.count + 1):
        begin = number * stops.period
        stop, end = _stop(stops, number)
        # A sample's pressure is the mean since the previous sample, so the sample at the stop belongs to the stroke.
        moving = (time > begin + 1e-9) & (time <= stop + 1e-9)
        if number == 0:
            moving |= time == 0
        if moving.any():
            strokes.append(Stroke(moving, (time > end - HELD * (end - stop)) & (time <= end + 1e-9)))
    return strokes


def _stop(stops: Stops, number: int) -> tuple[float, float]:
    """Return the two times [s] at which the piston stops after stroke `number` and at which it starts again.

    Both are infinite for the last stroke, because no stop follows it.
    """
    if number == stops.count:
        return np.inf, np.inf
    begin = number * stops.period
    return begin + stops.stroke_time, begin + stops.period


def peaks(pipe: PipeUnit | None, series: Mapping[str, np.ndarray]) -> list[float]:
    """Return the largest pressure of each stroke of the piston [Pa]."""
    return [float(series["pressure"][each.moving].max()) for each in strokes_of(pipe, series["time"])]


def held(pipe: PipeUnit | None, series: Mapping[str, np.ndarray]) -> list[float]:
    """Return the mean pressure over the second half of each pause [Pa]; NaN if no sample lies in this half."""
    pressure = series["pressure"]
    return [
        float(pressure[each.held].mean()) if each.held.any() else float("nan")
        for each in strokes_of(pipe, series["time"])[: pipe.stops.count if pipe and pipe.stops else 0]
    ]


def stroke_table(pipe: PipeUnit, series: Mapping[str, np.ndarray]) -> dict[str, Record]:
    """Return, by stroke number, the peak pressure of each stroke and the mean pressure in the pause after it."""
    table: dict[str, Record] = {}
    tops, holds = peaks(pipe, series), held(pipe, series)
    for number, top in enumerate(tops):
        table[str(number + 1)] = {"peak_pressure": quantity(top, "Pa")}
        if number < len(holds) and np.isfinite(holds[number]):
            table[str(number + 1)]["held_pressure"] = quantity(holds[number], "Pa")
    return table
