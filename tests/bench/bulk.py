"""Scenes of the three bulk processes of Dosta et al. 2024 (Computer Physics Communications 296, 109066).

A silo empties, a drum mixes two kinds of spheres, and a steel ball hits a bed of spheres. Geometry, materials,
velocities and time steps are those of the paper's programs for MercuryDPM (Drivers/Papers/OSBenchmark) and YADE
(examples/DEM2020Benchmark). The spheres of the paper start from published positions; :func:`poured` makes similar ones.
"""

import math
import time as wall_clock
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from warpcrete import Recorder, Simulation
from warpcrete.dem.laws import HertzMindlin
from warpcrete.dem.scene.scene import Bodies, Scene, Settle, TimeStep
from warpcrete.geometry.prisms import rectangle
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed, Wall

YOUNG = {"M1": 1e9, "M2": 0.5e9, "steel": 210e9}  # [Pa]
POISSON = 0.2
DENSITY = {"M1": 2500.0, "M2": 2000.0, "steel": 7200.0}  # [kg/m3]
IMPACTS = {
    ("M1", "M1"): (0.5, 0.3), ("M1", "M2"): (0.45, 0.2), ("M2", "M2"): (0.4, 0.4), ("M1", "steel"): (0.4, 0.2),
    ("M2", "steel"): (0.4, 0.2), ("steel", "steel"): (0.6, 0.5),
}  # fmt: skip
"""Coefficients of restitution and friction of each pair of materials."""
SIDES = 100
"""Number of flat sides of silo and drum, as in the paper's meshes. Their corners lie on the circle."""


def law(one: str, other: str) -> HertzMindlin:
    """Return the contact law of two materials."""
    pair = tuple(sorted((one, other)))
    restitution, friction = IMPACTS[pair]
    shear = {name: young / (2 * (1 + POISSON)) for name, young in YOUNG.items()}
    return HertzMindlin(
        effective_modulus=1 / sum((1 - POISSON**2) / YOUNG[name] for name in pair),
        effective_shear_modulus=1 / sum((2 - POISSON) / shear[name] for name in pair),
        restitution=restitution, friction=friction,
    )  # fmt: skip


CONTACTS = {pair: law(*pair) for pair in combinations_with_replacement(sorted(YOUNG), 2)}


def surface(rings: list[tuple[float, float]], sides: int = SIDES) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [m] and faces of a surface of revolution about the z axis through rings of given (radius, z)."""
    angle = 2 * np.pi * np.arange(sides) / sides
    vertices = [np.stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)], 1) for r, z in rings]
    k = np.arange(sides)
    following = (k + 1) % sides
    faces = []
    for first in range(0, sides * (len(rings) - 1), sides):
        a, b, c, d = (first + n for n in (k, following, sides + k, sides + following))
        faces += [np.stack([a, c, b], 1), np.stack([b, c, d], 1)]
    return np.concatenate(vertices), np.concatenate(faces)


@dataclass(frozen=True)
class Silo:
    """Silo of 0.2 m diameter with a hopper of 45 degrees above an orifice, and 100,000 spheres of 4 mm."""

    orifice: str = "large"
    material: str = "M1"
    count: int = 100_000
    size: float = 0.004
    """Diameter of the spheres [m]."""

    radius, pouring = 0.1, 0.5
    fall = 0.2
    """Distance from the orifice to the floor on which the spheres land [m]. The paper deletes them."""

    @property
    def rings(self) -> list[tuple[float, float]]:
        """Radius and height of the wall's rings [m], from the orifice to the upper rim."""
        narrow, low, rim = {"large": (0.03, -0.0554222, 0.314578), "small": (0.02, -0.0593008, 0.320699)}[self.orifice]
        return [(narrow, low), (self.radius, low + self.radius - narrow), (self.radius, rim)]

    @property
    def low(self) -> float:
        """Height of the orifice [m]."""
        return self.rings[0][1]

    @property
    def step(self) -> float:
        """Time step of the paper [s]."""
        return 1.5e-6 if self.material == "M1" else 2e-6

    def walls(self, closed: bool) -> tuple[Wall, ...]:
        """Return the silo above a floor; a closed silo has a lid in its orifice."""
        vertices, faces = surface(self.rings)
        below = PlaneWall(name="floor", point=(0, 0, self.low - self.fall), normal=(0, 0, 1), material="steel")
        if not closed:
            return below, MeshWall(name="silo", vertices=vertices, faces=faces, material="steel")
        wide = self.rings[0][0]
        lid, corners = rectangle((-wide, -wide, self.low), (2 * wide, 0, 0), (0, 2 * wide, 0))
        vertices, faces = np.concatenate([vertices, lid]), np.concatenate([faces, corners + len(vertices)])
        return below, MeshWall(name="silo", vertices=vertices, faces=faces, material="steel")

    def loose(self, random: np.random.Generator) -> list[tuple[str, float, np.ndarray]]:
        """Return material, diameter and positions of the spheres before they are poured."""
        (narrow, low), (wide, top), _ = self.rings

        def room(points: np.ndarray) -> np.ndarray:
            within = np.minimum(wide, narrow + (points[:, 2] - low) * (wide - narrow) / (top - low))
            return np.hypot(points[:, 0], points[:, 1]) < within - 0.8 * self.size

        box = np.array([[-wide, wide], [-wide, wide], [low + self.size, 10.0]])
        return [(self.material, self.size, lattice(self.count, self.size, box, room, random))]

    def scene(self, spheres: list[tuple[str, float, np.ndarray]], duration: float, step: float | None = None) -> Scene:
        """Return the emptying of the silo from given spheres; `step` None selects an automatic time step."""
        return scene("silo", self.walls(closed=False), spheres, duration, 0.1, step)


