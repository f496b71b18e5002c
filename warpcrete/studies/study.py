"""Parameter studies: cases from lists of parameter values, run in parallel, with one table and one figure.

On a GPU, cases of discrete elements that need the same features run as one batch, and flows run at the same time, each
on its own CUDA stream. On a CPU, each case runs in its own process. Every case has its own run folder inside the
study's folder, and a resumed study runs only unfinished cases.
"""

from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

from ..core.device.device import find_device
from ..core.errors import (
    InstabilityError,
    RunFolderError,
    SceneError,
    between,
    callback,
    flag,
    is_full,
    positive,
    quoted,
    refuse,
)
from ..core.inputs.amounts import amount, written_unit
from ..core.inputs.by_name import names_from_file
from ..core.inputs.limits import check_limit
from ..core.inputs.origin import check_files, check_named
from ..core.inputs.parameters import CompositeRule, Needs
from ..core.inputs.scene_functions import SceneFunction
from ..core.records import Record, SceneArguments
from ..core.run.files import check_new, read_record, write_json
from ..core.run.folders import locked_folder, new_folder
from ..core.run.progress import Progress
from ..core.run.provenance import provenance
from ..core.run.run import Run
from ..core.run.scene_module import SceneModule
from ..methods import method_of
from ..record.recorders import RECORDERS
from ..scenes import modules
from .cases import Case, cases_of, is_random
from .cluster import Cluster, check_scheduler, open_cluster, unnumbered
from .running import FAILED, outcome_of, previous_outcome, run_in_processes, run_on_gpu
from .study_result import Study
from .workers import WorkerDied


def run_study(
    scene_name: str,
    module: SceneModule,
    varied: Mapping[str, Sequence[object]],
    *,
    base: Mapping[str, object] | None = None,
    out: Path,
    repeat: int = 1,
    one_at_a_time: bool = False,
    device: str | None = None,
    precision: str = "float32",
    processes: int | None = None,
    frames: float | str | None = None,
    checkpoint_every: float | str = 60.0,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    units: Mapping[str, str] | None = None,
    **recorders: bool,
) -> Study:
    """Run a study of the scene function `module.scene` and write it to the new folder `out`.

    `varied` holds the values of each varied parameter, and `base` all other parameters that differ from their defaults.
    `repeat` is the number of seeds for each case. With `one_at_a_time`, each case changes at most one of the varied
    parameters, so the values are not combined. `processes` is the number of processes on a CPU (default: one per core).
    `frames` is the number of recorded frames per simulated second, and `checkpoint_every` the wall time between
    checkpoints [s]. `recorders` switches on additional recordings (`rerun`, `usd`). With a `scheduler`, the cases run
    on the `workers` of :func:`warpcrete.studies.cluster.open_cluster`. `units` maps names of parameters to the units in
    which the table and the figure show them; a parameter whose values are texts, such as "5 m3/h", is by default shown
    in the unit of these texts. Raises :class:`SceneError` before anything is written if a case is not a valid scene.
    """
    check_scheduler(scheduler, workers, processes)
    units = written_units(module.scene, {n: [v] for n, v in (base or {}).items()} | dict(varied)) | dict(units or {})
    given: SceneArguments = module.scene.resolved(base or {})
    varied = _resolved_values(module.scene, varied)
    known = module.scene.fields({**{name: values[0] for name, values in varied.items() if values}, **given})
    for name in varied:
        if name in given:
            refuse(name, given[name], "cannot be both given and varied", "give either one value or the list of values")
    strange = sorted(set(recorders) - {kind.name for kind in RECORDERS})
    if strange:
        refuse("recorders", strange, f"must be among {', '.join(kind.name for kind in RECORDERS)}")
    for name, recorded in recorders.items():
        flag(name, recorded)
    if "precision" in known:
        if "precision" in varied or given.get("precision", precision) != precision:
            problem = "must be the same for the whole study"
            refuse("precision", varied.get("precision", precision), problem, "run one study for each precision")
        given["precision"] = precision
    defaults = {name: found.default for name, found in known.items()} | module.scene.completed(given)
    cases = cases_of(
        given, varied, defaults=defaults, repeat=repeat, one_at_a_time=one_at_a_time, seeded="seed" in known
    )
    cases = _without_idle_parameters(module.scene, cases)
    if repeat > 1 and not any(is_random(module.scene(**case.parameters)) for case in cases):
        hint = "leave out 'repeat', or simulate aggregates"
        refuse(
            "repeat", repeat, "must be 1, because nothing in this scene is random: all seeds give equal results", hint
        )
    return run_listed(
        scene_name, module, cases, out=out, device=device, precision=precision,
        processes=processes, frames=frames, checkpoint_every=checkpoint_every, scheduler=scheduler, workers=workers,
        progress=progress, units=units, **recorders,
    )  # fmt: skip


