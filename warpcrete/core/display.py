"""What recorders draw of a run, whatever its method: bodies, walls, curves, a place for the eye."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from .errors import one_of
from .later import Later
from .moments import Moment, moment_of, on_host
from .paint import Paint, packed

Colour = tuple[int, int, int, int]
"""Red, green, blue and opacity, 0 to 255."""
GLASS: Colour = (150, 165, 180, 22)
PISTON: Colour = (190, 110, 60, 255)
OTHER: Colour = (150, 165, 180, 120)


@dataclass(frozen=True)
class DrawnWall:
    """A wall as a triangle mesh in its own frame."""

    name: str
    vertices: np.ndarray
    """[m], shape (v, 3)."""
    faces: np.ndarray
    """Shape (f, 3)."""
    moves: bool
    colour: Colour


@dataclass(frozen=True)
class Prototype:
    """Shape that several bodies have, at unit size."""

    name: str
    offsets: np.ndarray
    """Of its spheres' centres, shape (k, 3)."""
    radii: np.ndarray
    """Shape (k,)."""
    extent: float
    """Largest distance of its surface from the centroid."""


@dataclass(frozen=True)
class RigidBodies:
    """Bodies that share a few shapes, in order of their permanent numbers."""

    prototypes: tuple[Prototype, ...]
    prototype: np.ndarray
    """Of each body, shape (n,)."""
    sizes: np.ndarray
    """[m], shape (n,)."""


@dataclass(frozen=True)
class Pose:
    """Where rigid bodies are, in order of their permanent numbers."""

    positions: np.ndarray
    """[m], shape (n, 3)."""
    orientations: np.ndarray
    """Unit quaternions x, y, z, w, shape (n, 4)."""
    velocities: np.ndarray
    """[m/s], shape (n, 3)."""


@dataclass(frozen=True)
class Curve:
    """A line over time."""

    name: str
    """Of its path below the plot's."""
    label: str
    """With the unit."""
    value: Callable[[dict[str, float]], float | None]
    """Of a row of the series; None draws nothing."""
    colour: tuple[int, int, int] | None = None


@dataclass(frozen=True)
class Plot:
    """Curves over one another."""

    path: str
    title: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Points:
    """A curve over a place, at the moment that is drawn."""

    name: str
    """Of its path below the profile's."""
    read: Callable[[], tuple[np.ndarray, np.ndarray]]
    """Places and values, both (n,), in the units of the profile's title."""
    colour: tuple[int, int, int]


@dataclass(frozen=True)
class Profile:
    """Curves over a place, one over another."""

    path: str
    title: str
    """With what is drawn over what, and the units."""
    curves: tuple[Points, ...]


@dataclass(frozen=True)
class Lines:
    """Lines between bodies."""

    ends: np.ndarray
    """[m], shape (n, 2, 3)."""
    forces: np.ndarray
    """That they carry [N], shape (n,)."""
    radii: np.ndarray
    """[m], shape (n,)."""
    colours: np.ndarray
    """RGB bytes, shape (n, 3)."""


