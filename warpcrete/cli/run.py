"""`warpcrete run`: a scene, its recorders, a run folder, a report; and going on after a cut."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from ..core.device import default_threads
from ..core.errors import RunFolderError, between, positive, refuse
from ..core.files import check_new, next_folder, read_json, write_json
from ..core.interrupts import StopAtSample
from ..core.limits import check_limit
from ..core.method import report_of
from ..core.parameters import declared_fields
from ..core.progress import ProgressBar
from ..core.run_loop import Run
from ..core.units import number
from ..methods import Simulation, method_of
from ..record.checks import failed_checks
from ..record.loading import saved_scene
from ..record.recorders import RECORDERS, Look, recorders_of
from ..studies.pipeline import check_pipeline, pipeline_estimate

KEPT = ("frames", "colour", "network", *(kind.name for kind in RECORDERS), "pipeline_vertical", "pipeline_horizontal",
        "pipeline_other", "checkpoint_every", "threads")  # fmt: skip
"""Settings that scene.json keeps for a resumed run."""
CHECK_FAILED = 3
"""Exit code of a finished run that one of the scene's checks does not accept."""
INTERRUPTED = 130


def resume(folder: Path, modules: dict[str, Any], *, live: str | None, quiet: bool) -> None:
    """Go on with an interrupted run, in its folder; `live` shows it from here on."""
    if not (folder / "scene.json").is_file():
        raise RunFolderError(f"resume = '{folder}': is no run folder (it holds no scene.json)")
    record, module = saved_scene(folder / "scene.json", modules)
    if not (folder / "checkpoint.npz").is_file():
        result = folder / "result.json"
        if result.is_file() and read_json(result).get("finished"):
            raise RunFolderError(f"resume = '{folder}': that run is finished")
        raise RunFolderError(
            f"resume = '{folder}': holds no checkpoint (the run was cut before its first one, or wrote none); "
            f"start again with 'warpcrete run {folder / 'scene.json'}'"
        )
    settings = dict(record.get("command", {}))
    settings = {kind.name: False for kind in RECORDERS} | settings  # recorders that came after that run
    if set(settings) != set(KEPT):
        raise RunFolderError(
            f"'{folder / 'scene.json'}': does not say how the run was recorded; "
            "a case of a study goes on with 'warpcrete study --resume'"
        )
    if settings["threads"] > default_threads():
        here, there = default_threads(), settings["threads"]
        click.echo(f"note: the run began with {there} threads, here are {here}: it goes on, but not with the bits of "
                   "one that was never cut", err=True)  # fmt: skip
        settings["threads"] = default_threads()
    kept = {"device": record.get("device"), "precision": record.get("precision", "float32")}
    run(
        record["scene"], module, record["parameters"], settings | kept | {"out": folder, "live": live, "quiet": quiet},
        going_on=True,
    )  # fmt: skip


def run(
    name: str, module: Any, parameters: dict[str, Any], settings: dict[str, Any], *, going_on: bool = False
) -> None:
    """Run a scene into a new folder; with `going_on`, from the checkpoint of the folder that is there.

    `settings` are the values of :func:`warpcrete.cli.options.run_options` by name.
    """
    folder = settings["out"] if settings["out"] is not None else next_folder(name)
    if not going_on:
        check_new(folder)
    frames, every = settings["frames"], settings["checkpoint_every"]
    if frames is not None:
        positive("frames", frames, "1/s")
        check_limit("frames", frames, "1/s")
    between("checkpoint_every", every, 0, float("inf"), "s")
    check_limit("checkpoint_every", every, "s")
    precision = settings["precision"]
    if "precision" in declared_fields(module.scene.parameters):
        parameters = parameters | {"precision": precision}
    scene = module.scene(**parameters)
    other = _pipeline_checked(scene, settings)
    display = method_of(scene).display
    live = True if settings["live"] == "spawn" else settings["live"] or False
    look = Look(settings["colour"], settings["network"], live)
    if look.colouring is not None and look.colouring not in display.colourings:
        refuse("colour", look.colouring, f"must be one of {', '.join(display.colourings)}")
    if look.network and not display.has_network:
        refuse("network", True, f"draws lines between bodies; {display.noun} has none")
    settings = settings | {"threads": settings["threads"] or default_threads()}
    if settings["pipeline_other"] is not None:
        settings["pipeline_other"] = str(Path(settings["pipeline_other"]).resolve())
    progress = ProgressBar()
    checkpoint = folder / "checkpoint.npz"
    simulation = Simulation(
        scene,
        device=settings["device"],
        precision=precision,
        threads=settings["threads"],
        recorders=recorders_of(folder, module.check, settings, look, {key: settings[key] for key in KEPT}),
        frame_interval=None if frames is None else 1.0 / frames,
        progress=False if settings["quiet"] else progress,
        checkpoint_path=checkpoint if every else None,
        checkpoint_every=every,
    )
    for line in scene.remarks:
        click.echo(f"note: {line}", err=True)
    try:
        if going_on:
            try:
                simulation.resume(checkpoint)
            except KeyboardInterrupt:
                raise RunFolderError(
                    f"resume = '{folder}': interrupted before the run went on; nothing changed"
                ) from None
        else:
            simulation.prepare()
        with StopAtSample([simulation]):
            done = simulation.run()
            pipeline = _pipeline_report(done, settings, other)
    finally:
        progress.close()
    report(done, pipeline)
    if not done.finished:
        raise SystemExit(INTERRUPTED)
    if failed := failed_checks(done.result):
        click.echo(
            f"FAILED: {len(failed)} of {len(done.result['checks'])} checks ({', '.join(failed)}); do not trust this run"
        )
        raise SystemExit(CHECK_FAILED)


