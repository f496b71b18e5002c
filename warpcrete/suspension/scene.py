"""Scenes of a mortar with aggregates and a free surface."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeVar

from ..core.errors import at_most, refuse
from ..core.inputs.parameters import Above, Declared, Needs, OneOf, Suggests, Within
from ..dem.scene.clumps import TEMPLATE_SETS, ClumpTemplate, templates
from ..dem.scene.sizes import SieveCurve
from ..mps.free.scene import FreeScene
from ..theory.pipe import Concrete
from ..theory.suspension import concrete_of_mortar, mortar_of
from .aggregates import MIN_CELLS

UNIFORM = "uniform"
"""Value of `aggregate_sizes` for a size distribution without a sieve curve."""
MAX_FRACTION = 0.5
"""Largest volume fraction for which spheres can be placed at random without overlaps, in boxes that are six sphere
diameters wide."""


WITH_AGGREGATES = Needs("aggregate_fraction", bool, "is above 0")
USED_BY_AGGREGATES = Needs("aggregate_fraction", bool, "is above 0", refused=False)
"""Rule for a parameter that describes aggregates. A study may state the parameter also for a case without aggregates,
where it has no effect."""
RANGED = Needs("aggregate_sizes", lambda sizes: sizes == UNIFORM, "is uniform")

DESCRIBED = ("mortar", "concrete")
"""Values of `constants_of`: the material that the stated density, viscosity and yield stress describe."""
USUAL_CELLS = 4.0
"""Default number of cells across the narrowest side of the smallest aggregates."""


@dataclass(frozen=True, kw_only=True, repr=False)
class SphereFields:
    """Fields of a scene that describe its mortar and its aggregates."""

    concrete: Concrete
    """Constants of the mortar alone."""
    spacing: float
    """Requested width of the cells [m]. The actual width may differ, because a whole number of cells must fit."""
    aggregate_fraction: float
    """Volume of the aggregates divided by the volume of the concrete."""
    aggregate_diameters: tuple[float, float]
    """Smallest and largest diameter of the aggregates [m], if `aggregate_sizes` is uniform."""
    aggregate_density: float
    """Density of the aggregates [kg/m3]."""
    roughness: float
    """Gap below which two aggregates with the radii R1 and R2 count as touching, divided by R1 R2 / (R1 + R2)."""
    friction: float = 0.0
    """Coefficient of friction of aggregates with each other and with walls."""
    aggregate_shapes: str = "spheres"
    """Shapes of the aggregates: the name of a set of templates, or paths of meshes."""
    aggregate_sizes: str = UNIFORM
    """Size distribution: uniform, or a sieve curve as the text 'mm:passing,...'. Sizes are the diameters of spheres of
    equal volume."""

    @cached_property
    def templates(self) -> tuple[ClumpTemplate, ...]:
        """Shapes of the aggregates; all are equally frequent."""
        return templates(self.aggregate_shapes)

    @cached_property
    def sieve(self) -> SieveCurve | None:
        """Sieve curve of the stated aggregates, or None if all diameters in a range are equally likely."""
        return read_sieve(self.aggregate_sizes)

    @property
    def cell_width(self) -> float:
        """Largest width of the cells along any axis [m]."""
        return self.spacing

    @property
    def narrowest_shape(self) -> float:
        """Width of the narrowest shape, divided by the diameter of a sphere of the same volume."""
        return min(float(shape.widths.min()) for shape in self.templates)

    @property
    def resolved(self) -> float:
        """Size of the smallest aggregates that the cells resolve [m], as the diameter of a sphere of equal volume."""
        return MIN_CELLS * self.cell_width / self.narrowest_shape

    @property
    def simulated_fraction(self) -> float:
        """Volume of the simulated aggregates per volume of concrete. Aggregates that are too small count as mortar."""
        return self.aggregate_fraction * (1.0 if self.sieve is None else self.sieve.retained(self.resolved))

    @property
    def diameters(self) -> tuple[float, float]:
        """Smallest and largest diameter of the simulated aggregates [m], as spheres of equal volume."""
        if self.sieve is None:
            return self.aggregate_diameters
        return max(self.sieve.smallest, self.resolved), self.sieve.largest

    def check_aggregates(self) -> None:
        """Raise :class:`SceneError` if the cells are too coarse for the aggregates, or if their sizes are invalid."""
        if self.sieve is not None:
            finest, largest = self.resolved, self.sieve.largest
            if largest <= finest:
                refuse("spacing", self.spacing, f"is too coarse: aggregates below {finest:.3g} m count as mortar, and "
                                                f"even the largest stones of the sieve curve, {largest:g} m, are "
                                                "smaller",
                       f"use {self.spacing * largest / finest / 2:.2g} m or less")  # fmt: skip
            return
        smallest, largest = self.aggregate_diameters
        if largest < smallest:
            problem = f"must be at least 'aggregate_smallest' = {smallest:g} m"
            refuse("aggregate_largest", largest, problem, f"use {smallest:g} m for equal aggregates")
        narrow = smallest * self.narrowest_shape
        if narrow < MIN_CELLS * self.cell_width:
            refuse("spacing", self.spacing, f"is too coarse: the smallest aggregate, {narrow:.3g} m, must be at least "
                                            f"{MIN_CELLS:g} cells wide",
                   f"use {at_most(narrow / 4)} m or less, a quarter of its width, or count aggregates of this "
                   "size as mortar")  # fmt: skip


S = TypeVar("S", bound=SphereFields)


@dataclass(frozen=True, kw_only=True)
class SuspensionScene(SphereFields, FreeScene):
    """Mortar with rigid aggregates in a vessel; `concrete` holds the constants of the mortar alone."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.depth:
            problem = "must be above 0, because a flow with aggregates is three-dimensional"
            refuse("depth", self.depth, problem, "use half of the width")
        self.check_aggregates()

    @property
    def fluid(self) -> FreeScene:
        """Scene of the same vessel that contains only the mortar, without aggregates."""
        return FreeScene(**{f.name: getattr(self, f.name) for f in fields(FreeScene)})

    @property
    def whole_concrete(self) -> Concrete:
        """Concrete of mortar and aggregates, for closed-form solutions. Its constants follow from homogenisation."""
        return concrete_of_mortar(self.concrete, self.simulated_fraction, self.aggregate_density)

    @property
    def caption(self) -> str:
        """Scene, mortar and aggregates in words, for titles of figures and recordings."""
        return f"{self.name}, mortar {self.concrete.words} with {100 * self.aggregate_fraction:.3g} % of aggregates"

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, {self.aggregate_fraction:.0%} aggregates>"