class Display(ABC):
    """A simulation as recorders draw it, bodies coloured by `colouring`, one of `colourings`; None: what shows most."""

    colourings: ClassVar[tuple[str, ...]]
    noun: ClassVar[str]
    """What the bodies are called; recordings have them under this word."""
    has_network: ClassVar[bool] = False
    """There are lines between bodies to be drawn."""

    def __init__(self, simulation: Any, colouring: str | None = None) -> None:
        self.simulation = simulation
        self.colouring = self.preferred if colouring is None else colouring
        one_of("colour", self.colouring, self.colourings)
        self._sources: dict[str, Callable[[], Any]] = {}
        self._taken: Moment | None = None
        self._give_way: Callable[[], None] = lambda: None
        self._complete = False

    def read(self, path: str) -> np.ndarray:
        """An array of the state by its path, such as "bodies.velocity", at the moment that is drawn."""
        return self.once(path, lambda: attrgetter(path)(self.simulation.state))

    def once(self, name: str, source: Callable[[], Any]) -> Any:
        """What hangs on the state at the moment that is drawn: from a moment that was taken, or from `source` now.

        Displays of one simulation that read something by the same name get the same, not to be written to. An array of
        a device comes as one of NumPy.
        """
        if self._taken is not None:
            self._give_way()
            return self._taken.read(name)
        self._sources[name] = source
        return on_host(source())

    def worked_out(self, name: Hashable, work: Callable[[], Any]) -> Any:
        """What `work` makes of what was read of the moment that is drawn, not to be written to: once for all displays
        of the simulation that have it by the same name.
        """
        if self._taken is None:
            return work()
        known = self._taken.worked_out
        if name not in known:  # of two that find it missing the second replaces the first's, which is the same
            known[name] = work()
        return known[name]

    @property
    def time(self) -> float:
        """Simulated time that is drawn [s]."""
        return self.simulation.stepper.time if self._taken is None else self._taken.time

    def draw(self, later: Later, job: Callable[[float, int], None]) -> None:
        """Have a job draw the state as it is now, of which it is given time [s] and steps.

        The first one is done at once, and shows what is to be read; of later ones that is read now.
        """
        time, steps = self.simulation.stepper.time, self.simulation.stepper.steps
        if not later.beside or not self._complete:
            later.wait()
            job(time, steps)
            self._complete = True
            return
        moment, self._give_way = moment_of(self.simulation, self._sources), later.give_way

        def drawn() -> None:
            self._taken = moment
            try:
                job(time, steps)
            finally:
                self._taken = None

        later.do(drawn)

    @property
    def preferred(self) -> str:
        """What colours show unless they are told to."""
        return self.colourings[0]

    @abstractmethod
    def radii(self) -> np.ndarray:
        """Of all spheres [m], shape (n,); they do not change."""

    @abstractmethod
    def centres(self) -> np.ndarray:
        """Of all spheres [m], shape (n, 3)."""

    @abstractmethod
    def colours(self) -> np.ndarray:
        """RGB bytes of all spheres, shape (n, 3)."""

    def packed_colours(self) -> np.ndarray:
        """The same as one number each, shape (n,): see :func:`.paint.packed`."""
        return packed(self.colours())

    def fields(self) -> dict[str, np.ndarray]:
        """Quantities of all spheres in SI units by name, shape (n,) or (n, 3)."""
        return {}

    @abstractmethod
    def plots(self) -> tuple[Plot, ...]:
        """Curves beside the scene."""

    def profiles(self) -> tuple[Profile, ...]:
        """Curves over the radius, or along the way, beside the scene."""
        return ()

    def scale(self) -> tuple[str, float, float] | None:
        """What colours show, with its unit as read, and its values at both ends; None for colours of things."""
        return None

    def things(self) -> dict[str, np.ndarray]:
        """RGB bytes (3,) of what colours tell apart, by name, where they show no quantity."""
        return {}

    @abstractmethod
    def walls(self) -> list[DrawnWall]:
        """Walls that can be drawn."""

    @abstractmethod
    def bounds(self) -> np.ndarray:
        """Lowest and highest corner of what there is to see, shape (2, 3) [m]."""

    direction: ClassVar[tuple[float, float, float]] = (0.2, -0.95, 0.24)
    """From what there is to see to the eye."""

    def paint(self) -> Paint | None:
        """Colours of painted walls, on a scale that only grows; None where no wall is painted."""
        return None

    def wall_values(self, number: int) -> np.ndarray | None:
        """Of the vertices of a drawn wall (v,) what :meth:`paint` shows, as read; None where it has one colour."""
        return None

    def wall_pose(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (x, y, z, w) of a drawn wall now."""
        return np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])

    def rigid_bodies(self) -> RigidBodies | None:
        """Shapes of the bodies; None where bodies are single particles."""
        return None

    def pose(self) -> Pose:
        """Where rigid bodies are."""
        raise TypeError(f"{type(self).__name__} does not draw rigid bodies")

    def body_colours(self) -> np.ndarray:
        """RGB bytes of all bodies, shape (n, 3)."""
        return self.colours()

    def network(self) -> dict[str, Lines]:
        """Lines between bodies by name, wide and coloured by the force that they carry."""
        return {}

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of an upright plane through the middle, behind which one sees the inside; None: it is open
        already.
        """
        lower, upper = self.bounds()
        return float(0.5 * (lower[1] + upper[1]))

    def view(self, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """A place for the eye and the point to look at, both (3,) [m]: from one side, `distance` sizes away."""
        lower, upper = self.bounds()
        centre = 0.5 * (lower + upper)
        size = max(float(np.linalg.norm(upper - lower)), 0.1)
        return centre + distance * size * np.array(self.direction), centre
