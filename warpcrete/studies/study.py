"""Parameter studies: cases from lists of parameter values, run in parallel, with one table and one figure.

On a GPU, cases of discrete elements that need the same features run as one batch, and flows run side by side on streams
of their own. On a CPU, each case runs in its own process. Every case has its own run folder inside the study's folder,
and a resumed study runs only unfinished cases.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.device.device import find_device
from ..core.drawing.html import html_table
from ..core.errors import InstabilityError, RunFolderError, SceneError, between, positive, quoted, refuse
from ..core.inputs.by_name import names_from_file
from ..core.inputs.limits import check_limit
from ..core.inputs.origin import check_files, check_named
from ..core.run.files import atomic_file, check_new, is_full, read_record, write_json
from ..core.run.folders import locked_folder, new_folder
from ..core.run.method import Quantity
from ..core.run.provenance import provenance
from ..core.run.run import Run
from ..core.run.tables import dataframe, dataset
from ..core.units import number, shown
from ..methods import method_of
from ..record.checks import failed_checks
from ..record.loading import load as load_run
from ..record.recorders import RECORDERS
from ..scenes import modules
from .cases import Case, cases_of
from .cluster import Cluster, check_scheduler, open_cluster, unnumbered
from .drawing import draw
from .running import FAILED, outcome_of, previous_outcome, run_in_processes, run_on_gpu
from .study_table import columns_of, write_parquet
from .workers import WorkerDied

COUNTS = ("runs", "failed", "suspect")
"""Columns that count runs: finished ones, ones that ended with an error, and finished ones with a failed check."""
Progress = Callable[[str, float, dict[str, Any]], None]


@dataclass(repr=False)
class Study:
    """A parameter study, complete or still in progress."""

    folder: Path
    scene: str
    """Name of the scene."""
    cases: list[Case]
    quantities: Sequence[Quantity] = ()
    """Quantities in which the cases are compared."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of the varied parameters, by name; parameters without a unit are missing."""
    results: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Contents of result.json of every finished case, by case name."""
    failures: dict[str, str] = field(default_factory=dict)
    """Messages of the errors that ended cases, by case name."""
    not_at_fault: set[str] = field(default_factory=set)
    """Names of cases that failed only because their process died or the disk was full."""

    def __repr__(self) -> str:
        return f"<Study of scene {self.scene!r}: {self.progress}, folder '{self.folder}'>"

    @property
    def progress(self) -> str:
        """Numbers of finished and failed cases, as text."""
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
        """Names of failed checks, by the name of the finished case."""
        found = {name: failed_checks(result) for name, result in self.results.items()}
        return {name: checks for name, checks in found.items() if checks}

    @property
    def compared(self) -> list[Quantity]:
        """Quantities that at least one case yields; all quantities while no case has finished."""
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
        """Return the name of a parameter with its unit, as a column heading."""
        return f"{parameter} [{self.units[parameter]}]" if self.units.get(parameter) else parameter

    def rows(self) -> list[dict[str, Any]]:
        """Return the means and standard deviations of the quantities over the seeds, a row per set of varied values."""
        groups: dict[str, list[Case]] = {}
        for case in self.cases:
            groups.setdefault(json.dumps(case.varied, sort_keys=True), []).append(case)
        rows = []
        for members in groups.values():
            row: dict[str, Any] = dict(members[0].varied)
            done = [self.results[c.name] for c in members if c.name in self.results]
            for each in self.compared:
                values = [number(r[each.name]) for r in done if r.get(each.name) is not None]
                row[each.name] = float(np.mean(values)) if values else float("nan")
                row[f"{each.name}_scatter"] = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
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

    def _ipython_key_completions_(self) -> list[str]:
        return [case.name for case in self.cases]

    def table(self) -> Any:
        """Return all cases and seeds as a pandas DataFrame in SI units, one row per run, with `case` as index.

        `attrs["units"]` holds the units of the columns. Raises :class:`WarpcreteError` if pandas is not installed.
        """
        columns, units = columns_of(self)
        return dataframe(columns, units, "case")

    def to_xarray(self) -> Any:
        """Return all cases and seeds as an xarray Dataset in SI units, with the dimension `case`.

        Each variable has its unit in `attrs["units"]`. Raises :class:`WarpcreteError` if xarray is not installed.
        """
        columns, units = columns_of(self)
        return dataset(columns, units, "case", {"scene": self.scene})

    def plot(self) -> Any:
        """Return a Matplotlib figure of each compared quantity, with its scatter, over each varied parameter."""
        return draw(self)

    def _repr_html_(self) -> str:
        """Return the table of means and scatters as HTML for notebooks."""
        rows = [line.strip("| ").split(" | ") for line in self.markdown().splitlines() if not line.startswith("|--")]
        return html_table(rows[1:], rows[0], repr(self))

    def markdown(self) -> str:
        """Return a Markdown table of means and standard deviations over the seeds, in customary units."""
        titles = [f"{each.title} [{shown(each.unit)[1]}]" for each in self.compared]
        head = [*map(self.heading, self.varied), *titles, *COUNTS]
        lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
        for row in self.rows():
            cells = [str(row.get(name, "")) for name in self.varied]
            for each in self.compared:
                factor = shown(each.unit)[0]
                mean, scatter = row[each.name] * factor, row[f"{each.name}_scatter"] * factor
                text = f"{mean:.2f}" if np.isfinite(mean) else "none"
                cells.append(text + (f" +- {scatter:.2f}" if np.isfinite(scatter) else ""))
            lines.append("| " + " | ".join([*cells, *(str(row[name]) for name in COUNTS)]) + " |")
        return "\n".join(lines)

    def write(self, figure: bool = True) -> None:
        """Write the results so far: study.csv, study.md, study.parquet (with every case) and the figure study.png."""
        rows = self.rows()
        units = {each.name: each.unit for each in self.compared}
        units |= {f"{name}_scatter": unit for name, unit in units.items()}
        names = list(dict.fromkeys(key for row in rows for key in row))
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


def run_study(
    scene_name: str,
    module: Any,
    varied: Mapping[str, Sequence[Any]],
    *,
    base: Mapping[str, Any] | None = None,
    out: Path,
    repeat: int = 1,
    one_at_a_time: bool = False,
    device: str | None = None,
    precision: str = "float32",
    processes: int | None = None,
    frames: float | None = None,
    checkpoint_every: float = 60.0,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    **recorders: bool,
) -> Study:
    """Run a study of the scene function `module.scene` and write it to the new folder `out`.

    `varied` holds the values of each varied parameter, and `base` all other parameters that differ from their defaults.
    `repeat` is the number of seeds for each case. `one_at_a_time` varies each parameter alone instead of combining
    them. `processes` is the number of processes on a CPU (default: one per core). `frames` is the number of recorded
    frames per simulated second, and `checkpoint_every` the wall time between checkpoints [s]. `recorders` switches on
    additional recordings (`rerun`, `usd`). With a `scheduler`, the cases run on the `workers` of
    :func:`warpcrete.studies.cluster.open_cluster`. Raises :class:`SceneError` before anything is written if a case is
    no valid scene.
    """
    check_scheduler(scheduler, workers, processes)
    given: dict[str, Any] = module.scene.resolved(base or {})
    varied = _resolved_values(module.scene, varied)
    known = module.scene.fields({**{name: values[0] for name, values in varied.items() if values}, **given})
    for name in varied:
        if name in given:
            refuse(name, given[name], "cannot be both given and varied", "give either one value or the list of values")
    strange = sorted(set(recorders) - {kind.name for kind in RECORDERS})
    if strange:
        refuse("recorders", strange, f"must be among {', '.join(kind.name for kind in RECORDERS)}")
    if "precision" in known:
        if "precision" in varied or given.get("precision", precision) != precision:
            refuse(
                "precision",
                varied.get("precision", precision),
                "must be the same for the whole study",
                "run one study for each precision",
            )
        given["precision"] = precision
    defaults = {name: found.default for name, found in known.items()} | module.scene.completed(given)
    cases = cases_of(
        given, varied, defaults=defaults, repeat=repeat, one_at_a_time=one_at_a_time, seeded="seed" in known
    )
    return run_listed(
        scene_name, module, _without_idle_parameters(module.scene, cases), out=out, device=device, precision=precision,
        processes=processes, frames=frames, checkpoint_every=checkpoint_every, scheduler=scheduler, workers=workers,
        progress=progress, **recorders,
    )  # fmt: skip


def run_listed(
    scene_name: str,
    module: Any,
    cases: Sequence[Case],
    *,
    out: Path,
    device: str | None = None,
    precision: str = "float32",
    processes: int | None = None,
    frames: float | None = None,
    checkpoint_every: float = 60.0,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    figure: bool = True,
    **recorders: bool,
) -> Study:
    """Run a study of the given cases, with or without a figure; see :func:`run_study` for the other arguments."""
    cases = list(cases)
    if frames is not None:
        positive("frames", frames, "1/s")
        check_limit("frames", frames, "1/s")
    between("checkpoint_every", checkpoint_every, 0, float("inf"), "s")
    files: dict[str, str] = {}
    check_limit("checkpoint_every", checkpoint_every, "s")
    for place, case in enumerate(cases):
        made = module.scene(**case.parameters)
        # The record holds values as the scene uses them, such as absolute paths and a concrete's single parameters.
        cases[place] = replace(case, parameters=module.scene.plain(made, case.parameters))
        check_named(made)
        files |= made.parameters.files
    check_new(out)
    with open_cluster(scheduler, workers, device) as cluster:
        seed = int(cases[0].parameters.get("seed", 0))
        if cluster is None:
            here = find_device(device)
            found, made_by = str(here), provenance(here, precision, seed)
        else:
            found, made_by = cluster.machine(device, precision, seed)
        with new_folder(out):
            write_json(
                out / "study.json",
                {
                    "scene": scene_name,
                    "cases": [{"name": c.name, "varied": c.varied, "parameters": c.parameters} for c in cases],
                    "files": files,
                    "device": found,
                    "precision": precision,
                    "figure": figure,
                    "command": {"frames": frames, "checkpoint_every": checkpoint_every, **recorders},
                    "provenance": made_by,
                },
            )
            return _continue(out, module, processes, cluster, progress)


def resume_study(
    folder: Path,
    module: Any,
    *,
    processes: int | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Study:
    """Continue a study: keep finished and failed cases, and continue interrupted ones from their checkpoints.

    The study may continue with other `processes` or another `scheduler` than before; :func:`run_study` explains them.
    """
    check_scheduler(scheduler, workers, processes)
    record = read_record(folder / "study.json")
    check_files(folder / "study.json", record.get("files", {}))
    # Use all GPUs that are present, because the number of the earlier GPU means nothing on another machine.
    device = unnumbered(record.get("device"))
    with locked_folder(folder, "study.json"), open_cluster(scheduler, workers, device) as cluster:
        return _continue(folder, module, processes, cluster, progress)


def _continue(
    folder: Path, module: Any, processes: int | None, cluster: Cluster | None, progress: Progress | None
) -> Study:
    """Run all unfinished cases, and write the tables and the figure."""
    record, study = _opened(folder, module)
    cases = study.cases
    pending = [case for case in cases if not _take_over(study, case)]
    tell = progress or (lambda phase, fraction, figures: None)

    def store_outcome(case: Case, outcome: Any) -> None:
        """Store the outcome of a case; only an instability or an invalid scene counts as its final failure."""
        if isinstance(outcome, Run | dict):
            result = outcome.result if isinstance(outcome, Run) else outcome
            if result.get("finished"):
                study.results[case.name] = result
        elif isinstance(outcome, Exception):
            study.failures[case.name] = str(outcome) or type(outcome).__name__
            if isinstance(outcome, WorkerDied) or is_full(outcome):
                study.not_at_fault.add(case.name)
            if isinstance(outcome, InstabilityError | SceneError):
                (folder / case.name).mkdir(exist_ok=True)
                (folder / case.name / FAILED).write_text(f"{outcome}\n", encoding="utf-8")
        tell("running", len(study.results) / len(cases), {})

    try:
        if pending and cluster is not None:
            cluster.run(record, module, folder, pending, store_outcome)
        elif pending and find_device(record["device"]).is_cuda:
            run_on_gpu(record, module, folder, pending, store_outcome, tell)
        elif pending:
            run_in_processes(record, module, folder, pending, processes, store_outcome)
    finally:
        study.write(record.get("figure", True))
    return study


@names_from_file()
def _opened(folder: Path, module: Any) -> tuple[dict[str, Any], Study]:
    """Return the record of a study and a :class:`Study` without results."""
    record = read_record(folder / "study.json")
    try:
        cases = [Case(c["name"], c["varied"], c["parameters"]) for c in record["cases"]]
        for name in (case.name for case in cases):
            if Path(name).name != name or name in ("", ".", ".."):
                raise KeyError(f"case name {quoted(name)} cannot be the name of a folder")
        missing = {"scene", "command", "device", "precision"} - set(record)
        if missing or not cases:
            raise KeyError(", ".join(sorted(missing)) or "cases")
    except (KeyError, TypeError) as error:
        raise RunFolderError(
            f"'{folder / 'study.json'}': is not the record of a study ({error}); give a folder made by 'warpcrete "
            "study'"
        ) from error
    method = method_of(module.scene(**cases[0].parameters))
    units = {name: f.unit.strip() for case in cases for name, f in module.scene.fields(case.parameters).items()}
    return record, Study(folder, record["scene"], cases, method.compared, units)


def load_study(folder: Path) -> Study:
    """Load the study in a folder, even an unfinished one, without changing any file.

    Raises :class:`RunFolderError` if the folder holds no study of this version.
    """
    name, known = read_record(folder / "study.json").get("scene"), modules()
    if name not in list(known):
        raise RunFolderError(
            f"'{folder / 'study.json'}': names a scene that this version does not have; its scenes are "
            f"{', '.join(known)}"
        )
    _, study = _opened(folder, known[name])
    for case in study.cases:
        _store_outcome(study, case, outcome_of(folder / case.name))
    return study


def _resolved_values(scene: Any, varied: Mapping[str, Sequence[Any]]) -> dict[str, list[Any]]:
    """Return the varied values by the parameters' own names, after replacing aliases and reading units."""
    found: dict[str, list[Any]] = {}
    for name, values in varied.items():
        (own,) = scene.resolved({name: None})
        for value in values:
            if is_dataclass(value):
                refuse(name, value, "is an object, but only names and numbers can be varied",
                       "give the name of the object's class instead, and vary its parameters, whose names begin with "
                       f"{name}_")  # fmt: skip
        if own in found:
            refuse(
                name,
                values,
                f"varies {own!r}, which is already varied under this or another name",
                "leave out one of the two",
            )
        found[own] = [scene.resolved({name: value})[own] for value in values]
    return found


def _without_idle_parameters(scene: Any, cases: Sequence[Case]) -> list[Case]:
    """Return the cases without parameters that have no effect in them.

    Raises :class:`SceneError` for a parameter that has no effect in any case.
    """
    found = [replace(case, parameters=scene.effective_values(case.parameters)) for case in cases]
    used = {name for case in found for name in case.parameters}
    for case in cases:
        if set(case.parameters) - used:
            scene(**case.parameters)  # this raises the error that names the parameter without effect
    return found


def _take_over(study: Study, case: Case) -> bool:
    """Return whether a case has finished or failed before, and store that outcome in `study`.

    A case that was interrupted before its first checkpoint is deleted.
    """
    found = previous_outcome(study.folder / case.name)
    _store_outcome(study, case, found)
    return found is not None


def _store_outcome(study: Study, case: Case, found: Any) -> None:
    if isinstance(found, dict):
        study.results[case.name] = found
    elif found is not None:
        study.failures[case.name] = str(found)