def run_listed(
    scene_name: str,
    module: SceneModule,
    cases: Sequence[Case],
    *,
    out: Path,
    device: str | None = None,
    precision: str = "float32",
    processes: int | None = None,
    frames: float | str | None = None,
    checkpoint_every: float | str = 60.0,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    figure: bool = True,
    units: Mapping[str, str] | None = None,
    **recorders: bool,
) -> Study:
    """Run a study of the given cases; :func:`run_study` explains all arguments except `figure`.

    `figure` is True if the study and its cases write figures. Drawing one figure takes as long as hundreds of
    measurements during a run.
    """
    cases = list(cases)
    if isinstance(checkpoint_every, str):
        checkpoint_every = amount("checkpoint_every", checkpoint_every, "s")
    if isinstance(frames, str):
        frames = amount("frames", frames, "1/s")
    if frames is not None:
        positive("frames", frames, "1/s")
        check_limit("frames", frames, "1/s")
    between("checkpoint_every", checkpoint_every, 0, float("inf"), "s")
    callback("progress", progress)
    files: dict[str, str] = {}
    check_limit("checkpoint_every", checkpoint_every, "s")
    for place, case in enumerate(cases):
        scene = module.scene(**case.parameters)
        # Store in the study's record the values that the scene uses: absolute paths in place of relative ones, and the
        # parameters of a named concrete.
        cases[place] = replace(case, parameters=module.scene.plain(scene, case.parameters))
        check_named(scene)
        files |= scene.parameters.files
    check_new(out)
    with open_cluster(scheduler, workers, device) as cluster:
        seed = int(cases[0].parameters.get("seed", 0))
        if cluster is None:
            here = find_device(device)
            machine, made_by = str(here), provenance(here, precision, seed)
        else:
            machine, made_by = cluster.machine(device, precision, seed)
        with new_folder(out):
            write_json(
                out / "study.json",
                {
                    "scene": scene_name,
                    "cases": [{"name": c.name, "varied": c.varied, "parameters": c.parameters} for c in cases],
                    "files": files,
                    "units": dict(units or {}),
                    "device": machine,
                    "precision": precision,
                    "figure": figure,
                    "command": {"frames": frames, "checkpoint_every": checkpoint_every, **recorders},
                    "provenance": made_by,
                },
            )
            return _continue(out, module, processes, cluster, progress)


