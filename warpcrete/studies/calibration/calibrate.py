"""Calibration: find the parameters of a concrete that reproduce measured values, in rounds of simulation runs.

The parameter sets of the first round fill the parameter ranges evenly. In this round, flows of standard tests have wide
cells, if the scenes accept them; such trials are called coarse, and all others full. In each further round, most
parameter sets are samples of the posterior of all runs so far, and the others are proposed by Optuna's tree-structured
Parzen estimator. Every run has its own random seed, and the scatter between seeds enters the posterior as noise.
Finally, verification runs simulate the likeliest parameters with fresh seeds.
"""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.device.device import find_device
from ...core.errors import RunFolderError, WarpcreteError, callback, refuse, refuse_unknown_settings, whole
from ...core.extras import needs_extra
from ...core.inputs.origin import check_files, files_read
from ...core.records import Record
from ...core.run.files import check_new, output_folder, read_record, write_json
from ...core.run.folders import locked_folder, new_folder
from ...core.run.progress import Progress
from ...core.run.scene_module import SceneModule
from ...record.checks import failed_checks
from ...scenes import modules
from ..cases import MAX_CASES, Case
from ..cluster import check_scheduler
from ..study import resume_study, run_listed
from ..study_result import Study
from .calibration import Calibration, Trial
from .coarse import coarse_changes
from .posterior import CoarseRuns, posterior
from .report import write
from .rounds import MIN_VALUES, next_round, verification_runs
from .starts import closed_forms
from .targets import Target, Task, found_in, read_task, task_of

RECORD = "calibration.json"
COARSE_ERROR = 0.1
"""Assumed standard deviation of the error of coarse runs, as a fraction of the measured value. Most of the first full
trials are samples of the posterior of the coarse runs; a larger assumed error only makes this posterior wider."""
SETTLED_ERROR_RATIO = 0.5
"""Largest ratio of the Gaussian-process emulator's standard error to the uncertainty of a target (a standard deviation)
at which the emulator counts as accurate enough. The search ends when all targets fulfil this condition and the
posterior no longer shifts."""
SETTLED_SHIFT = 0.25
"""Shift of the posterior mean from one round to the next, in posterior standard deviations, below which the search may
end."""


def calibrate(
    targets: Path | str | Mapping[str, Any], *, out: Path | str | None = None, **settings: object
) -> Calibration:
    """Find the parameters of a concrete that reproduce `targets`, a file of targets or its contents as a mapping.

    `out` is the new folder (default: runs/calibration-NNN). :func:`run_calibration` explains the `settings` and the
    errors raised.
    """
    asked = Path(targets) if isinstance(targets, str) else targets
    if not isinstance(asked, Path | Mapping):
        refuse("targets", targets, "must be the path of a YAML file, or a mapping", "for example 'targets.yaml'")
    refuse_unknown_settings(run_calibration, settings)
    return run_calibration(asked, modules(), out=output_folder(out, "calibration"), **settings)


