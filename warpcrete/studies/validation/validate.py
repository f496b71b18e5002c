"""Comparison of predictions with measured cases: ratios, medians and the share of cases inside their bands."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...core.device.device import find_device
from ...core.drawing.html import html_table
from ...core.errors import WarpcreteError, one_line, one_of, refuse
from ...core.records import Record
from ...core.run.files import atomic_file, write_json
from ...core.run.method import Progress
from .blocked import BlockingComparison, compare_blocking
from .cases import BASES, Case, held_out_groups, shipped_cases
from .comparison import Comparison, compare
from .figure import draw
from .kinds import BLOCKING, KINDS, UNITS
from .simulated import representatives, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Summary:
    """Statistics of the comparisons of one kind of measurement."""

    kind: str
    basis: str
    """Origin of the values with which the predictions are compared: "measurement", "model" or "guideline"."""
    chosen: str
    """Set of cases that the statistics cover: "all" (without simulated ones), "all, held out" (all cases, and all of
    them are held out), "held out", "others" (not held out) or "simulated"."""
    count: int
    groups: int
    """Number of independent groups (mixes, lines or laboratories) to which the cases belong."""
    ratio: float
    """Median, over the cases, of the ratio of the predicted value to the measured value."""
    error: float
    """Median of the relative errors of the predictions. A prediction that is too large or too small by a factor of 1.2
    has the error 0.2."""
    inside: float
    """Fraction of the concretes whose measured values lie in the predicted uncertainty bands."""
    factor: float
    """Median of the uncertainty factors f of the predictions, whose bands reach about from prediction / f to
    prediction * f."""


@dataclass(repr=False)
class Validation:
    """Comparisons of all cases with their predictions, as statistics, table and figure."""

    comparisons: list[Comparison]
    blocking: list[BlockingComparison]
    """Comparison of the rules against blocking with the observation, for each concrete of which it is known whether it
    blocked."""
    refused: dict[str, str]
    """Reason why the program refuses to predict a case, by the case's name."""

    def __repr__(self) -> str:
        return f"<Validation of {len(self.comparisons) + len(self.blocking)} cases>"

    def _repr_html_(self) -> str:
        return html_table([summary_cells(each) for each in self.summaries()], SUMMARY_COLUMNS, repr(self))

    def summaries(self) -> list[Summary]:
        """Return statistics of the comparisons, separately for each kind and each origin of the values.

        For each kind and origin, there are up to four entries (:attr:`Summary.chosen`): all cases predicted by closed
        forms, those of them that are held out, those that are not, and all cases predicted by simulations. An entry
        without cases, or with the same cases as the first entry, is left out.
        """
        found = []
        for kind, basis in itertools.product(KINDS, BASES):
            cases = [each for each in self.comparisons if (each.case.kind, each.case.basis) == (kind, basis)]
            own = [each for each in cases if not each.simulated]
            parts = {
                "all, held out" if all(x.held_out for x in own) else "all": own,
                "held out": [x for x in own if x.held_out],
                "others": [x for x in own if not x.held_out],
                "simulated": [x for x in cases if x.simulated],
            }
            found += [
                _summary(kind, basis, name, part)
                for name, part in parts.items()
                if part and (name.startswith("all") or part != own)
            ]
        return found

    def counts(self) -> str:
        """Return sentences on the number of compared values that were measured, and of those with another origin."""
        of = {basis: sum(x.case.basis == basis and not x.simulated for x in self.comparisons) for basis in BASES}
        return (
            f"{of['measurement']} of these values were measured. Those of a model ({of['model']}) or a guideline "
            f"({of['guideline']}) have rows of their own."
        )

    def summary_lines(self) -> list[str]:
        """Return the table of the statistics and the number of values by their origin, as lines of Markdown."""
        return [*markdown(SUMMARY_COLUMNS, [summary_cells(each) for each in self.summaries()]), "", self.counts()]

    def table(self) -> str:
        """Return tables of the statistics and of the cases as Markdown."""
        lines = [*self.summary_lines(), ""]
        lines += markdown(CASE_COLUMNS, [_case_cells(each) for each in self.comparisons])
        lines += ["", *self.blocking_lines(), ""] if self.blocking else []
        lines += [f"- refused: {name}: {why}" for name, why in self.refused.items()]
        return "\n".join(lines)

    def blocking_lines(self) -> list[str]:
        """Return the comparison of the rules against blocking with observations, as lines of Markdown.

        A sentence states how many verdicts agree with the observations. A table of all cases follows.
        """
        right = sum(each.agrees for each in self.blocking)
        rows = [(x.case.name, "yes" if x.held_out else "no", "blocked" if x.blocked else "not blocked", x.verdict,
                 x.rules or "-", "yes" if x.agrees else "no") for x in self.blocking]  # fmt: skip
        return [f"The rules against blocking agree with {right} of {len(rows)} observations.", "",
                *markdown(BLOCKING_COLUMNS, rows)]  # fmt: skip

    def record(self) -> Record:
        """Return the contents of the file validation.json, with all values in SI units."""
        return {
            "summaries": [vars(each) for each in self.summaries()],
            "cases": [
                {"id": x.case.name, "kind": x.case.kind, "group": x.case.group, "basis": x.case.basis,
                 "held_out": x.held_out, "simulated": x.simulated,
                 "unit": KINDS[x.case.kind].unit, "measured": x.measured, "predicted": x.band.value,
                 "low": x.band.low, "high": x.band.high, "causes": dict(x.band.shares), "source": x.case.source,
                 "note": x.case.note}
                for x in self.comparisons
            ],
            "blocking": [
                {"id": x.case.name, "group": x.case.group, "held_out": x.held_out, "blocked": x.blocked,
                 "verdict": x.verdict, "rules": x.rules, "source": x.case.source, "note": x.case.note}
                for x in self.blocking
            ],
            "refused": self.refused,
        }  # fmt: skip

    def plot(self) -> Figure:
        """Return a Matplotlib figure of predicted against measured values, with the uncertainty bands."""
        return draw(self.comparisons)

    def write(self, folder: Path) -> None:
        """Write validation.md, .csv and .json into a folder, and validation.png if quantities were compared."""
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_file(folder / "validation.md") as partial:
            partial.write_text(self.table() + "\n", encoding="utf-8")
        with atomic_file(folder / "validation.csv") as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(CASE_COLUMNS)
            writer.writerows(_case_cells(each) for each in self.comparisons)
        write_json(folder / "validation.json", self.record())
        if self.comparisons:
            with atomic_file(folder / "validation.png") as partial:
                self.plot().savefig(partial, dpi=150, format="png")


