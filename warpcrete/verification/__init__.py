"""Verification: results of the simulators compared with published results and closed-form solutions.

`run_cases` runs the cases and yields their results, and `table` and `figure` show them. The command `warpcrete verify`
runs the cases and shows the results. The tolerances follow from measured errors. Tests run the same cases on every
device and in both precisions. Modules here import `core`, `geometry`, `theory`, all simulation methods and their
kernels, but no recorder. To read the code, start with `case`, which defines a case, and go on with `contacts`.
"""

import math
from collections.abc import Iterator

from ..core.errors import WarpcreteError
from . import (
    assemblies,
    bonds,
    clumps,
    contacts,
    flows,
    impacts,
    spreading,
    stability,
    starting,
    suspensions,
    suspensions_clumps,
    suspensions_friction,
    suspensions_gaps,
    suspensions_many,
    vessels,
)
from .case import Case, Row

__all__ = ["Case", "Row", "cases", "run_cases", "summary", "table"]


def cases() -> list[Case]:
    """Return all verification cases, in the order in which the table of results lists them."""
    modules = (
        impacts, contacts, bonds, clumps, assemblies, stability, flows, starting, vessels, spreading, suspensions,
        suspensions_gaps, suspensions_clumps, suspensions_friction, suspensions_many,
    )  # fmt: skip
    return [case for module in modules for case in module.CASES]


def run_cases(
    chosen: list[Case], device: str, precision: str, *, slow: bool = True
) -> Iterator[tuple[Case, list[Row]]]:
    """Run verification cases one after the other, and yield each case with the rows of its results.

    If a case raises an error, it has a single row, which counts as failed and states the error. Without `slow`, the
    slow cases are left out.
    """
    for case in chosen:
        if slow or not case.slow:
            try:
                rows = case.run(device, precision)
            except WarpcreteError as error:
                rows = [Row(f"stopped: {error}", math.nan, 0.0, 0.0, scale=1.0)]
            yield case, rows


def table(results: list[tuple[Case, list[Row]]]) -> str:
    """Return a Markdown table with one line for each computed quantity."""
    lines = [
        "| case | quantity | computed | expected | error | tolerance | | source of the expected value |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case, rows in results:
        for number, row in enumerate(rows):
            unit = "" if row.unit == "1" else f" {row.unit}"
            first = number == 0
            cells = [
                case.name if first else "", row.quantity, f"{row.ours:.6g}{unit}", f"{row.expected:.6g}{unit}",
                _shown(row.error), _shown(row.tolerance), "" if row.passed else "**FAIL**",
                case.source if first else "",
            ]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def summary(results: list[tuple[Case, list[Row]]]) -> str:
    """Return a Markdown table with one line per case.

    The line shows the largest error among the computed quantities of the case, with its tolerance. Errors are compared
    after division by their tolerances.
    """
    lines = [
        "| case | figures | largest error | its tolerance | source of the expected values |",
        "|---|---|---|---|---|",
    ]
    for case, rows in results:
        worst = max(rows, key=lambda row: row.error / row.tolerance if row.tolerance else float(not row.passed))
        wrong = sum(not row.passed for row in rows)
        shown = f"{wrong} of {len(rows)} **FAIL**" if wrong else str(len(rows))
        lines.append(f"| {case.name} | {shown} | {_shown(worst.error)} | {_shown(worst.tolerance)} | {case.source} |")
    return "\n".join(lines) + "\n"


def _shown(value: float) -> str:
    return f"{value:.1e}" if math.isfinite(value) else "-"