def resume_study(
    folder: Path,
    module: SceneModule,
    *,
    processes: int | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Study:
    """Continue a study: keep finished and failed cases, and continue interrupted cases from their checkpoints.

    The study may continue with other `processes` or another `scheduler` than before; :func:`run_study` explains them.
    """
    check_scheduler(scheduler, workers, processes)
    record = read_record(folder / "study.json")
    check_files(folder / "study.json", record.get("files", {}))
    # Let the workers use all GPUs that are present. The GPU number in the record is ignored, because it may belong to
    # another machine.
    device = unnumbered(record.get("device"))
    with locked_folder(folder, "study.json"), open_cluster(scheduler, workers, device) as cluster:
        return _continue(folder, module, processes, cluster, progress)


def _continue(
    folder: Path, module: SceneModule, processes: int | None, cluster: Cluster | None, progress: Progress | None
) -> Study:
    """Run all unfinished cases of the study in `folder`, and write the tables and the figure."""
    record, study = _opened(folder, module)
    cases = study.cases
    pending = [case for case in cases if not _take_over(study, case)]
    tell = progress or (lambda phase, fraction, figures: None)

    def tell_done() -> None:
        """Report the fraction of the cases that have finished or failed."""
        tell("running", (len(study.results) + len(study.failures)) / len(cases), {})

    def tell_pending(phase: str, fraction: float, figures: dict[str, float]) -> None:
        """Report the finished fraction of the pending cases as a fraction of all cases, or report another phase."""
        all_done = 1 - (1 - fraction) * len(pending) / len(cases)
        tell(phase, all_done if phase == "running" else fraction, figures)

    def store_outcome(case: Case, outcome: object) -> None:
        """Store the outcome of a case.

        A failure is final if the simulation was unstable or the scene invalid. After any other failure, the case runs
        again when the study is resumed.
        """
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
        if not on_gpu:  # The runs on a GPU report their own progress.
            tell_done()

    if pending:
        tell_done()
    try:
        on_gpu = bool(pending) and cluster is None and find_device(record["device"]).is_cuda
        if pending and cluster is not None:
            cluster.run(record, module, folder, pending, store_outcome)
        elif on_gpu:
            run_on_gpu(record, module, folder, pending, store_outcome, tell_pending)
        elif pending:
            run_in_processes(record, module, folder, pending, processes, store_outcome)
    finally:
        study.write(record.get("figure", True))
    return study


@names_from_file()
def _opened(folder: Path, module: SceneModule) -> tuple[Record, Study]:
    """Read the record of the study in `folder`; return the record and a :class:`Study` that has no results yet."""
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
    return record, Study(folder, record["scene"], cases, method.compared, units, written=record.get("units", {}))


def load_study(folder: Path) -> Study:
    """Load the study in a folder, even an unfinished one, without changing any file.

    Raises :class:`RunFolderError` if the folder holds no study of this version.
    """
    name, known = read_record(folder / "study.json").get("scene"), modules()
    if name not in list(known):
        raise RunFolderError(
            f"'{folder / 'study.json'}': its scene {name!r} does not exist in this version, which has "
            f"{', '.join(known)}; load the study with the version that made it"
        )
    _, study = _opened(folder, known[name])
    for case in study.cases:
        _store_outcome(study, case, outcome_of(folder / case.name))
    return study


def written_units(scene: SceneFunction, written: Mapping[str, Sequence[object]]) -> dict[str, str]:
    """Return the units in which the user stated the values of parameters, by the parameter's name.

    `written` holds the values of each parameter as the user wrote them, such as "5 m3/h". A parameter is left out if
    its values have no unit or different units.
    """
    fields = {name: field for name, field in scene.fields({}).items() if field.kind is float}
    units: dict[str, str] = {}
    for name, values in written.items():
        if any(isinstance(value, str) for value in values):
            unit = written_unit(values, fields[name].units) if name in fields else None
            units |= {name: unit} if unit else {}
    return units


def _resolved_values(scene: SceneFunction, varied: Mapping[str, Sequence[object]]) -> dict[str, list[Any]]:
    """Return the values of the varied parameters, by name, with numbers in place of texts with units."""
    for name, values in varied.items():
        for value in values:
            if is_dataclass(value):
                refuse(name, value, "is an object, but only names and numbers can be varied",
                       "give the name of the object's class instead, and vary its parameters, whose names begin with "
                       f"{name}_")  # fmt: skip
    resolved = {name: [scene.resolved({name: value})[name] for value in values] for name, values in varied.items()}
    for name, field in scene.fields({}).items():
        if name in resolved and not any(field.of_kind(CompositeRule)):
            used = [repr(field.converted(value, name)) for value in resolved[name]]
            if len(set(used)) < len(used):
                refuse(
                    name,
                    resolved[name],
                    "must be one or more values that are all different",
                    "leave out repeated values",
                )
    return resolved


def _without_idle_parameters(scene: SceneFunction, cases: Sequence[Case]) -> list[Case]:
    """Remove from each case the parameters that do not affect its results, and return the cases.

    Raises :class:`SceneError` if a varied parameter affects none of the cases. If a parameter that is not varied
    affects none of the cases, creating the scene gives an error or a warning, depending on how the scene declares the
    parameter. The density of aggregates in a flow without aggregates, for example, gives a warning.
    """
    effective_cases = [replace(case, parameters=scene.effective_values(case.parameters)) for case in cases]
    used = {name for case in effective_cases for name in case.parameters}
    for case in cases:
        if idle := set(case.parameters) - used:
            # The parameters in `idle` affect no case of the study, which is probably a mistake. Create the scene, which
            # raises an error or gives a warning that names the parameter.
            scene(**case.parameters)
            for name in sorted(idle & set(case.varied)):
                problem = "is varied, but has no effect in any case of the study"
                field = scene.fields(case.parameters).get(name)
                needed = [rule.condition for rule in field.of_kind(Needs)] if field is not None else []
                cure = f"; it has an effect only if {' and '.join(needed)}" if needed else ""
                refuse(name, case.varied[name], problem, f"leave out {name!r}{cure}")
    return effective_cases


def _take_over(study: Study, case: Case) -> bool:
    """Store the outcome that a case has from an earlier call of the study; return whether it has finished or failed.

    The folder of a case that was interrupted before its first checkpoint is deleted.
    """
    outcome = previous_outcome(study.folder / case.name)
    _store_outcome(study, case, outcome)
    return outcome is not None


def _store_outcome(study: Study, case: Case, outcome: object) -> None:
    if isinstance(outcome, dict):
        study.results[case.name] = outcome
    elif outcome is not None:
        study.failures[case.name] = str(outcome)
