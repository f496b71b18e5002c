"""Concretes by name or from a file, with the parameters that they define for each simulation method.

A file is YAML or JSON with up to two sections of parameters, both in SI units:

- `elements`: parameters of scenes with discrete elements, which `warpcrete run pipe --help` lists under aggregate,
  contacts and bonds;
- `flow`: the five constants of a Bingham fluid with a slip layer, and further constants of other flow laws, if any.

A section `mix` may replace both sections. It describes the concrete by amounts with units, from which
:mod:`warpcrete.mix` derives the parameters.

The key `base` names another concrete, whose values apply unless this file states other values. The keys `source` and
`calibrated` say where the numbers come from.
"""

import functools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import known_names, one_line, refuse, suggested
from ..narrowing import is_dict
from ..records import Record
from .limits import warn
from .text_files import errors_in_file, errors_located_at, name_of, read_mapping
from .yaml_files import merged

SHIPPED = Path(__file__).parents[2] / "measured" / "concretes"
FILES = (".yaml", ".yml", ".json")
SECTIONS = ("elements", "flow")
TEXTS = ("name", "source", "calibrated", "base")
KEYS = (*TEXTS, *SECTIONS, "mix")
FACTOR_KEYS = ("yield_factor", "viscosity_factor")
"""Entries of the section `flow` that describe the concrete at another age or temperature. They multiply all yield
stresses and all viscosities."""
FACTOR_SOURCE = "factor_source"
"""Entry of the section `flow` that states where the factors in :data:`FACTOR_KEYS` come from."""
FACTORS_BELONG = (
    "factors for another age or temperature belong to the section 'flow' of the concrete's file: 'flow: "
    "{yield_factor: 1.5, viscosity_factor: 1.2, factor_source: tribometer after 60 min}'"
)
"""Hint for users who write such factors in another section."""
MISPLACED_FACTORS = (*FACTOR_KEYS, FACTOR_SOURCE, "factor", "factors", "age", "temperature")
"""Entries with which users try to describe the age or temperature of a concrete outside the section `flow`."""
OF_MIXES = ("parts", "slump", "spread", "t500", "density", "air", "volume", "sieve", "sizes", "shape", "aggregate",
            "water_binder", "layer")  # fmt: skip
"""Entries of the section `mix` that users sometimes write outside this section by mistake."""
MAXIMUM_CHAIN = 10
"""Maximum number of concretes in a chain in which each one is the base of the next."""


@dataclass(frozen=True)
class MixSection:
    """Section `mix` of a concrete's file, from which the program derives parameters of the concrete.

    `elements` and `flow` are the values in the other sections of the file. They override the derived parameters.
    """

    values: Any
    folder: Path
    elements: Mapping[str, Any]
    flow: Mapping[str, Any]


@dataclass(frozen=True)
class NamedConcrete:
    """Parameters of a concrete for each simulation method, and the source of the numbers."""

    name: str
    source: str = ""
    calibrated: str = ""
    """Text that states which parameters were fitted to which measurement; empty if all values are published or
    measured."""
    elements: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Parameters of this concrete for simulations with discrete elements, in SI units; empty if unknown."""
    flow: Mapping[str, float] = field(default_factory=dict[str, float])
    """Constants of this concrete as a yield stress fluid with a slip layer, in SI units; empty if unknown."""
    mix: MixSection | None = None
    factor_sources: Mapping[str, str] = field(default_factory=dict[str, str])
    """Source of each factor for another age or temperature in the section `flow`, by the name of the factor.

    The source is empty if the file with this factor states none.
    """

    @property
    def factor_source(self) -> str:
        """Source of the factors as one text, with the names of the factors if they have different sources."""
        stated = {key: source for key, source in self.factor_sources.items() if source}
        if len(set(self.factor_sources.values())) <= 1:
            return next(iter(stated.values()), "")
        return "; ".join(f"{key}: {source}" for key, source in stated.items())


@functools.cache
def shipped() -> tuple[str, ...]:
    """Return the names of the concretes that come with the package."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.yaml")))


def is_file(name: str) -> bool:
    """Return whether the name of a concrete is the path of a YAML or JSON file."""
    return Path(name).suffix.lower() in FILES


def concrete(name: str) -> NamedConcrete:
    """Return the concrete called `name`: one that comes with the package, or one from the file at this path.

    Raises :class:`SceneError` if there is no such concrete, or if its file has errors.
    """
    if is_file(name):
        return _read(Path(name), 0)
    if name not in shipped():
        problem = f"must be one of {', '.join(shipped())}, or the path of a .yaml file"
        refuse("concrete", name, problem, suggested(name, shipped()))
    return _shipped(name)


@functools.cache
def _shipped(name: str) -> NamedConcrete:
    return _read(SHIPPED / f"{name}.yaml", 0)


def _read(path: Path, depth: int) -> NamedConcrete:
    given = read_mapping(path, "concrete")
    with errors_in_file(path):
        return _concrete(given, path, depth)


