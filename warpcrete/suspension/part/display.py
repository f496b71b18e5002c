"""Display of mortar with aggregates in a part of a pump line.

Recorders draw all aggregates, a transparent wall, and the mortar in the half of the pipe that is away from the camera.
"""

from typing import ClassVar

import numpy as np

from ...mps.part.display import PartDisplay
from ...mps.part.layout import Frame
from ..display import SphereDisplay
from .scene import PartSuspensionScene


class PartSuspensionDisplay(SphereDisplay, PartDisplay):
    """Display of mortar with aggregates in a part of a pump line.

    The mortar in the half of the pipe that faces the camera is left out, so that the aggregates in it are visible.
    """

    halved: ClassVar = True

    @property
    def _suspension(self) -> PartSuspensionScene:
        return self.simulation.scene

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the cutting plane, which contains the first point of the pipe's axis."""
        return float(self._suspension.axis.at(0.0)[0][0, 1])

    def images(self, centres: np.ndarray) -> list[np.ndarray]:
        frame = Frame(self._suspension)
        return [frame.to_scene(centres * [1.0, sign, 1.0]) for sign in self._mirror_signs]
