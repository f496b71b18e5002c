"""Cases of a parameter study: which parameters vary, and in which combinations."""

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..core.errors import flag, refuse, whole
from ..core.inputs.scene_functions import SceneFunction
from ..core.records import SceneArguments

MAX_NAME_LENGTH = 120
"""Maximum length of a run folder's name [characters]; file systems allow 255 bytes."""
MAX_CASES = 10_000
"""Maximum number of cases in a study. The number is limited because every case fills a folder and appears in the tables
and the figure."""


@dataclass(frozen=True)
class Case:
    """One run of a study."""

    name: str
    """Name of the case's run folder."""
    varied: SceneArguments
    """Values of the varied parameters in this case, by name; the seed is left out."""
    parameters: SceneArguments = field(repr=False)
    """All keyword arguments of the scene function."""


def cases_of(
    base: Mapping[str, object],
    varied: Mapping[str, Sequence[object]],
    *,
    defaults: Mapping[str, object] | None = None,
    repeat: int = 1,
    one_at_a_time: bool = False,
    seeded: bool = True,
) -> list[Case]:
    """Return the cases of a study: all combinations of the varied values, or each parameter varied one at a time.

    `base` holds the fixed parameters of the scene function. `varied` holds a list of values for each varied parameter,
    and `defaults` the default values of all parameters. Each combination of values becomes `repeat` cases with
    consecutive seeds, of which the first is the seed in `base` (default 0). With `one_at_a_time`, at most one parameter
    differs from its value in `base` or, without such a value, from its default; identical cases are merged. `seeded` is
    True if the scene has a seed. Raises :class:`SceneError` for empty or repeated values and for too many cases.
    """
    whole("repeat", repeat, 1, MAX_CASES)
    flag("one_at_a_time", one_at_a_time)
    for name, values in varied.items():
        if not values or len(set(map(repr, values))) < len(values):
            refuse(name, values, "must be one or more values that are all different", "leave out repeated values")
    if repeat > 1 and not seeded:
        problem = "must be 1, because nothing in this scene depends on a seed"
        refuse("repeat", repeat, problem, "leave out 'repeat'")
    if "seed" in varied and repeat > 1:
        refuse("repeat", repeat, "cannot be combined with a list of seeds", "leave out 'repeat' or 'seed'")
    count = repeat * (sum if one_at_a_time and varied else math.prod)(map(len, varied.values()))
    if count > MAX_CASES:
        refuse("repeat" if repeat > 1 else next(iter(varied)), repeat if repeat > 1 else f"{count} combinations",
               f"makes {count:,} cases, but a study has at most {MAX_CASES:,}, because each fills a folder",
               "vary fewer values, or split them over several studies")  # fmt: skip
    points = _one_at_a_time(base, varied, defaults or {}) if one_at_a_time and varied else _all_combinations(varied)
    first = int(base.get("seed", 0))
    cases: list[Case] = []
    for point in points:
        for seed in range(first, first + repeat):
            seeds = {"seed": seed} if seeded and "seed" not in point else {}
            shown = point | (seeds if repeat > 1 or not point else {})
            text = "-".join(f"{name}={name_part(value)}" for name, value in shown.items())
            name = f"{len(cases) + 1:03d}-{text}"[:MAX_NAME_LENGTH]
            cases.append(Case(name, dict(point), {**base, **point, **seeds}))
    return cases


def is_random(scene: SceneFunction) -> bool:
    """Return whether a scene's results depend on its random seed."""
    parts = (getattr(scene, name, None) for name in ("fill", "aggregates", "aggregate_fraction"))
    return any(part is not None for part in parts)


def short_name(words: str) -> str:
    """Return the text `words` as the name of a folder.

    A text of more than `MAX_NAME_LENGTH` characters is cut off, and a hash of the whole text is appended.
    """
    if len(words) <= MAX_NAME_LENGTH:
        return words
    return f"{words[: MAX_NAME_LENGTH - 11]}-{hashlib.sha256(words.encode()).hexdigest()[:10]}"


def _all_combinations(varied: Mapping[str, Sequence[object]]) -> list[SceneArguments]:
    return [dict(zip(varied, values)) for values in itertools.product(*varied.values())]


def _one_at_a_time(
    base: Mapping[str, object], varied: Mapping[str, Sequence[object]], defaults: Mapping[str, object]
) -> list[SceneArguments]:
    """Return the sets of parameter values in which at most one varied parameter differs from its base value.

    The base value is the value in `base` or, if there is none, in `defaults`. Every set names all varied parameters.
    """
    held = {name: base.get(name, defaults.get(name)) for name in varied}
    points = [held | {name: value} for name, values in varied.items() for value in values]
    unique: list[SceneArguments] = []
    for point in points:
        if point not in unique:
            unique.append(point)
    return unique


def name_part(value: object) -> str:
    """Return a value as part of a folder's name, with unsafe characters replaced."""
    return "".join(
        c if c.isalnum() or c in ".+-" else "_" for c in (f"{value:g}" if isinstance(value, float) else str(value))
    )
