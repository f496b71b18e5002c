"""Reproduction of a paper: run the paper's cases, and judge whether the results agree with its numbers and trends."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...core.device.device import find_device
from ...core.errors import RunFolderError, one_of, refuse
from ...core.inputs.hyphens import spelled
from ...core.records import Record, SceneArguments
from ...core.run.files import read_json, read_record, write_json
from ...core.run.folders import locked_folder, new_folder
from ...core.run.progress import Progress
from ...core.run.scene_module import SceneModule
from ...scenes import modules
from ..cases import MAX_CASES, Case
from ..study import resume_study, run_listed
from ..study_result import Study
from .papers import CONCRETES, OPEN_ASSUMPTIONS, UNITS, UNITS_ROW, ZHAN, column_parameters, rows_of, xu_cases, zhan_case
from .report import write
from .state import Reproduction, key_of, unit_case

PAPERS = ("zhan", "xu")
RECORD = "reproduction.json"
KNOWN_RESULTS = "known.json"
"""Name of the file that holds copies of the results from earlier reproductions."""
QUICK = ("literal", "calibrated")
"""Names of the concretes that a quick reproduction simulates; it leaves out all others."""
HYDRATED = ("calibrated", "literal")
"""Names of the concretes that are also run with hydrated bonds, the stiffer of two kinds of bonds between elements. The
concrete "stiff stones" is not among them, because its runs would need ten times as many time steps."""


def reproduce(
    paper: str,
    *,
    out: Path,
    quick: bool = False,
    seeds: int = 1,
    only: Sequence[str] = (),
    known: Sequence[Path] = (),
    device: str | None = None,
    processes: int | None = None,
    progress: Progress | None = None,
) -> Reproduction:
    """Run the cases of a paper, `zhan` (discrete elements) or `xu` (flows), and write to the new folder `out`.

    `quick` replaces clumps by coarse spheres and runs fewer cases. `seeds` is the number of seeds for each case of
    discrete elements. `only` restricts the runs for Zhan et al. to some columns and rows of the report, by name
    (:func:`names_of_parts`). The columns are the concretes and the assumptions about details that the paper leaves
    open; the rows are the pipe units, as one group, and the varied parameters. Without names of columns, the runs of
    all columns are made, and without names of rows, those of all rows. `known` lists folders of earlier reproductions
    whose results are reused. Raises :class:`SceneError` for an unknown paper or name, and :class:`RunFolderError` for a
    folder without results.
    """
    one_of("paper", paper, PAPERS)
    if not 1 <= seeds <= MAX_CASES:
        refuse("seeds", seeds, f"must be from 1 to {MAX_CASES}")
    columns, rows = chosen(paper, only)
    earlier_results: Record = {}
    for folder in known:
        earlier_results |= _results(folder, paper, quick)
    find_device(device)
    record = {"paper": paper, "quick": quick, "seeds": seeds, "device": device, "columns": columns, "rows": rows}
    with new_folder(out):
        write_json(out / KNOWN_RESULTS, earlier_results)
        write_json(out / RECORD, record)
        return _continue(out, processes, progress)


def resume_reproduction(
    folder: Path, *, processes: int | None = None, progress: Progress | None = None
) -> Reproduction:
    """Continue a reproduction and reuse its finished runs."""
    with locked_folder(folder, RECORD):
        return _continue(folder, processes, progress)


def _continue(folder: Path, processes: int | None, progress: Progress | None) -> Reproduction:
    record = read_record(folder / RECORD)
    if not {"paper", "quick", "seeds", "device"} <= set(record) or record["paper"] not in ("zhan", "xu"):
        raise RunFolderError(
            f"'{folder / RECORD}': was not written by 'warpcrete reproduce'; give the folder of a reproduction"
        )
    reproduction = Reproduction(folder, record["paper"], record["quick"], record["seeds"], record["device"],
                         tuple(record.get("columns", ())), tuple(record.get("rows", ())))  # fmt: skip
    if (folder / KNOWN_RESULTS).is_file():
        reproduction.results |= read_json(folder / KNOWN_RESULTS)
    studies = zhan_studies(reproduction) if reproduction.paper == "zhan" else xu_studies(reproduction)
    tell = progress or (lambda phase, fraction, figures: None)
    lost: list[str] = []
    try:
        for place, (group, scene, cases) in enumerate(studies):
            study = _run(reproduction, group, scene, cases, processes, _part(tell, place, len(studies)))
            _store_results(reproduction, group, study)
            if not study.finished:
                return reproduction
            lost += study.lost
        reproduction.finished = not lost
    finally:
        write(reproduction)
    return reproduction


def _part(tell: Progress, place: int, count: int) -> Progress:
    def report_progress(phase: str, fraction: float, figures: dict[str, float]) -> None:
        tell(phase, (place + fraction) / count if phase == "running" else fraction, figures)

    return report_progress


def names_of_parts() -> list[str]:
    """Return the names of the columns and rows of the report on Zhan et al."""
    return [*CONCRETES, *OPEN_ASSUMPTIONS, UNITS_ROW, *(row.name for row in ZHAN)]


def chosen(paper: str, only: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split the names in `only` into columns and rows of the report on Zhan et al.; an empty list stands for all.

    Raises :class:`SceneError` for an unknown name, for names with the paper `xu`, and if the names select no runs.
    """
    if only and paper != "zhan":
        refuse("only", list(only), f"has no effect for the paper {paper!r}, only for 'zhan'", "leave out 'only'")
    known = names_of_parts()
    only = [spelled(name, known) for name in only]
    for name in only:
        one_of("only", name, known)
    columns = [name for name in (*CONCRETES, *OPEN_ASSUMPTIONS) if name in only]
    rows = [name for name in known if name in only and name not in columns]
    if columns and rows and not any(row in rows_of(column) for column in columns for row in rows):
        hint = f"combine {columns[0]!r} with one of {', '.join(rows_of(columns[0]))}"
        refuse("only", list(only), "selects no runs, because no named column has results in a named row", hint)
    return columns, rows


