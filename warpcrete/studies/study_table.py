"""Table of all cases of a study, for DataFrames and Parquet files."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..core.run.files import atomic_file

FINISHED, FAILED, OPEN = "finished", "failed", "not finished"


def columns_of(study: Any) -> tuple[dict[str, list[Any]], dict[str, str]]:
    """Return the columns of a study's table by name, with one row per run, and the units of the columns by name.

    The columns are the case, its outcome, its seed, the varied parameters, all numbers of its result in SI units, the
    names of failed checks, and the error. A column without a unit is missing from the units.
    """
    rows = [_row(study, case) for case in study.cases]
    first = ["case", "outcome", "seed", *study.varied]
    last = ["failed_checks", "error"]
    quantities = dict.fromkeys(name for row, _ in rows for name in row if name not in (*first, *last))
    units: dict[str, str] = {name: unit for name, unit in study.units.items() if name in study.varied and unit}
    for _, found in rows:
        units |= found
    names = [*dict.fromkeys(first), *quantities, *last]
    return {name: [row.get(name) for row, _ in rows] for name in names}, units


def _row(study: Any, case: Any) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the values of one case, by column of the study's table, and the units of its result quantities."""
    result = study.results.get(case.name, {})
    outcome = FINISHED if result else FAILED if case.name in study.failures else OPEN
    row: dict[str, Any] = {"case": case.name, "outcome": outcome, "seed": case.parameters.get("seed"), **case.varied}
    units: dict[str, str] = {}
    for name, entry in result.items():
        if name in row:  # If a result has the name of a varied parameter, the column shows the parameter.
            continue
        if isinstance(entry, dict) and set(entry) == {"value", "unit"}:
            units[name] = entry["unit"]
            entry = entry["value"]
        if isinstance(entry, int | float) and not isinstance(entry, bool):
            row[name] = float(entry)
    row["failed_checks"] = ", ".join(study.suspect.get(case.name, []))
    row["error"] = study.failures.get(case.name, "")
    return row, units


def write_parquet(study: Any, path: Path) -> None:
    """Write the table of a study as Parquet.

    Each column's unit is in the metadata of its field. Pandas reads all units into `attrs["units"]` of the DataFrame.
    """
    import pyarrow
    from pyarrow import parquet

    columns, units = columns_of(study)
    arrays = [_array(pyarrow, values) for values in columns.values()]
    fields = [
        pyarrow.field(name, array.type, metadata={"unit": units[name]} if name in units else None)
        for name, array in zip(columns, arrays)
    ]
    notes = {"scene": study.scene, "units": json.dumps(units), "PANDAS_ATTRS": json.dumps({"units": units})}
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields, metadata=notes))
    with atomic_file(path) as partial:
        parquet.write_table(table, partial)


def _array(pyarrow: Any, values: Sequence[Any]) -> Any:
    """Return one column as an Arrow array; values of mixed types become text."""
    try:
        return pyarrow.array(values)
    except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError):
        return pyarrow.array([None if value is None else str(value) for value in values])
