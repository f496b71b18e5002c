"""Knobs of a scene: parameters that trade accuracy for computing time, each with levels from coarse to fine."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Level:
    """One setting of a knob, which is a parameter that trades accuracy for computing time."""

    label: str
    """Name of this setting of the accuracy parameter (knob) in tables, such as "10 mm"."""
    changes: Mapping[str, object] = field(default_factory=dict[str, object])
    """Values of the scene's parameters that this setting of the accuracy parameter (knob) changes, by name."""
    cost: float = 1.0
    """Expected wall time of a run with this setting, relative to the other settings of the same accuracy parameter
    (knob). It is used only for planning, before wall times are measured."""
    key: str = ""
    """Name of this setting of the accuracy parameter (knob) that is the same in all scenes. For example, half the
    element size has the key "x 0.5" in every scene, whereas `label` is a length such as "10 mm". If the key is empty,
    `label` is the key."""
    converted: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    """Conversions of result quantities, by the quantity's name. A result of a run with this setting of the accuracy
    parameter may need a conversion before it is comparable with results of the user's scene. For example, a pipe of
    half the length needs about half the pressure. A conversion is a pair (offset, factor), and the converted value is
    offset + factor * (value - offset)."""


@dataclass(frozen=True)
class Knob:
    """Parameter of a scene, such as the element size, whose coarser settings take less computing time."""

    name: str
    levels: tuple[Level, ...]
    """Settings of the accuracy parameter (knob), from the coarsest to the finest, including the setting that the
    user's scene has."""
    physical: bool = False
    """True if this accuracy parameter (knob) changes the concrete itself, so that a coarser setting simulates another
    concrete."""
    chosen: bool = True
    """True if the program may change this accuracy parameter (knob) in the settings that it recommends. If False, its
    effect is only measured."""
    resolution: bool = False
    """True if this accuracy parameter (knob) is a cell width or a particle spacing. Results then converge to a limit as
    it becomes smaller."""

    def level_of(self, key: str) -> Level | None:
        """Return the setting (level) of this accuracy parameter (knob) with the key `key`, or None if it is missing."""
        return next((level for level in self.levels if (level.key or level.label) == key), None)


def scaled(
    name: str, parameter: str, value: float, factors: Iterable[float], power: float, unit: str = "",
    physical: bool = False, resolution: bool = False,
) -> Knob:  # fmt: skip
    """Return a knob (accuracy parameter) for the numeric scene parameter `parameter`, whose chosen value is `value`.

    At each setting (level) of the knob, the parameter is `value` times one of `factors`, from the coarsest to the
    finest setting. The expected wall time at a setting is proportional to its factor to the power of `power`. `unit` is
    shown after the value; `physical` and `resolution` are attributes of :class:`Knob`.
    """
    levels = [Level(f"{value * f:.4g} {unit}".strip(), {parameter: value * f}, f**power, f"x {f:g}") for f in factors]
    return Knob(name, tuple(levels), physical, resolution=resolution)


def precisions() -> Knob:
    """Return the knob (accuracy parameter) that selects single or double precision."""
    return Knob(
        "precision", (Level("float32", {"precision": "float32"}), Level("float64", {"precision": "float64"}, 1.3))
    )


@dataclass(frozen=True)
class Trading:
    """Description of a scene for studies that weigh accuracy against computing time.

    The description contains the knobs (accuracy parameters with their settings), the quantities to compare, and a
    function that returns whether the scene has an exact closed-form solution. The module of the scene assigns this
    object to the name `trading`.
    """

    knobs: Callable[[Any], Iterator[Knob]]
    """Function that takes the scene's parameters and yields the knobs (accuracy parameters)."""
    quantities: tuple[str, ...]
    """Names of result quantities. Unless the user names others, a study computes their errors for each setting of the
    accuracy parameters."""
    closed_form: Callable[[Any], bool] = lambda given: False
    """Function that takes the scene's parameters and returns whether a closed-form solution is exact for them. If so,
    the results of a run contain the error of each quantity NAME, under `NAME_error`."""
    variants: Callable[[Any], Mapping[str, Mapping[str, object]]] = lambda given: {}
    """Function that takes the scene's parameters and returns changed parameters for each of several similar scenes. The
    key of each entry is a text that describes the change. Recommended settings are also tested on these scenes."""
    tolerance: str = ""
    """Name of the parameter that sets the largest error that the scene's checks accept; empty if there is none."""