def _results(folder: Path, paper: str, quick: bool) -> Record:
    """Return the results in the folder of an earlier reproduction of the same paper, without failed runs.

    Raises :class:`SceneError` if the reproduction belongs to another paper, or if only one of the two is `quick`.
    """
    if not (folder / RECORD).is_file() or not (folder / "results.json").is_file():
        raise RunFolderError(
            f"known = '{folder}': contains no results of a reproduction; give a folder made by 'warpcrete reproduce'"
        )
    record = read_record(folder / RECORD)
    if (record.get("paper"), record.get("quick")) != (paper, quick):
        refuse("known", str(folder), "cannot be used, because it contains results of "
               f"'warpcrete reproduce {record.get('paper')}{' --quick' if record.get('quick') else ''}'",
               f"give a folder of 'warpcrete reproduce {paper}{' --quick' if quick else ''}'")  # fmt: skip
    return read_json(folder / "results.json")["results"]


def zhan_studies(reproduction: Reproduction) -> list[tuple[str, str, list[SceneArguments]]]:
    """Return the studies of those cases of Zhan et al. 2019 that have no result yet, the most expensive studies last.

    A study is a tuple with the name of a group of runs, the name of a scene, and the parameters of its cases.
    """
    names = reproduction.columns or (QUICK if reproduction.quick else (*CONCRETES, *OPEN_ASSUMPTIONS))
    studies = [(name, _cases(reproduction, name, hydrated=False)) for name in names]
    hydrated = [name for name in HYDRATED if name in names and not reproduction.quick]
    # The concretes in `HYDRATED` are run with hydrated bonds by default. If the user named both columns and rows,
    # every named concrete is run with hydrated bonds, provided that a named row varies them.
    if reproduction.columns and reproduction.rows:
        hydrated = [name for name in names if name in CONCRETES]
    studies += [(f"{name}, hydrated", _cases(reproduction, name, hydrated=True)) for name in hydrated]
    return [(group, "pipe", cases) for group, cases in studies if cases]


