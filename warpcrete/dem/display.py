"""Discrete elements as recorders draw them."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ..core.display import (
    GLASS,
    OTHER,
    PISTON,
    Curve,
    Display,
    DrawnWall,
    Plot,
    Pose,
    Prototype,
    RigidBodies,
    on_palette,
)
from ..geometry.walls import Prescribed
from .probes import chunks_of, largest_forces, pairs_of

COLOURS = {"pipe": GLASS, "piston": PISTON}
WORN = (255, 255, 255, 215)
"""Over the colours of wear: stones are to be seen through it a little."""
WEAR_PALETTE = "magma_r"
"""Another one than that of stones; pale where nothing is worn."""
CONTACTS, BONDS = (130, 130, 130), (230, 140, 30)
ENERGIES = {"kinetic_energy": "kinetic [J]", "elastic_energy": "elastic [J]", "bond_energy": "bonds [J]"}


class ElementDisplay(Display):
    """Aggregates by speed, size or largest contact force; every clump is drawn by its own spheres."""

    colourings: ClassVar = ("speed", "size", "force")
    noun: ClassVar = "aggregates"
    has_network: ClassVar = True

    def __init__(self, simulation: Any, colouring: str | None = None) -> None:
        super().__init__(simulation, colouring)
        self._upper = self._limit()
        self._patches: dict[int, np.ndarray] = {}
        """Patch of each vertex of a worn wall, by the wall's number."""
        walls = simulation.model.walls
        self._drawn = [number for number, wall in enumerate(walls) if wall.drawn() is not None]

    def _limit(self) -> float:
        """Top of the colour scale: 1.5 times the steady speed, the largest size, a strong contact force."""
        scene = self.simulation.scene
        largest = float(self.simulation.state.bodies.size.numpy().max(initial=0.0))
        if self.colouring == "size":
            return largest
        if self.colouring == "speed":
            motions = [wall.motion for wall in scene.walls if isinstance(wall.motion, Prescribed)]
            speeds = [float(np.linalg.norm(motion.velocity)) for motion in motions]
            nominal = scene.pipe.velocity if scene.pipe is not None else max(speeds, default=0.0)
            return 1.5 * float(nominal) if nominal else 1.0
        return 0.05 * scene.contact.stress_scale * largest**2

    def _sphere_order(self) -> np.ndarray:
        return np.argsort(self.read("spheres.id"))

    def _body_order(self) -> np.ndarray:
        return np.argsort(self.read("bodies.id"))

    def radii(self) -> np.ndarray:
        """Of all spheres [m], in order of permanent numbers, shape (n,)."""
        return self.read("spheres.position")[self._sphere_order(), 3]

    def centres(self) -> np.ndarray:
        """Of all spheres [m], likewise, shape (n, 3)."""
        return self.read("spheres.position")[self._sphere_order(), :3]

    def colours(self) -> np.ndarray:
        """RGB bytes of all spheres, each as its body, shape (n, 3)."""
        body = self.read("bodies.id")[self.read("spheres.body")[self._sphere_order()]]
        return self.body_colours()[body]

    def fields(self) -> dict[str, np.ndarray]:
        """Of every sphere its body's number, velocity [m/s] and largest contact force [N]."""
        model, state = self.simulation.model, self.simulation.state
        place = self.read("spheres.body")[self._sphere_order()]
        force = self.once("largest forces", lambda: largest_forces(model, state))
        velocity = self.read("bodies.velocity")
        return {"body": self.read("bodies.id")[place], "velocity": velocity[place, :3], "force": force[place]}

    def body_colours(self) -> np.ndarray:
        """RGB bytes of all bodies, shape (n, 3)."""
        order = self._body_order()
        if self.colouring == "size":
            values = self.read("bodies.size")[order].astype(float)
        elif self.colouring == "speed":
            values = np.linalg.norm(self.read("bodies.velocity")[order].astype(float), axis=1)
        else:
            model, state = self.simulation.model, self.simulation.state
            values = self.once("largest forces", lambda: largest_forces(model, state))[order]
        return on_palette(values, self._upper)

    def plots(self) -> tuple[Plot, ...]:
        """Pressure on the piston, and energies."""
        pressure = Curve(
            "piston", "piston pressure [kPa]", lambda row: row["pressure"] / 1e3 if "pressure" in row else None,
            (215, 95, 30),
        )  # fmt: skip
        energies = tuple(Curve(name, label, lambda row, n=name: row[n]) for name, label in ENERGIES.items())
        return Plot("pressure", "Pressure on the piston", (pressure,)), Plot("energy", "Energy", energies)

    def walls(self) -> list[DrawnWall]:
        """Walls that can be drawn: endless planes cannot."""
        found = []
        for number in self._drawn:
            wall = self.simulation.model.walls[number]
            vertices, faces = wall.drawn()
            colour = COLOURS.get(wall.name, OTHER)
            if (worn := self._worn(number)) is not None:
                (vertices, faces, _), colour = worn.patches.surface(), WORN
            found.append(DrawnWall(wall.name, vertices, faces, wall.motion is not None, colour))
        return found

    def _worn(self, number: int) -> Any:
        """What is known of a wall's wear; None of planes, which have one patch."""
        sampler = getattr(self.simulation, "sampler", None)  # there is none before t = 0
        if sampler is None or sampler.wear is None or len(sampler.wear.walls[number].done) == 1:
            return None
        return sampler.wear.walls[number]

    def wall_colours(self, number: int) -> np.ndarray | None:
        """Of walls that wear: depth over that of the hundredth of the patches that is worn most."""
        worn = self._worn(number := self._drawn[number])
        if worn is None:
            return None
        depth = self.once(f"wear of {number}", lambda: worn.depth)
        if number not in self._patches:
            self._patches[number] = worn.patches.surface()[2]
        return on_palette(depth, float(np.quantile(depth, 0.99)), name=WEAR_PALETTE)[self._patches[number]]

    def wall_pose(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (x, y, z, w) of a drawn wall now."""
        number = self._drawn[number]
        return (
            self.read("walls.position").reshape(-1, 3)[number].astype(float),
            self.read("walls.orientation").reshape(-1, 4)[number].astype(float),
        )

    def rigid_bodies(self) -> RigidBodies:
        """Shapes of the bodies."""
        state, order = self.simulation.state, self._body_order()
        prototypes = tuple(Prototype(t.name, t.offsets, t.radii, t.extent) for t in state.templates)
        return RigidBodies(prototypes, state.bodies.shape.numpy()[order], state.bodies.size.numpy()[order])

    def pose(self) -> Pose:
        """Where rigid bodies are."""
        order = self._body_order()
        return Pose(*(self.read(f"bodies.{name}")[order] for name in ("position", "orientation", "velocity")))

    def network(self) -> dict[str, tuple[np.ndarray, tuple[int, int, int]]]:
        """Touching pairs that are not bonded, and bonds."""
        chunks = self.once("chunks", lambda: chunks_of(self.simulation.state))
        i, j, place = pairs_of(self.read("pairs.start"), self.read("pairs.other"), chunks)
        position = self.read("spheres.position")
        reach = position[i, 3] + position[j, 3]
        touching = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < reach
        bonded = np.zeros_like(touching)
        if self.simulation.model.features.bonds:
            bonded = self.read("pairs.bond")[place] > 0

        def lines(chosen: np.ndarray) -> np.ndarray:
            return np.stack([position[i[chosen], :3], position[j[chosen], :3]], axis=1)

        return {"contacts": (lines(touching & ~bonded), CONTACTS), "bonds": (lines(bonded), BONDS)}

    def bounds(self) -> np.ndarray:
        """Lowest and highest corner of the pipe's axis, or of all spheres, shape (2, 3) [m]."""
        pipe = self.simulation.scene.pipe
        if pipe is not None:
            points, _ = pipe.axis.at(np.linspace(0, pipe.axis.length, 50))
            return np.stack([points.min(0), points.max(0)])
        position = self.read("spheres.position").astype(float)
        if len(position) == 0:
            return np.zeros((2, 3))
        return np.stack([(position[:, :3] - position[:, 3:]).min(0), (position[:, :3] + position[:, 3:]).max(0)])
