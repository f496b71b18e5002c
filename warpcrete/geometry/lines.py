"""Pipelines read from a file: their parts, their course in space, and checks that the parts fit together."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core.errors import SceneError, one_line, one_of, positive, refuse, suggested
from ..core.inputs.amounts import amount, bare_number, customary_unit, is_customary, written_unit
from ..core.inputs.concretes import KEYS as CONCRETE_KEYS
from ..core.inputs.concretes import OF_MIXES, is_file
from ..core.inputs.limits import check_limit, check_velocity, warn
from ..core.inputs.text_files import errors_in_file, errors_located_at, name_of, read_mapping
from ..core.records import Record
from .axis import Axis
from .bend_factors import with_bend_factor
from .course import Course
from .crossings import first_crossing
from .customary_labels import with_customary_labels
from .line_entries import AMOUNTS, BEGINS, KEYS, LIMITED_AS, MOST_PARTS, OTHER_BEGINS, PART_HINTS, PARTS
from .pipe_line import PipeLine
from .pumps import Pump, pump_of

SHIPPED = Path(__file__).parents[1] / "measured" / "lines"
CROSSING_SAMPLES = {"bend": 9, "hose": 33, "bore": 33}
"""Number of points along a part, by the kind of the part. The search for crossings treats the part as straight between
neighbouring points."""
OF_CONCRETES = tuple(key for key in (*CONCRETE_KEYS, *OF_MIXES) if key not in KEYS)
"""Keys of a concrete's file. They reveal that the user gave such a file by mistake as the file of a line."""


