"""Points that were measured, from CSV files whose header names columns with their units."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from pathlib import Path

from ..core.amounts import amount
from ..core.errors import positive, refuse

PUMPED = {"flow": "m3/s", "pressure": "Pa"}
"""Columns of points of a pipe, and the units in which the program has them."""


def read_points(path: Path, columns: Mapping[str, str] = PUMPED, field: str = "fit") -> list[list[float]]:
    """Columns of a CSV file, in SI units; the header has them with units, as `flow [m3/h],pressure [bar]`.

    `field` is what named the file. Raises :class:`SceneError` for a file without them, or with a number not above 0.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        refuse(field, str(path), f"cannot be read ({error})", "give a CSV file")
    heads = [re.fullmatch(r"\s*(\w+)\s*(?:\[([^\[\]]+)\])?\s*", head) for head in (rows[0] if rows else [])]
    places = {head[1]: (place, head[2] or "") for place, head in enumerate(heads) if head is not None}
    found = []
    for name, unit in columns.items():
        if name not in places:
            example = "flow [m3/h],pressure [bar]" if columns is PUMPED else ",".join(
                f"{each} [{its}]" for each, its in columns.items()
            )  # fmt: skip
            refuse(field, str(path), f"has no column {name!r}", f"its first line must be as '{example}'")
        place, own = places[name]
        column = {k: row[place] if place < len(row) else "" for k, row in enumerate(rows[1:], 2) if row}
        fields = {k: f"{path.name}, line {k}: {name}" for k in column}
        found.append([amount(fields[k], f"{text.strip()} {own}".strip(), unit) for k, text in column.items()])
        for each, value in zip(fields.values(), found[-1], strict=True):
            positive(each, value, unit, "leave points at rest out")
    return found
