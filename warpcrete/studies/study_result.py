"""Cases and results of a parameter study, with their table and figure."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.drawing.html import html_table
from ..core.inputs.amounts import UNITS
from ..core.inputs.concretes import is_file
from ..core.records import Record
from ..core.run.files import atomic_file
from ..core.run.method import Quantity
from ..core.run.run import Run
from ..core.run.tables import dataframe, dataset, unstacked
from ..core.units import number, rounded, shown
from ..record.checks import failed_checks
from ..record.loading import load as load_run
from .cases import Case
from .drawing import draw
from .study_table import columns_of, write_parquet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNTS = ("runs", "failed", "suspect")
"""Columns that count runs: finished runs, runs that ended with an error, and finished runs with a failed check."""


@dataclass(repr=False)
class Study:
    """A parameter study, complete or still in progress."""

    folder: Path
    scene: str
    """Name of the scene."""
    cases: list[Case]
    quantities: Sequence[Quantity] = ()
    """Result quantities that the table and the figure of the study compare between the cases."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of the varied parameters, by name; parameters without a unit are missing."""
    results: dict[str, Record] = field(default_factory=dict)
    """Contents of the file result.json of every finished case; the keys are the names of the cases."""
    failures: dict[str, str] = field(default_factory=dict)
    """Messages of the errors that ended cases; the keys are the names of the cases."""
    not_at_fault: set[str] = field(default_factory=set)
    """Names of cases that failed only because their process died or the disk was full; they can run again."""
    written: Mapping[str, str] = field(default_factory=dict)
    """Units in which the user stated parameters, by name; the table and the figure use these units."""

    def __repr__(self) -> str:
        return f"<Study of scene {self.scene!r}: {self.progress}, folder '{self.folder}'>"

    @property
    def progress(self) -> str:
        """Text that states how many cases have finished and how many have failed."""
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return f"{len(self.results)} of {len(self.cases)} cases done{failed}"

    @property
    def finished(self) -> bool:
        """True if every case has either finished or failed."""
        return len(self.results) + len(self.failures) == len(self.cases)

    @property
    def lost(self) -> list[str]:
        """Names of failed cases that will run again, because their process died or the disk was full."""
        return [name for name in self.failures if name in self.not_at_fault]

    @property
    def suspect(self) -> dict[str, list[str]]:
        """Names of the plausibility checks that a finished case failed, by the name of the case."""
        failed_by_case = {name: failed_checks(result) for name, result in self.results.items()}
        return {name: checks for name, checks in failed_by_case.items() if checks}

    @property
    def compared(self) -> list[Quantity]:
        """Quantities to compare that occur in at least one result; all of them as long as no case has finished."""
        results = self.results.values()

        def met(each: Quantity) -> bool:
            if each.rare:
                return any(number(result.get(each.name, 0.0)) > 0 for result in results)
            return not results or any(each.name in result for result in results)

        return [each for each in self.quantities if met(each)]

    @property
    def varied(self) -> list[str]:
        """Names of the varied parameters."""
        return list(dict.fromkeys(key for case in self.cases for key in case.varied))

    def heading(self, parameter: str) -> str:
        """Return the name of a parameter with its SI unit, as a column heading."""
        return f"{parameter} [{self.units[parameter]}]" if self.units.get(parameter) else parameter

    def unit(self, parameter: str) -> tuple[float, str]:
        """Return the factor that converts SI values of a parameter to the unit in which it is displayed, and this unit.

        The unit is the one in which the user stated the parameter. Values without a unit are displayed in SI units.
        """
        unit, written = self.units.get(parameter, ""), self.written.get(parameter, "")
        return (1 / UNITS[unit][written], written) if written in UNITS.get(unit, ()) else (1.0, unit)

    def worded(self, parameter: str, value: object, factor: float | None = None) -> str:
        """Return the value of a parameter as text, with numbers in the unit of display and without the unit.

        `factor` converts a number to the unit of display; by default it is the factor that :meth:`unit` returns. The
        file of a concrete is named without its folder and suffix.
        """
        if isinstance(value, float):
            return rounded(value * (self.unit(parameter)[0] if factor is None else factor))
        return Path(value).stem if isinstance(value, str) and is_file(value) else str(value)

    def rows(self, quantities: Sequence[Quantity] | None = None) -> list[Record]:
        """Return one row for each set of varied values: means and standard deviations of quantities over the seeds.

        `quantities` are the quantities in the rows, by default those of :attr:`compared`. The standard deviation of a
        quantity has the suffix `_scatter`. If some of the finished runs have no value of a quantity, such as a plateau,
        the number of runs with a value has the suffix `_runs`.
        """
        groups: dict[str, list[Case]] = {}
        for case in self.cases:
            groups.setdefault(json.dumps(case.varied, sort_keys=True), []).append(case)
        rows = []
        for members in groups.values():
            row: Record = dict(members[0].varied)
            done = [self.results[c.name] for c in members if c.name in self.results]
            for each in self.compared if quantities is None else quantities:
                values = [number(r[each.name]) for r in done if r.get(each.name) is not None]
                values = [value for value in values if np.isfinite(value)]
                row[each.name] = float(np.mean(values)) if values else float("nan")
                row[f"{each.name}_scatter"] = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
                if len(values) < len(done):
                    row[f"{each.name}_runs"] = len(values)
            row["runs"] = len(done)
            row["failed"] = sum(c.name in self.failures for c in members)
            row["suspect"] = sum(c.name in self.suspect for c in members)
            rows.append(row)
        return rows

    def __getitem__(self, case: str) -> Run:
        """Load the run of a case by the case's name; raise :class:`KeyError` for an unknown case."""
        if case not in self._ipython_key_completions_():
            raise KeyError(
                f"the study has no case {case!r}; its cases are {', '.join(self._ipython_key_completions_())}"
            )
        return load_run(self.folder / case)

    def runs(self) -> dict[str, Run]:
        """Return the runs of the finished cases by the case's name, read from their folders."""
        return {name: self[name] for name in self if name in self.results}

    def __contains__(self, case: object) -> bool:
        return case in self._ipython_key_completions_()

    def __iter__(self) -> Iterator[str]:
        return iter(self._ipython_key_completions_())

    def _ipython_key_completions_(self) -> list[str]:
        return [case.name for case in self.cases]

    def table(self) -> Any:
        """Return all cases and seeds as a pandas DataFrame in SI units, one row per run, with `case` as index.

        `attrs["units"]` holds the units of the columns. Raises :class:`WarpcreteError` if pandas is not installed.
        """
        columns, units = columns_of(self)
        return dataframe(columns, units, "case", "study.rows()")

    def to_xarray(self) -> Any:
        """Return all cases and seeds as an xarray Dataset in SI units, with one dimension for each varied parameter.

        If the study has several seeds, `seed` is a further dimension. Combinations of values that the study does not
        contain are NaN, or an empty text. The only dimension is `case` if two cases have the same values, if a case has
        no value of a varied parameter, or if the study contains less than half of all combinations. Variables with a
        unit have it in `attrs["units"]`. Raises :class:`WarpcreteError` if xarray is not installed.
        """
        columns, units = columns_of(self)
        runs = dataset(columns, units, "case", {"scene": self.scene}, "study.rows()")
        several = ["seed"] if "seed" not in self.varied and len(set(columns["seed"])) > 1 else []
        names = [*self.varied, *several]
        keys = list(zip(*(columns[name] for name in names), strict=True))
        combinations = math.prod(len(set(columns[name])) for name in names)
        if not names or len(set(keys)) < len(keys) or combinations > 2 * len(keys) or any(None in k for k in keys):
            return runs
        return unstacked(runs, names)

    def plot(
        self, quantity: str | None = None, x: str | None = None, unit: str | None = None, y_unit: str | None = None
    ) -> Figure:
        """Return a Matplotlib figure of each compared quantity as a function of each varied parameter.

        `quantity` selects one number in the results of the runs, such as "pressure", which is drawn together with its
        closed-form prediction. `x` selects the varied parameter on the horizontal axis. `unit` is the unit of this
        parameter, such as "m3/h", and `y_unit` is the unit of the quantity. Without `x`, each varied parameter has a
        panel of its own. If `quantity` is also missing and the cases are all combinations of several parameters, there
        is one panel, which shows the parameter with the most values on the horizontal axis, and the others as series.
        Raises :class:`SceneError` for names and units that the study does not have.
        """
        return draw(self, quantity, x, unit, y_unit)

    def _repr_html_(self) -> str:
        """Return the table of means and standard deviations as HTML for notebooks."""
        rows = [line.strip("| ").split(" | ") for line in self.markdown().splitlines() if not line.startswith("|--")]
        return html_table(rows[1:], rows[0], repr(self))

    def markdown(self) -> str:
        """Return a Markdown table of means and standard deviations over the seeds, in customary units."""
        titles = [f"{each.title} [{shown(each.unit)[1]}]" for each in self.compared]
        named = [f"{name} [{self.unit(name)[1]}]" if self.unit(name)[1] else name for name in self.varied]
        head = [*named, *titles, *COUNTS]
        lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
        for row in self.rows():
            cells = [self.worded(name, row[name]) if name in row else "" for name in self.varied]
            for each in self.compared:
                factor = shown(each.unit)[0]
                mean, scatter = row[each.name] * factor, row[f"{each.name}_scatter"] * factor
                text = rounded(mean) if np.isfinite(mean) else "none"
                text += f" +- {rounded(scatter, 2)}" if np.isfinite(scatter) else ""
                met = row.get(f"{each.name}_runs")
                cells.append(text if not met else f"{text} ({met} of {row['runs']} runs)")
            lines.append("| " + " | ".join([*cells, *(str(row[name]) for name in COUNTS)]) + " |")
        return "\n".join(lines)

    def write(self, figure: bool = True) -> None:
        """Write the results so far: study.csv, study.md, study.parquet (with every case) and the figure study.png."""
        rows = self.rows()
        units = {each.name: each.unit for each in self.compared}
        units |= {f"{name}_scatter": unit for name, unit in units.items()}
        names = list(dict.fromkeys(key for row in rows for key in row))
        # Put the columns that count runs last. Some quantities occur only in later rows, so that their columns would
        # otherwise follow the counts.
        names.sort(key=COUNTS.__contains__)
        with atomic_file(self.folder / "study.csv") as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([f"{n} [{units[n]}]" if n in units else self.heading(n) for n in names])
            writer.writerows([[row.get(name, "") for name in names] for row in rows])
        with atomic_file(self.folder / "study.md") as partial:
            partial.write_text(f"{self.markdown()}\n", encoding="utf-8")
        write_parquet(self, self.folder / "study.parquet")
        if figure and self.results:
            with atomic_file(self.folder / "study.png") as partial:
                draw(self).savefig(partial, dpi=150, format="png")
