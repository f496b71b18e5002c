"""Display of a flow through a part of a pump line. Recorders draw the concrete and a transparent wall."""

from functools import cached_property
from typing import ClassVar

import numpy as np

from ...core.drawing.display import GLASS, Curve, DrawnWall, Plot, Points, Profile
from ...core.drawing.style import RUN, SECOND, THEORY
from ...core.drawing.surfaces import Cut, Level, Surface
from ...geometry.mesh_parts import together
from ..grid.display import HALF_CELL, GridDisplay
from .layout import Frame, bore_distance, inlet_distance
from .probes import friction_ahead
from .scene import PartScene

WALL_GAP = 0.03
"""Gap that recorders leave between the concrete and the drawn wall, divided by the pipe's radius at the start of the
part."""
FACETS_AROUND, RING_COUNT = 48, 60
"""Number of facets around the axis, and number of rings along the axis, with which a round wall is drawn."""


class PartDisplay(GridDisplay):
    """Display of a flow through a part of a pump line: concrete coloured by speed, pressure or shear rate.

    If only half of the part is simulated, its mirror image is drawn as well.
    """

    colourings: ClassVar = ("speed", "pressure", "shear")

    @property
    def _scene(self) -> PartScene:
        return self.simulation.scene

    @property
    def _mirror_signs(self) -> tuple[float, ...]:
        return (1.0, -1.0) if self._scene.is_half else (1.0,)

    @property
    def copies(self) -> int:
        """Number of images of each displayed particle: 2 if only half of the part is simulated, otherwise 1."""
        return len(self._mirror_signs)

    def centres(self) -> np.ndarray:
        """Return the positions of drawn particles [m], shape (n, 3)."""
        x = self.read("particles.position").astype(float)[self.drawn_particles]
        frame = Frame(self._scene)
        return np.concatenate([frame.to_scene(x * [1.0, sign, 1.0]) for sign in self._mirror_signs])

    @cached_property
    def _bore(self) -> np.ndarray:
        """Distance of each cell's centre from the wall of the bore or the inlet, whichever is nearer, in cell widths.

        The distance is positive in the concrete, and limited to half a cell.
        """
        layout = self._layout
        middles = layout.room.places([0.5] * layout.axes)
        inner = (slice(1, -1),) * layout.axes
        points = middles[inner].reshape(-1, layout.axes)
        gap = np.minimum(bore_distance(self._scene)(points), inlet_distance(self._scene)(points))
        return np.clip(gap.reshape(layout.cells) / layout.spacing, -HALF_CELL, HALF_CELL)

    def _cell_levels(self) -> np.ndarray:
        return self._bore

    def _level(self) -> Level:
        level = super()._level()
        return level.mirrored(1) if self._scene.is_half else level

    def _cutting_plane(self) -> Cut | None:
        frame = Frame(self._scene)
        return None if self.cut is None else Cut(frame.axes[:, 1], self.cut - frame.end[1])

    def _surface(self, cut: bool) -> Surface:
        return super()._surface(cut).moved(Frame(self._scene).to_scene)

    def scale(self) -> tuple[str, float, float]:
        """Return label, lowest and highest value of the quantity that the colours show."""
        scene = self._scene
        if self.colouring == "pressure":
            return "friction ahead [kPa]", 0.0, 1.2e-3 * scene.friction_loss(0.0, scene.axis.length)
        fastest = 1.5 * scene.velocity * (scene.radius / scene.narrowest) ** 2
        return ("speed [m/s]", 0.0, fastest) if self.colouring == "speed" else ("shear rate [1/s]", 0.0, 5.0)

    def plots(self) -> tuple[Plot, ...]:
        """Return two plots over time: the pressure at the start of the part, and the friction per metre of pipe.

        The friction per metre is measured in the straight pipes upstream and downstream of the middle of this part of
        the pump line.
        """
        return (
            Plot("pressure", "Pressure", (
                Curve("pressure", "pressure at the start [kPa]", lambda row: 1e-3 * row["pressure"], RUN),
            )),
            Plot("friction", "Friction", (
                Curve("upstream", "upstream [kPa/m]", lambda row: 1e-3 * row["upstream_gradient"], RUN),
                Curve("downstream", "downstream [kPa/m]", lambda row: 1e-3 * row["downstream_gradient"], SECOND),
            )),
        )  # fmt: skip

    def profiles(self) -> tuple[Profile, ...]:
        """Return a plot of the pressure along the axis, with the pressure in straight pipes with the same bores."""
        return (Profile("pressure", "Pressure [kPa] along the axis [m]", (
            Points("this run", self._pressures, RUN), Points("theory", self._expected, THEORY),
        )),)  # fmt: skip

    def _friction_ahead(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m], and the frictional pressure loss from each of them to the end of the part [Pa]."""
        return self.snapshot_value("friction ahead", lambda: friction_ahead(self.flow))

    def _pressures(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m] and the mean pressure in the cross-section at each of them, including weight [kPa]."""
        place, friction = self._friction_ahead()
        return place, (friction + self._scene.weight(place)) / 1e3

    def _expected(self) -> tuple[np.ndarray, np.ndarray]:
        place = self._friction_ahead()[0]
        return place, (np.interp(place, *self._friction) + self._scene.weight(place)) / 1e3

    @cached_property
    def _friction(self) -> tuple[np.ndarray, np.ndarray]:
        """Arc lengths [m], and the theoretical frictional loss from each of them to the end [Pa].

        The loss is computed for straight pipes with the bores of the part.
        """
        end = self._scene.axis.length
        s = np.linspace(0, end, RING_COUNT)
        return s, np.array([self._scene.friction_loss(each, end) for each in s[:-1]] + [0.0])

    def walls(self) -> list[DrawnWall]:
        """Return the wall of the bore as a drawn wall."""
        scene, inner = self._scene, self._scene.inner
        if inner is not None:
            drawn = [(inner.vertices, inner.faces)]
            for low, high in ((0.0, inner.begin), (inner.end, scene.axis.length)):
                if high - low > 0.01 * scene.radius:
                    drawn.append(
                        scene.axis.swept(np.array([low, high]), float(scene.bore(0.5 * (low + high))), FACETS_AROUND)
                    )
            vertices, faces = together(drawn)
        else:
            s = np.linspace(0, scene.axis.length, RING_COUNT)
            vertices, faces = scene.axis.swept(s, scene.bore(s), FACETS_AROUND)
        # Move the drawn wall a little outwards. If it coincided with the surface of the concrete, a viewer could not
        # tell whether the wall or the concrete is in front.
        outward = vertices - scene.axis.projected(vertices)[0]
        outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-12)[:, None]
        return [DrawnWall("wall", vertices + WALL_GAP * scene.radius * outward, faces, False, GLASS)]

    def bounds(self) -> np.ndarray:
        scene = self._scene
        points, _ = scene.axis.at(np.linspace(0, scene.axis.length, 50))
        return np.stack([points.min(0) - scene.widest, points.max(0) + scene.widest])
