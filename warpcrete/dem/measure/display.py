"""Display of a discrete element run: the colours, lines, plots and walls that recorders and viewers draw."""

from typing import Any, ClassVar, Protocol

import numpy as np

from ...core.device.simulation_protocol import DrawnSimulation
from ...core.drawing.display import (
    GLASS,
    OTHER,
    PISTON,
    Curve,
    Display,
    DrawnWall,
    Lines,
    Plot,
    Points,
    Pose,
    Profile,
    Prototype,
    RigidBodies,
)
from ...core.drawing.paint import Paint, packed, palette_colours, rounded_up
from ...core.drawing.style import RUN, SECOND, SERIES, THIRD
from ...core.units import shown
from ...geometry.axis import Axis
from ...geometry.walls import Prescribed
from ...kernels.dem.bond_parallel import HYDRATED
from ..engine.bonding import bond_kinds
from ..engine.model import Model
from ..engine.pairs import chunks_of, pairs_of
from ..scene.slices import Stations
from .probes import largest_forces, listed_forces
from .station_forces import STRESS_RESOLUTION, body_stresses
from .stations import COLUMNS, stresses_along

COLOURS = {"pipe": GLASS, "piston": PISTON}
WORN = (255, 255, 255, 215)
"""Base colour of worn walls as red, green, blue and alpha; aggregates remain faintly visible behind such walls."""
WEAR_PALETTE = "magma_r"
"""Colour map of wear, different from the colour map of aggregates, and pale where a wall is not worn."""
HEAP = {"spread": "spread", "top": "highest point"}
"""Columns of the time series that show the shape of a heap, with their labels in plots.

These columns are plotted for standard tests that do not choose other columns.
"""
NANOMETRES = 1e9
WEAR_QUANTILE = 0.99
"""Quantile of the depths of all worn patches that sets the top of the colour scale.

The largest depth is unsuitable, because single patches are worn far deeper than the rest.
"""
BONDS = (230, 140, 30)
ALONG = (("axial", "axial_stress", RUN), ("mean", "pressure", SECOND))
"""Stresses plotted along the pipe: the label of each, its column in the table of stations (slices of the pipe), and its
colour."""
MAX_LINE_RADIUS, MIN_LINE_RATIO = 0.12, 0.04
"""Radii of the lines that show contact forces.

`MAX_LINE_RADIUS` is the radius for the force at the top of the colour scale, as a fraction of the size of the largest
aggregate. `MIN_LINE_RATIO` is the radius for a contact without force, as a fraction of the radius at the top of the
colour scale.
"""
RINGS = 10
"""Number of rings of a velocity profile between the axis and the wall."""
STRETCH = (0.2, 0.8)
"""Two fractions of the number of bodies, counted along the pipe from the rear. A velocity profile is averaged over the
bodies between these two fractions, because the velocity is different near the ends of the concrete."""
ENERGIES = {
    "kinetic_energy": ("kinetic [J]", RUN),
    "elastic_energy": ("elastic [J]", SECOND),
    "bond_energy": ("bonds [J]", THIRD),
}
"""Label and colour of each energy that is plotted over time, by its column in the series."""


class DrawnElements(DrawnSimulation, Protocol):
    """Members of a discrete element simulation that its display reads."""

    @property
    def model(self) -> Model:
        """Constant device arrays of the run, and the features of its scene."""
        ...


