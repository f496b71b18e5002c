"""Display of a part of a line for recorders: particles of the concrete and a transparent wall."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from ...core.drawing.display import GLASS, Curve, Display, DrawnWall, Plot, Points, Profile
from ...core.drawing.paint import palette_colours
from ...geometry.mesh_parts import together
from .layout import Frame
from .probes import friction_ahead
from .scene import PartScene

MAX_DRAWN_PARTICLES = 12000
"""Maximum number of particles that are drawn."""
FACETS_AROUND, RING_COUNT = 48, 60
"""Number of facets around the axis, and number of rings along the axis, with which a round wall is drawn."""
OURS, OTHER_LINE, THEORY = (215, 95, 30), (90, 120, 170), (150, 150, 150)


class PartDisplay(Display):
    """Display of a part of a pump line: particles coloured by speed, by pressure or by shear rate.

    If only half of the part is simulated, its mirror image is drawn as well.
    """

    colourings: ClassVar = ("speed", "pressure", "shear")
    noun: ClassVar = "concrete"

    @property
    def _scene(self) -> PartScene:
        return self.simulation.scene

    @property
    def _mirror_signs(self) -> tuple[float, ...]:
        return (1.0, -1.0) if self._scene.is_half else (1.0,)

    @cached_property
    def _drawn_particles(self) -> np.ndarray:
        count = self.simulation.state.count
        return np.arange(0, count, max(1, -(-count * len(self._mirror_signs) // MAX_DRAWN_PARTICLES)))

    def radii(self) -> np.ndarray:
        """Return the radii of drawn particles [m], larger if fewer are drawn, so that they always fill the part."""
        state, chosen = self.simulation.state, self._drawn_particles
        fewer = (state.count / len(chosen)) ** (1 / 3)
        return np.full(len(chosen) * len(self._mirror_signs), 0.45 * state.particle_spacing * fewer, np.float32)

    def centres(self) -> np.ndarray:
        """Return the positions of drawn particles [m], shape (n, 3)."""
        x = self.read("particles.position").astype(float)[self._drawn_particles]
        frame = Frame(self._scene)
        return np.concatenate([frame.to_scene(x * [1.0, sign, 1.0]) for sign in self._mirror_signs])

    def scale(self) -> tuple[str, float, float]:
        """Return label, lowest and highest value of the quantity that the colours show."""
        scene = self._scene
        if self.colouring == "pressure":
            return "friction ahead [kPa]", 0.0, 1.2e-3 * scene.friction(0.0, scene.axis.length)
        fastest = 1.5 * scene.velocity * (scene.radius / scene.narrowest) ** 2
        return ("speed [m/s]", 0.0, fastest) if self.colouring == "speed" else ("rate of shear [1/s]", 0.0, 5.0)

    def fields(self) -> dict[str, np.ndarray]:
        """Return speed [m/s] and pressure without hydrostatic part [Pa] of the drawn particles."""
        speed = np.linalg.norm(self.read("particles.velocity").astype(float), axis=1)
        found = {"speed": speed, "pressure": self.read("particles.pressure").astype(float)}
        return {name: np.tile(values[self._drawn_particles], len(self._mirror_signs)) for name, values in found.items()}

    def colours(self) -> np.ndarray:
        """Return RGB bytes of all drawn particles, shape (n, 3)."""
        if self.colouring == "pressure":
            values = self.read("particles.pressure").astype(float) / 1e3
        elif self.colouring == "speed":
            values = np.linalg.norm(self.read("particles.velocity").astype(float), axis=1)
        else:
            slope = self.read("particles.gradient").astype(float)
            values = np.sqrt(0.5 * np.sum((slope + slope.transpose(0, 2, 1)) ** 2, axis=(1, 2)))
        _, lower, upper = self.scale()
        return np.tile(palette_colours(values[self._drawn_particles], upper, lower), (len(self._mirror_signs), 1))

    def plots(self) -> tuple[Plot, ...]:
        """Return two plots over time: the pressure at the part's start, and the friction gradients.

        The friction gradients are those of the straight pipes upstream and downstream of the part's middle.
        """
        return (
            Plot("pressure", "Pressure", (
                Curve("pressure", "at the start [kPa]", lambda row: 1e-3 * row["pressure"], OURS),
            )),
            Plot("friction", "Friction", (
                Curve("upstream", "upstream [kPa/m]", lambda row: 1e-3 * row["upstream_gradient"], OURS),
                Curve("downstream", "downstream [kPa/m]", lambda row: 1e-3 * row["downstream_gradient"], OTHER_LINE),
            )),
        )  # fmt: skip

    def profiles(self) -> tuple[Profile, ...]:
        """Return the pressure along the axis, and the theoretical pressure along straight pipes."""
        return (Profile("pressure", "Pressure [kPa] over the position along the axis [m]", (
            Points("this run", self._pressures, OURS), Points("theory", self._expected, THEORY),
        )),)  # fmt: skip

    def _friction_ahead(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m] and, for each, the frictional loss from there to the end of the part [Pa]."""
        return self.snapshot_value("friction ahead", lambda: friction_ahead(self.simulation.flow))

    def _pressures(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m] and the mean pressure of each section, weight included [kPa]."""
        place, friction = self._friction_ahead()
        return place, (friction + self._scene.weight(place)) / 1e3

    def _expected(self) -> tuple[np.ndarray, np.ndarray]:
        place = self._friction_ahead()[0]
        return place, (np.interp(place, *self._friction) + self._scene.weight(place)) / 1e3

    @cached_property
    def _friction(self) -> tuple[np.ndarray, np.ndarray]:
        """Arc lengths [m] and, for each, the theoretical frictional loss from there to the end of the part [Pa]."""
        end = self._scene.axis.length
        s = np.linspace(0, end, RING_COUNT)
        return s, np.array([self._scene.friction(each, end) for each in s[:-1]] + [0.0])

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
            return [DrawnWall("wall", *together(drawn), False, GLASS)]
        s = np.linspace(0, scene.axis.length, RING_COUNT)
        points, _, normal, side = scene.axis.frame(s)
        angle = 2 * np.pi * np.arange(FACETS_AROUND) / FACETS_AROUND
        ring = np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]
        vertices = (points[:, None] + scene.bore(s)[:, None, None] * ring).reshape(-1, 3)
        row, column = np.meshgrid(np.arange(RING_COUNT - 1), np.arange(FACETS_AROUND), indexing="ij")
        a, b = (row * FACETS_AROUND + column).ravel(), (row * FACETS_AROUND + (column + 1) % FACETS_AROUND).ravel()
        faces = np.concatenate(
            [np.stack([a, b, a + FACETS_AROUND], 1), np.stack([b, b + FACETS_AROUND, a + FACETS_AROUND], 1)]
        )
        return [DrawnWall("wall", vertices, faces, False, GLASS)]

    def bounds(self) -> np.ndarray:
        """Return the lowest and highest corner of all that is drawn [m], shape (2, 3)."""
        scene = self._scene
        points, _ = scene.axis.at(np.linspace(0, scene.axis.length, 50))
        return np.stack([points.min(0) - scene.widest, points.max(0) + scene.widest])
