"""Tables that notebooks show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from .origin import changed_fields


def html_table(rows: Iterable[Sequence[Any]], head: Sequence[Any] = (), caption: str = "") -> str:
    """Cells as a table of HTML."""
    found = [f'<caption style="text-align: left">{escape(caption)}</caption>'] if caption else []
    if head:
        found.append("<tr>" + "".join(f"<th>{escape(str(cell))}</th>" for cell in head) + "</tr>")
    for row in rows:
        found.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>")
    return f"<table>{''.join(found)}</table>"


class Parametrised:
    """What notebooks show by its parameters."""

    parameters: Mapping[str, Any]

    def _repr_html_(self) -> str:
        """Parameters that have a value, as a table."""
        rows = [(name, value) for name, value in self.parameters.items() if value is not None and value != ""]
        if rows and (changed := changed_fields(self)):
            rows.append(("changed after creation", ", ".join(changed)))
        return html_table(rows, caption=repr(self))
