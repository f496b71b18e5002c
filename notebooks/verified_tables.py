"""Tables of the pages that compare results with exact solutions, from two runs of `warpcrete verify`.

warpcrete verify --device cpu --precision float32 --extremes --out V32
warpcrete verify --device cpu --precision float64 --out V64
python notebooks/verified_tables.py V32 V64

Writes the tables of the pages verified-*.md, exact-solutions.md, extremes.md and extreme-flows.md of the folder
`notebooks/validation` anew. The figure of exact-solutions.md is the file verification.png of the first run.
"""

import re
import sys
from pathlib import Path

PAGES = Path(__file__).parent / "validation"
EXTREMES = {"extremes": "| scene | deepest overlap", "extreme-flows": "| flow | unbalanced"}
"""Pages with a table of extreme scenes, and the first words of this table."""


def cells(line: str) -> list[str]:
    """Return the cells of a row of a table."""
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split(" | ")]


def table_at(text: str, head: str) -> tuple[int, int]:
    """Return where the table that begins with `head` begins and ends in a text."""
    begin = text.index(head)
    end = text.find("\n\n", begin)
    return begin, end if end > 0 else len(text)


def rows_of(text: str, head: str) -> list[list[str]]:
    """Return the rows of the table that begins with `head`, without its head."""
    begin, end = table_at(text, head)
    return [cells(line) for line in text[begin:end].rstrip().splitlines()[2:]]


def results(text: str) -> dict[str, list[list[str]]]:
    """Return the rows of each case: quantity, computed and expected value, error, tolerance."""
    found: dict[str, list[list[str]]] = {}
    name = ""
    for row in rows_of(text, "| case | quantity |"):
        name = row[0] or name
        found.setdefault(name, []).append(row[1:])
    return found


def tolerance(single: str, double: str) -> str:
    """Return the tolerance in single precision, with that in double precision if they differ."""
    return single if single == double else f"{single}; float64 {double}"


def verified(page: str, single: dict[str, list[list[str]]], double: dict[str, list[list[str]]]) -> str:
    """Return a page with the table below each heading that names a case."""
    for name, rows in single.items():
        heading = re.search(rf"^## {re.escape(name[0].upper() + name[1:])}$", page, re.M)
        if heading is None:
            continue
        lines = ["| quantity | expected | computed, float32 | error, float32 | error, float64 | tolerance |"]
        lines.append("|---|---|---|---|---|---|")
        for row, other in zip(rows, double[name], strict=True):
            allowed = tolerance(row[4], other[4])
            lines.append(f"| {row[0]} | {row[2]} | {row[1]} | {row[3]} | {other[3]} | {allowed} |")
        begin, end = table_at(page[heading.end() :], "| quantity |")
        page = page[: heading.end() + begin] + "\n".join(lines) + page[heading.end() + end :].removesuffix("\n") + "\n"
    return page


def summary(single: str, double: str) -> str:
    """Return the table with the result of each case that comes nearest to its tolerance in single precision."""
    lines = ["| case | figures | largest error, float32 | float64 | allowed (float32) | expected from |"]
    lines.append("|---|---|---|---|---|---|")
    head = "| case | figures |"
    others = {row[0]: row for row in rows_of(double, head)}
    for row in rows_of(single, head):
        lines.append(f"| {row[0]} | {row[1]} | {row[2]} | {others[row[0]][2]} | {row[3]} | {row[4]} |")
    return "\n".join(lines)


def main() -> None:
    """Write the tables of all pages."""
    single, double = (Path(folder, "verification.md").read_text(encoding="utf-8") for folder in sys.argv[1:3])
    for path in sorted(PAGES.glob("verified-*.md")):
        page = path.read_text(encoding="utf-8")
        path.write_text(verified(page, results(single), results(double)), encoding="utf-8")
    tables = {"exact-solutions": ("| case | figures |", summary(single, double))}
    for name, head in EXTREMES.items():
        begin, end = table_at(single, head)
        tables[name] = (head, re.sub(r"; usual cures: .*\|$", " |", single[begin:end], flags=re.M).rstrip())
    for name, (head, table) in tables.items():
        path = PAGES / f"{name}.md"
        page = path.read_text(encoding="utf-8")
        begin, end = table_at(page, head)
        path.write_text(page[:begin] + table + page[end:], encoding="utf-8")


if __name__ == "__main__":
    main()
