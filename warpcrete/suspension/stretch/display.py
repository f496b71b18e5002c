"""Display of mortar with aggregates in a stretch of pipe.

Recorders draw all aggregates, a transparent wall, and the mortar in the half of the pipe that is away from the camera.
"""

from functools import cached_property
from typing import ClassVar

import numpy as np

from ...core.drawing.display import GLASS, Curve, DrawnWall, Plot, Points, Profile
from ...core.drawing.paint import rounded_up
from ...core.drawing.style import RUN, SECOND, THEORY
from ...geometry.axis import Axis, Line
from ...mps.grid.display import HALF_CELL
from ..display import SphereDisplay
from .probes import fraction_profile, velocity_profile
from .scene import StretchScene

FACETS = 48
"""Number of facets around the axis with which the wall is drawn."""
WALL_GAP = 0.03
"""Distance between the mortar and the drawn wall, in radii of the pipe."""


class StretchDisplay(SphereDisplay):
    """Display of a stretch of pipe: mortar coloured by speed, by shear rate or by pressure.

    The mortar in the half of the pipe that faces the camera is left out, so that the aggregates in it are visible.
    """

    colourings: ClassVar = ("speed", "shear", "pressure")
    halved: ClassVar = True

    @property
    def _scene(self) -> StretchScene:
        return self.simulation.scene

    def centres(self) -> np.ndarray:
        """Return the positions of drawn particles [m], shape (n, 3)."""
        return self.read("particles.position").astype(float)[self.drawn_particles]

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the cutting plane, which contains the axis of a pipe or halves the depth of a channel."""
        return 0.5 * self._scene.depth

    @cached_property
    def _gap(self) -> np.ndarray:
        """Distance of each cell's centre from the wall in cell widths, positive inside the pipe.

        Values are limited to half a cell width. The indices of the array are those along the axes x, y and z.
        """
        layout = self._layout
        middles = layout.room.places([0.5] * 3)[1:-1, 1:-1, 1:-1]
        gap = self._scene.radius - self._scene.aside(middles[..., 0], middles[..., 1])
        return np.clip(gap / layout.spacing, -HALF_CELL, HALF_CELL)

    def _cell_levels(self) -> np.ndarray:
        return self._gap

    def scale(self) -> tuple[str, float, float]:
        """Return label, lowest and highest value of the quantity that the colours show."""
        scene = self._scene
        fastest = float(scene.velocity_alone(np.zeros(1))[0])
        if self.colouring == "speed":
            return "speed [m/s]", 0.0, rounded_up(fastest)
        if self.colouring == "shear":
            return "shear rate [1/s]", 0.0, rounded_up(2 * fastest / scene.radius)
        return "pressure [kPa]", 0.0, rounded_up(2e-3 * scene.gradient * scene.length)

    def plots(self) -> tuple[Plot, ...]:
        """Return plots over time: the flow or the friction, and the mean distance of the aggregates from the axis."""
        radius = Curve("radius", "mean distance from the axis [radii]", lambda row: row["aggregate_radius"], SECOND)
        driven = Plot("flow", "Flow", (Curve("flow", "flow [m3/h]", lambda row: 3600 * row["flow"], RUN),))
        if self._scene.mean_velocity is not None:
            label = "friction [kPa/m]"
            driven = Plot("friction", "Friction", (Curve("friction", label, lambda row: 1e-3 * row["gradient"], RUN),))
        return (driven, Plot("migration", "Aggregates", (radius,)))

    def profiles(self) -> tuple[Profile, ...]:
        """Return plots over the radius: velocities of the run and of mortar alone by theory, and aggregate fraction."""
        return (Profile("velocity", "Velocity [m/s] over the radius [mm]", (
            Points("this run", lambda: self._velocities()[0], RUN),
            Points("mortar alone, theory", lambda: self._velocities()[1], THEORY),
        )), Profile("fraction", "Fraction of aggregates over the radius [mm]", (
            Points("this run", self._fractions, SECOND),
        )))  # fmt: skip

    def _velocities(self) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        radius, velocity = self.snapshot_value("velocities", lambda: velocity_profile(self.flow))
        return (1e3 * radius, velocity), (1e3 * radius, self._scene.velocity_alone(radius))

    def _fractions(self) -> tuple[np.ndarray, np.ndarray]:
        radius = self.snapshot_value("velocities", lambda: velocity_profile(self.flow))[0]
        return 1e3 * radius, self.snapshot_value("fractions", lambda: fraction_profile(self.flow))

    def walls(self) -> list[DrawnWall]:
        """Return the wall of the pipe, slightly wider than the mortar, so that both surfaces remain visible."""
        scene = self._scene
        if scene.depth:
            return [self._plane(side) for side in (-1, 1)]
        axis = Axis((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (Line(scene.length),))
        vertices, faces = axis.swept(np.array([0.0, scene.length]), (1 + WALL_GAP) * scene.radius, FACETS)
        return [DrawnWall("wall", vertices, faces, False, GLASS)]

    def _plane(self, side: int) -> DrawnWall:
        """Return one of the two walls of a flow between planes, slightly outside the mortar.

        `side` is -1 for the wall at x = -radius and 1 for the wall at x = radius.
        """
        scene = self._scene
        y, z = (np.array(values) for values in ((0.0, scene.depth, scene.depth, 0.0), (0.0, 0.0) + 2 * (scene.length,)))
        corners = np.stack([np.full(4, side * (1 + WALL_GAP) * scene.radius), y, z], 1)
        name = "lower plane" if side < 0 else "upper plane"
        return DrawnWall(name, corners, np.array([[0, 1, 2], [0, 2, 3]]), False, GLASS)

    def bounds(self) -> np.ndarray:
        scene, wide = self._scene, self._scene.radius
        low, high = (0.0, scene.depth) if scene.depth else (-wide, wide)
        return np.array([[-wide, low, 0.0], [wide, high, scene.length]])
