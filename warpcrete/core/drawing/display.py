"""Displays, which give recorders the data to draw a run: bodies, walls, plots over time and space, a camera view."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar, TypeVar

import numpy as np

from ..device.recorder_thread import RecorderThread
from ..device.simulation_protocol import DrawnSimulation
from ..errors import one_of
from .paint import Paint, packed, palette_colours
from .snapshots import Snapshot, on_host, snapshot_of
from .surfaces import Surface

Colour = tuple[int, int, int, int]
"""Colour as red, green, blue and opacity, each from 0 to 255."""
GLASS: Colour = (95, 130, 170, 70)
PISTON: Colour = (190, 110, 60, 255)
OTHER: Colour = (130, 150, 170, 80)
T = TypeVar("T")


@dataclass(frozen=True)
class DrawnWall:
    """Wall as a triangle mesh, in coordinates that move with the wall."""

    name: str
    vertices: np.ndarray
    """Positions of v vertices in the wall's own coordinate frame [m], shape (v, 3)."""
    faces: np.ndarray
    """Indices of the three vertices of each of the wall's f triangles, shape (f, 3)."""
    moves: bool
    colour: Colour


@dataclass(frozen=True)
class Prototype:
    """Shape of a rigid body of unit size, as a clump of spheres; bodies of different sizes may share one shape."""

    name: str
    offsets: np.ndarray
    """Centres of the clump's spheres relative to its centroid, divided by the body's size, shape (k, 3)."""
    radii: np.ndarray
    """Radii of the clump's spheres divided by the body's size, shape (k,)."""
    extent: float
    """Distance from the clump's centroid to the farthest point of its surface, divided by the body's size."""


@dataclass(frozen=True)
class RigidBodies:
    """Shapes and sizes of rigid bodies, in the order of the bodies' permanent numbers."""

    prototypes: tuple[Prototype, ...]
    prototype: np.ndarray
    """Index of each body's shape in `prototypes`, shape (n,)."""
    sizes: np.ndarray
    """Size of each body [m], shape (n,): the length by which its shape at unit size is multiplied."""


@dataclass(frozen=True)
class Pose:
    """Positions, orientations and velocities of rigid bodies, in the order of the bodies' permanent numbers."""

    positions: np.ndarray
    """Positions of the bodies [m], shape (n, 3)."""
    orientations: np.ndarray
    """Orientations of the bodies as unit quaternions (x, y, z, w), shape (n, 4)."""
    velocities: np.ndarray
    """Velocities of the bodies [m/s], shape (n, 3)."""


@dataclass(frozen=True)
class DrawnSpheres:
    """Spheres that lie in a concrete with a surface, such as the stones in a mortar, with their mirror images."""

    centres: np.ndarray
    """Centres of the spheres [m], shape (n, 3)."""
    radii: np.ndarray
    """Radii of the spheres [m], shape (n,)."""
    speeds: np.ndarray
    """Speeds of the bodies to which the spheres belong [m/s], shape (n,)."""
    bodies: np.ndarray
    """Number of the body to which each sphere belongs, shape (n,). Mirror images have the number of the original."""
    ids: np.ndarray
    """Permanent number of each sphere, shape (n,); each mirror image has a number of its own."""
    velocities: np.ndarray
    """Velocities of the centres of the spheres [m/s], shape (n, 3)."""
    colour: tuple[int, int, int]
    """Colour of the spheres: red, green and blue from 0 to 255."""


@dataclass(frozen=True)
class Curve:
    """Curve of a quantity over time, in a plot."""

    name: str
    """Name of the curve; a recording stores the curve under the path of its plot, followed by this name."""
    label: str
    """Text for the curve in the plot's legend, with the unit."""
    value: Callable[[dict[str, float]], float | None]
    """Function that takes a row of the time series and returns the value to draw, or None to draw nothing."""
    colour: tuple[int, int, int] | None = None


@dataclass(frozen=True)
class Plot:
    """Plot of one or more quantities over time."""

    path: str
    title: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Points:
    """Curve of a quantity over a spatial coordinate at one time, as part of a :class:`Profile`."""

    name: str
    """Name of the curve; a recording stores the curve under the path of its plot, followed by this name."""
    read: Callable[[], tuple[np.ndarray, np.ndarray]]
    """Function that returns coordinates and values, each of shape (n,), in the units stated in the profile's title."""
    colour: tuple[int, int, int]


@dataclass(frozen=True)
class Profile:
    """Plot of one or more quantities over a spatial coordinate, such as a radius, at one time."""

    path: str
    title: str
    """Title that names the quantities on both axes and their units."""
    curves: tuple[Points, ...]


