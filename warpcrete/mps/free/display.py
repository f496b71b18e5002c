"""Concrete with a free surface as recorders draw it: a section, the half of the heap behind it, the mould."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from ...core.display import OTHER, Colour, Curve, Display, DrawnWall, Plot, on_palette

SECTION, BEHIND = 4000, 8000
"""Particles that are drawn of a section, and of the half behind it, at most."""
OURS = (215, 95, 30)
PLATE = (150, 150, 150, 255)
FASTEST = 5.0
"""Rate of shear at the scale's upper end [1/s]."""


class FreeDisplay(Display):
    """Particles by rate of shear, by speed, or by pressure. About an axis, one particle stands for a ring."""

    colourings: ClassVar = ("shear", "speed", "pressure")
    noun: ClassVar = "concrete"
    direction: ClassVar[tuple[float, float, float]] = (0.25, -0.85, 0.45)

    @property
    def _axial(self) -> bool:
        return self.simulation.scene.axial

    @cached_property
    def _chosen(self) -> tuple[np.ndarray, np.ndarray]:
        """Which particles are drawn, and the angle from the section at which [rad]."""
        count = self.simulation.state.count
        section = np.arange(0, count, max(1, -(-count // SECTION)))
        if not self._axial:
            return section, np.zeros(len(section))
        around = 24
        few = np.arange(0, count, max(1, -(-count * around // BEHIND)))
        turn = np.pi * (np.arange(around) + 0.5) / around
        particles = np.concatenate([section, section, np.repeat(few, around)])
        angles = [np.zeros(len(section)), np.full(len(section), np.pi), np.tile(turn, len(few))]
        return particles, np.concatenate(angles)

    def radii(self) -> np.ndarray:
        """Half a particle's distance in the section, half a cell's behind it [m]."""
        layout, (_, angles) = self.simulation.state.layout, self._chosen
        cut = np.isin(angles, (0.0, np.pi))
        stride = np.sqrt(max(1.0, len(layout.fluid) / max(np.count_nonzero(angles == 0), 1)))
        size = np.where(cut, 0.5 * layout.mark_spacing * stride, 0.6 * layout.spacing)
        return size.astype(np.float32)

    def centres(self) -> np.ndarray:
        """Particles in the room [m], shape (n, 3): z up, the section in the plane of x and z."""
        x = self.simulation.state.particles.position.numpy().astype(float)
        particles, angles = self._chosen
        x = x[particles]
        return np.stack([x[:, 0] * np.cos(angles), x[:, 0] * np.sin(angles), x[:, 1]], 1)

    def scale(self) -> tuple[str, float, float]:
        """What colours show, with its lowest and highest value."""
        scene = self.simulation.scene
        height = float(np.max(np.array(scene.outline)[:, 1]))
        if self.colouring == "pressure":
            return "pressure [kPa]", 0.0, scene.concrete.density * scene.gravity * height / 1e3
        if self.colouring == "speed":
            return "speed [m/s]", 0.0, 0.1 * float(np.sqrt(2 * scene.gravity * height))
        return "rate of shear [1/s]", 0.0, FASTEST

    def colours(self) -> np.ndarray:
        """RGB bytes of all that is drawn, shape (n, 3)."""
        found, state = self._chosen[0], self.simulation.state
        if self.colouring == "pressure":
            values = state.particles.pressure.numpy().astype(float) / 1e3
        elif self.colouring == "speed":
            values = np.linalg.norm(state.particles.velocity.numpy().astype(float), axis=1)
        else:
            slope = state.particles.gradient.numpy().astype(float)
            values = np.sqrt(0.5 * np.sum((slope + slope.transpose(0, 2, 1)) ** 2, axis=(1, 2)))
        _, lower, upper = self.scale()
        return on_palette(values[found], upper, lower)

    def plots(self) -> tuple[Plot, ...]:
        """How wide and how high the concrete is."""
        word = "spread" if self._axial else "way of the front"
        return (
            Plot("shape", "Shape", (
                Curve("spread", f"{word} [mm]", lambda row: 1e3 * row["spread"], OURS),
                Curve("top", "highest point [mm]", lambda row: 1e3 * row["top"], (90, 120, 170)),
            )),
            Plot("speed", "Speed", (Curve("fastest", "fastest [mm/s]", lambda row: 1e3 * row["fastest"], OURS),)),
        )  # fmt: skip

    def walls(self) -> list[DrawnWall]:
        """The plate, and the mould or gate, which moves."""
        scene, found = self.simulation.scene, []
        below = -0.005
        if self._axial:
            found.append(_revolved("plate", np.array([[0.0, below], [scene.width, below]]), PLATE, False))
            if scene.gate:
                corners = np.array(scene.outline)
                shell = corners[corners[:, 0] > 0]
                found.append(_revolved("mould", shell[np.argsort(shell[:, 1])], OTHER, True))
            return found
        floor = np.array([[0.0, below], [scene.width, below]])
        found.append(_drawn_out("plate", floor, PLATE, False))
        if scene.gate:
            found.append(_drawn_out("gate", np.array([*scene.gate, scene.gate[0]]), OTHER, True))
        return found

    def wall_pose(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation of a drawn wall now."""
        lift = 0.0
        if self.walls()[number].moves:
            lift = self.simulation.scene.lift_speed * self.simulation.stepper.time
        return np.array([0.0, 0.0, lift]), np.array([0.0, 0.0, 0.0, 1.0])

    def bounds(self) -> np.ndarray:
        """Lowest and highest corner of what there is to see, shape (2, 3) [m]."""
        scene = self.simulation.scene
        height = float(np.max(np.array(scene.outline)[:, 1]))
        left = -0.8 * scene.width if self._axial else 0.0
        return np.array([[left, 0.0, 0.0], [0.8 * scene.width if self._axial else scene.width, 0.0, height]])


def _revolved(name: str, line: np.ndarray, colour: Colour, moves: bool, facets: int = 48) -> DrawnWall:
    """A line of radius and height [m], turned about the axis."""
    angle = 2 * np.pi * np.arange(facets) / facets
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(facets, z)]) for r, z in line])
    faces = []
    for k in range(len(line) - 1):
        for n in range(facets):
            a, b = k * facets + n, k * facets + (n + 1) % facets
            faces += [(a, b, a + facets), (b, b + facets, a + facets)]
    return DrawnWall(name, vertices, np.array(faces), moves, colour)


def _drawn_out(name: str, line: np.ndarray, colour: Colour, moves: bool, deep: float = 0.1) -> DrawnWall:
    """A line across and up [m], and so `deep` behind the section [m]."""
    vertices = np.array([(x, y, z) for x, z in line for y in (0.0, deep)])
    faces = [
        f for k in range(len(line) - 1) for f in ((2 * k, 2 * k + 1, 2 * k + 2), (2 * k + 1, 2 * k + 3, 2 * k + 2))
    ]
    return DrawnWall(name, vertices, np.array(faces), moves, colour)
