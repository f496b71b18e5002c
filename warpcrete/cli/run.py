"""Command `warpcrete run`: simulates a scene into a run folder and prints a report, or continues an interrupted run."""

import time
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from ..core.device.device import default_threads
from ..core.device.interrupts import StopAtSample
from ..core.errors import RunFolderError, WarpcreteError, between, one_line, positive, refuse
from ..core.inputs.by_name import trust_option
from ..core.inputs.limits import check_limit
from ..core.inputs.parameters import declared_fields
from ..core.records import Record, SceneArguments
from ..core.run.files import next_folder, read_json
from ..core.run.folder_kinds import wrong_folder
from ..core.run.method import report_of
from ..core.run.progress import ProgressBar, no_progress, rate_text
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.scene_module import SceneModule
from ..core.run.simulation_base import SimulationBase
from ..core.units import number
from ..methods import method_of
from ..record.checks import failed_checks
from ..record.loading import is_finished, repeatable_scene
from ..record.output import PIPELINE, SETTINGS, RunFolder, Simulation
from ..record.recorders import RECORDERS
from ..studies.lines.pipeline import check_pipeline, pipeline_estimate
from .exits import CHECK_FAILED, INTERRUPTED


def resume(
    folder: Path, modules: dict[str, SceneModule], accepted: set[str] | None = None, *, live: str | None, bind: str,
    quiet: bool,
) -> None:  # fmt: skip
    """Continue an interrupted run in its folder; with `live`, a viewer shows the run from the checkpoint on.

    `modules` maps the name of each scene to its Python module. `accepted` are the scenes whose runs may be continued,
    or None for all. `live`, `bind` and `quiet` are options of the command.
    """
    if not (folder / "scene.json").is_file():
        raise RunFolderError(f"resume = '{folder}': {wrong_folder(folder, 'scene.json')}")
    record, module = repeatable_scene(folder / "scene.json", modules)
    if accepted is not None and record["scene"] not in accepted:
        raise RunFolderError(
            f"resume = '{folder}': is a run of the scene {record['scene']!r}; continue it with 'warpcrete run --resume "
            f"{folder}'"
        )
    if is_finished(folder):
        raise RunFolderError(
            f"resume = '{folder}': the run is already finished; start a new run with another folder for --out"
        )
    settings = dict(record.get("command", {}))
    # A recorder that was off in the interrupted run must stay off, even if it is on by default.
    settings = {kind.name: False for kind in RECORDERS} | settings
    if set(settings) != set(SETTINGS):
        raise RunFolderError(
            f"'{folder / 'scene.json'}': belongs to a run that was not started with 'warpcrete run', so this command "
            "cannot continue it; continue the cases of a study with 'warpcrete study --resume FOLDER'"
        )
    if settings["threads"] > default_threads():
        here, there = default_threads(), settings["threads"]
        click.echo(f"note: the run began with {there} threads and continues with {here}: its results may differ in the "
                   "last digits from those of an uninterrupted run", err=True)  # fmt: skip
        settings["threads"] = default_threads()
    kept = {"device": record.get("device"), "precision": record.get("precision", "float32")}
    where = {"out": folder, "live": live, "bind": bind, "quiet": quiet}
    run(record["scene"], module, record["parameters"], settings | kept | where, going_on=True)


def run(
    name: str, module: SceneModule, parameters: SceneArguments, settings: dict[str, Any], *, going_on: bool = False
) -> None:
    """Run a scene into a new folder, or continue the run in an existing folder.

    `name` and `module` are the scene's name and Python module, and `parameters` holds the parameters that the user set.
    `settings` holds the values of the options that :func:`warpcrete.cli.options.run_options` defines, by name. If
    `going_on` is true, the folder already holds the run. An interrupted run continues from its checkpoint, or starts
    again if it has none.
    """
    begun = time.perf_counter()
    folder = settings["out"] if settings["out"] is not None else next_folder(name)
    there = (folder / "scene.json").is_file()
    frames, every = settings["frames"], settings["checkpoint_every"]
    if frames is not None:
        positive("frames", frames, "1/s")
        check_limit("frames", frames, "1/s")
    between("checkpoint_every", every, 0, float("inf"), "s")
    check_limit("checkpoint_every", every, "s")
    source = settings["pipeline_other"] and str(Path(settings["pipeline_other"]).resolve())
    out = RunFolder(
        folder,
        recordings=[kind.name for kind in RECORDERS if settings[kind.name]],
        colour=settings["colour"],
        network=settings["network"],
        live=True if settings["live"] == "spawn" else settings["live"] or False,
        bind=settings["bind"],
        pipeline={name: settings[name] for name in PIPELINE} | {"pipeline_other": source},
        resumed=going_on,
    )
    precision = settings["precision"]
    if "precision" in declared_fields(module.scene.parameters):
        parameters = parameters | {"precision": precision}
    scene = module.scene(**parameters)
    other = _pipeline_checked(scene, settings)
    progress = ProgressBar()
    simulation = Simulation(
        scene,
        device=settings["device"],
        precision=precision,
        threads=settings["threads"],
        out=out,
        recorders=[PipelineRecorder(settings["pipeline_vertical"], settings["pipeline_horizontal"], other)],
        frame_interval=None if frames is None else 1.0 / frames,
        progress=no_progress if settings["quiet"] else progress,
        checkpoint_every=every,
    )
    for line in scene.remarks:
        click.echo(f"note: {line}", err=True)
    try:
        try:
            simulation.begin()
        except KeyboardInterrupt:
            if there:
                raise RunFolderError(
                    f"resume = '{folder}': Ctrl-C ended the command before the run continued; no results were lost, so "
                    "repeat the command"
                ) from None
            click.echo("the run was interrupted before it began, so nothing is saved; repeat the command", err=True)
            raise
        with StopAtSample([simulation]):
            done = simulation.run()
    finally:
        progress.close()
    report(done, pipeline_report(done, settings), time.perf_counter() - begun)
    if not done.finished:
        raise SystemExit(INTERRUPTED)
    if failed := failed_checks(done.result):
        click.echo(
            f"FAILED: {len(failed)} of {len(done.result['checks'])} checks ({', '.join(failed)}); do not trust this run"
        )
        raise SystemExit(CHECK_FAILED)