@dataclass(frozen=True)
class Lines:
    """Lines that are drawn between bodies, such as force chains."""

    ends: np.ndarray
    """End points of n lines that are drawn between bodies [m], shape (n, 2, 3)."""
    forces: np.ndarray
    """Force between the two bodies that each drawn line joins [N], shape (n,)."""
    radii: np.ndarray
    """Radii with which the lines between bodies are drawn, as thin tubes [m], shape (n,)."""
    colours: np.ndarray
    """Colours of n lines that are drawn between bodies, as RGB bytes, shape (n, 3)."""


class Display(ABC):
    """View of a simulation that gives recorders the data to draw.

    `colouring` is the name of the quantity that colours the bodies, one of `colourings`; None selects `preferred`.
    Raises :class:`SceneError` for another value.
    """

    colourings: ClassVar[tuple[str, ...]]
    noun: ClassVar[str]
    """Word for the bodies, such as "particles"; recordings store the bodies under this word."""
    has_network: ClassVar[bool] = False
    """True if the display can draw lines between bodies, such as force chains."""
    has_surface: ClassVar[bool] = False
    """True if the surface of the concrete is drawn instead of bodies."""
    has_spheres: ClassVar[bool] = False
    """True if the concrete with this surface contains spheres, such as the stones in a mortar."""

    def __init__(self, simulation: DrawnSimulation, colouring: str | None = None) -> None:
        self.simulation = simulation
        self.colouring = self.preferred if colouring is None else colouring
        one_of("colour", self.colouring, self.colourings)
        self._sources: dict[str, Callable[[], object]] = {}
        self._current_snapshot: Snapshot | None = None
        self._yield_to_run: Callable[[], None] = lambda: None
        self._complete = False

    def read(self, path: str) -> np.ndarray:
        """Return an array of the simulation's state, with its values at the time that is drawn.

        `path` leads from the state to the array, such as "bodies.velocity".
        """
        return self.snapshot_value(path, lambda: attrgetter(path)(self.simulation.state))

    def snapshot_value(self, name: str, source: Callable[[], object]) -> Any:
        """Return a quantity of the simulation's state as it was at the drawn time.

        `source` is a function that returns the quantity's present value. It is not called while a snapshot (copy of the
        state at one time) is drawn: the result is then the value that the snapshot stores under `name`. All displays of
        a simulation share the values of a snapshot, so the caller must not modify the value. A Warp array is returned
        as a NumPy array.
        """
        if self._current_snapshot is not None:
            self._yield_to_run()
            return self._current_snapshot.read(name)
        self._sources[name] = source
        return on_host(source())

    def derived(self, name: Hashable, work: Callable[[], T]) -> T:
        """Return the result of the function `work`, which processes values of the drawn snapshot (copy of the state).

        The snapshot stores the result under `name`, so that `work` runs only once for all displays of the simulation.
        The caller must not modify the result.
        """
        if self._current_snapshot is None:
            return work()
        results = self._current_snapshot.derived
        if name not in results:  # No lock is needed: two threads would compute equal results.
            results[name] = work()
        return results[name]

    @property
    def time(self) -> float:
        """Simulated time of the state that is drawn [s]."""
        return self.simulation.stepper.time if self._current_snapshot is None else self._current_snapshot.time

    def draw(self, later: RecorderThread, job: Callable[[float, int], None]) -> None:
        """Let `job` draw the present state; the arguments of `job` are the simulated time [s] and the number of steps.

        `later` is the recorder thread, which draws while the simulation goes on. The first job runs at once in the
        calling thread, and the display records which values the job reads. For each of the next jobs, this method
        copies these values, and the recorder thread runs the job. Without such a thread, all jobs run at once.
        """
        time, steps = self.simulation.stepper.time, self.simulation.stepper.steps
        if not later.in_thread or not self._complete:
            later.wait()
            job(time, steps)
            self._complete = True
            return
        snapshot, self._yield_to_run = snapshot_of(self.simulation, self._sources), later.yield_to_run

        def drawn() -> None:
            self._current_snapshot = snapshot
            try:
                job(time, steps)
            finally:
                self._current_snapshot = None

        later.submit(drawn)

    @property
    def preferred(self) -> str:
        """Name of the quantity that colours the bodies if the user chooses none."""
        return self.colourings[0]

    @abstractmethod
    def radii(self) -> np.ndarray:
        """Return the radii of all spheres [m], shape (n,); the radii never change."""

    @abstractmethod
    def centres(self) -> np.ndarray:
        """Return the centres of all spheres [m], shape (n, 3)."""

    @abstractmethod
    def colours(self) -> np.ndarray:
        """Return the colours of all spheres as RGB bytes, shape (n, 3)."""

    def packed_colours(self) -> np.ndarray:
        """Return the colour of each sphere as one 32-bit number for red, green, blue and opacity, shape (n,)."""
        return packed(self.colours())

    def fields(self) -> dict[str, np.ndarray]:
        """Return quantities of the n spheres in SI units, by name; each array has shape (n,) or (n, 3)."""
        return {}

    @abstractmethod
    def plots(self) -> tuple[Plot, ...]:
        """Return the plots over time that are shown next to the scene."""

    def surface(self, cut: bool = False) -> Surface | None:
        """Return the surface of the concrete; None if the bodies are drawn one by one.

        If the argument `cut` is true, leave out the concrete in front of the plane that the attribute `cut` describes.
        """
        return None

    def bare_surface(self) -> Surface | None:
        """Return the surface of the concrete without spheres; None if the bodies are drawn one by one."""
        return self.surface()

    def spheres(self) -> DrawnSpheres:
        """Return the spheres in the concrete. Raises TypeError if the concrete contains none."""
        raise TypeError(f"{type(self).__name__} does not draw spheres in a concrete")

    def surface_values(self, surface: Surface) -> np.ndarray:
        """Return the values of the quantity that colours a surface, at the surface's vertices, shape (v,).

        The values are in the unit of the colour scale. Raises TypeError if the display has no surface.
        """
        raise TypeError(f"{type(self).__name__} does not draw a surface")

    def surface_colours(self, surface: Surface) -> np.ndarray:
        """Return the colours of a surface at its vertices as RGB bytes, shape (v, 3)."""
        scale = self.scale()
        assert scale is not None
        return palette_colours(self.surface_values(surface), scale[2], scale[1], self.palette)

    @property
    def palette(self) -> str:
        """Name of the colour map for the quantity that colours bodies or surfaces, such as "viridis"."""
        return "viridis"

    def profiles(self) -> tuple[Profile, ...]:
        """Return the plots over the radius or along the pipe that are shown next to the scene."""
        return ()

    def scale(self) -> tuple[str, float, float] | None:
        """Return the colour scale's title with its unit, and the values at both ends of the scale.

        Return None if colours show categories instead of a quantity.
        """
        return None

    def categories(self) -> dict[str, np.ndarray]:
        """Return the colour of each category as RGB bytes (3,), by name; empty if colours show a quantity."""
        return {}

    @abstractmethod
    def walls(self) -> list[DrawnWall]:
        """Return the walls that can be drawn."""

    @abstractmethod
    def bounds(self) -> np.ndarray:
        """Return the lowest and highest corner of everything that is drawn [m], shape (2, 3)."""

    direction: ClassVar[tuple[float, float, float]] = (0.2, -0.95, 0.24)
    """Direction from the scene to the camera (x, y, z): a vector of about unit length."""

    def paint(self) -> Paint | None:
        """Return the colour scale of walls that are coloured by a quantity, such as the worn depth.

        The upper end of the scale may grow during the run, but it never falls. Return None if no wall is coloured by a
        quantity.
        """
        return None

    def wall_values(self, number: int) -> np.ndarray | None:
        """Return the values of the quantity that colours a drawn wall, at the vertices of the wall, shape (v,).

        The values are in the unit of the colour scale. The result is None for a wall of a single colour. `number` is
        the index of the wall in the list that :meth:`walls` returns.
        """
        return None

    def wall_pose(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the current position [m], shape (3,), and the orientation quaternion (x, y, z, w) of a drawn wall.

        `number` is the index of the wall in the list that :meth:`walls` returns.
        """
        return np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])

    def rigid_bodies(self) -> RigidBodies | None:
        """Return the shapes of the bodies; return None if the bodies are single particles."""
        return None

    def pose(self) -> Pose:
        """Return the current positions, orientations and velocities of the rigid bodies.

        Raises TypeError if there are no rigid bodies.
        """
        raise TypeError(f"{type(self).__name__} does not draw rigid bodies")

    def body_colours(self) -> np.ndarray:
        """Return the colours of all bodies as RGB bytes, shape (n, 3)."""
        return self.colours()

    def network(self) -> dict[str, Lines]:
        """Return groups of lines that join bodies, by group name; a line's width and colour show the force in it."""
        return {}

    @property
    def cut(self) -> float | None:
        """Coordinate y of an upright plane through the middle of the scene [m]; None if no cut is needed.

        Only parts beyond this plane, as seen from the camera, are drawn. This shows the inside of a pipe or vessel.
        """
        lower, upper = self.bounds()
        return float(0.5 * (lower[1] + upper[1]))

    @property
    def cut_title(self) -> str:
        """Title of the view that shows the parts beyond the cutting plane."""
        return "Cut through the middle"

    def view(self, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Return a camera position and the point to look at, both of shape (3,) [m].

        The camera is in the direction `direction` from the centre of the scene. Its distance is `distance` times the
        diagonal of the box around the scene.
        """
        lower, upper = self.bounds()
        centre = 0.5 * (lower + upper)
        size = max(float(np.linalg.norm(upper - lower)), 0.1)
        return centre + distance * size * np.array(self.direction), centre