def shipped_lines() -> tuple[str, ...]:
    """Return the names of the pipelines that are shipped with the package."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.yaml")))


def read_line(name: Path | str) -> PipeLine:
    """Read a pipeline from a YAML file, or a shipped pipeline by its name.

    Raises :class:`SceneError` if the file cannot be read, or if the parts do not fit together.
    """
    given, path = line_file(name)
    with errors_in_file(path):
        return line_of(given, name_of(path), path.parent)


def line_file(name: Path | str) -> tuple[Record, Path]:
    """Read the entries of a pipeline file, and return them with the path of the file.

    A relative path of a concrete's file is resolved from the folder of the pipeline file. Raises :class:`SceneError` if
    the file does not exist or holds no 'key: value' lines.
    """
    if not isinstance(name, (str, Path)):
        refuse("line", name, "must be the path of a file", "'warpcrete line --help' shows an example")
    known = shipped_lines()
    path = SHIPPED / f"{name}.yaml" if str(name) in known else Path(name)
    if not path.suffix and not os.path.exists(path):
        problem = f"must be the path of a file, or one of {', '.join(known)}"
        refuse("line", str(name), problem, suggested(str(name), known) or "'warpcrete line --help' shows an example")
    given = read_mapping(path, "line")
    if isinstance(given.get("concrete"), str) and is_file(given["concrete"]):
        given["concrete"] = str(path.parent / given["concrete"])
    return given, path


def line_of(given: Mapping[str, object], name: str = "line", folder: Path = Path()) -> PipeLine:
    """Build a pipeline from the entries of its file.

    Two entries are required: `parts`, a list of mappings from the kind of a part to its entries, and `diameter`, the
    diameter of the first part. The entries `begin` (the direction in which the line starts), `flow`, `concrete`,
    `largest_stone`, `pump`, `bend_factor`, `source` and `recorded` are optional. Paths of mesh files are relative to
    `folder`. Raises :class:`SceneError` if an entry is wrong or the parts do not fit together.
    """
    if not isinstance(given, Mapping):
        refuse("line", given, "must consist of 'key: value' lines")
    for key in (each for each in given if each in OF_CONCRETES):
        with errors_located_at(given, key):
            hint = "give this file as --concrete, or as 'concrete' in the file of a line"
            if isinstance(given.get("parts"), list):  # A list describes a line, a mapping a mix.
                hint = "move it to a file of its own, and name this file as 'concrete', or use the option --slump"
            refuse("line's key", key, "describes a concrete, not a line", hint)
    for key in given:
        with errors_located_at(given, key):
            if key == "stone":
                refuse("line's key", key, "is called 'largest_stone' in a line", "write 'largest_stone: 20 mm'")
            if key in PARTS or key in PART_HINTS:
                instead = PART_HINTS.get(key, f"write '- {key}: ...' below 'parts:'")
                refuse("line's key", key, "is a part; parts belong into the list 'parts'", instead)
            one_of("line's key", key, KEYS)
    with errors_located_at(given, "concrete"):
        if isinstance(given.get("concrete"), Mapping | list):
            problem = "must be the name of a concrete, or the path of its file"
            refuse("concrete", given["concrete"], problem, "describe the concrete in a file of its own")
    entries = given.get("parts")
    with errors_located_at(given, "parts"):
        _check_list(entries)
    if "diameter" not in given:
        raise SceneError("diameter: is missing; add the diameter of the first part, for example 'diameter: 125 mm'")
    diameter, stone, flow, recorded = (
        _above(given, field, AMOUNTS[field][0]) for field in ("diameter", "largest_stone", "flow", "recorded")
    )
    assert diameter is not None
    begin = given.get("begin", "level")
    with errors_located_at(given, "begin"):
        if isinstance(begin, str) and begin in OTHER_BEGINS:
            refuse("begin", begin, f"must be one of {', '.join(BEGINS)}", f"did you mean {OTHER_BEGINS[begin]!r}?")
        one_of("begin", begin, BEGINS)
    course = Course(np.array(BEGINS[begin]), diameter, folder)
    for number, entry in enumerate(entries, 1):
        with errors_located_at(entries, number - 1):
            course.add(number, entry)
    if flow is not None:
        with errors_located_at(given, "flow"):
            narrow = min(min(part.diameter, part.outlet) for part in course.parts)
            check_velocity("flow", flow, 4 * flow / (math.pi * narrow**2))
    axis = Axis((0.0, 0.0, 0.0), BEGINS[begin], tuple(course.pieces))
    parts = tuple(course.parts)
    if "bend_factor" in given:
        with errors_located_at(given, "bend_factor"):
            parts = with_bend_factor(parts, given["bend_factor"])
    _check_units(entries)
    customary = any(is_customary(given.get(key)) for key in (*AMOUNTS, "pump", "parts"))
    if customary:
        parts = with_customary_labels(parts, entries, given["diameter"])
    line = PipeLine(
        name=_text(given, "name", name),
        parts=parts,
        axis=axis,
        flow=flow,
        concrete=str(given["concrete"]) if "concrete" in given else None,
        source=_text(given, "source", ""),
        recorded=recorded,
        pump=_pump(given),
        customary=customary,
    )
    with errors_located_at(given, "parts"):
        check_crossing(line)
    with errors_located_at(given, "largest_stone"):
        return with_stone(line, stone)


def _check_list(entries: object) -> None:
    """Refuse the entry `parts` of a pipeline file if it is not a list of parts, or if the list contains other entries.

    A user who indents an entry of the line by mistake, such as `diameter`, makes it an item of this list.
    """
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        hint = "begin each part with a dash" if isinstance(entries, Mapping) else "write one part per line"
        refuse("parts", entries, "must be a list of one or more parts", f"{hint}, as in '- straight: 10 m'")
    if len(entries) > MOST_PARTS:
        problem = f"must be at most {MOST_PARTS} parts"
        refuse("parts", f"{len(entries)} parts", problem, "merge neighbouring straight parts")
    for number, entry in enumerate(entries):
        for key in entry if isinstance(entry, Mapping) else ():
            if key in KEYS:
                with errors_located_at(entries, number), errors_located_at(entry, key):
                    hint = f"write '{key}: {entry[key]}' outside the list 'parts', without indentation"
                    refuse(f"part {number + 1}", key, "describes the whole line, so it cannot be a part", hint)


def _check_units(entries: Sequence[Mapping[str, object]]) -> None:
    """Warn about lengths of parts without a unit beside lengths in feet or yards."""
    lengths: list[tuple[int, str, object]] = []
    for number, entry in enumerate(entries, 1):
        kind, said = next(iter(entry.items())) if isinstance(entry, Mapping) else (str(entry), None)
        value = said.get("length") if isinstance(said, Mapping) else said
        if kind in ("straight", "hose", "valve") or isinstance(said, Mapping):
            lengths.append((number, kind, value))
    unit = customary_unit((value for _, _, value in lengths if written_unit([value], "m") != "in"), "m")
    bare = [(number, kind, value) for number, kind, value in lengths if bare_number(value)]
    if unit is not None and bare:
        number, kind, value = bare[0]
        others = f" (also {', '.join(f'part {each}' for each, _, _ in bare[1:])})" if bare[1:] else ""
        warn(
            f"part {number}, {kind}: {value}{others}: without a unit, this is in m, but other parts are in {unit}; "
            f"did you mean '{value} {unit}'?"
        )


def with_stone(line: PipeLine, stone: float | None) -> PipeLine:
    """Return a copy of the pipeline in which the largest stone of the concrete has the diameter `stone` [m].

    If `stone` is None, the diameter is unknown. Raises :class:`SceneError` if the stone does not fit through a part of
    the pipeline.
    """
    for part in line.parts:
        if stone is not None and stone >= part.narrow:
            problem = f"does not pass through part {part.number}, {part.label}, which is {part.narrow:.6g} m wide"
            refuse("largest_stone", stone, problem, "use a wider pipe, or concrete with smaller stones")
    return replace(line, largest_stone=stone)


def _text(given: Mapping[str, object], field: str, default: str) -> str:
    """Return the text in the entry `field` without control characters, or `default` if the entry is missing."""
    text = given.get(field, default)
    if isinstance(text, Mapping | list):
        with errors_located_at(given, field):
            refuse(field, text, "must be text of one line", "put the text in quotes")
    return one_line(str(text))


def _pump(given: Mapping[str, object]) -> Pump | None:
    """Return the data sheet of the pump in the entry `pump`, or None if there is no such entry."""
    if "pump" not in given:
        return None
    with errors_located_at(given, "pump"):
        return pump_of(given["pump"])


def _above(given: Mapping[str, object], field: str, unit: str) -> float | None:
    """Return the value of the entry `field` in `unit` after checking it, or None if there is no such entry."""
    if field not in given:
        return None
    with errors_located_at(given, field):
        value = amount(field, given[field], unit)
        positive(field, value, unit)
        check_limit(field, value, unit, LIMITED_AS.get(field, field))
    return value


def check_crossing(line: PipeLine, gap: float = 0.0, hint: str = "change the course of the line") -> None:
    """Refuse a pipeline whose walls meet, or come closer to each other than `gap` [m]."""
    parts = line.parts
    spans = []
    for part in parts:
        wide = max(part.diameter, part.outlet)
        # If a gap is required, divide long parts into short pieces. The check ignores two pieces that are close to each
        # other along the axis, because such pieces are always close in space. If each leg of a U-turn were a single
        # long piece, the check would also ignore the two legs, however close they are.
        spans.append((part.length, wide, CROSSING_SAMPLES.get(part.kind, 2 + int(part.length / wide) if gap else 2)))
    crossing = first_crossing(line.axis, spans, gap)
    if crossing is None:
        return
    why = f"come within {gap:.3g} m of each other" if gap else "touch each other: the line crosses itself"
    refuse("parts", [parts[k].number for k in crossing], why, hint)
