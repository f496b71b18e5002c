"""Trade-off studies: measure how the knobs of a scene change its wall time and its errors, within a time budget.

A knob is a parameter that trades accuracy for speed, such as the resolution. A study has four phases:

1. Run the user's scene, and then with one knob changed at a time.
2. Run the scene with all knobs as fine as the budget allows. This run is the reference, unless a closed form is known.
3. For each of several error limits from 20 % down to 1 %, run the combination of knobs that is expected to be the
   cheapest one within this limit.
4. Test the cheapest settings with new random seeds and in variants of the scene.

Every run has its own folder, so a resumed study reuses it. Runs that share a processor would falsify each other's wall
times, so only one run at a time takes place on this machine. With a Dask scheduler, the runs take place on its workers,
one at a time on each. A worker is a process on this or another machine, with its own GPU or CPU cores.
"""

import importlib
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from ...core.device.device import default_threads, find_device
from ...core.errors import RunFolderError, at_least, between, callback, positive, refuse, suggested, whole
from ...core.inputs.amounts import amount
from ...core.inputs.by_name import names_from_file
from ...core.inputs.hyphens import spelled
from ...core.inputs.limits import check_limit
from ...core.inputs.origin import check_files, check_named
from ...core.inputs.scene_functions import SceneFunction
from ...core.records import Record
from ...core.run.files import check_new, output_folder, read_json, read_record, write_json
from ...core.run.folders import locked_folder, new_folder
from ...core.run.progress import Progress
from ...core.run.provenance import provenance, versions
from ...core.run.scene_module import SceneModule
from ...methods import Simulation, method_of
from ..api import check_settings, module_of
from ..cases import MAX_CASES, is_random
from ..cluster import Cluster, check_scheduler, open_cluster, unnumbered
from .fronts import Error, cheapest_within, worst
from .points import COMBINED, GIVEN, REFERENCE, WANTED_ERRORS, Promise, Setting
from .report import write
from .state import Trade

SETTINGS = ("budget", "quantities", "knobs", "repeat", "device", "threads", "scheduler", "workers", "progress")
FRESH_SEEDS = 3
"""Number of new random seeds with which a promised error bound is tested. None of them was used to compute the
bound."""
SINGLE_KNOBS_UNTIL, FINEST_UNTIL, COMBINED_UNTIL = 0.55, 0.8, 0.9
"""Fractions of the budget at which three phases of a study end: runs with a single changed knob, runs with the finest
setting, and runs with several changed knobs."""


def trade(scene: SceneFunction, *, out: Path | str | None = None, **given: object) -> Trade:
    """Measure how the accuracy settings of a scene change its run time and its errors.

    `scene` is a scene function, such as ``warpcrete.scenes.pipe``. The arguments `budget` [s], `quantities`, `knobs`,
    `repeat`, `device`, `threads`, `scheduler`, `workers` and `progress`, and the errors raised, are explained in
    :func:`run_trade`. All other keywords are parameters of the scene. `out` is the new folder (default:
    runs/trade-NNN).
    """
    name, module = module_of(scene)
    settings = {key: given.pop(key) for key in SETTINGS if key in given}
    check_settings(scene, given, (*SETTINGS, "out"))
    return run_trade(name, module, base=given, out=output_folder(out, "trade"), **settings)


