"""Scenes of a mortar with aggregates that flows through a part of a pump line."""

from dataclasses import dataclass, fields
from typing import Annotated, ClassVar

from ...core.errors import refuse
from ...core.inputs.parameters import Above, Declared
from ...mps.part.scene import PartScene
from ..scene import USED_BY_AGGREGATES, AggregateParameters, SphereFields

MAX_PART = 0.9
"""Largest accepted diameter of an aggregate, divided by the width of the narrowest simulated bore."""


@dataclass(frozen=True, kw_only=True)
class BlockageSettings(Declared):
    """Settings that decide when aggregates count as a blockage of the pump line; a blockage ends the run."""

    common: ClassVar[tuple[str, ...]] = ()

    blocked_travel: Annotated[
        float | None,
        "Blockage criterion: distance by which concrete flows in while some aggregates stand still [m]; default: the "
        "largest diameter of the aggregates",
        Above(),
        USED_BY_AGGREGATES,
    ] = None
    pressure_limit: Annotated[
        float,
        "Frictional pressure at the start of the pipe above which a pipe with aggregates counts as blocked [Pa]",
        Above(),
        USED_BY_AGGREGATES,
    ] = 1e7


@dataclass(frozen=True, kw_only=True, repr=False)
class PartSuspensionScene(SphereFields, BlockageSettings, PartScene):
    """Mortar with rigid aggregates in a part of a pump line; `concrete` holds the constants of the mortar alone."""

    has_heavy_aggregates: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.aggregate_fraction > 0:
            refuse("aggregate_fraction", self.aggregate_fraction, "must be above 0", "use a part without aggregates")
        self.check_aggregates()
        room = self.narrowest if self.is_half else 2 * self.narrowest
        if self.diameters[1] > MAX_PART * room:
            half = "; 'symmetry' = 'whole' allows twice this size" if self.is_half else ""
            problem = f"is too large: the simulated part of the narrowest bore is {room:.3g} m wide"
            refuse("aggregate_largest", self.diameters[1], problem, f"use {MAX_PART * room:.3g} m or less{half}")

    @property
    def cell_width(self) -> float:
        """Width of the cells [m]."""
        return self.rounded_spacing

    @property
    def density(self) -> float:
        """Density of mortar and aggregates together [kg/m3]."""
        return self.concrete.density + self.simulated_fraction * (self.aggregate_density - self.concrete.density)

    @property
    def standing_travel(self) -> float:
        """Distance of inflow [m] during which some aggregates must stand still, so that the pipe counts as blocked."""
        return self.blocked_travel or self.diameters[1]

    @property
    def caption(self) -> str:
        """Text with scene, diameter, mortar, aggregates and flow, for titles of figures and recordings."""
        return f"{super().caption}, {100 * self.aggregate_fraction:.3g} % of aggregates"

    def __repr__(self) -> str:
        return f"{PartScene.__repr__(self)[:-1]}, {self.aggregate_fraction:.0%} aggregates>"


def part_scene(parameters: AggregateParameters, **given: object) -> PartScene:
    """Return the scene of a part of a pump line, with aggregates if their volume fraction is above 0."""
    if parameters.aggregate_fraction > 0:
        settings = {f.name: getattr(parameters, f.name) for f in fields(BlockageSettings)}
        return parameters.with_mortar(PartSuspensionScene(**given, **settings, **parameters.aggregates()))
    return PartScene(**given)
