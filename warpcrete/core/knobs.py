"""Knobs of a scene: parameters that trade accuracy for time, each with levels from the coarsest to the finest."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Level:
    """One setting of a knob."""

    label: str
    """As tables have it."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Parameters that differ from the scene's."""
    cost: float = 1.0
    """Time that is expected over that of the other levels of the knob; only plans go by it, before it is measured."""
    key: str = ""
    """What it is called in a scene of other numbers: a factor, where `label` is a number. Default: the label."""
    converted: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Of quantities that have another meaning here: (offset, factor), to be taken as offset + factor (value - offset).
    """


@dataclass(frozen=True)
class Knob:
    """What can be set coarser or finer in a scene."""

    name: str
    levels: tuple[Level, ...]
    """From the coarsest to the finest; one of them is the scene as it is given."""
    physical: bool = False
    """Its parameters are properties of the concrete, of which a coarser level makes others."""
    chosen: bool = True
    """Settings for a wanted accuracy may have it; if not, it is measured alone and that is all."""

    def level_of(self, key: str) -> Level | None:
        """The level that goes by a key in scenes of any numbers; None where this scene has it not."""
        return next((level for level in self.levels if (level.key or level.label) == key), None)


def scaled(
    name: str, parameter: str, value: float, factors: Iterable[float], power: float, unit: str = "",
    physical: bool = False,
) -> Knob:  # fmt: skip
    """Knob of one number: its `value` times `factors`, from the coarsest on; time goes with the factor's `power`."""
    levels = [Level(f"{value * f:.4g} {unit}".strip(), {parameter: value * f}, f**power, f"x {f:g}") for f in factors]
    return Knob(name, tuple(levels), physical)


def precisions() -> Knob:
    """Knob of single and double precision."""
    return Knob(
        "precision", (Level("float32", {"precision": "float32"}), Level("float64", {"precision": "float64"}, 1.3))
    )


@dataclass(frozen=True)
class Trading:
    """What a scene lets be traded: a scene's file has one under the name `trading`."""

    knobs: Callable[[Any], Iterator[Knob]]
    """Of the scene's parameters."""
    quantities: tuple[str, ...]
    """That errors are of, unless others are named."""
    closed_form: Callable[[Any], bool] = lambda given: False
    """Whether theory is exact for a scene of these parameters; results then have an entry `NAME_error` beside each."""
    variants: Callable[[Any], Mapping[str, Mapping[str, Any]]] = lambda given: {}
    """Parameters of other scenes, by what sets them apart, on which settings for a wanted accuracy are tried, too."""
    tolerance: str = ""
    """Parameter of the scene that says how much error its checks accept; empty if they ask for none."""