def run_trade(
    scene_name: str,
    module: SceneModule,
    *,
    base: Mapping[str, object] | None = None,
    out: Path,
    budget: float | str = 1200.0,
    quantities: Sequence[str] | None = None,
    knobs: Sequence[str] | None = None,
    repeat: int | None = None,
    device: str | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Trade:
    """Measure how the accuracy settings of the scene `module.scene` change its run time and its errors.

    `base` holds the parameters of the scene. Results go to the new folder `out`. `budget` is the wall time [s].
    `quantities` names the result quantities whose errors are measured. `knobs` names the parameters that are varied
    because they trade accuracy for run time (default: all that the scene has). `repeat` is the number of seeds of each
    setting (default 3, or 1 if nothing is random).

    With a `scheduler`, runs are distributed over the `workers` of :func:`warpcrete.studies.cluster.open_cluster`. Each
    worker runs one simulation at a time, and no other worker uses its GPU or its `threads` cores (default 1). The
    budget is wall time, whatever the number of workers, so more workers measure more settings. Raises
    :class:`SceneError` before anything is written if the settings are impossible, and after the first run if the budget
    is too short for a second run.
    """
    check_scheduler(scheduler, workers)
    trading = getattr(module, "trading", None)
    if trading is None:
        hint = "use a scene that has such settings, or define the variable 'trading' in the scene's file"
        refuse("scene", scene_name, "has no settings that a trade-off study could vary", hint)
    scene = module.scene(**(base or {}))
    check_named(scene)
    given = module.scene.declared(base or {})
    parameters = module.scene.plain(scene, base or {})
    known = {each.name: each for each in method_of(scene).quantities}
    for field, names in (("quantities", quantities), ("knobs", knobs)):
        if names is not None and (isinstance(names, str) or not isinstance(names, Iterable)):
            refuse(field, names, "must be a list of names, or None", f"for example [{names!r}]")
    callback("progress", progress)
    chosen = list(quantities or trading.quantities)
    for name in chosen:
        if name not in known:
            refuse("quantity", name, f"must be one of {', '.join(known)}", suggested(name, known))
        if trading.closed_form(given) and f"{name}_error" not in known:
            problem = "has no exact solution for comparison"
            refuse("quantity", name, problem, f"use {' or '.join(n for n in known if f'{n}_error' in known)}")
    all_knobs = [knob.name for knob in trading.knobs(given) if len(knob.levels) > 1]
    knobs = [spelled(name, all_knobs) for name in knobs or ()]
    for name in knobs:
        if name not in all_knobs:
            refuse("knob", name, f"must be one of {', '.join(all_knobs)}", suggested(name, all_knobs))
    seeded = is_random(scene)
    if repeat is not None:
        whole("repeat", repeat, 1, MAX_CASES)
    if repeat is not None and repeat > 1 and not seeded:
        refuse("repeat", repeat, "must be 1, because nothing in this scene is random", "leave out 'repeat'")
    if repeat is not None and repeat < (2 if seeded else 1):
        refuse("repeat", repeat, "must be at least 2, to measure the scatter between seeds" if seeded else "must be 1")
    budget = amount("budget", budget, "s") if isinstance(budget, str) else budget
    positive("budget", budget, "s")
    check_limit("budget", budget, "s")
    threads = 1 if threads is None and scheduler else threads
    _check_cores(scheduler, workers, device, threads)
    check_new(out)
    with open_cluster(scheduler, workers, device, threads or 1) as cluster:
        if cluster is None:
            found, made_by = _machine(module, parameters, device, threads)
        else:
            cluster.hardware(device)
            found, made_by = cluster.ask(_machine_of, module.__name__, parameters, cluster.device(device), threads)
        with new_folder(out):
            record = {
                "scene": scene_name,
                "parameters": parameters,
                "files": scene.parameters.files,
                "quantities": chosen,
                "knobs": list(knobs or all_knobs),
                "repeat": (repeat or 3) if seeded else 1,
                "seeded": seeded,
                "device": found,
                "threads": threads or default_threads(),
                "provenance": made_by,
            }
            write_json(out / "trade.json", record)
            return _continue(Trade(out, module, read_json(out / "trade.json")), budget, cluster, progress)


def _machine(
    module: SceneModule, parameters: Mapping[str, object], device: str | None, threads: int | None
) -> tuple[str, Record]:
    """Return the device on which a scene runs, and the provenance to be recorded with its results.

    Raises an error if the scene cannot run on the requested device.
    """
    scene = module.scene(**parameters)
    found = Simulation(scene, device=device, precision=scene.precision, threads=threads).device
    return str(found), provenance(found, scene.precision, int(getattr(scene, "seed", 0)))


def _machine_of(module_name: str, *arguments: object) -> tuple[str, Record]:
    return _machine(importlib.import_module(module_name), *arguments)


def _check_cores(scheduler: str | None, workers: int | None, device: str | None, threads: int | None) -> None:
    """Refuse workers that would share CPU cores, because the wall times of their runs would be meaningless."""
    cores = default_threads()
    between("threads", 1 if threads is None else threads, 1, float("inf"))
    if scheduler == "local" and workers and workers * (threads or 1) > cores and not find_device(device).is_cuda:
        hint = "use fewer workers or threads, because runs that share cores give wrong times"
        problem = f"workers with {threads} threads each need more than the {cores} cores of this machine"
        refuse("workers", workers, problem, hint)


def resume_trade(
    folder: Path,
    module: SceneModule,
    *,
    budget: float | str = 1200.0,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Trade:
    """Continue a trade-off study for another `budget` of wall time [s], reusing the finished runs.

    The study may continue with another `scheduler`, or without one, on the same kind of GPU or CPU. Raises
    :class:`RunFolderError` if `folder` holds no trade-off study, or one of another version or processor.
    """
    check_scheduler(scheduler, workers)
    record = read_record(folder / "trade.json")
    # Check that the study's files have not changed before the scene is created, because creating the scene may import
    # one of these files as a Python module and run its code.
    check_files(folder / "trade.json", record.get("files", {}))
    try:
        with names_from_file():
            trade = Trade(folder, module, record)
        version = record["provenance"]["warpcrete"]
        if not trade.quantities:
            raise KeyError("quantities")
    except (KeyError, TypeError) as error:
        raise RunFolderError(
            f"'{folder / 'trade.json'}': is not the record of a trade-off study ({type(error).__name__}: "
            f"{error}); give a folder made by 'warpcrete trade'"
        ) from error
    now = versions()["warpcrete"]
    if version != now:
        raise RunFolderError(
            f"'{folder}': was measured with version {version} of warpcrete, but this is version {now}, so wall times "
            "cannot be compared; start a new trade-off study"
        )
    positive("budget", budget, "s")
    check_limit("budget", budget, "s")
    if scheduler is None:
        find_device(trade.device)
    # Let the workers use all GPUs that are present. The GPU number in the record is ignored, because it may belong to
    # another machine.
    device = unnumbered(trade.device)
    _check_cores(scheduler, workers, device, trade.threads)
    with locked_folder(folder, "trade.json"), open_cluster(scheduler, workers, device, trade.threads) as cluster:
        if cluster is not None and (here := cluster.hardware(device)) != trade.hardware:
            raise RunFolderError(
                f"'{folder}': contains wall times of {trade.hardware}, but the workers have {here}, so wall times "
                "cannot be compared; use the same hardware, or start a new trade-off study"
            )
        return _continue(trade, budget, cluster, progress)


def _continue(trade: Trade, budget: float, cluster: Cluster | None, progress: Progress | None) -> Trade:
    trade.budget, trade.cluster = budget, cluster
    _measure(trade, progress or (lambda phase, fraction, figures: None))
    trade.cluster = None
    return trade


def _measure(trade: Trade, tell: Progress) -> None:
    """Run all phases that the budget allows; write the tables and the figure even after an error or an interruption."""
    given = trade.point(GIVEN, {})
    try:
        with trade.gap:
            _phases(trade, given, tell)
    except KeyboardInterrupt:
        trade.interrupted = True
    finally:
        trade.judge()
        write(trade)


def _phases(trade: Trade, given: Setting, tell: Progress) -> None:
    if not trade.run(given, trade.seeds[:1], tell):
        if given.failure:
            problem = f"fails with the given parameters: {given.failure}"
            refuse("scene", trade.scene_name, problem, "change the parameters, and start a new trade-off study")
        return
    needed = trade.rounds(2 * len(trade.seeds)) * given.cost
    # Refuse a short budget only if this call has made a run (`spent` is above 0). Otherwise, the study is resumed, and
    # a few further runs may complete it.
    if trade.spent > 0 and needed > trade.budget:
        problem = "is too short for two runs" + " for every seed" * trade.has_seeds
        hint = f"one run takes {given.cost:.3g} s; give {at_least(5 * needed, 2)} s or more"
        refuse("budget", f"{trade.budget:.3g} s", problem, hint)
    missing = [each.name for each in trade.quantities if not given.values(each.name, trade.seeds)]
    if missing:
        problem = "is missing in the result of the scene with the given parameters"
        refuse("quantity", missing[0], problem, "choose another quantity, or change the parameters")
    if not trade.run(given, trade.seeds, tell):
        return
    _one_at_a_time(trade, tell)
    if not trade.exact:
        _run_reference(trade, tell)
    trade.judge()
    _run_combinations(trade, tell)
    trade.judge()
    _find_promises(trade, tell)


def promises_from_runs(trade: Trade, settings: Sequence[Setting]) -> None:
    """Compute the errors of `settings` from existing runs, and find the cheapest one for each error limit.

    No new runs are made. The error limits are those of `WANTED_ERRORS`.
    """

    def tell(phase: str, fraction: float, figures: Mapping[str, object]) -> None:
        pass

    trade.interrupted = True  # An interrupted study reads existing runs, but starts no new ones.
    trade.run_all(settings, trade.seeds, tell)
    trade.points = [point for point in trade.points if point.results or point.failures]
    trade.judge()
    _find_promises(trade, tell)


def _one_at_a_time(trade: Trade, tell: Progress) -> None:
    """Change one accuracy parameter at a time, and run the scene with each of its possible values.

    Settings with a low expected cost run first.
    """
    alone = [trade.point(knob.name, {knob.name: k}) for knob in trade.knobs for k in range(len(knob.levels))]
    trade.run_all(sorted(alone, key=trade.expected), trade.seeds, tell, SINGLE_KNOBS_UNTIL)


def _run_reference(trade: Trade, tell: Progress) -> None:
    """Run the reference setting: every knob at its finest level, or as fine as the budget allows.

    A knob is a parameter that trades accuracy for run time, and its levels are its possible values. As long as the run
    would exceed the budget, one knob is set to its next coarser level: the knob whose coarser level saves most time for
    the error that it adds. No knob becomes coarser than in the user's scene.
    """
    levels = {}
    for knob in trade.chosen_knobs:
        first = trade.level_as_given(knob)
        usable = [k for k in range(first, len(knob.levels)) if math.isfinite(trade.shift(knob, k))]
        if usable:
            levels[knob.name] = usable
    by_name = {knob.name: knob for knob in trade.knobs}
    while True:
        top = {name: usable[-1] for name, usable in levels.items()}
        cost = trade.given.cost * math.prod(trade.ratio(by_name[name], k) for name, k in top.items())
        if cost * trade.rounds(len(trade.seeds)) <= max(FINEST_UNTIL * trade.budget - trade.spent, 0.0):
            break
        # An earlier call had a larger budget and already ran this setting. Use it as the reference again.
        if top == trade.record.get("finest"):
            break
        # The reference would exceed its budget, so one knob must take its next coarser level. Choose the knob that
        # saves the most time for its error: the largest ln(t_present / t_coarser) / error, with the run times t and the
        # error of the coarser level. The logarithm is used because the savings of several knobs multiply.
        saved = {}
        for name, usable in levels.items():
            if len(usable) > 1:
                ratio = trade.ratio(by_name[name], usable[-1]) / trade.ratio(by_name[name], usable[-2])
                if ratio > 1.0:
                    saved[name] = math.log(ratio) / (trade.shift(by_name[name], usable[-2]) + 1e-4)
        if not saved:
            break
        levels[max(saved, key=lambda name: saved[name])].pop()
    before = len(trade.points)
    point = trade.point(REFERENCE, top)
    if trade.run(point, trade.seeds, tell, COMBINED_UNTIL):
        trade.record = {**trade.record, "finest": top}
    else:  # The finest setting did not run to its end. The user's scene becomes the reference instead.
        del trade.points[before:]
        point = trade.given
    point.origin = REFERENCE


def _run_combinations(trade: Trade, tell: Progress) -> None:
    """Run, for each error limit, the combination of accuracy parameters that is expected to be the cheapest one.

    The expected error and time of a combination follow from runs in which a single parameter was changed. The errors
    that its changed parameters caused in such runs are added up. The error limits are those of `WANTED_ERRORS`.
    """
    choices = {
        knob.name: [(trade.ratio(knob, k), trade.shift(knob, k)) for k in range(len(knob.levels))]
        for knob in trade.chosen_knobs
        if any(math.isfinite(trade.shift(knob, k)) for k in range(len(knob.levels)))
    }
    wanted = [cheapest_within(choices, target) for target in WANTED_ERRORS]
    points = [trade.point(COMBINED, levels) for levels in wanted if levels is not None]
    trade.run_all(sorted(points, key=trade.expected), trade.seeds, tell, COMBINED_UNTIL)


def _find_promises(trade: Trade, tell: Progress) -> None:
    """Find and test, for each error limit, the cheapest setting whose error bound is within the limit.

    The error limits are those of `WANTED_ERRORS`. A setting is tested in runs with new random seeds and in runs of
    variants of the scene. It is rejected, and the next cheapest setting is tested, in three cases:

    - A run with new seeds fails, or fails a check.
    - The error in a variant, or the bound that follows from all variants, exceeds the limit.
    - The scene has variants, but the setting could not be tested in any of them.

    The error in the runs with new seeds is reported, but not compared with the limit.
    """
    # Run variants only if a closed form gives the expected values, or if nothing is random. Otherwise, each variant
    # would need reference runs with several seeds, which takes too long.
    compared = trade.exact or (trade.reference is not None and not trade.has_seeds)
    variants = trade.module.trading.variants(trade.declared) if compared else {}
    chosen = {knob.name for knob in trade.chosen_knobs}
    fresh = [trade.seeds[-1] + 1 + k for k in range(FRESH_SEEDS)] if trade.has_seeds else []
    for target in WANTED_ERRORS:
        within = [
            p
            for p in trade.measured
            if p.timed and trade.promised(p) <= target and not p.suspect and chosen.issuperset(p.levels)
        ]
        promise = Promise(target, None)
        for point in sorted(within, key=lambda p: p.cost):
            tried = bool(fresh) and trade.run(point, fresh, tell)
            if point.failure or point.suspect:
                continue
            carried, bound = _test_variants(trade, point, variants, target, tell)
            if bound <= target and (any(carried.values()) or not variants):
                found = worst(trade.errors_of(point, fresh)) if tried else None
                promise = Promise(target, point, found, carried, bound)
                break
        trade.promises.append(promise)


def _test_variants(
    trade: Trade, point: Setting, variants: Mapping[str, Mapping[str, object]], target: float, tell: Progress
) -> tuple[dict[str, Error | None], float]:
    """Return a setting's largest error in each variant of the scene, and an upper bound of its error in other scenes.

    The test ends at the first variant in which the error exceeds `target`. If there are several workers, they run
    several variants at the same time.
    """
    found: dict[str, Error | None] = {}
    points: list[Setting] = []
    bound = trade.promised(point)
    others = [trade.carried(point, variant, changes) for variant, changes in variants.items()]
    finest = (
        []
        if trade.exact or trade.reference is None
        else [trade.carried(trade.reference, variant, changes) for variant, changes in variants.items()]
    )
    for number, (variant, other) in enumerate(zip(variants, others)):
        needed = [other, *finest[number : number + 1]]
        if not all(trade.complete(each, trade.seeds) for each in needed):
            here = slice(number, number + trade.abreast)
            trade.run_all([*finest[here], *others[here]], trade.seeds, tell)
        if any(not each.results and not each.failure.startswith("failed") for each in needed):
            continue  # The study had no time left to run this variant of the scene.
        if any(each.failure for each in finest[number : number + 1]):
            continue  # The reference run of this variant of the scene failed, so the error in the variant is unknown.
        error = worst(trade.errors_of(other, trade.seeds)) if other.results else None
        found[variant if not other.suspect else f"{variant} (fails: {', '.join(other.suspect)})"] = error
        if error is not None:
            points.append(other)
            if error.size > target:
                return found, error.size
    return found, max(bound, trade.bound_in_variants(point, points) if points else 0.0)
