"""Settings that flows of every kind share."""

from typing import Annotated, Any

import numpy as np

from ...core.errors import between, positive
from ...core.inputs.parameters import Within

STEP_ERROR = (
    "Allowed error of the velocity in a time step on a grid, divided by the rms velocity; it sets the length of each "
    "step; 0: all steps have the length time_step"
)
PressureTolerance = Annotated[
    float,
    "Tolerance of the pressure solve: norm of the final residual, divided by that of the initial residual",
    Within(1e-12, 0.5),
]
MaximumIterations = Annotated[
    int, "Largest number of iterations of a linear solve; if a solve needs more, the run ends with an error", Within(1)
]
"""Type of a parameter that limits the iterations of each linear solve. All flows on a grid have this parameter."""


def check_interval(scene: Any) -> None:
    """Raise :class:`SceneError` if all time steps are equal and longer than the interval between measurements."""
    positive("sample_interval", scene.sample_interval, "s")
    if not scene.step_error:
        between("sample_interval", scene.sample_interval, scene.time_step, np.inf, "s", "use the time step or more")