def _cases(reproduction: Reproduction, name: str, hydrated: bool) -> list[SceneArguments]:
    """Return the parameters of the runs in one column of the report that have no result yet, for all seeds.

    `name` is the name of the column. If `hydrated` is True, these are the runs in which a property of hydrated bonds
    varies. Otherwise, they are the runs of the pipe units, and the runs in which another parameter varies.
    """
    requested_rows = [each for each in rows_of(name) if each in (reproduction.rows or rows_of(name))]
    units = (
        [unit_case(unit, reproduction.quick) for unit in UNITS] if UNITS_ROW in requested_rows and not hydrated else []
    )
    # Leave out the runs with other aggregate sizes in a quick reproduction, because small stones make a run long.
    rows = [row for row in ZHAN if row.name in requested_rows and row.is_hydrated == hydrated
            and not (reproduction.quick and row.parameter == "size_max")]  # fmt: skip
    cases = units + [zhan_case(row, value, reproduction.quick) for row in rows for value in row.values]
    each = [{**case, **column_parameters(name), "seed": seed} for case in cases for seed in range(reproduction.seeds)]
    group = f"{name}, hydrated" if hydrated else name
    return _unique_cases([case for case in each if key_of(group, case) not in reproduction.results])


def xu_studies(reproduction: Reproduction) -> list[tuple[str, str, list[SceneArguments]]]:
    """Return the studies of those cases of Xu, Li & Jiang 2021 that have no result yet.

    A study is a tuple with the name of a group of runs, the name of a scene, and the parameters of its cases.
    """
    studies = []
    for group, cases in xu_cases(reproduction.quick).items():
        for scene in dict.fromkeys(scene for scene, _ in cases):
            name = f"{group}, {scene}"
            each = _unique_cases([{**case, "seed": 0} for s, case in cases if s == scene])
            studies.append((name, scene, [case for case in each if key_of(name, case) not in reproduction.results]))
    return [study for study in studies if study[2]]


def _unique_cases(cases: Sequence[SceneArguments]) -> list[SceneArguments]:
    unique: list[SceneArguments] = []
    for case in cases:
        if case not in unique:
            unique.append(case)
    return unique


def _run(
    reproduction: Reproduction,
    group: str,
    scene: str,
    cases: Sequence[SceneArguments],
    processes: int | None,
    tell: Progress,
) -> Study:
    folder = reproduction.folder / group.replace(", ", "-").replace(" ", "-")
    module = modules()[scene]
    if (folder / "study.json").is_file():
        return resume_study(folder, module, processes=processes, progress=tell)
    same: dict[str, list[Mapping[str, Any]]] = {}
    for case in cases:  # Run equal cases only once. The reference case, for example, belongs to several variations.
        same.setdefault(repr(module.scene.declared(_effective_parameters(module, case))), []).append(case)
    first = [_effective_parameters(module, loss_key[0]) for loss_key in same.values()]
    listed = [Case(f"{place + 1:03d}", each, each) for place, each in enumerate(first)]
    keys = {case.name: [key_of(group, each) for each in loss_key] for case, loss_key in zip(listed, same.values())}
    write_json(folder.with_suffix(".json"), keys)
    return run_listed(scene, module, listed, out=folder, device=reproduction.device, processes=processes, rerun=False,
                      usd=False, figure=False, progress=tell)  # fmt: skip


def _effective_parameters(module: SceneModule, case: Mapping[str, object]) -> SceneArguments:
    """Return those parameters of a case that affect its results. The seed, for example, does not affect a flow."""
    return module.scene.effective_values(case)


def _store_results(reproduction: Reproduction, group: str, study: Study) -> None:
    keys = read_json(study.folder.with_suffix(".json"))
    for case in study.cases:
        named = keys[case.name]
        # The file lists, for each case of the study, the keys under which its result is stored in the reproduction.
        # Files of version 0.2 have a single key for each case, as a text instead of a list.
        for key in [named] if isinstance(named, str) else named:
            if case.name in study.results:
                reproduction.results[key] = study.results[case.name]
            elif case.name in study.failures:
                reproduction.failures[key] = study.failures[case.name]
