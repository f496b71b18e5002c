"""Display of free-surface flows for recorders: the concrete, a section through it, and the mould or the vessel."""

from typing import ClassVar

import numpy as np

from ...core.drawing.display import OTHER, Colour, Curve, DrawnWall, Plot
from ...core.drawing.paint import rounded_up
from ...core.drawing.style import RUN, SECOND
from ...core.drawing.surfaces import Level
from ..grid.display import GridDisplay
from ..grid.geometry import MIRROR, WALL
from .scene import Points

PLATE = (150, 150, 150, 255)
SHOWN_DEPTH = 0.1
"""Depth along y with which recorders draw the concrete of a plane flow [m]; a plane flow itself has no depth."""
SHOWN_SHEAR = 0.02
"""Upper end of the colour scale of the shear rate, as a fraction of a typical shear rate. The typical rate is (p -
tau_0) / mu, with the initial pressure p of the concrete on its base, the yield stress tau_0 and the plastic viscosity
mu. The upper end is then rounded up."""


class FreeDisplay(GridDisplay):
    """Display of a free-surface flow: concrete coloured by shear rate, by speed or by pressure.

    Axisymmetric flow is drawn as a body of revolution. At a plane of symmetry the mirror image is drawn as well.
    """

    colourings: ClassVar = ("shear", "speed", "pressure")
    relative_radius: ClassVar = 0.5
    direction: ClassVar[tuple[float, float, float]] = (0.25, -0.85, 0.45)

    @property
    def _axial(self) -> bool:
        return self.simulation.scene.axial

    @property
    def _solid(self) -> bool:
        return self.simulation.scene.depth > 0

    @property
    def _mirrored(self) -> list[tuple[float, float]]:
        """Factors 1 or -1 for x and y of each image of a three-dimensional flow: the original and its mirror images."""
        sides = self.simulation.scene.sides
        if not self._solid:
            return [(1.0, 1.0)]
        across = (1.0, -1.0) if sides.get("left") == MIRROR else (1.0,)
        deep = (1.0, -1.0) if sides.get("front") == MIRROR else (1.0,)
        return [(a, b) for a in across for b in deep]

    @property
    def copies(self) -> int:
        """Number of drawn images of each particle: 1 without planes of symmetry, 2 with one, 4 with two planes."""
        return len(self._mirrored)

    def centres(self) -> np.ndarray:
        """Return the positions of drawn particles [m], shape (n, 3).

        The axis z points upwards; the section of a two-dimensional flow lies in the plane y = 0.
        """
        particles = self.drawn_particles
        x = self.read("particles.position").astype(float)[particles]
        if not self._solid:
            return np.insert(x, 1, 0.0, axis=1)
        # Particles that have left the simulated space have mass 0. Draw them at a point below it, where they are out of
        # sight.
        gone = self.read("particles.mass")[particles] == 0
        x[gone] = [0.0, 0.0, -0.5]
        return np.concatenate([x * [a, b, 1.0] for a, b in self._mirrored])

    def _level(self) -> Level:
        level = super()._level()
        if self._solid:
            for axis, side in enumerate(("left", "front")):
                level = level.mirrored(axis) if self.simulation.scene.sides.get(side) == MIRROR else level
        elif not self._axial:  # A plane flow has no depth; draw it with the depth SHOWN_DEPTH.

            def deep(values: np.ndarray) -> np.ndarray:
                return np.repeat(values[:, None], 2, axis=1)

            places = level.places[0], SHOWN_DEPTH * np.array([0.25, 0.75]), level.places[1]
            fields = {name: deep(values) for name, values in level.fields.items()}
            level = Level(places, deep(level.values), fields)
        return level

    def scale(self) -> tuple[str, float, float]:
        """Return label, lowest and highest value of the quantity that the colours show."""
        scene = self.simulation.scene
        height = float(np.max(np.array(scene.outline)[:, 1]))
        if self.colouring == "pressure":
            return "pressure [kPa]", 0.0, scene.concrete.density * scene.gravity * height / 1e3
        if self.colouring == "speed":
            return "speed [m/s]", 0.0, 0.1 * float(np.sqrt(2 * scene.gravity * height))
        concrete, stress = scene.concrete, scene.concrete.density * scene.gravity * height
        rate = max(stress - concrete.yield_stress, 0.1 * stress) / concrete.viscosity
        return "shear rate [1/s]", 0.0, rounded_up(SHOWN_SHEAR * rate)

    def plots(self) -> tuple[Plot, ...]:
        """Return plots over time: shape and speed of the concrete, or the amount in a funnel and its speed."""
        word = "spread" if self.simulation.scene.about_axis else "position of the front"
        test = self.simulation.scene.test
        if test and test.outflow:
            return (
                Plot(
                    "remaining", "Remaining", (Curve("inside", "remaining [%]", lambda row: 1e2 * row["inside"], RUN),)
                ),
                Plot("speed", "Speed", (Curve("fastest", "fastest [mm/s]", lambda row: 1e3 * row["fastest"], RUN),)),
            )
        return (
            Plot("shape", "Shape", (
                Curve("spread", f"{word} [mm]", lambda row: 1e3 * row["spread"], RUN),
                Curve("top", "highest point [mm]", lambda row: 1e3 * row["top"], SECOND),
            )),
            Plot("speed", "Speed", (Curve("fastest", "fastest [mm/s]", lambda row: 1e3 * row["fastest"], RUN),)),
        )  # fmt: skip

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the cutting plane, which contains the axis of axisymmetric flow; None for plane flow."""
        return super().cut if self._solid else 0.0 if self._axial else None

    def walls(self) -> list[DrawnWall]:
        """Return the drawn walls: the plate, the walls of the scene, and the mould or gate, which moves."""
        scene, drawn_walls = self.simulation.scene, []
        below = -0.005
        if scene.about_axis:
            drawn_walls.append(_revolved("plate", np.array([[0.0, below], [scene.width, below]]), PLATE, False))
            if scene.gate:
                corners = np.array(scene.outline)
                shell = corners[corners[:, 0] > 0]
                drawn_walls.append(_revolved("mould", shell[np.argsort(shell[:, 1])], OTHER, True))
            return drawn_walls + self._standing_walls()
        deep = scene.depth or SHOWN_DEPTH
        low = -deep if scene.sides.get("front") == MIRROR else 0.0
        if scene.sides.get("bottom", WALL) == WALL:
            floor = np.array([[0.0, below], [scene.width, below]])
            drawn_walls.append(_extruded("plate", floor, PLATE, False, low, deep))
        images = {a for a, _ in self._mirrored}
        for number, block in enumerate(scene.blocks):
            for a in sorted(images, reverse=True):
                name = f"block{number + 1}" + ("" if a > 0 else "_image")
                line = self._cropped(block) * [a, 1.0]
                drawn_walls.append(_extruded(name, line, OTHER, False, low, deep))
        drawn_walls += self._standing_walls()
        if scene.gate:
            drawn_walls.append(_extruded("gate", self._cropped(scene.gate), OTHER, True, low, deep))
        return drawn_walls

    def _standing_walls(self) -> list[DrawnWall]:
        """Return the walls of the scene that stand still, and their mirror images."""
        drawn_walls = []
        for wall in self.simulation.scene.walls:
            drawn = wall.drawn()
            if drawn is not None:
                for a, b in self._mirrored:
                    name = wall.name + ("" if a > 0 else "_left") + ("" if b > 0 else "_front")
                    drawn_walls.append(DrawnWall(name, drawn[0] * [a, b, 1.0], drawn[1], False, PLATE))
        return drawn_walls

    def _cropped(self, points: Points) -> np.ndarray:
        """Return the corners `points` of a polygon [m], clipped to the simulated space, with the first one repeated."""
        scene = self.simulation.scene
        corners = np.array([*points, points[0]])
        return np.clip(corners, [0.0, 0.0], [scene.width, scene.height])

    def wall_pose(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the current position [m], shape (3,), and orientation quaternion (x, y, z, w) of a drawn wall."""
        lift = 0.0
        if self.walls()[number].moves:
            lift = self.simulation.scene.lift_speed * self.time
        return np.array([0.0, 0.0, lift]), np.array([0.0, 0.0, 0.0, 1.0])

    def bounds(self) -> np.ndarray:
        scene = self.simulation.scene
        height = float(np.max(np.array(scene.outline)[:, 1]))
        left = -0.8 * scene.width if self._axial else 0.0
        if self._solid:
            upper = np.array([scene.width, scene.depth, height])
            signs = np.array([[a, b, 0.0] for a, b in self._mirrored]).min(0)
            return np.stack([np.minimum(signs * upper, 0.0), upper])
        return np.array([[left, 0.0, 0.0], [0.8 * scene.width if self._axial else scene.width, 0.0, height]])


