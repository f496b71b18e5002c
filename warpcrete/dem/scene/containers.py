"""Containers that are filled with aggregates, and the description of their filling."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...core.errors import positive, refuse
from ...core.inputs.field_help import help_on_fields
from ...core.inputs.fingerprints import EqualByContent
from ...geometry.axis import Axis
from ...geometry.bores import Bores
from ...geometry.meshes import load_closed, signed_distance
from ...geometry.walls import MeshWall, PipeWall, PlaneWall, Wall
from .clumps import ClumpTemplate, reference
from .sizes import Gaussian, Sizes

START_RADIUS_RATIO = 0.95
"""Radius within which aggregates are placed, divided by the pipe's inner radius at the same arc length. It is below 1,
so that aggregates also fit a pipe whose cross-section is a polygon of eight or more sides."""


def low_discrepancy_points(count: int, random: np.random.Generator) -> np.ndarray:
    """Return `count` low-discrepancy points in the unit cube, shape (count, 3).

    The points are Roberts' R3 sequence, shifted by a random vector.
    """
    # Positive root of x^4 = x + 1, the counterpart of the golden ratio in three dimensions. Multiples of its powers -1,
    # -2 and -3, modulo 1, are the coordinates of points that fill the cube evenly.
    root = 1.2207440846057596
    steps = root ** -np.arange(1, 4)
    return (random.uniform(size=3) + np.arange(1, count + 1)[:, None] * steps) % 1.0


@dataclass(frozen=True)
class PipeContainer:
    """Container in the shape of a pipe: the first stretch of a pipe, closed by a plane at either end.

    The stretch begins where the axis of the pipe begins, and has a given length. A round pipe of constant radius is
    described by `radius` alone. In other pipes, such as a reducer or a pipe with flat facets, the mesh `bore` is the
    wall; `radius` is then the smallest radius, and `area` is the mean cross-sectional area. If the radius varies,
    `bores` gives the radius as a function of arc length, so that aggregates are placed evenly over the volume. If the
    cross-section is not round, `clear` gives the radii of the largest circles about the axis that lie inside the bore;
    aggregates are placed in these circles.
    """

    axis: Axis
    radius: float
    """Inner radius of the pipe [m]; the smallest inner radius if it varies along the pipe."""
    length: float
    """Length of the container along the axis [m]."""
    bore: MeshWall | None = None
    area: float | None = None
    """Mean cross-sectional area [m2]; None means the area of a round pipe of the given `radius`."""
    bores: Bores | None = None
    clear: Bores | None = None

    def __post_init__(self) -> None:
        positive("container radius", self.radius, "m")
        positive("container length", self.length, "m")
        if self.area is not None:
            positive("container area", self.area, "m2")

    @property
    def volume(self) -> float:
        """Volume [m3], from cross-section and length of the axis; a bend does not change it (Pappus's theorem)."""
        if self.bores is not None:
            return self.bores.volume(0.0, self.length)
        return float(np.pi * self.radius**2 if self.area is None else self.area) * self.length

    @property
    def narrowest(self) -> float:
        """Diameter of the largest sphere that fits into the container [m]."""
        return min(2 * self.radius, self.length)

    def walls(self, material: str) -> tuple[Wall, ...]:
        """Return the pipe's wall and both end planes; their contacts follow the laws of `material`."""
        points, tangents = self.axis.at([0.0, self.length])
        ends = (
            PlaneWall(name="start", point=tuple(points[0]), normal=tuple(tangents[0]), material=material),
            PlaneWall(name="end", point=tuple(points[1]), normal=tuple(-tangents[1]), material=material),
        )
        if self.bore is not None:
            return (*ends, replace(self.bore, name="pipe", material=material, motion=None))
        return (PipeWall(name="pipe", axis=self.axis, radius=self.radius, material=material), *ends)

    def pilot(self) -> PipeContainer:
        """Return a shorter pipe for cheap trial packings, which have nearly the properties of the whole packing."""
        return replace(self, length=min(self.length, 3 * self.radius))

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return `count` evenly distributed points inside the container [m], shape (count, 3)."""
        u = low_discrepancy_points(count, random)
        s = u[:, 0] * self.length
        radius: np.ndarray | float = self.radius
        if self.bores is not None:
            s = self.bores.spread(u[:, 0], self.length)
            radius = START_RADIUS_RATIO * (self.clear or self.bores).at(s)
        r = radius * np.sqrt(u[:, 1])
        angle = 2 * np.pi * u[:, 2]
        points, _, normal, side = self.axis.frame(s)
        return points + (r * np.cos(angle))[:, None] * normal + (r * np.sin(angle))[:, None] * side


@dataclass(frozen=True, eq=False)
class MeshContainer(EqualByContent):
    """Interior of a closed triangle mesh, a ``trimesh.Trimesh`` or a path that trimesh can read.

    A mesh of two nested surfaces encloses the space between them, as around an obstacle. For a vessel with thick walls,
    give only its inner surface.
    """

    mesh: object

    def __post_init__(self) -> None:
        object.__setattr__(self, "mesh", load_closed(self.mesh, "container"))

    @property
    def volume(self) -> float:
        """Volume enclosed by the mesh [m3]."""
        return float(self.mesh.volume)  # type: ignore[attr-defined]

    @property
    def narrowest(self) -> float:
        """Length of the shortest side of the mesh's bounding box [m]."""
        return float(self.mesh.extents.min())  # type: ignore[attr-defined]

    def walls(self, material: str) -> tuple[Wall, ...]:
        """Return the mesh as a wall whose contacts follow the laws of `material`."""
        vertices, faces = self.mesh.vertices, self.mesh.faces  # type: ignore[attr-defined]
        return (MeshWall(name="container", vertices=vertices, faces=faces, material=material),)

    def pilot(self) -> MeshContainer:
        """Return the whole container for trial packings, because a mesh cannot be shortened as a pipe can."""
        return self

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return `count` evenly distributed points inside the container [m], shape (count, 3)."""
        lower, upper = self.mesh.bounds  # type: ignore[attr-defined]
        wanted = int(1.2 * count * np.prod(upper - lower) / self.volume) + 64
        while True:
            points = lower + low_discrepancy_points(wanted, random) * (upper - lower)
            inside = points[signed_distance(self.mesh, points) < 0]  # type: ignore[arg-type]
            if len(inside) >= count:
                # Drop surplus points at regular intervals of the sequence, because the sequence without its last points
                # would be distributed less evenly.
                return inside[np.linspace(0, len(inside) - 1, count).astype(int)]
            wanted *= 2


@help_on_fields
@dataclass(frozen=True, kw_only=True)
class Fill:
    """Aggregates and the container into which they are packed.

    Exactly one of `solid_fraction` and `pressure` must be given. Raises :class:`SceneError` for invalid values.
    """

    container: PipeContainer | MeshContainer
    """Container that the bodies fill: a piece of pipe, or the interior of a closed mesh."""
    sizes: Sizes = field(default_factory=Gaussian)
    """Distribution of the bodies' sizes: `Gaussian`, `Uniform` or `SieveCurve` of :mod:`warpcrete.dem.scene.sizes`. The
    default is `Gaussian()`, from 5 to 20 mm."""
    templates: tuple[ClumpTemplate, ...] = field(default_factory=reference)
    """Shapes of the bodies. The default is the four clumps of :func:`warpcrete.dem.scene.clumps.reference`, with two to
    four spheres each. For single spheres write `templates=(warpcrete.dem.scene.clumps.sphere(),)`."""
    fractions: tuple[float, ...] | None = None
    """Fraction of the solid volume that bodies of each shape (template) make up; None means equal fractions. The sum is
    scaled to 1."""
    density: float = 2500.0
    """Density of the bodies [kg/m3]."""
    bulk_density: float | None = None
    """Density of the filled container [kg/m3]; if given, it replaces `density`.

    The bodies then also carry the mass of the mortar between them.
    """
    material: str = "aggregate"
    """Name of the bodies' material, which selects the contact law in `Scene.contacts`."""
    solid_fraction: float | None = None
    """Ratio of solid volume to container volume, from 0.01 to 0.8; an alternative to `pressure`."""
    pressure: float | None = None
    """Mean pressure of the finished packing, without gravity or friction [Pa]."""

    @property
    def filled_density(self) -> float:
        """Mass of the bodies per volume of the filled container [kg/m3]; 0 if it is not known in advance.

        The value is `bulk_density` if given, otherwise the density of the grains times the solid fraction. Without a
        bulk density, it is unknown for packings to a given pressure, because the solid fraction is then a result.
        """
        return self.bulk_density or self.density * (self.solid_fraction or 0.0)

    def __post_init__(self) -> None:
        positive("density", self.density, "kg/m3")
        if self.bulk_density is not None:
            positive("bulk_density", self.bulk_density, "kg/m3")
        if (self.solid_fraction is None) == (self.pressure is None):
            problem = "must be given if there is no packing pressure, and left out otherwise"
            refuse("solid_fraction", self.solid_fraction, problem)
        if self.solid_fraction is not None and not 0.01 <= self.solid_fraction <= 0.8:
            refuse("solid_fraction", self.solid_fraction, "must be in [0.01, 0.8]", "use 0.55 to 0.7 for dense mixes")
        if self.pressure is not None:
            positive("packing pressure", self.pressure, "Pa")
        if isinstance(self.templates, ClumpTemplate) or not self.templates:
            problem = "must be a tuple of at least one template"
            refuse("templates", self.templates, problem, "for single spheres: (warpcrete.dem.scene.clumps.sphere(),)")
        given = np.ones(len(self.templates)) if self.fractions is None else np.asarray(self.fractions, float)
        wrong = given.shape != (len(self.templates),) or not np.all(np.isfinite(given)) or np.any(given < 0)
        if wrong or not given.sum() > 0:
            problem = f"must be {len(self.templates)} numbers, none below 0 and not all 0"
            refuse("fractions", self.fractions, problem, "give one fraction for each shape")
        object.__setattr__(self, "fractions", tuple((given / given.sum()).tolist()))
        # A long aggregate may lie along the container, so compare only its thickness with the width of the container.
        thickest = self.sizes.largest * min(2 * float(t.radii.max()) for t in self.templates)
        if thickest >= self.container.narrowest:
            problem = f"exceeds the width of the container, {self.container.narrowest:g} m"
            refuse("largest size", self.sizes.largest, problem, "choose smaller aggregates or a wider pipe")
