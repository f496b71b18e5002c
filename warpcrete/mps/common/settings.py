"""Settings that flows of every kind share."""

from typing import Annotated, Any

import numpy as np

from ...core.errors import between, positive
from ...core.inputs.parameters import Within

STEP_ERROR = (
    "Largest error of a step on a grid, as a fraction of the rms speed; it limits each step, and so does the passage "
    "of a cell; 0: all steps equal time_step"
)
PressureTolerance = Annotated[
    float, "Tolerance of the pressure solve: residual over the residual at its start", Within(1e-12, 0.5)
]
MaximumIterations = Annotated[
    int, "Largest number of iterations of a solve; the run ends with an error beyond it", Within(1)
]
"""Type of a parameter that limits the iterations of each linear solve. All flows on a grid have this parameter."""


def check_interval(scene: Any) -> None:
    """Raise :class:`SceneError` if all time steps are equal and longer than the interval between measurements."""
    positive("sample_interval", scene.sample_interval, "s")
    if not scene.step_error:
        between("sample_interval", scene.sample_interval, scene.time_step, np.inf, "s", "use the time step or more")
