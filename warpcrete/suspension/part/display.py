"""Display of mortar with aggregates in a part of a pump line.

Recorders draw all aggregates, a transparent wall, and the mortar in the half of the pipe that is away from the camera.
"""

import numpy as np

from ...core.drawing.surfaces import Surface
from ...mps.part.display import PartDisplay
from ...mps.part.layout import Frame
from ..aggregates import is_inside
from ..display import SphereDisplay
from .scene import PartSuspensionScene


class PartSuspensionDisplay(SphereDisplay, PartDisplay):
    """Display of mortar with aggregates in a part of a pump line.

    The mortar in the half of the pipe that faces the camera is left out, so that the aggregates in it are visible.
    """

    @property
    def _suspension(self) -> PartSuspensionScene:
        return self.simulation.scene

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the cutting plane, which contains the first point of the pipe's axis."""
        return float(self._suspension.axis.at(0.0)[0][0, 1])

    def surface(self, cut: bool = False) -> Surface:
        """Return the surfaces of mortar and aggregates; with `cut`, only aggregates beyond the cutting plane.

        Beyond means on the side that is away from the camera.
        """
        mortar = super().surface(True)
        return self.derived(("with aggregates", cut), lambda: self._with_aggregates(mortar, cut))

    def _with_aggregates(self, mortar: Surface, cut: bool) -> Surface:
        inside = is_inside(self.read("aggregates.centre").astype(float))
        chosen = np.flatnonzero(inside[self.flow.aggregates.parts.body])
        frame, signs, centres = Frame(self._suspension), self._mirror_signs, self.sphere_centres()[chosen]
        places = np.concatenate([frame.to_scene(centres * [1.0, sign, 1.0]) for sign in signs])
        return self.with_spheres(mortar, places, np.tile(chosen, len(signs)), self.cut if cut else None)