def _pipeline_checked(scene: Any, settings: dict[str, Any]) -> dict[str, Any] | None:
    """Refuse what no pipeline can be worked out from; the result.json of `pipeline_other`, if that is given."""
    lengths = {key: settings[key] for key in ("pipeline_vertical", "pipeline_horizontal")}
    for field, value in lengths.items():
        if value is not None:
            between(field, value, 0, float("inf"), "m")
            check_limit(field, value, "m")
    source = settings["pipeline_other"]
    if all(value is None for value in lengths.values()):
        if source is not None:
            refuse("pipeline_other", str(source), "means nothing without a pipeline",
                   "give pipeline_vertical, pipeline_horizontal or both")  # fmt: skip
        return None
    other = read_json(Path(source) / "result.json") if source is not None else None
    check_pipeline(scene, other, source)
    return other


def _pipeline_report(run: Run, settings: dict[str, Any], other: dict[str, Any] | None) -> list[tuple[str, str]]:
    """The pressure of the pipeline as a line of the report, also kept in the run's result."""
    height, distance = settings["pipeline_vertical"], settings["pipeline_horizontal"]
    if height is None and distance is None:
        return []
    estimate = pipeline_estimate(run, height or 0.0, distance or 0.0, other) if run.finished else None
    if estimate is None:
        return [("pipeline, Eq. 13", "none: it goes by the plateau of a finished run")]
    run.result["pipeline_estimate"] = estimate
    if run.folder is not None:
        write_json(run.folder / "result.json", run.result)
    total = number(estimate["total_pressure"]) / 1e6
    return [("pipeline, Eq. 13", f"{total:.2f} MPa; other direction from {estimate['other_direction_from']}")]


def report(run: Run, more: Iterable[tuple[str, str]] = ()) -> None:
    """Print what people look at first; `more` are labels and texts to come after what the method reports."""
    result = run.result

    def show(label: str, text: str) -> None:
        click.echo(f"{label:<20s} {text}")

    click.echo()
    method = method_of(run.scene)
    for label, text in (*report_of(method.quantities, run), *method.report(run), *more):
        show(label, text)
    speed = result["speed"]
    total = sum(number(speed[key]) for key in ("packing_time", "settling_time", "wall_time") if key in speed)
    show("time", f"{total:.0f} s for {result['steps']} steps ({number(speed['steps_per_second']):.0f} a second) "
         f"on {result['provenance']['device']}")  # fmt: skip
    for name, check in result.get("checks", {}).items():
        show("check", f"{'ok  ' if check['passed'] else 'FAIL'} {name}: {check['found']}")
    if not run.finished:
        show("interrupted", f"at t = {number(result['simulated_time']):.3f} s; everything so far is written")
        if run.folder is not None and (run.folder / "checkpoint.npz").is_file():
            show("go on with", f"warpcrete run --resume {run.folder}")
    if run.folder is not None:
        show("run folder", f"{run.folder}   (warpcrete view {run.folder})")
