"""Settings that flows of every kind share."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.errors import between, positive

STEP_ERROR = (
    "Largest error of a step on a grid, as a fraction of the rms speed; it limits each step, and so does the passage "
    "of a cell; 0: all steps equal time_step"
)


def check_interval(scene: Any) -> None:
    """Raise :class:`SceneError` if all time steps are equal and longer than the interval between measurements."""
    positive("sample_interval", scene.sample_interval, "s")
    if not scene.step_error:
        between("sample_interval", scene.sample_interval, scene.time_step, np.inf, "s", "use the time step or more")