def _concrete(given: Record, path: Path, depth: int) -> NamedConcrete:
    """Return the concrete that the contents `given` of the file `path` describe, together with its base concrete.

    `depth` is the number of files that name this file as their base, directly or through other files.
    """
    if depth >= MAXIMUM_CHAIN:
        refuse(
            "concrete base",
            str(path),
            f"is part of a chain of more than {MAXIMUM_CHAIN} files, each with the next one as its 'base', or of a "
            "loop of files",
            "shorten the chain, or remove one 'base' of the loop",
        )
    for key in given:
        if key not in KEYS:
            with errors_located_at(given, key):
                hint = known_names(key, KEYS)
                if "diameter" in given:
                    hint = "a file with a diameter describes a line; use it as 'warpcrete line FILE'"
                elif key in MISPLACED_FACTORS:
                    hint = FACTORS_BELONG
                elif key in OF_MIXES:
                    hint = "it belongs to the section 'mix': write 'mix:' above it, and indent it"
                refuse("concrete", str(path), f"has the unknown key {key!r}", hint)
    texts = {key: one_line(str(given[key])) for key in TEXTS if given.get(key) is not None}
    sections: dict[str, Record] = {}
    for section in SECTIONS:
        entries: object = given.get(section) or {}
        if not is_dict(entries):
            with errors_located_at(given, section):
                problem = "must hold 'name: value' lines"
                hint = f"write each property on a line of its own below '{section}:', and indent these lines"
                refuse(f"concrete {section}", entries, problem, hint)
        sections[section] = entries
    factor_sources = _factor_sources(given, sections["flow"], name_of(path))
    if "mix" in given and not is_dict(given["mix"]):
        with errors_located_at(given, "mix"):
            hint = f"write 'base: {given['mix']}'" if given["mix"] in shipped() else "indent them below 'mix:'"
            refuse("mix", given["mix"], "must consist of 'key: value' lines", hint)
    mix = (
        MixSection(given["mix"], path.parent, elements=sections["elements"], flow=sections["flow"])
        if "mix" in given
        else None
    )
    if "base" in texts:
        with errors_located_at(given, "base"):
            base = _base(texts.pop("base"), path, depth)
        # Values in a concrete's file take precedence over values that follow from the mix of the base concrete.
        if mix is None and base.mix is not None:
            both = {section: merged(getattr(base.mix, section), sections[section]) for section in SECTIONS}
            mix = replace(base.mix, **both)
        elif mix is not None:
            mix = replace(mix, flow=merged(_factors(base.flow), mix.flow))
        factor_sources = {**base.factor_sources, **factor_sources}
        sections = {section: merged(getattr(base, section), sections[section]) for section in SECTIONS}
        texts.setdefault("source", base.source)
    if mix is None and not any(sections.values()):
        hint = "add a section 'elements', 'flow' or 'mix', or name another concrete, as in 'base: no1'"
        refuse("concrete", str(path), "defines no properties", hint)
    return NamedConcrete(
        **{"name": name_of(path), **texts}, elements=sections["elements"], flow=sections["flow"], mix=mix,
        factor_sources=factor_sources,
    )  # fmt: skip


def _factor_sources(given: Mapping[str, object], flow: dict[str, Any], name: str) -> dict[str, str]:
    """Remove the entry `factor_source` from the section `flow` of the concrete `name`.

    Return the source of each factor in the section as one line. `given` are all entries of the file. A warning is given
    if the section states a factor other than 1 without a source, or a source without a factor.
    """
    with errors_located_at(given, "flow"):
        stated = flow.pop(FACTOR_SOURCE, None)
        if stated is not None and not isinstance(stated, (str, int, float)):
            refuse(f"concrete flow {FACTOR_SOURCE}", stated, "must be a text, such as 'tribometer after 60 min'")
    source = "" if stated is None else one_line(str(stated))
    factors = [key for key in FACTOR_KEYS if key in flow]
    if not source and (unsourced := [key for key in factors if not _is_one(flow[key])]):
        warn(f"concrete {name}: {' and '.join(unsourced)} without a source; state where the numbers come from, as in "
             f"'{FACTOR_SOURCE}: tribometer after 60 min'")  # fmt: skip
    if source and not factors:
        warn(f"concrete {name}: {FACTOR_SOURCE} has no effect, because the section 'flow' of this file states no "
             f"factor; add {' or '.join(FACTOR_KEYS)}, or remove it")  # fmt: skip
    return dict.fromkeys(factors, source)


def _factors(flow: Mapping[str, object]) -> Mapping[str, Any]:
    """Return the factors for another age or temperature in a section `flow`."""
    factors = merged(flow)
    for key in set(factors).difference(FACTOR_KEYS):
        del factors[key]
    return factors


def _is_one(factor: object) -> bool:
    """Return whether a factor, as it is written in a file, is 1, such as 1.0 or '100 %'."""
    text = str(factor).strip()
    try:
        return float(text.rstrip("%")) == (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        return False


def _base(name: str, path: Path, depth: int) -> NamedConcrete:
    if is_file(name):
        return _read(path.parent / name, depth + 1)
    if name not in shipped():
        problem = f"must be one of {', '.join(shipped())}, or a .yaml file in the folder of {path.name}"
        refuse("concrete base", name, problem, suggested(name, shipped()))
    return _read(SHIPPED / f"{name}.yaml", depth + 1)


def known_only(section: str, values: Mapping[str, object], known: Collection[str], name: str) -> Record:
    """Return the `values` of a section of the concrete `name` after checking that all their keys are in `known`."""
    for key in values:
        if key not in known:
            with errors_located_at(values, key):
                refuse(f"concrete {section}", key, f"is an unknown parameter (in {name})", known_names(key, known))
    return merged(values)
