"""Straight lines fitted to measured points, with the standard errors of their coefficients."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

STUDENT_T = {1: 12.71, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306, 9: 2.262, 10: 2.228}
"""Factor from the standard error to the 95 % confidence limit (Student's t), by the number of degrees of freedom."""


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


def student_t(freedom: int) -> float:
    """Return the factor from a standard error to the 95 % confidence limit, for a number of degrees of freedom.

    Beyond ten degrees of freedom, an expansion about the normal distribution is used, which is exact to 0.1 %
    (Abramowitz & Stegun 1964, 26.7.5).
    """
    if freedom < 1:
        return math.inf
    z = 1.959964
    return STUDENT_T.get(freedom) or z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
