"""Scenes of a mortar with aggregates and a free surface."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar

from ..core.errors import at_most, refuse
from ..core.inputs.parameters import Above, Declared, Within
from ..mps.free.scene import FreeScene
from .aggregates import MIN_CELLS

MAX_FRACTION = 0.5
"""Largest volume fraction for which spheres can be placed at random without overlaps, in boxes that are six sphere
diameters wide."""


SmallestDiameter = Annotated[
    float, "Smallest diameter of the simulated aggregates [m]: at least three cells, preferably four", Above()
]
LargestDiameter = Annotated[float, "Largest diameter of the simulated aggregates [m]", Above()]
"""Declarations of parameters that several scenes with aggregates have."""


@dataclass(frozen=True, kw_only=True, repr=False)
class SphereFields:
    """Fields of a scene that describe its aggregates."""

    spacing: float
    """Wanted width of the cells [m]."""
    aggregate_fraction: float
    """Volume of the aggregates divided by the volume of the concrete."""
    aggregate_diameters: tuple[float, float]
    """Smallest and largest diameter of the aggregates [m]. Between them, all diameters are equally likely."""
    aggregate_density: float
    """Density of the aggregates [kg/m3]."""
    roughness: float
    """Gap below which two aggregates with the radii R1 and R2 touch, divided by R1 R2 / (R1 + R2)."""

    def check_aggregates(self) -> None:
        """Raise :class:`SceneError` if sizes of aggregates and cells do not fit each other."""
        smallest, largest = self.aggregate_diameters
        if largest < smallest:
            refuse("aggregate_largest", largest, f"must be at least 'aggregate_smallest' = {smallest:g} m",
                   f"use {smallest:g} m for equal aggregates")  # fmt: skip
        if smallest < MIN_CELLS * self.spacing:
            refuse("spacing", self.spacing, f"is too coarse: the smallest aggregate, {smallest:g} m, must be at least "
                                            f"{MIN_CELLS:g} cells wide",
                   f"use {at_most(smallest / 4)} m or less, or count aggregates of this size as mortar")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SuspensionScene(SphereFields, FreeScene):
    """Mortar with rigid spherical aggregates in a vessel; `concrete` holds the constants of the mortar alone."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.depth:
            refuse("depth", self.depth, "must be above 0, because a flow with aggregates is three-dimensional",
                   "use half of the width")  # fmt: skip
        self.check_aggregates()

    @property
    def fluid(self) -> FreeScene:
        """This scene with the mortar alone."""
        return FreeScene(**{f.name: getattr(self, f.name) for f in fields(FreeScene)})

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, {self.aggregate_fraction:.0%} aggregates>"


@dataclass(frozen=True, kw_only=True)
class AggregateParameters(Declared):
    """Parameters of the aggregates that are simulated as rigid spheres in the mortar."""

    common: ClassVar[tuple[str, ...]] = ("aggregate_fraction",)

    aggregate_fraction: Annotated[
        float,
        "Volume fraction of aggregates that are simulated one by one, as rigid spheres in the mortar; "
        "the constants of the concrete are then those of the mortar between them. 0 simulates concrete as one fluid",
        Within(0, MAX_FRACTION),
    ] = 0.0
    aggregate_smallest: SmallestDiameter = 0.05
    aggregate_largest: LargestDiameter = 0.05
    aggregate_density: Annotated[float, "Density of the simulated aggregates [kg/m3]", Within(500, 10000)] = 2650.0
    roughness: Annotated[
        float,
        "Roughness of aggregates: gap below which two aggregates of radii R1 and R2 touch, over 1 / (1 / R1 + 1 / R2)",
        Within(1e-4, 0.1),
    ] = 0.01

    def aggregates(self) -> dict[str, Any]:
        """Return the fields of :class:`SuspensionScene` that describe the aggregates."""
        return {
            "aggregate_fraction": self.aggregate_fraction,
            "aggregate_diameters": (self.aggregate_smallest, self.aggregate_largest),
            "aggregate_density": self.aggregate_density,
            "roughness": self.roughness,
        }


def vessel_scene(parameters: AggregateParameters, **fields: Any) -> FreeScene:
    """Return the scene of a vessel, with aggregates if their volume fraction is above 0."""
    if parameters.aggregate_fraction > 0:
        return SuspensionScene(**fields, **parameters.aggregates())
    return FreeScene(**fields)