@dataclass(frozen=True)
class Drum:
    """Drum of 0.2 m diameter and 0.06 m length that turns at 2 rad/s about the y axis; 8000 M2 below 30,000 M1."""

    counts: tuple[int, int] = (30_000, 8000)
    """Numbers of spheres of M1 and M2."""
    sizes: tuple[float, float] = (0.002, 0.004)
    """Diameters of the spheres of M1 and M2 [m]."""
    turns: float = -2.0
    """Angular velocity about the y axis [rad/s]; the wall moves up at positive x."""

    radius, half, step, pouring = 0.1, 0.03, 8e-7, 0.4

    def walls(self, closed: bool) -> tuple[Wall, ...]:
        """Return the drum, which stands still while it is `closed` for pouring."""
        motion = None if closed else Prescribed(spin=(0.0, self.turns, 0.0))
        vertices, faces = surface([(self.radius, -self.half), (self.radius, self.half)])
        ends = tuple(
            PlaneWall(name=name, point=(0, -side * self.half, 0), normal=(0, side, 0), material="steel", motion=motion)
            for name, side in (("front", 1), ("back", -1))
        )
        shell = MeshWall(name="shell", vertices=vertices[:, [1, 2, 0]], faces=faces, material="steel", motion=motion)
        return (*ends, shell)

    def loose(self, random: np.random.Generator) -> list[tuple[str, float, np.ndarray]]:
        """Return material, diameter and positions of the spheres before they are poured, the large ones below."""
        found, low = [], -self.radius
        for name, count, size in zip(("M2", "M1"), self.counts[::-1], self.sizes[::-1]):

            def room(points: np.ndarray, size: float = size) -> np.ndarray:
                return np.hypot(points[:, 0], points[:, 2]) < self.radius - 0.8 * size

            sides = self.radius, self.half - 0.6 * size
            box = np.array([[-sides[0], sides[0]], [-sides[1], sides[1]], [low + size, self.radius]])
            found.append((name, size, lattice(count, size, box, room, random)))
            low = found[-1][2][:, 2].max() + 0.5 * size
        return found

    def scene(self, spheres: list[tuple[str, float, np.ndarray]], duration: float, step: float | None = None) -> Scene:
        """Return the turning drum with given spheres; `step` None selects an automatic time step."""
        return scene("drum", self.walls(closed=False), spheres, duration, 0.1, step)


@dataclass(frozen=True)
class Impact:
    """Steel ball of 20 mm that hits a bed of spheres of 2 mm in a box of 0.1 x 0.06 m at 5 m/s."""

    count: int = 25_000
    size: float = 0.002
    ball: float = 0.02
    """Diameter of the ball [m]."""

    sides, floor, height, speed, step, pouring = (0.1, 0.06), -0.0902431, 0.06, 5.0, 5e-7, 0.3

    def walls(self, closed: bool) -> tuple[Wall, ...]:
        """Return the floor and the four sides of the box."""
        x, y = (0.5 * side for side in self.sides)
        planes = {"floor": ((0, 0, self.floor), (0, 0, 1))}
        for name, point in (("left", (-x, 0, 0)), ("right", (x, 0, 0)), ("front", (0, -y, 0)), ("back", (0, y, 0))):
            planes[name] = point, tuple(-np.sign(point))
        return tuple(PlaneWall(name=n, point=p, normal=v, material="steel") for n, (p, v) in planes.items())

    def loose(self, random: np.random.Generator) -> list[tuple[str, float, np.ndarray]]:
        """Return material, diameter and positions of the bed's spheres before they are poured."""
        x, y = (0.5 * side - 0.6 * self.size for side in self.sides)
        box = np.array([[-x, x], [-y, y], [self.floor + self.size, 10.0]])
        return [("M1", self.size, lattice(self.count, self.size, box, lambda p: p[:, 2] > self.floor, random))]

    def scene(self, spheres: list[tuple[str, float, np.ndarray]], duration: float, step: float | None = None) -> Scene:
        """Return the impact on given spheres; `step` None selects an automatic time step."""
        made = scene("impact", self.walls(closed=True), spheres, duration, 1e-3, step)
        ball = Bodies(
            positions=[[0, 0, self.height]], sizes=self.ball, density=DENSITY["steel"], material="steel",
            velocities=[[0, 0, -self.speed]],
        )  # fmt: skip
        return replace(made, bodies=(*made.bodies, ball))