def _pipeline_checked(scene: Any, settings: Record) -> Record | None:
    """Check the options for the pressure of a whole pipeline, and return the result of the run that they refer to.

    The option `pipeline_other` names the folder of an earlier run of a straight pipe: a vertical pipe if this run's
    pipe is horizontal, or a horizontal pipe if it is vertical. The return value is the contents of result.json in that
    folder, or None without the option.
    """
    lengths = {key: settings[key] for key in ("pipeline_vertical", "pipeline_horizontal")}
    for field, value in lengths.items():
        if value is not None:
            between(field, value, 0, float("inf"), "m")
            check_limit(field, value, "m")
    source = settings["pipeline_other"]
    if all(value is None for value in lengths.values()):
        if source is not None:
            problem = "needs the lengths of the whole pipeline"
            refuse("pipeline_other", str(source), problem, "set 'pipeline_vertical', 'pipeline_horizontal' or both")
        return None
    other = read_json(Path(source) / "result.json") if source is not None else None
    check_pipeline(scene, other, source)
    return other


class PipelineRecorder(Recorder):
    """Recorder that adds the pressure of a pipeline to the result of a finished run.

    This recorder must finish before the recorder of tables, which writes the result. The run is complete even if the
    pressure of the pipeline cannot be computed.
    """

    def __init__(self, height: float | None, distance: float | None, other: Record | None) -> None:
        self.height, self.distance, self.other = height, distance, other

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Compute the pressure of the whole pipeline from the run's pressure plateau, if the run has reached one."""
        if run.finished and (self.height is not None or self.distance is not None):
            try:
                estimate = pipeline_estimate(run, self.height or 0.0, self.distance or 0.0, self.other)
            except Exception as error:
                reason = one_line(str(error) if isinstance(error, WarpcreteError) else repr(error))
                text = f"the run is complete, but the pressure of the whole pipeline was not computed: {reason}"
                warnings.warn(text, stacklevel=2)
                return
            if estimate is not None:
                run.result["pipeline_estimate"] = estimate


def pipeline_report(run: Run, settings: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the estimated pressure of the whole pipeline for the report, as a list with one pair of label and text.

    The list is empty if no option requests this estimate.
    """
    if settings["pipeline_vertical"] is None and settings["pipeline_horizontal"] is None:
        return []
    if "pipeline_estimate" not in run.result:
        return [
            (
                "pipeline, Eq. 13",
                "not known: it needs the pressure plateau of a finished run; after a finished run, a warning says why",
            )
        ]
    estimate = run.result["pipeline_estimate"]
    total = number(estimate["total_pressure"]) / 1e6
    return [("pipeline, Eq. 13", f"{total:.2f} MPa; other direction from {estimate['other_direction_from']}")]


def report(run: Run, more: Iterable[tuple[str, str]] = (), took: float = 0.0) -> None:
    """Print the main results of a run.

    `more` holds pairs of label and text. They are printed below the results of the simulation method. `took` is the
    wall time of the whole command [s]. The time that the command spent outside the run, for example to compile
    kernels, is also printed if it is at least one second.
    """
    result = run.result

    def show(label: str, text: str) -> None:
        click.echo(f"{label:<20s} {text}")

    click.echo()
    method = method_of(run.scene)
    for label, text in (*report_of(method.quantities, run), *method.report(run), *more):
        show(label, text)
    speed = result["speed"]
    total = sum(number(speed[key]) for key in ("packing_time", "settling_time", "wall_time") if key in speed)
    rest = took - total
    extra = f", and {rest:.0f} s to compile kernels, set up and write files" if rest >= 1 else ""
    rate = f"{rate_text(number(speed['steps_per_second']))} per second while the steps run"
    show("time", f"{total:.0f} s for {result['steps']} steps on {result['provenance']['device']} ({rate}){extra}")
    for name, check in result.get("checks", {}).items():
        show("check", f"{'ok  ' if check['passed'] else 'FAIL'} {name}: {check['found']}")
    if run.ended is not None:
        show("ended", run.ended.message + ("" if run.finished else "; all results so far are saved"))
    if not run.finished and run.folder is not None and (run.folder / "checkpoint.npz").is_file():
        show("continue with", f"warpcrete {trust_option(run.scene.parameters)}run --resume {run.folder}")
    if run.folder is not None:
        show("run folder", f"{run.folder}   (warpcrete view {run.folder})")
