"""Comparison of one measured case with its prediction."""

import math
from dataclasses import dataclass

import numpy as np

from ...core.errors import refuse
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
    """True if the case is held out, so that no constant of the program was fitted to it."""
    measured: float
    band: Band
    """Predicted value and its uncertainty band, in the SI unit of the case's kind."""
    simulated: bool = False
    """True if the prediction comes from a flow simulation, and False if it comes from a closed form."""

    @property
    def ratio(self) -> float:
        """Predicted value divided by the measured one."""
        return self.band.value / self.measured

    @property
    def inside(self) -> float:
        """Fraction of the case's concretes whose measured values lie in the predicted band; 0 or 1 for one concrete.

        If the case is a mean over several concretes, only their smallest and largest value are known. The values of the
        other concretes are assumed to be uniformly distributed between the two on a logarithmic scale.
        """
        if self.case.ends is None:
            return float(self.band.contains(self.measured))
        low, high = self.case.ends
        below, above = max(low, self.band.low), min(high, self.band.high)
        return math.log(above / below) / math.log(high / low) if above > below else 0.0


def compare(case: Case, held_out: bool = False) -> Comparison:
    """Predict the values of one case, and return them next to the measured values.

    `held_out` is stored in the result. Raises :class:`SceneError` if the program refuses the inputs of the case.
    """
    bands = PREDICTORS[case.kind](case)
    measured = np.array(case.measured)
    if case.kind == "line":
        weight = line_weight(case)
        if min(case.measured) <= weight:
            refuse("case measured", min(case.measured), f"must exceed the pressure due to the weight of "
                   f"the concrete in the line, {weight:.4g} Pa", "check the unit of the pressure, the rises and the "
                   "density")  # fmt: skip
        measured = measured - weight
    value, low, high = (
        float(np.exp(np.mean(np.log([max(getattr(x, end), 1e-9) for x in bands])))) for end in ("value", "low", "high")
    )
    return Comparison(case, held_out, float(np.exp(np.mean(np.log(measured)))), Band(value, low, high, bands[0].shares))
