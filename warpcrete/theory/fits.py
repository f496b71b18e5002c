"""Straight lines fitted to measured points, with the standard errors of their coefficients."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StraightLine:
    """Straight line y = offset + slope x, fitted by least squares."""

    slope: float
    offset: float
    slope_error: float
    """Standard error of the slope; NaN for two points, because a line fits two points exactly."""
    offset_error: float


def straight_line(x: Sequence[float] | np.ndarray, y: Sequence[float] | np.ndarray) -> StraightLine:
    """Fit a straight line by least squares through two or more points at different x."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    slope, offset = np.polyfit(x, y, 1)
    if len(x) < 3:
        return StraightLine(float(slope), float(offset), math.nan, math.nan)
    variance = float(np.sum((y - offset - slope * x) ** 2)) / (len(x) - 2)
    spread = float(np.sum((x - x.mean()) ** 2))
    off = math.sqrt(variance * (1 / len(x) + float(x.mean()) ** 2 / spread))
    return StraightLine(float(slope), float(offset), math.sqrt(variance / spread), off)