def _revolved(name: str, line: np.ndarray, colour: Colour, moves: bool) -> DrawnWall:
    """Return the surface of revolution of a line of radii and heights [m] as a drawn wall.

    `moves` is True if the position of the wall changes in time.
    """
    facets = 48
    angle = 2 * np.pi * np.arange(facets) / facets
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(facets, z)]) for r, z in line])
    faces = []
    for k in range(len(line) - 1):
        for n in range(facets):
            a, b = k * facets + n, k * facets + (n + 1) % facets
            faces += [(a, b, a + facets), (b, b + facets, a + facets)]
    return DrawnWall(name, vertices, np.array(faces), moves, colour)


def _extruded(name: str, line: np.ndarray, colour: Colour, moves: bool, low: float, high: float) -> DrawnWall:
    """Return the surface that a line in the plane of x and z [m] sweeps from y = `low` to y = `high` [m].

    The surface is returned as a drawn wall. `moves` is True if the position of the wall changes in time.
    """
    vertices = np.array([(x, y, z) for x, z in line for y in (low, high)])
    faces = [
        f for k in range(len(line) - 1) for f in ((2 * k, 2 * k + 1, 2 * k + 2), (2 * k + 1, 2 * k + 3, 2 * k + 2))
    ]
    return DrawnWall(name, vertices, np.array(faces), moves, colour)