def run_calibration(
    targets: Path | Mapping[str, Any],
    modules: Mapping[str, SceneModule],
    /,
    *,
    out: Path,
    trials: int | None = None,
    batch: int | None = None,
    repeat: int = 3,
    seed: int = 0,
    device: str | None = None,
    precision: str = "float32",
    processes: int | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Find the parameters of a concrete with which scenes reproduce measured values, the targets.

    `targets` is a file of targets or its contents as a mapping, and `modules` maps the names of scenes to their
    modules. Results go to the new folder `out`. `trials` is the maximum number of parameter sets that are run with full
    accuracy (default: 10, plus 10 for each free parameter); coarse trials and verification runs do not count. `batch`
    is the number of parameter sets in one round (default: 4, plus 2 for each free parameter). If the first round is
    coarse, it has 2 * `batch` sets, and each later round has `batch` / 2. `repeat` is the number of verification runs
    of the likeliest parameters, each with another seed; if no scene depends on a random seed, the likeliest parameters
    are simulated once. Raises :class:`SceneError` for wrong targets, before anything is written, and
    :class:`WarpcreteError` if too few runs yield the value of a target.
    """
    needs_extra("calibrate", "optuna", "sklearn", "emcee")
    with files_read() as files:
        read = isinstance(targets, Path)
        task, raw = read_task(targets, modules) if read else (task_of(targets, modules), dict(targets))
    # The record of the calibration contains the targets themselves, so the user may change the file of targets before
    # the calibration is resumed. All other files that were read must stay the same.
    files.pop(str(targets.resolve()) if read else "", None)
    free = len(task.free)
    most = 10 + 10 * free if trials is None else trials
    batch_size = 4 + 2 * free if batch is None else batch
    _check_trial_count(most)
    whole("batch", batch_size, 1, MAX_CASES)
    whole("repeat", repeat, 0, MAX_CASES)
    whole("seed", seed, 0, 2**31)
    check_scheduler(scheduler, workers, processes)
    callback("progress", progress)
    check_new(out)
    settings = {"trials": most, "batch": batch_size, "repeat": repeat, "seed": seed, "device": device,
                "precision": precision}  # fmt: skip
    if scheduler is None:
        find_device(device)
    with new_folder(out):
        write_json(out / RECORD, {"targets": raw, "settings": settings, "rounds": [], "files": files})
        return _continue(out, modules, processes, scheduler, workers, progress)


def resume_calibration(
    folder: Path,
    modules: Mapping[str, SceneModule],
    *,
    trials: int | None = None,
    processes: int | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Continue the calibration in `folder`, and reuse its finished runs.

    `trials` is a new maximum for the number of full trials, including those already run; None keeps the earlier
    maximum.
    """
    needs_extra("calibrate", "optuna", "sklearn", "emcee")
    if trials is not None:
        _check_trial_count(trials)
    with locked_folder(folder, RECORD):
        record = _record(folder)
        if trials is not None:
            record["settings"]["trials"] = trials
            write_json(folder / RECORD, record)
        return _continue(folder, modules, processes, scheduler, workers, progress)


def _check_trial_count(most: int) -> None:
    whole("trials", most, 4, MAX_CASES)


def _record(folder: Path) -> Record:
    record = read_record(folder / RECORD)
    if set(record) - {"files"} != {"targets", "settings", "rounds"}:
        raise RunFolderError(
            f"'{folder / RECORD}': was not written by 'warpcrete calibrate'; give the folder of a calibration"
        )
    check_files(folder / RECORD, record.get("files", {}))
    return record


def _continue(
    folder: Path,
    modules: Mapping[str, SceneModule],
    processes: int | None,
    scheduler: str | None,
    workers: int | None,
    progress: Progress | None,
) -> Calibration:
    begun = time.perf_counter()
    record = _record(folder)
    task = task_of(record["targets"], modules)
    calibration = Calibration(folder, task, record)
    if not record["rounds"]:
        calibration.coarsened = coarse_changes(task, modules)
    else:
        changes = record["rounds"][0].get("coarse", [])
        calibration.coarsened = {group[0].key: each for group, each in zip(task.groups, changes) if each}
    where = dict(processes=processes, scheduler=scheduler, workers=workers)
    try:
        _search(calibration, modules, where, progress or (lambda phase, fraction, figures: None))
    finally:
        calibration.took = time.perf_counter() - begun
        if calibration.posterior is not None:
            calibration.closed_forms = closed_forms(calibration.task, calibration.posterior.best, modules)
        write(calibration, modules)
    return calibration


def _search(
    calibration: Calibration, modules: Mapping[str, SceneModule], where: Mapping[str, object], tell: Progress
) -> None:
    """Run rounds of simulations, followed by verification runs of the likeliest parameters.

    The rounds end when the posterior has converged (:attr:`Calibration.settled`), or when the maximum number of trials
    is reached. `where` holds the settings `processes`, `scheduler` and `workers`, and `tell` is the progress callback.
    """
    settings, rounds = calibration.record["settings"], calibration.record["rounds"]
    most = settings["trials"]
    place = 0
    while True:
        if place == len(rounds):
            left = most - len(calibration.searched)
            if rounds and rounds[-1]["proof"] and (calibration.settled or left <= 0):
                calibration.finished = True
                return
            proposed = next_round(calibration, left, settings, modules)
            if proposed is None:
                break
            rounds.append(proposed)
            write_json(calibration.folder / RECORD, calibration.record)
        each = rounds[place]
        trials = [
            Trial(len(calibration.trials) + k, list(units), each["seeds"][k], each["proof"], "coarse" in each)
            for k, units in enumerate(each["units"])
        ]
        # Compute the progress of the whole calibration. The total is the maximum number of trials plus the number of
        # verification runs. If the search ends early, the verification runs count as the whole remaining work.
        coarse = sum(len(found["units"]) for found in rounds if "coarse" in found)
        whole = coarse + most + verification_runs(calibration, modules)
        begun = (len(calibration.trials) - len(calibration.verifying)) / whole
        last = each["proof"] and place == len(rounds) - 1
        part = (begun, 1 - begun if last else len(trials) / whole)
        if not run_round(calibration, modules, place, trials, where, tell, part):
            return
        calibration.trials += trials
        place += 1
        if "coarse" in each:
            _learn_from_coarse_trials(calibration, settings["seed"] + place)
        elif not each["proof"]:
            _update_posterior(calibration, settings["seed"] + place)
    calibration.finished = settings["repeat"] == 0


def run_round(
    calibration: Calibration,
    modules: Mapping[str, SceneModule],
    place: int,
    trials: Sequence[Trial],
    where: Mapping[str, object],
    tell: Progress,
    part: tuple[float, float],
) -> bool:
    """Run all scenes for one round of trials and store their results; return False if the user interrupted the round.

    `place` is the index of the round, `where` holds the settings `processes`, `scheduler` and `workers`, and `tell` is
    the progress callback. `part` holds two fractions of the whole calibration's work, for the progress bar: the work
    done before this round, and the work of this round. Raises :class:`WarpcreteError` if runs were lost because a
    process died or the disk was full.
    """
    for group in range(len(calibration.task.groups)):
        study = _run_group(
            calibration, modules, place, group, trials, where, _progress_within(tell, part, group, calibration.task)
        )
        if not study.finished:
            return False
        if study.lost:
            raise WarpcreteError(
                f"trial {study.lost[0]}: {study.failures[study.lost[0]]}; {len(study.lost)} of {len(study.cases)} runs "
                "were lost because a process died or the disk was full; run them again with 'warpcrete calibrate "
                f"--resume {calibration.folder}'"
            )
        _store_results(study, trials, calibration.task.groups[group])
    return True


def _progress_within(tell: Progress, part: tuple[float, float], group: int, task: Task) -> Progress:
    """Return a progress callback for the study that runs the scene of a `group` of targets in a round of a calibration.

    The callback converts the progress of this study into the progress of the whole calibration, and reports it to
    `tell`. `part` is explained in :func:`run_round`.
    """
    groups = len(task.groups)

    def report_progress(phase: str, fraction: float, figures: dict[str, float]) -> None:
        tell("running" if phase == "running" else phase, part[0] + part[1] * (group + fraction) / groups, figures)

    return report_progress


def _run_group(
    calibration: Calibration, modules: Mapping[str, Any], place: int, group: int, trials: Sequence[Trial],
    where: Mapping[str, Any], tell: Progress,
) -> Study:  # fmt: skip
    """Run one scene with all parameter sets of a round as a separate study, or continue that study if it exists.

    `place` is the index of the round, and `group` the index of the group of targets that belong to the scene. `where`
    holds the settings that decide on which devices or machines the runs take place.
    """
    target = calibration.task.groups[group][0]
    folder = calibration.folder / "rounds" / f"{place + 1:02d}-{group + 1}-{target.scene}"
    module = modules[target.scene]
    if (folder / "study.json").is_file():
        return resume_study(folder, module, progress=tell, **where)
    cases = []
    for trial in trials:
        values = calibration.task.values(trial.units)
        parameters = calibration.task.parameters(target, values, module)
        if trial.coarse:
            parameters = {**parameters, **calibration.coarsened.get(target.key, {})}
        if "seed" in module.scene.parameters.__dataclass_fields__:
            parameters = {"seed": trial.seed, **parameters}
        shown = {name: value for name, value in parameters.items() if name in values}
        cases.append(Case(f"{trial.number + 1:03d}", shown, parameters))
    settings = calibration.record["settings"]
    return run_listed(
        target.scene, module, cases, out=folder, device=settings["device"], precision=settings["precision"],
        rerun=False, usd=False, figure=False, progress=tell, **where,
    )  # fmt: skip


def _store_results(study: Study, trials: Sequence[Trial], targets: Sequence[Target]) -> None:
    """Store the results of one scene's runs in their `trials`: target values, failures and failed checks."""
    for trial, case in zip(trials, study.cases, strict=True):
        result = study.results.get(case.name)
        if result is None:
            if not all(target.held_out for target in targets):
                trial.failure = trial.failure or study.failures.get(case.name, "did not finish")
            continue
        failed = failed_checks(result)
        trial.suspect += failed
        trial.doubtful.update(targets if failed else ())
        for target in targets:
            value = found_in(result, target)
            if value is not None:
                trial.values[target] = value
            elif not target.held_out:
                trial.failure = trial.failure or f"has no {target.label} in its result"


def _results(calibration: Calibration, trials: Sequence[Trial]) -> tuple[np.ndarray, dict[Target, np.ndarray]]:
    """Return the parameters of some trials, and the values that they yielded for each target.

    The parameters, shape (n, free), are scaled to 0 to 1 over their ranges. The values of a target have the shape (n,),
    with NaN for trials that yielded none.
    """
    values = {
        target: np.array([trial.values.get(target, math.nan) for trial in trials])
        for target in calibration.task.targets
    }
    return np.array([trial.units for trial in trials]), values


def _doubtful(calibration: Calibration, trials: Sequence[Trial]) -> dict[Target, np.ndarray]:
    """Return for each target an array of shape (n,), which is True for trials whose run failed a check of its scene."""
    targets = calibration.task.targets
    return {target: np.array([target in trial.doubtful for trial in trials], dtype=bool) for target in targets}


def _learn_from_coarse_trials(calibration: Calibration, seed: int) -> None:
    """Compute the posterior of the coarse trials, which proposes the parameters of the first full trials.

    No posterior is computed if a fitted target has fewer than `MIN_VALUES` values.
    """
    points, values = _results(calibration, calibration.coarse)
    if all(np.isfinite(values[target]).sum() >= MIN_VALUES for target in calibration.task.fitted):
        calibration.coarse_posterior = posterior(calibration.task, points, values, seed, model_error=COARSE_ERROR)


def _update_posterior(calibration: Calibration, seed: int) -> None:
    """Compute the posterior of the trials so far, and record whether the search may end (`calibration.settled`).

    A posterior needs at least `MIN_VALUES` runs that yield the value of each fitted target. If there are fewer, the
    function returns without a new posterior as long as trials are left, and otherwise raises :class:`WarpcreteError`.
    If no run has yielded a value of some fitted target, it raises this error at once, unless the calibration began with
    coarse trials.
    """
    searched = calibration.searched
    points, values = _results(calibration, searched)
    for target in calibration.task.fitted:
        count = int(np.isfinite(values[target]).sum())
        failures = (trial.failure for trial in searched if trial.failure and target not in trial.values)
        why = next(failures, "the scene does not measure it there")
        if count == 0 and calibration.coarse and len(searched) < calibration.record["settings"]["trials"]:
            return
        if count == 0:
            raise WarpcreteError(
                f"the {target.label} is missing in all {len(searched)} runs; reason in the first run: "
                f"{why}; use other ranges under 'vary'"
            )
        if count < MIN_VALUES and len(searched) < calibration.record["settings"]["trials"]:
            return
        if count < MIN_VALUES:
            raise WarpcreteError(
                f"the {target.label} was found in only {count} of {len(searched)} runs; reason in the first run "
                f"without it: {why}; use other ranges under 'vary', or continue with more trials"
            )
    before = calibration.posterior
    doubtful = _doubtful(calibration, searched)
    learned: Record = {}
    if calibration.coarse:
        coarsened = [target for target in values if target.key in calibration.coarsened]
        doubts = _doubtful(calibration, calibration.coarse)
        learned["coarse"] = CoarseRuns(*_results(calibration, calibration.coarse), doubts, coarsened)
    calibration.posterior = now = posterior(calibration.task, points, values, seed, doubtful, **learned)
    emulator_error_ratio = max(now.emulator_error_ratio(target) for target in calibration.task.fitted)
    moved = math.inf
    if before is not None:
        spread = np.maximum(now.samples.std(0), 1e-3)
        moved = float(np.max(np.abs(now.samples.mean(0) - before.samples.mean(0)) / spread))
    calibration.settled = emulator_error_ratio < SETTLED_ERROR_RATIO and moved < SETTLED_SHIFT
