"""Measured points from CSV files whose header names columns with their units."""

from collections.abc import Mapping
from pathlib import Path

from ..core.errors import positive, refuse
from ..core.inputs.amounts import amount, is_amount
from ..core.inputs.limits import check_limit
from ..core.inputs.text_files import read_columns

PUMPED = {"flow": "m3/s", "pressure": "Pa"}
"""Columns of points measured in a pipe, with their SI units."""


def read_points(path: Path, columns: Mapping[str, str] = PUMPED, field: str = "fit") -> list[list[float]]:
    """Return columns of a CSV file in SI units, one list for each of `columns`.

    The header names columns with their units, such as `flow [m3/h],pressure [bar]`. `field` is the entry that named the
    file, for error messages. Raises :class:`SceneError` for a missing column or a number that is not positive.
    """
    places, rows = read_columns(path, field)
    columns_read = []
    for name, unit in columns.items():
        if name not in places:
            example = (
                "flow [m3/h],pressure [bar]"
                if columns is PUMPED
                else ",".join(f"{each} [{its}]" for each, its in columns.items())
            )
            refuse(field, str(path), f"has no column {name!r}", f"write the first line in the form '{example}'")
        place, own = places[name]
        columns_read.append([])
        for line, row in rows:
            each = f"{path.name}, line {line}: {name}"
            cell = row[place].strip()
            value = amount(each, cell if is_amount(cell, unit) else f"{cell} {own}".strip(), unit)
            positive(each, value, unit, "leave out points without flow")
            check_limit(each, value, unit, name)
            columns_read[-1].append(value)
    return columns_read
