"""Pressures that were measured at taps, the places of gauges along a trial line, read from a file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import at_least_and_below, positive, refuse
from ...core.inputs.amounts import amount, is_amount
from ...core.inputs.limits import check_limit, check_velocity
from ...core.inputs.text_files import read_columns, read_rows
from ...geometry.pipe_line import Part, PipeLine

COLUMNS = {"place": "m", "part": "1", "pressure": "Pa", "flow": "m3/s"}
"""Columns of a file of pressures that were measured along a pump line, with their SI units. One of two columns tells
where a gauge is: `place` is its distance from the pump along the line, and `part` is the number of the part of the line
before which the gauge sits."""

SAME_FLOW = 0.02
"""Relative difference up to which two flows count as equal. Pressures that were all measured at the same flow do not
distinguish the yield stress of the slip layer from its viscosity."""


@dataclass(frozen=True)
class Tap:
    """Reading of a gauge at one place of a trial line."""

    place: float
    """Distance along the line from the pump to the place of the measurement [m]."""
    pressure: float
    """Measured pressure [Pa]."""
    flow: float
    """Volume flow through the line during the pressure measurement [m3/s]."""
    row: int
    """Line number of the reading in the file of measurements, for messages."""


def read_taps(path: Path, line: PipeLine, flow: float | None = None) -> tuple[Tap, ...]:
    """Read pressures measured along a pump line from a CSV file.

    The header names columns with their units, such as `place [m],pressure [bar],flow [m3/h]`. The column of places
    may also be called `distance`, and other columns are ignored. Instead of the place of a gauge, the column `part` may
    give the number of the part before which the gauge sits. Without a column of flows, all pressures belong to the flow
    rate `flow` [m3/s]. Raises :class:`SceneError` for a missing column or an impossible number.
    """
    example = "write the first line in the form 'place [m],pressure [bar],flow [m3/h]'"
    columns, rows, _ = _columns(path)
    if ("place" in columns) == ("part" in columns):
        refuse("fit", str(path), "must have one of the columns 'place' and 'part'", example)
    for name in ("pressure", *(() if flow is not None else ("flow",))):
        if name not in columns:
            refuse("fit", str(path), f"has no column {name!r}", example)
    starts = np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])
    narrow = min(part.narrow for part in line.parts)
    taps = []
    for row, cells in rows:
        values = {"flow": flow or 0.0}
        for name, (place, unit) in columns.items():
            field = f"{path.name}, line {row}: {name}"
            if not (cell := cells[place].strip()):
                refuse(field, "", "is empty", "write a number, or leave out the row")
            with_unit = cell if is_amount(cell, COLUMNS[name]) else f"{cell} {unit}".strip()
            values[name] = amount(field, with_unit, COLUMNS[name])
            if name in ("pressure", "flow"):
                positive(field, values[name], COLUMNS[name], "leave out rows without pressure")
                check_limit(field, values[name], COLUMNS[name], name)
        if "part" in values:
            field, last = f"{path.name}, line {row}: part", len(line.parts)
            if values["part"] != int(values["part"]) or not 1 <= values["part"] <= last:
                problem = f"must be the number of a part, 1 to {last}"
                refuse(field, values["part"], problem, "count the parts of the line from the pump")
            values["place"] = float(starts[int(values["part"]) - 1])
        field = f"{path.name}, line {row}: place"
        hint = "'place' is the distance from the pump along the line, and must lie before the open end"
        at_least_and_below(field, values["place"], 0.0, float(starts[-1]), "m", hint)
        check_velocity(f"{path.name}, line {row}: flow", values["flow"], 4 * values["flow"] / (math.pi * narrow**2))
        taps.append(Tap(values["place"], values["pressure"], values["flow"], row))
    return tuple(taps)


def foreign_columns(path: Path) -> list[str]:
    """Return the names of the columns in a CSV file of measured pressures that a fit does not use."""
    return _columns(path)[2]


def _columns(path: Path) -> tuple[dict[str, tuple[int, str]], list[tuple[int, list[str]]], list[str]]:
    """Read the columns that a fit uses, as :func:`read_columns` does; also return the names of all other columns.

    The name `distance` means `place`. Raises :class:`SceneError` if the file has both.
    """
    columns, rows = read_columns(path, "fit")
    if "distance" in columns:
        if "place" in columns:
            problem = "has both a column 'place' and a column 'distance', which mean the same"
            refuse("fit", str(path), problem, "leave out one of the two columns")
        columns["place"] = columns.pop("distance")
    used = {name: column for name, column in columns.items() if name in COLUMNS}
    places = [place for place, _ in used.values()]
    header, _ = read_rows(path, "fit")
    others = (head.strip() for place, head in enumerate(header) if place not in places)
    # A comma at the end of the header leaves an empty name, which is left out here.
    return used, rows, [name for name in others if name]


def at_one_flow(taps: Sequence[Tap]) -> bool:
    """Return whether all pressures were measured at the same flow, up to a relative difference of `SAME_FLOW`."""
    flows = np.array([tap.flow for tap in taps])
    return bool(np.ptp(flows) <= SAME_FLOW * flows.mean())


def is_free(part: Part) -> bool:
    """Return whether a fit can determine a part's friction factor: a bend for which the line's file states none."""
    return part.kind == "bend" and part.factor is None
