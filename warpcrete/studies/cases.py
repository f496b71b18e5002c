"""Cases of a parameter study: which parameters vary, and in which combinations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.errors import refuse

LONGEST_NAME = 120  # of a run folder
MOST_CASES = 10_000
"""Cases of one study: each has a folder of its own, and all are in its tables and its figure."""


@dataclass(frozen=True)
class Case:
    """One run of a study."""

    name: str
    """Of its run folder."""
    varied: dict[str, Any]
    """The parameters that the study varies, and their values here; without the seed."""
    parameters: dict[str, Any]
    """All that the scene function is given."""


def cases_of(
    base: Mapping[str, Any],
    varied: Mapping[str, Sequence[Any]],
    *,
    defaults: Mapping[str, Any] | None = None,
    repeat: int = 1,
    one_at_a_time: bool = False,
    seeded: bool = True,
) -> list[Case]:
    """Cases of a study: every combination of the values, or each parameter alone; seeds count from the base's.

    `base` and `varied` are parameters of the scene function, `defaults` the values of those that are not given. Of each
    parameter alone, the others hold their base or default value, and a point that several parameters share is one case.
    Raises :class:`SceneError` for empty or repeated values.
    """
    if not 1 <= repeat <= MOST_CASES:
        refuse("repeat", repeat, f"must be from 1 to {MOST_CASES}")
    for name, values in varied.items():
        if not values or len(set(map(repr, values))) < len(values):
            refuse(name, values, "must be one or more values, all different")
    if repeat > 1 and not seeded:
        refuse("repeat", repeat, "must be 1, because nothing in this scene depends on a seed")
    if "seed" in varied and repeat > 1:
        refuse("repeat", repeat, "cannot be combined with a list of seeds", "leave out one of the two")
    count = repeat * (sum if one_at_a_time and varied else math.prod)(map(len, varied.values()))
    if count > MOST_CASES:
        refuse("repeat" if repeat > 1 else next(iter(varied)), repeat if repeat > 1 else f"{count} combinations",
               f"makes {count:,} cases, but a study has at most {MOST_CASES:,}, because each fills a folder",
               "vary fewer values, or split the study")  # fmt: skip
    points = _alone(base, varied, defaults or {}) if one_at_a_time and varied else _combined(varied)
    first = int(base.get("seed", 0))
    cases: list[Case] = []
    for point in points:
        for seed in range(first, first + repeat):
            seeds = {"seed": seed} if seeded and "seed" not in point else {}
            shown = point | (seeds if repeat > 1 or not point else {})
            text = "-".join(f"{name}={word_of(value)}" for name, value in shown.items())
            name = f"{len(cases) + 1:03d}-{text}"[:LONGEST_NAME]
            cases.append(Case(name, dict(point), {**base, **point, **seeds}))
    return cases


def _combined(varied: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    return [dict(zip(varied, values)) for values in itertools.product(*varied.values())]


def _alone(
    base: Mapping[str, Any], varied: Mapping[str, Sequence[Any]], defaults: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Each parameter varied while the others hold; every point names all of them."""
    held = {name: base.get(name, defaults.get(name)) for name in varied}
    points = [held | {name: value} for name, values in varied.items() for value in values]
    unique: list[dict[str, Any]] = []
    for point in points:
        if point not in unique:
            unique.append(point)
    return unique


def word_of(value: Any) -> str:
    """A value as part of a folder's name."""
    return "".join(
        c if c.isalnum() or c in ".+-" else "_" for c in (f"{value:g}" if isinstance(value, float) else str(value))
    )
