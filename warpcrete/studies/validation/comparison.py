"""Comparison of one measured case with its prediction."""

import math
from dataclasses import dataclass

import numpy as np

from ...theory.bands import Band
from .cases import Case
from .predictions import PREDICTORS, line_weight


@dataclass(frozen=True)
class Comparison:
    """Predicted and measured value of one case.

    If the case was measured at several flows, both values are geometric means over the flows.
    """

    case: Case
    held_out: bool
    """True if no constant of the program may be fitted to the case."""
    measured: float
    band: Band
    """Predicted value and its uncertainty band, in the SI unit of the case's kind."""
    simulated: bool = False
    """True if a flow was simulated, and False if a closed form predicts the case."""

    @property
    def ratio(self) -> float:
        """Predicted value divided by the measured one."""
        return self.band.value / self.measured

    @property
    def inside(self) -> float:
        """Fraction of the case's concretes whose measured values lie in the predicted band; 0 or 1 for one concrete.

        For several concretes, only the smallest and the largest value are known. The others are assumed to lie evenly
        between these two on a logarithmic scale.
        """
        if self.case.ends is None:
            return float(self.band.contains(self.measured))
        low, high = self.case.ends
        below, above = max(low, self.band.low), min(high, self.band.high)
        return math.log(above / below) / math.log(high / low) if above > below else 0.0


def compare(case: Case, held_out: bool = False) -> Comparison:
    """Predict one case; raises :class:`SceneError` if the program refuses its inputs."""
    bands = PREDICTORS[case.kind](case)
    measured = np.array(case.measured)
    if case.kind == "line":
        measured = measured - line_weight(case)
    value, low, high = (float(np.exp(np.mean(np.log([max(getattr(x, end), 1e-9) for x in bands]))))
                        for end in ("value", "low", "high"))  # fmt: skip
    return Comparison(case, held_out, float(np.exp(np.mean(np.log(measured)))), Band(value, low, high, bands[0].shares))
