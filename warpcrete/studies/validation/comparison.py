"""Comparison of one measured case with its prediction."""

from __future__ import annotations

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
    """Prediction and its band, in the SI unit of the case's kind."""
    simulated: bool = False
    """True if a flow was simulated, and False if a closed form predicts the case."""

    @property
    def ratio(self) -> float:
        """Predicted value divided by the measured one."""
        return self.band.value / self.measured

    @property
    def inside(self) -> bool:
        """True if the measured value lies in the uncertainty band of the prediction."""
        return self.band.contains(self.measured)


def compare(case: Case, held_out: bool = False) -> Comparison:
    """Predict one case; raises :class:`SceneError` if the program refuses its inputs."""
    bands = PREDICTORS[case.kind](case)
    measured = np.array(case.measured)
    if case.kind == "line":
        measured = measured - line_weight(case)
    value, low, high = (float(np.exp(np.mean(np.log([max(getattr(x, end), 1e-9) for x in bands]))))
                        for end in ("value", "low", "high"))  # fmt: skip
    return Comparison(case, held_out, float(np.exp(np.mean(np.log(measured)))), Band(value, low, high, bands[0].shares))