class ElementDisplay(Display):
    """Display of aggregates coloured by largest contact force, speed or size; a clump is drawn as its spheres."""

    colourings: ClassVar = ("force", "speed", "size")
    noun: ClassVar = "aggregates"
    has_network: ClassVar = True

    def __init__(self, simulation: DrawnElements, colouring: str | None = None) -> None:
        super().__init__(simulation, colouring)
        self._model = simulation.model
        self._upper = self._limit()
        self._patches: dict[int, np.ndarray] = {}
        """Index of the wear patch (area over which wear is summed) at each vertex of a worn wall, by the number of the
        wall."""
        self._worn_most = 0.0
        self._latest: tuple[float, np.ndarray] | None = None
        """Simulated time of the last stress measurement in the slices of the pipe [s], and the measured values."""
        walls = self._model.walls
        self._drawn = [number for number, wall in enumerate(walls) if wall.drawn() is not None]

    def _limit(self) -> float:
        """Return the value at the top of the colour scale for the quantity by which the aggregates are coloured.

        For contact forces the top is 5 % of the stress scale of the contact law times the square of the largest size
        [N]. For sizes it is the largest size [m]. For speeds it is 1.5 times the speed of the piston or, without a
        pipe, of the fastest wall with prescribed motion [m/s]; if nothing moves, it is 1 m/s.
        """
        scene = self.simulation.scene
        self._largest = largest = float(self.simulation.state.bodies.size.numpy().max(initial=0.0))
        self._thick = MAX_LINE_RADIUS * largest
        self._strong = 0.05 * scene.contact.stress_scale * largest**2
        if self.colouring == "size":
            return largest
        if self.colouring == "speed":
            motions = [wall.motion for wall in scene.walls if isinstance(wall.motion, Prescribed)]
            speeds = [float(np.linalg.norm(motion.velocity)) for motion in motions]
            nominal = scene.pipe.velocity if scene.pipe is not None else max(speeds, default=0.0)
            return 1.5 * float(nominal) if nominal else 1.0
        return self._strong

    def scale(self) -> tuple[str, float, float]:
        if self.colouring == "size":
            return "size [mm]", 0.0, 1e3 * self._upper
        if self.colouring == "speed":
            return "speed [cm/s]", 0.0, 100 * self._upper
        return "largest contact force per aggregate [N]", 0.0, self._upper

    def _sphere_order(self) -> np.ndarray:
        return self.derived("order of spheres", lambda: _places_of(self.read("spheres.id")))

    def _body_order(self) -> np.ndarray:
        return self.derived("order of bodies", lambda: _places_of(self.read("bodies.id")))

    def radii(self) -> np.ndarray:
        """Return the radii of all spheres [m], in order of permanent numbers, shape (n,)."""
        return self.read("spheres.position")[self._sphere_order(), 3]

    def centres(self) -> np.ndarray:
        """Return the centres of all spheres [m], in order of permanent numbers, shape (n, 3)."""
        return np.take(self.read("spheres.position"), self._sphere_order(), axis=0)[:, :3]

    def colours(self) -> np.ndarray:
        return np.take(self._painted(), self._bodies_of_spheres(), axis=0)

    def packed_colours(self) -> np.ndarray:
        return np.take(packed(self._painted()), self._bodies_of_spheres())

    def _bodies_of_spheres(self) -> np.ndarray:
        """Return the index of each sphere's body in the body arrays, in order of the spheres' permanent numbers."""
        return np.take(self.read("spheres.body"), self._sphere_order())

    def fields(self) -> dict[str, np.ndarray]:
        """Return permanent number, velocity [m/s] and largest contact force [N] of the body of each sphere."""
        place = self.read("spheres.body")[self._sphere_order()]
        velocity, force = self.read("bodies.velocity"), self._largest_forces()
        return {"body": self.read("bodies.id")[place], "velocity": velocity[place, :3], "force": force[place]}

    def _pair_forces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return, for every listed pair, both sphere indices, the index in the pair arrays and the normal force [N]."""
        model, state = self._model, self.simulation.state
        force = self.snapshot_value("pair forces", lambda: listed_forces(model, state))
        chunks = self.snapshot_value("chunks", lambda: chunks_of(state))
        i, j, place = pairs_of(self.read("pairs.start"), self.read("pairs.other"), chunks)
        return i, j, place, force[place]

    def _largest_forces(self) -> np.ndarray:
        """Return the largest contact force on each body [N], in the order of the state's arrays."""
        model, state = self._model, self.simulation.state
        return self.snapshot_value("largest forces", lambda: largest_forces(model, state))

    def body_colours(self) -> np.ndarray:
        return np.take(self._painted(), self._body_order(), axis=0)

    def _painted(self) -> np.ndarray:
        """Return the colours of all bodies as RGB bytes, in the order of the bodies in memory, shape (n, 3)."""
        return self.derived(
            f"{self.colouring} up to {self._upper}", lambda: palette_colours(self._shown(), self._upper)
        )

    def _shown(self) -> np.ndarray:
        """Return the size, speed or largest contact force by which each body is coloured.

        The bodies are in the order of the state's arrays.
        """
        if self.colouring == "size":
            return self.read("bodies.size").astype(float)
        if self.colouring == "speed":
            return np.linalg.norm(self.read("bodies.velocity").astype(float), axis=1)
        return self._largest_forces()

    def plots(self) -> tuple[Plot, ...]:
        """Return the plots over time: energies, the pressure on a piston, and the shape of the concrete in a vessel."""
        scene, plots = self.simulation.scene, []
        if scene.pressure is not None:
            pressure = Curve("piston", "piston pressure [kPa]", lambda row: row["pressure"] / 1e3, RUN)
            plots.append(Plot("pressure", "Pressure on the piston", (pressure,)))
        if scene.vessel is not None:
            test = scene.vessel.test
            names = test.curves or {name: words for name, words in HEAP.items() if name in test.columns}
            described = [(n, words, *shown(self.simulation.unit(n))) for n, words in names.items()]
            curves = tuple(
                Curve(n, f"{words} [{unit}]", lambda row, n=n, f=factor: f * row[n], colour)
                for (n, words, factor, unit), colour in zip(described, SERIES, strict=False)
            )
            if curves:
                plots.append(Plot("shape", "Shape", curves))
        energies = tuple(Curve(name, label, lambda row, n=name: row[n], c) for name, (label, c) in ENERGIES.items())
        return (*plots, Plot("energy", "Energy", energies))

    def profiles(self) -> tuple[Profile, ...]:
        """Return the curves to plot: velocity over the radius of the pipe, and stresses along the pipe.

        The stresses are left out if the scene does not measure them in slices.
        """
        scene, profiles = self.simulation.scene, []
        if scene.pipe is not None:
            title = "Velocity [cm/s] over radius [mm]"
            profiles.append(Profile("velocity", title, (Points("aggregates", self._velocities, RUN),)))
        if scene.stations is not None:
            curves = tuple(Points(name, lambda c=column: self._stresses(c), colour) for name, column, colour in ALONG)
            profiles.append(Profile("pressure", "Pressure [kPa] along the pipe [m]", curves))
        return tuple(profiles)

    def _stresses(self, column: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the mid-points of all filled slices along the pipe [m] and their stress [kPa] named `column`."""
        stations = self.simulation.scene.stations
        # All curves of a frame share one measurement. Repeat this measurement only when the simulated time has changed.
        if self._latest is None or self._latest[0] != self.time:
            self._latest = self.time, self._current_stresses(stations)
        values = self._latest[1][:, COLUMNS.index(column)]
        full = np.isfinite(values)
        return (stations.places - stations.origin)[full], values[full] / 1e3

    def _current_stresses(self, stations: Stations) -> np.ndarray:
        """Return the stresses in all slices of the pipe [Pa], shape (slices, stresses), in the order of `COLUMNS`.

        If the time series contains stresses, they are taken from its last row. This row is at most one sampling
        interval old, by default 0.01 s of simulated time. Otherwise the stresses are computed from the current state.
        """
        simulation = self.simulation
        sampler = getattr(simulation, "sampler", None)
        if sampler is None:  # Before t = 0, nothing is sampled, so the stresses are unknown (NaN) and not drawn.
            return np.full((len(stations.places), len(COLUMNS)), np.nan)
        if stations.each_row:
            # The samples are never changed after they have been recorded, so the display needs no copy.
            return self.snapshot_value("stations", lambda: sampler.log.samples[-1])
        unit = simulation.scene.contact.stress_scale * self._largest**3
        stress = self.snapshot_value("body stresses", lambda: body_stresses(self._model, simulation.state, unit))
        probe, travel = simulation.scene.pressure, 0.0
        if probe is not None:
            number = next(k for k, wall in enumerate(self._model.walls) if wall.name == probe.wall)
            travel = float(self.read("walls.travel")[number])
        s, _, tangent = self._on_axis(stations.axis)
        return stresses_along(
            stations, STRESS_RESOLUTION * unit * stress, s, tangent, self.read("bodies.size").astype(float),
            self.read("bodies.group") == 0, travel,
        )  # fmt: skip

    def _on_axis(self, axis: Axis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the arc length [m] of each body along the pipe, the nearest point of the axis [m] and its tangent.

        The shapes are (n,), (n, 3) and (n, 3).
        """

        def found() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            s = axis.along(self.read("bodies.position"))
            return s, *axis.at(s)

        return self.derived(("on", axis), found)

    def _velocities(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the mid-radii of rings about the pipe's axis [mm], and the bodies' mean axial velocity in each [cm/s].

        Bodies are weighted by volume. Rings without bodies are omitted.
        """
        pipe = self.simulation.scene.pipe
        position, velocity = self.read("bodies.position"), self.read("bodies.velocity")
        along, places, tangent = self._on_axis(pipe.axis)
        # Leave out the bodies at both ends of the concrete: find the arc lengths between which bodies are averaged.
        low, high = (round(part * max(len(along) - 1, 0)) for part in STRETCH)
        ends = np.partition(along, (low, high))[[low, high]] if len(along) else np.zeros(2)
        # Give bodies outside the averaged range the weight 0, which is faster than selecting the bodies inside it.
        apart = position - places
        distance = np.sqrt(np.einsum("ij,ij->i", apart, apart))
        speed = np.einsum("ij,ij->i", velocity[:, :3], tangent)
        volume = self.read("bodies.size").astype(float) ** 3 * ((along >= ends[0]) & (along <= ends[1]))
        ring = np.clip(np.nan_to_num(RINGS * distance / pipe.radius), 0, RINGS - 1).astype(int)
        weight = np.bincount(ring, volume, RINGS)
        there = weight > 0
        mean = np.bincount(ring, volume * speed, RINGS)[there] / weight[there]
        return 1e3 * pipe.radius * (np.arange(RINGS)[there] + 0.5) / RINGS, 100 * mean

    def walls(self) -> list[DrawnWall]:
        """Return the walls to draw as triangle meshes; infinite planes cannot be drawn."""
        drawn_walls = []
        for number in self._drawn:
            wall = self._model.walls[number]
            surface = wall.drawn()
            assert surface is not None
            vertices, faces = surface
            colour = COLOURS.get(wall.name, OTHER)
            if (worn := self._worn(number)) is not None:
                (vertices, faces, _), colour = worn.patches.surface(), WORN
            drawn_walls.append(DrawnWall(wall.name, vertices, faces, wall.motion is not None, colour))
        return drawn_walls

    def _worn(self, number: int) -> Any:
        """Return the wear record of wall `number`; None without a wear record or without patches.

        A plane is a single patch, so it has no distribution of wear that could be drawn.
        """
        # The sampler, which records the wear, is created at t = 0. Before, no wear is recorded.
        sampler = getattr(self.simulation, "sampler", None)
        if sampler is None or sampler.wear is None or len(sampler.wear.walls[number].done) == 1:
            return None
        return sampler.wear.walls[number]

    def paint(self) -> Paint | None:
        """Return the colour scale of the worn depth [nm], or None if no wall wears.

        The scale ends at a round number above the depth that only one worn patch in a hundred exceeds.
        """
        depths = [depth for number in self._drawn if (depth := self._depth(number)) is not None]
        if not depths:
            return None
        most = [float(np.quantile(depth[depth > 0], WEAR_QUANTILE)) for depth in depths if depth.any()]
        self._worn_most = max(self._worn_most, *most, 0.0)
        return Paint("worn depth [nm]", WEAR_PALETTE, rounded_up(self._worn_most) if self._worn_most > 0 else 0.0)

    def _depth(self, number: int) -> np.ndarray | None:
        """Return the worn depth of each patch of wall `number` [nm], or None if the wall does not wear."""
        worn = self._worn(number)
        return None if worn is None else NANOMETRES * self.snapshot_value(f"wear of {number}", lambda: worn.depth)

    def wall_values(self, number: int) -> np.ndarray | None:
        """Return the worn depth at the vertices of drawn wall `number` [nm], or None if it does not wear."""
        depth = self._depth(number := self._drawn[number])
        if depth is None:
            return None
        if number not in self._patches:
            self._patches[number] = self._worn(number).patches.surface()[2]
        return depth[self._patches[number]]

    def wall_pose(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        number = self._drawn[number]
        return (
            self.read("walls.position").reshape(-1, 3)[number].astype(float),
            self.read("walls.orientation").reshape(-1, 4)[number].astype(float),
        )

    def rigid_bodies(self) -> RigidBodies:
        state, order = self.simulation.state, self._body_order()
        prototypes = tuple(Prototype(t.name, t.offsets, t.radii, t.extent) for t in state.templates)
        return RigidBodies(prototypes, state.bodies.shape.numpy()[order], state.bodies.size.numpy()[order])

    def pose(self) -> Pose:
        order = self._body_order()
        names = "position", "orientation", "velocity"
        return Pose(*(np.take(self.read(f"bodies.{name}"), order, axis=0) for name in names))

    def network(self) -> dict[str, Lines]:
        """Return the contact network as sets of lines: touching pairs without a bond, bonds, and hydrated bonds."""
        i, j, place, force = self._pair_forces()
        position = self.read("spheres.position")
        reach = position[i, 3] + position[j, 3]
        touching = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < reach
        kinds = np.zeros(len(place), int)
        if self._model.features.bonds:
            kinds = bond_kinds(self.read("pairs.bond")[place])

        def lines(chosen: np.ndarray) -> Lines:
            ends = np.stack([position[i[chosen], :3], position[j[chosen], :3]], axis=1)
            radii = self._thick * np.clip(force[chosen] / self._strong, MIN_LINE_RATIO, 1)
            colours = np.where(force[chosen, None] > 0, palette_colours(force[chosen], self._strong), BONDS)
            return Lines(ends, force[chosen], radii.astype(np.float32), colours.astype(np.uint8))

        # Bonds of kind 2 are hydrated bonds only if the scene has hydration. In other scenes kind 2 is used for other
        # bonds, such as the bonds inside a body group, so all bonds get the same colour.
        if not self.simulation.scene.hydration:
            return {"contacts": lines(touching & (kinds <= 0)), "bonds": lines(kinds > 0)}
        hydrated = kinds == int(HYDRATED)
        bonds = {"bonds": lines((kinds > 0) & ~hydrated), "hydrated bonds": lines(hydrated)}
        return {"contacts": lines(touching & (kinds <= 0)), **bonds}

    def bounds(self) -> np.ndarray:
        """Return the lowest and the highest corner of a bounding box [m], shape (2, 3).

        The box encloses the pipe's axis, or all spheres if the scene has no pipe.
        """
        pipe = self.simulation.scene.pipe
        if pipe is not None:
            points, _ = pipe.axis.at(np.linspace(0, pipe.axis.length, 50))
            return np.stack([points.min(0), points.max(0)])
        position = self.read("spheres.position").astype(float)
        if len(position) == 0:
            return np.zeros((2, 3))
        return np.stack([(position[:, :3] - position[:, 3:]).min(0), (position[:, :3] + position[:, 3:]).max(0)])


def _places_of(numbers: np.ndarray) -> np.ndarray:
    """Return the inverse of a permutation: the index at which each number from 0 to n - 1 is stored."""
    places = np.empty(len(numbers), dtype=np.intp)
    places[numbers] = np.arange(len(numbers))
    return places
