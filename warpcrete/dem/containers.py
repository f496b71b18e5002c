"""Containers that are filled with aggregates, and what they are filled with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..core.errors import positive, refuse
from ..geometry.axis import Axis
from ..geometry.bores import Bores
from ..geometry.meshes import load_closed, signed_distance
from ..geometry.walls import MeshWall, PipeWall, PlaneWall, Wall
from .clumps import ClumpTemplate, reference
from .sizes import Gaussian, Sizes

SOWN = 0.95
"""Part of the local radius within which aggregates are sown where a pipe is made of eight facets or more."""


def spread_points(count: int, random: np.random.Generator) -> np.ndarray:
    """Low-discrepancy points in the unit cube (Roberts' R3 sequence), randomly shifted; shape (count, 3)."""
    root = 1.2207440846057596  # real root of x^4 = x + 1
    steps = root ** -np.arange(1, 4)
    return (random.uniform(size=3) + np.arange(1, count + 1)[:, None] * steps) % 1.0


@dataclass(frozen=True)
class PipeContainer:
    """The first `length` of a pipe, between two planes across it.

    `bore`, a mesh, is the true wall where that is no round pipe of `radius` (a reducer, a few facets): `radius` is then
    the least, inside which aggregates are sown, and `area` the mean cross-section. Where `bores` says how wide the pipe
    is all along, aggregates are sown by that; where it is not round, within the circles that are free, `clear`.
    """

    axis: Axis
    radius: float
    """[m]"""
    length: float
    """[m]"""
    bore: MeshWall | None = None
    area: float | None = None
    """[m2]; None: of the round pipe."""
    bores: Bores | None = None
    clear: Bores | None = None

    def __post_init__(self) -> None:
        positive("container radius", self.radius, "m")
        positive("container length", self.length, "m")
        if self.area is not None:
            positive("container area", self.area, "m2")

    @property
    def volume(self) -> float:
        """[m3] (Pappus: a bend does not change it)."""
        if self.bores is not None:
            return self.bores.volume(0.0, self.length)
        return float(np.pi * self.radius**2 if self.area is None else self.area) * self.length

    @property
    def narrowest(self) -> float:
        """Largest sphere diameter that fits [m]."""
        return min(2 * self.radius, self.length)

    def walls(self, material: str) -> tuple[Wall, ...]:
        """Pipe and end planes."""
        points, tangents = self.axis.at([0.0, self.length])
        ends = (
            PlaneWall(name="start", point=tuple(points[0]), normal=tuple(tangents[0]), material=material),
            PlaneWall(name="end", point=tuple(points[1]), normal=tuple(-tangents[1]), material=material),
        )
        if self.bore is not None:
            return (*ends, replace(self.bore, name="pipe", material=material, motion=None))
        return (PipeWall(name="pipe", axis=self.axis, radius=self.radius, material=material), *ends)

    def pilot(self) -> PipeContainer:
        """A smaller container in which packings are much the same."""
        return replace(self, length=min(self.length, 3 * self.radius))

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Well spread points inside, shape (count, 3) [m]."""
        u = spread_points(count, random)
        s = u[:, 0] * self.length
        radius: np.ndarray | float = self.radius
        if self.bores is not None:
            s = self.bores.spread(u[:, 0], self.length)
            radius = SOWN * (self.clear or self.bores).at(s)
        r = radius * np.sqrt(u[:, 1])
        angle = 2 * np.pi * u[:, 2]
        points, _, normal, side = self.axis.frame(s)
        return points + (r * np.cos(angle))[:, None] * normal + (r * np.sin(angle))[:, None] * side


@dataclass(frozen=True)
class MeshContainer:
    """Inside of a closed triangle mesh: a ``trimesh.Trimesh`` or a path that trimesh reads.

    Two skins hold the room between them, as around an obstacle: of a thick vessel give the inner skin alone.
    """

    mesh: object

    def __post_init__(self) -> None:
        object.__setattr__(self, "mesh", load_closed(self.mesh, "container"))

    @property
    def volume(self) -> float:
        """[m3]"""
        return float(self.mesh.volume)  # type: ignore[attr-defined]

    @property
    def narrowest(self) -> float:
        """Shortest side of the bounding box [m]."""
        return float(self.mesh.extents.min())  # type: ignore[attr-defined]

    def walls(self, material: str) -> tuple[Wall, ...]:
        """The mesh itself."""
        return (MeshWall(name="container", vertices=self.mesh.vertices, faces=self.mesh.faces, material=material),)  # type: ignore[attr-defined]

    def pilot(self) -> MeshContainer:
        """The container itself: of a mesh nothing smaller is alike."""
        return self

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Well spread points inside, shape (count, 3) [m]."""
        lower, upper = self.mesh.bounds  # type: ignore[attr-defined]
        wanted = int(1.2 * count * np.prod(upper - lower) / self.volume) + 64
        while True:
            points = lower + spread_points(wanted, random) * (upper - lower)
            inside = points[signed_distance(self.mesh, points) < 0]  # type: ignore[arg-type]
            if len(inside) >= count:
                # A sequence is well spread in whole only: thin it evenly.
                return inside[np.linspace(0, len(inside) - 1, count).astype(int)]
            wanted *= 2


@dataclass(frozen=True, kw_only=True)
class Fill:
    """Aggregates and the container they are packed into."""

    container: PipeContainer | MeshContainer
    sizes: Sizes = field(default_factory=Gaussian)
    templates: tuple[ClumpTemplate, ...] = field(default_factory=reference)
    fractions: tuple[float, ...] | None = None
    """Volume fraction of each template; None: equal."""
    density: float = 2500.0
    """Of the bodies [kg/m3]."""
    bulk_density: float | None = None
    """Of the filled container [kg/m3], instead: bodies bear what is between them, too."""
    material: str = "aggregate"
    solid_fraction: float | None = None
    """Solid volume over container volume; give this or `pressure`."""
    pressure: float | None = None
    """Mean pressure of the finished packing, without gravity or friction [Pa]."""

    def __post_init__(self) -> None:
        positive("density", self.density, "kg/m3")
        if self.bulk_density is not None:
            positive("bulk_density", self.bulk_density, "kg/m3")
        if (self.solid_fraction is None) == (self.pressure is None):
            refuse("solid_fraction", self.solid_fraction, "give either a solid fraction or a pressure")
        if self.solid_fraction is not None and not 0.01 <= self.solid_fraction <= 0.8:
            refuse("solid_fraction", self.solid_fraction, "must be in [0.01, 0.8]", "dense mixes pack at 0.55 to 0.7")
        if self.pressure is not None:
            positive("packing pressure", self.pressure, "Pa")
        if not self.templates:
            refuse("templates", self.templates, "needs one or more")
        given = np.ones(len(self.templates)) if self.fractions is None else np.asarray(self.fractions, float)
        wrong = given.shape != (len(self.templates),) or not np.all(np.isfinite(given)) or np.any(given < 0)
        if wrong or not given.sum() > 0:
            refuse("fractions", self.fractions, f"must be {len(self.templates)} numbers, 0 or more, not all 0",
                   "one for each shape")  # fmt: skip
        object.__setattr__(self, "fractions", tuple((given / given.sum()).tolist()))
        # An aggregate lies along the container if it is long, so its thinnest width decides.
        thickest = self.sizes.largest * min(2 * float(t.radii.max()) for t in self.templates)
        if thickest >= self.container.narrowest:
            refuse(
                "largest size",
                self.sizes.largest,
                f"does not fit the container, which is {self.container.narrowest:g} m across",
                "choose smaller aggregates or a wider pipe",
            )
