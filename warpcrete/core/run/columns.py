"""Columns of a table of numbers, and their summary: the unit and the first, last, smallest and largest value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np

from ..drawing.html import html_table

HEAD = ("column", "unit", "first", "last", "smallest", "largest")
"""Titles of the columns in the summary of a table of numbers."""


class Columns(dict[str, np.ndarray]):
    """Columns of equal length by name, as arrays. `print` shows a summary with one line for each column."""

    def __init__(
        self,
        columns: Mapping[str, np.ndarray] | Iterable[tuple[str, np.ndarray]],
        units: Mapping[str, str] = MappingProxyType({}),
        row: str = "row",
    ) -> None:
        """Create a copy of `columns` with their `units`; `row` names one row in the summary, such as "sample".

        The defaults are for `dataclasses.asdict`, which creates a copy from the names and arrays only, without units.
        """
        super().__init__(columns)
        self._units, self._row = units, row

    def __reduce__(self) -> tuple[type[Columns], tuple[dict[str, np.ndarray], Mapping[str, str], str]]:
        return Columns, (dict(self), self._units, self._row)

    def _title(self) -> str:
        count = max(map(len, self.values()), default=0)
        plural = "" if len(self) == 1 else "s"
        return f"{len(self)} column{plural} of {count} {self._row}{'' if count == 1 else 's'}"

    def _lines(self) -> list[tuple[str, ...]]:
        return [(name, self._units.get(name, ""), *_numbers(np.asarray(values))) for name, values in self.items()]

    def __repr__(self) -> str:
        rows = [HEAD, *self._lines()]
        widths = [max(map(len, cells)) for cells in zip(*rows)]
        texts = [f"{row[0]:<{widths[0]}}  {row[1]:<{widths[1]}}" for row in rows]
        numbers = ["".join(f"  {cell:>{width}}" for cell, width in zip(row[2:], widths[2:])) for row in rows]
        return "\n".join([self._title(), *(text + more for text, more in zip(texts, numbers))])

    def html(self) -> str:
        """Return the summary as an HTML table."""
        return html_table(self._lines(), HEAD, self._title())

    def _repr_html_(self) -> str:
        return self.html()


def _numbers(values: np.ndarray) -> tuple[str, ...]:
    """Return the first, last, smallest and largest value as texts.

    NaN and infinity do not count as smallest or largest value. If the values are not numbers, the texts for the
    smallest and the largest value are empty.
    """
    if not len(values):
        return ("",) * 4
    if values.dtype.kind not in "fiu":
        return str(values[0]), str(values[-1]), "", ""
    finite = values[np.isfinite(values)]
    ends = [finite.min(), finite.max()] if len(finite) else [np.nan, np.nan]
    return tuple(f"{value:.6g}" for value in (values[0], values[-1], *ends))
