"""The script that writes the tables of the pages about exact solutions, from what `warpcrete verify` prints."""

import importlib.util
from pathlib import Path

from warpcrete import verification
from warpcrete.verification import Case, Row

SCRIPT = Path(__file__).parents[2] / "notebooks" / "verified_tables.py"
PAGE = """\
# Verified

## Free fall

This case drops a sphere.

| quantity | expected | computed, float32 | error, float32 | error, float64 | tolerance |
|---|---|---|---|---|---|
| an old row | 1 | 1 | 0.0e+00 | 0.0e+00 | 0.0e+00 |

## Not covered

Nothing.
"""


def script():
    """Return the module of the script."""
    spec = importlib.util.spec_from_file_location("verified_tables", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def printed(speed: float, allowed: float) -> str:
    """Return what `warpcrete verify` prints of one case with two results."""
    case = Case("free fall", "Galilei", lambda device, precision: [], "motion")
    rows = [Row("speed after 1 s", speed, 9.81, allowed, "m/s"), Row("falls (1: yes)", 1.0, 1.0, 0.0)]
    return f"CPU\n\n{verification.summary([(case, rows)])}\n{verification.table([(case, rows)])}"


def test_tables_of_a_page_are_written_anew():
    tables = script()
    single, double = printed(9.82, 2e-3), printed(9.8100981, 1e-4)
    page = tables.verified(PAGE, tables.results(single), tables.results(double))
    head, rest = PAGE[: PAGE.index("| an old row")], PAGE[PAGE.index("\n## Not covered") :]
    rows = (
        "| speed after 1 s | 9.81 m/s | 9.82 m/s | 1.0e-03 | 1.0e-05 | 2.0e-03; float64 1.0e-04 |\n"
        "| falls (1: yes) | 1 | 1 | 0.0e+00 | 0.0e+00 | 0.0e+00 |\n"
    )
    assert page == head + rows + rest
    assert tables.verified(page, tables.results(single), tables.results(double)) == page
    last = tables.summary(single, double).splitlines()[-1]
    assert last == "| free fall | 2 | 1.0e-03 | 1.0e-05 | 2.0e-03 | Galilei |"


def test_every_case_of_the_pages_is_one_of_the_program():
    """A heading with a table that no case writes would keep its old figures."""
    names = {case.name[0].upper() + case.name[1:] for case in verification.cases()}
    for path in sorted(script().PAGES.glob("verified-*.md")):
        headings = [
            line.removeprefix("## ") for line in path.read_text(encoding="utf-8").splitlines() if line[:3] == "## "
        ]
        assert set(headings) - {"Not covered"} <= names, path.name
