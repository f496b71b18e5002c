"""HTML tables for notebooks."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..inputs.origin import changed_fields


def html_table(rows: Iterable[Sequence[object]], head: Sequence[object] = (), caption: str = "") -> str:
    """Return rows of cells as an HTML table, with an optional header row and caption."""
    # Import `html` only here. The import takes 2 ms, and commands that print to a terminal do not need it.
    from html import escape

    lines = [f'<caption style="text-align: left">{escape(caption)}</caption>'] if caption else []
    if head:
        lines.append("<tr>" + "".join(f"<th>{escape(str(cell))}</th>" for cell in head) + "</tr>")
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>")
    return f"<table>{''.join(lines)}</table>"


class Parametrised:
    """Base class of objects that a notebook shows as a table of their parameters."""

    parameters: Mapping[str, Any]

    def _repr_html_(self) -> str:
        """Return an HTML table of the parameters and their values, without parameters whose value is None or empty."""
        rows = [(name, value) for name, value in self.parameters.items() if value is not None and value != ""]
        if rows and (changed := changed_fields(self)):
            rows.append(("changed after creation", ", ".join(changed)))
        return html_table(rows, caption=repr(self))