SUMMARY_COLUMNS = (
    "kind", "value from", "cases", "number", "groups", "median ratio", "median error", "inside",
    "median factor of band",
)  # fmt: skip
BLOCKING_COLUMNS = ("case", "held out", "observed", "verdict", "rules that warn", "agrees")
CASE_COLUMNS = ("case", "kind", "value from", "held out", "unit", "measured", "predicted", "low", "high", "ratio",
                "inside")  # fmt: skip


def validate(
    cases: Sequence[Case] | None = None, *, kinds: Iterable[str] = (), quick: bool = False, device: str | None = None,
    progress: Progress | None = None,
) -> Validation:  # fmt: skip
    """Predict measured cases, by default all that are shipped, and compare the predictions with the measurements.

    `kinds` restricts the comparison to some kinds of cases; an empty sequence means all kinds. Unless `quick` is set,
    one case of each group of slumps, spreads and funnels is also simulated as a flow, which takes a few minutes. A case
    that the program refuses to predict is listed with the reason. Raises :class:`SceneError` for an unknown kind or if
    there is no case of these kinds, and :class:`DeviceError` for a device that does not exist.
    """
    kinds = tuple(kinds)
    for kind in kinds:
        one_of("kind", kind, UNITS)
    if device is not None or not quick:
        find_device(device)
    everything = list(cases) if cases is not None else shipped_cases()
    held = held_out_groups(everything)
    chosen = [case for case in everything if not kinds or case.kind in kinds]
    if not chosen:
        known = ", ".join(dict.fromkeys(case.kind for case in everything))
        problem = f"is the kind of no case; the cases have the kinds {known}" if known else "has no cases to compare"
        refuse("kind", ", ".join(kinds) or "any", problem)
    found: list[Comparison] = []
    blocking: list[BlockingComparison] = []
    refused: dict[str, str] = {}
    jobs = [(case, False) for case in chosen] + [(case, True) for case in ([] if quick else representatives(chosen))]
    for place, (case, as_flow) in enumerate(jobs):
        if progress is not None:
            progress(case.name, place / len(jobs))
        held_out = (case.kind, case.group) in held
        try:
            if case.kind == BLOCKING:
                blocking.append(compare_blocking(case, held_out))
            else:
                found.append(simulate(case, held_out, device=device) if as_flow else compare(case, held_out))
        except WarpcreteError as error:
            refused[f"{case.name}{', simulated' if as_flow else ''}"] = one_line(str(error))
    return Validation(found, blocking, refused)


def _summary(kind: str, basis: str, chosen: str, part: Sequence[Comparison]) -> Summary:
    ratios = np.array([each.ratio for each in part])
    return Summary(
        kind, basis, chosen, len(part), len({each.case.group for each in part}),
        float(np.median(ratios)),
        math.exp(float(np.median(np.abs(np.log(ratios))))) - 1,
        float(np.average([each.inside for each in part], weights=[each.case.concretes for each in part])),
        float(np.median([each.band.factor for each in part])),
    )  # fmt: skip


def summary_cells(x: Summary) -> tuple[str, ...]:
    """Return the texts in the cells of a table row that shows the statistics `x` of one kind of measurement."""
    return (KINDS[x.kind].label, x.basis, x.chosen, str(x.count), str(x.groups), f"{x.ratio:.2f}",
            f"{100 * x.error:.0f} %", f"{100 * x.inside:.0f} %", f"{x.factor:.2f}")  # fmt: skip


def _case_cells(x: Comparison) -> tuple[str, ...]:
    name = f"{x.case.name}, simulated" if x.simulated else x.case.name
    numbers = (x.measured, x.band.value, x.band.low, x.band.high)
    return (name, x.case.kind, x.case.basis, "yes" if x.held_out else "no", KINDS[x.case.kind].unit,
            *(f"{each:.4g}" for each in numbers), f"{x.ratio:.2f}", f"{100 * x.inside:.0f} %")  # fmt: skip


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a table with the given column headings and rows as lines of Markdown."""
    return [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *(f"| {' | '.join(row)} |" for row in rows)]