@dataclass(frozen=True, kw_only=True)
class AggregateParameters(Declared):
    """Parameters of the aggregates that are simulated as rigid bodies in the mortar."""

    common: ClassVar[tuple[str, ...]] = ("aggregate_fraction",)

    aggregate_fraction: Annotated[
        float,
        "Volume fraction of aggregates that are simulated as rigid bodies in mortar. 0: the concrete is one fluid "
        "without aggregates",
        Within(0, MAX_FRACTION),
    ] = 0.0
    constants_of: Annotated[
        str,
        "What density, viscosity and yield stress describe if there are aggregates: mortar, or concrete (mortar with "
        "its aggregates; those of the mortar are then calculated)",
        OneOf(DESCRIBED),
        USED_BY_AGGREGATES,
    ] = "mortar"
    aggregate_smallest: Annotated[
        float | None,
        "Smallest diameter of the simulated aggregates [m], at least three cells; default: such that their narrowest "
        "side is four cells wide",
        Above(),
        RANGED,
        USED_BY_AGGREGATES,
    ] = None
    aggregate_largest: Annotated[
        float | None,
        "Largest diameter of the simulated aggregates [m]; default: the smallest",
        Above(),
        RANGED,
        USED_BY_AGGREGATES,
    ] = None
    aggregate_shapes: Annotated[
        str,
        "Shapes of the aggregates: spheres, reference (four clumps), shape-F with shape factor F, or paths of "
        "closed meshes; the diameter of an aggregate is that of a sphere of equal volume",
        Suggests(lambda: TEMPLATE_SETS, files=True),
        WITH_AGGREGATES,
    ] = "spheres"
    aggregate_sizes: Annotated[
        str,
        "Size distribution of the aggregates: uniform, or a sieve curve by mass as 'mm:passing,...'; stones that are "
        "too small for the cells count as mortar",
        WITH_AGGREGATES,
    ] = UNIFORM
    aggregate_density: Annotated[
        float, "Density of the simulated aggregates [kg/m3]", Within(500, 10000), USED_BY_AGGREGATES
    ] = 2650.0
    roughness: Annotated[
        float,
        "Roughness of aggregates: gap at which two aggregates with the radii R1 and R2 touch, divided by R1 R2 / (R1 "
        "+ R2)",
        Within(1e-4, 0.1),
        USED_BY_AGGREGATES,
    ] = 0.01
    friction: Annotated[
        float,
        "Coulomb friction coefficient of aggregates with each other and with walls",
        Within(0, 2),
        USED_BY_AGGREGATES,
    ] = 0.0

    @property
    def diameters(self) -> tuple[float, float]:
        """Smallest and largest diameter of the aggregates [m], if `aggregate_sizes` is uniform."""
        narrowest = min(float(shape.widths.min()) for shape in templates(self.aggregate_shapes))
        # Every scene with aggregates declares the parameter `spacing`; its default differs from scene to scene.
        usual = USUAL_CELLS * float(vars(self)["spacing"]) / narrowest
        smallest = self.aggregate_smallest or min(usual, self.aggregate_largest or usual)
        return smallest, self.aggregate_largest or smallest

    @property
    def coarsest(self) -> float:
        """Largest diameter of the aggregates [m]."""
        curve = read_sieve(self.aggregate_sizes)
        return self.diameters[1] if curve is None else curve.largest

    def check_largest(self, limit: float, why: str) -> None:
        """Raise :class:`SceneError` if an aggregate is larger than `limit` [m]; `why` is the text of the reason."""
        if self.coarsest <= limit:
            return
        if self.aggregate_sizes == UNIFORM and self.aggregate_largest is None and self.aggregate_smallest is None:
            spacing = float(vars(self)["spacing"])
            refuse("spacing", spacing, f"is too coarse: aggregates of the default size, whose narrowest side is "
                                       f"{USUAL_CELLS:g} cells wide, are {self.coarsest:.3g} m large, but {why}",
                   f"use {at_most(spacing * limit / self.coarsest, 2)} m or less, or state 'aggregate_smallest' and "
                   "'aggregate_largest'")  # fmt: skip
        name = "aggregate_largest" if self.aggregate_sizes == UNIFORM else "aggregate_sizes"
        value = self.coarsest if name == "aggregate_largest" else self.aggregate_sizes
        hint = f"use {at_most(limit, 2)} m or less"
        refuse(name, value, f"is too large: {why}", hint if value == self.coarsest else f"{hint} as the largest size")

    def with_mortar(self, scene: S) -> S:
        """Return the scene with the constants of its mortar, if the stated constants describe the concrete.

        The constants of the mortar follow from the volume fraction of the simulated aggregates (:func:`mortar_of`).
        Raises :class:`SceneError` if the stated density is too small for a concrete with these aggregates.
        """
        if self.constants_of == "mortar":
            return scene
        fraction = scene.simulated_fraction
        if scene.concrete.density <= fraction * scene.aggregate_density:
            problem = (
                f"is too small for a concrete of which {fraction:.3g} of the volume are aggregates of "
                f"{scene.aggregate_density:g} kg/m3"
            )
            refuse("density", scene.concrete.density, problem, "use a larger 'density', or 'constants_of' = mortar")
        mortar = mortar_of(scene.concrete, fraction, scene.aggregate_density)
        return replace(scene, concrete=replace(mortar, name=scene.concrete.name))

    def aggregates(self) -> dict[str, Any]:
        """Return the fields of :class:`SuspensionScene` that describe the aggregates."""
        return {
            "aggregate_fraction": self.aggregate_fraction,
            "aggregate_diameters": self.diameters,
            "aggregate_density": self.aggregate_density,
            "roughness": self.roughness,
            "friction": self.friction,
            "aggregate_shapes": self.aggregate_shapes,
            "aggregate_sizes": self.aggregate_sizes,
        }


def read_sieve(sizes: str) -> SieveCurve | None:
    """Return the sieve curve of the parameter `aggregate_sizes`, or None if the sizes are uniform."""
    if sizes == UNIFORM:
        return None
    return SieveCurve.from_text(sizes, "aggregate_sizes", "must be 'uniform' or a sieve curve")


def vessel_scene(parameters: AggregateParameters, **fields: object) -> FreeScene:
    """Return the scene of a vessel, with aggregates if their volume fraction is above 0."""
    if parameters.aggregate_fraction > 0:
        return parameters.with_mortar(SuspensionScene(**fields, **parameters.aggregates()))
    return FreeScene(**fields)