Process = Silo | Drum | Impact


def read(path: Path, process: Process) -> list[tuple[str, float, np.ndarray]]:
    """Return the spheres of a file of the benchmark, without the ball.

    The rows of a silo are x, y, z [m], those of the other processes radius, x, y, z [m].
    """
    columns = 3 if isinstance(process, Silo) else 4
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    rows = np.array([[float(v) for v in line] for line in lines if len(line) == columns and line[0][-1].isdigit()])
    if isinstance(process, Silo):
        return [(process.material, process.size, rows)]
    materials = {0.001: "M1", 0.002: "M2"}
    return [(materials[r], 2 * r, rows[rows[:, 0] == r, 1:]) for r in np.unique(rows[:, 0]) if r in materials]


def lattice(count: int, size: float, box: np.ndarray, room, random: np.random.Generator) -> np.ndarray:
    """Return `count` places from below on a shaken cubic lattice in a `box`, shape (3, 2), where `room` is True."""
    spacing = 1.15 * size
    columns = [np.arange(math.floor((b - a) / spacing) + 1) * spacing for a, b in box[:2]]
    columns = [x + 0.5 * (a + b - x[-1]) for x, (a, b) in zip(columns, box[:2])]
    found, z, total = [], box[2, 0], 0
    while total < count:
        layer = np.stack(np.meshgrid(*columns, [z], indexing="ij"), -1).reshape(-1, 3)
        layer += random.uniform(-1, 1, layer.shape) * 0.06 * size
        found.append(layer[room(layer)])
        total, z = total + len(found[-1]), z + spacing
        if z > box[2, 1]:
            raise ValueError(f"{total} of {count} spheres of {size} m fit into the box")
    return np.concatenate(found)[:count]


def scene(
    name: str, walls: tuple[Wall, ...], spheres: list[tuple[str, float, np.ndarray]], duration: float,
    sample_interval: float, step: float | None,
) -> Scene:  # fmt: skip
    """Return a scene with spheres, given as material, diameter and positions, between steel walls."""
    used = {"steel", *(kind for kind, _, _ in spheres)}
    return Scene(
        name=name, duration=duration, walls=walls, sample_interval=sample_interval,
        bodies=tuple(
            Bodies(positions=places, sizes=size, density=DENSITY[kind], material=kind) for kind, size, places in spheres
        ),
        contacts={pair: made for pair, made in CONTACTS.items() if used.issuperset(pair)}, contact=CONTACTS["M1", "M1"],
        time_step=TimeStep() if step is None else TimeStep(fixed=step, safety=1.0),
    )  # fmt: skip


def poured(process: Process, *, seed: int = 0, device: str = "cpu") -> list[tuple[str, float, np.ndarray]]:
    """Return the spheres of a process at rest after a fall, as a list of material, diameter and positions [m]."""
    spheres = process.loose(np.random.default_rng(seed))
    made = scene("pouring", process.walls(closed=True), spheres, 0.0, 0.1, None)
    run = Simulation(replace(made, settle=Settle(duration=process.pouring, local_damping=0.0)), device=device).run()
    ends = np.cumsum([len(places) for _, _, places in spheres])
    places = np.split(run.bodies.position, ends[:-1])
    return [(kind, size, x) for (kind, size, _), x in zip(spheres, places)]


class OutOfTime(Exception):
    """Wall time that a run may take is over."""


class Measured(Recorder):
    """Recorder that computes numbers from the positions of all bodies at each row of the time series."""

    def __init__(self, measure, limit: float = math.inf) -> None:
        """`measure` takes the positions [m], shape (n, 3); after `limit` seconds of wall time the run ends."""
        self.measure, self.limit = measure, limit
        self.times, self.rows, self.clock, self.steps = [], [], [], 0

    def sample(self, simulation, row) -> None:
        bodies = simulation.state.bodies
        places = np.empty((len(bodies.id), 3))
        places[bodies.id.numpy()] = bodies.position.numpy()[:, :3]
        self.times.append(simulation.stepper.time)
        self.rows.append(self.measure(places))
        self.clock.append(wall_clock.perf_counter())
        self.steps = simulation.stepper.steps
        if self.clock[-1] - self.clock[0] > self.limit:
            raise OutOfTime


def measured(made: Scene, measure, device: str, limit: float = math.inf) -> Measured:
    """Run a scene and return what was measured, also if the wall time `limit` [s] ended the run early."""
    recorder = Measured(measure, limit)
    with suppress(OutOfTime):
        Simulation(made, device=device, recorders=[recorder]).run()
    return recorder
