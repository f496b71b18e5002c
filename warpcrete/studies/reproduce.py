"""Reproduce a paper: run what it ran, and say of each of its figures and trends whether ours agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import one_of, refuse
from ..core.files import check_new, read_json, write_json
from ..scenes import modules
from .cases import Case
from .papers import CONCRETES, UNITS, ZHAN, xu_cases, zhan_case
from .reproduction import Reproduction, key_of, unit_case
from .reproduction_report import write
from .study import Study, resume_study, run_listed

PAPERS = ("zhan", "xu")
RECORD = "reproduction.json"
QUICK = ("literal", "calibrated")
"""Concretes that a quick reproduction runs."""
Progress = Callable[[str, float, dict[str, Any]], None]


def reproduce(
    paper: str,
    *,
    out: Path,
    quick: bool = False,
    seeds: int = 1,
    device: str | None = None,
    processes: int | None = None,
    progress: Progress | None = None,
) -> Reproduction:
    """Run what a paper ran, `zhan` (discrete elements) or `xu` (flows), into the new folder `out`.

    `quick` takes coarse spheres for clumps and fewer cases; every case of elements has so many `seeds`. Raises
    :class:`SceneError` for an unknown paper.
    """
    one_of("paper", paper, PAPERS)
    if seeds < 1:
        refuse("seeds", seeds, "must be 1 or more")
    check_new(out)
    out.mkdir(parents=True)
    write_json(out / RECORD, {"paper": paper, "quick": quick, "seeds": seeds, "device": device})
    return resume_reproduction(out, processes=processes, progress=progress)


def resume_reproduction(
    folder: Path, *, processes: int | None = None, progress: Progress | None = None
) -> Reproduction:
    """Go on with a reproduction: runs that are finished are used."""
    record = read_json(folder / RECORD)
    found = Reproduction(folder, record["paper"], record["quick"], record["seeds"], record["device"])
    studies = zhan_studies(found) if found.paper == "zhan" else xu_studies(found)
    tell = progress or (lambda phase, fraction, figures: None)
    try:
        for place, (group, scene, cases) in enumerate(studies):
            study = _run(found, group, scene, cases, processes, _part(tell, place, len(studies)))
            _take(found, group, study)
            if not study.finished:
                return found
        found.finished = True
    finally:
        write(found)
    return found


def _part(tell: Progress, place: int, count: int) -> Progress:
    def hear(phase: str, fraction: float, figures: dict[str, Any]) -> None:
        tell(phase, (place + fraction) / count if phase == "running" else fraction, figures)

    return hear


def zhan_studies(found: Reproduction) -> list[tuple[str, str, list[dict[str, Any]]]]:
    """Group, scene and parameters of what is run of Zhan et al. 2019; the dearest last.

    Hydrated bonds are not run with stiff stones, whose steps are as short without.
    """
    names = QUICK if found.quick else tuple(CONCRETES)
    studies = [(name, _cases(found, name, hydrated=False)) for name in names]
    if not found.quick:
        studies += [(f"{name}, hydrated", _cases(found, name, hydrated=True)) for name in reversed(QUICK)]
    return [(group, "pipe", cases) for group, cases in studies]


def _cases(found: Reproduction, name: str, hydrated: bool) -> list[dict[str, Any]]:
    """Of one concrete with all seeds: the parameters that have to do with hydration, or the others and the units."""
    units = [] if hydrated else [unit_case(unit, found.quick) for unit in UNITS]
    # Small stones are what makes a run long: a quick reproduction goes without sizes.
    rows = [row for row in ZHAN if row.is_hydrated == hydrated and not (found.quick and row.parameter == "size_max")]
    cases = units + [zhan_case(row, value, found.quick) for row in rows for value in row.values]
    return _once([{**case, **CONCRETES[name], "seed": seed} for case in cases for seed in range(found.seeds)])


def xu_studies(found: Reproduction) -> list[tuple[str, str, list[dict[str, Any]]]]:
    """The same of Xu, Li & Jiang 2021."""
    studies = []
    for group, cases in xu_cases(found.quick).items():
        for scene in dict.fromkeys(scene for scene, _ in cases):
            studies.append(
                (f"{group}, {scene}", scene, _once([{**case, "seed": 0} for s, case in cases if s == scene]))
            )
    return studies


def _once(cases: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for case in cases:
        if case not in found:
            found.append(case)
    return found


def _run(
    found: Reproduction, group: str, scene: str, cases: Sequence[dict[str, Any]], processes: int | None, tell: Progress
) -> Study:
    folder = found.folder / group.replace(", ", "-").replace(" ", "-")
    module = modules()[scene]
    if (folder / "study.json").is_file():
        return resume_study(folder, module, processes=processes, progress=tell)
    listed = [Case(f"{place + 1:03d}", _meant(module, case), _meant(module, case)) for place, case in enumerate(cases)]
    write_json(folder.with_suffix(".json"), {case.name: key_of(group, each) for case, each in zip(listed, cases)})
    return run_listed(scene, module, listed, out=folder, device=found.device, processes=processes, rerun=False,
                      usd=False, figure=False, progress=tell)  # fmt: skip


def _meant(module: Any, case: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that mean something: flows have no seed that matters, and nothing hydrates at a fraction of 0."""
    return module.scene.meaningful(case)


def _take(found: Reproduction, group: str, study: Study) -> None:
    keys = read_json(study.folder.with_suffix(".json"))
    for case in study.cases:
        if case.name in study.results:
            found.results[keys[case.name]] = study.results[case.name]
        elif case.name in study.failures:
            found.failures[keys[case.name]] = study.failures[case.name]
