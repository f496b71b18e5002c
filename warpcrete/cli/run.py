"""The main job of the command line: a scene, recorders, a run folder, a report; and going on after a cut."""

from __future__ import annotations

import inspect
import signal
from pathlib import Path
from typing import Any

import click

from ..core.errors import RunFolderError, between, one_of, positive, refuse

KEPT = ("frames", "colour", "network", "rerun", "usd", "pipeline_vertical", "pipeline_horizontal", "pipeline_other",
        "checkpoint_every", "threads")  # fmt: skip


def saved_scene(path: Path, modules: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Contents of a scene.json, and the module of its scene."""
    from ..record.run_folder import read_json

    record = read_json(path)
    if record.get("scene") not in modules or not isinstance(record.get("parameters"), dict):
        raise RunFolderError(f"'{path}': names no scene of this version ({', '.join(modules)})")
    module = modules[record["scene"]]
    known = inspect.signature(module.scene).parameters
    unknown = sorted(set(record["parameters"]) - set(known))
    if unknown:
        raise RunFolderError(f"'{path}': has parameters that {record['scene']} does not: {', '.join(unknown)}")
    return record, module


def resume(folder: Path, modules: dict[str, Any], *, live: str | None, quiet: bool) -> None:
    """Go on with an interrupted run, in its folder; `live` shows it from here on."""
    from ..core.device import default_threads
    from ..record.run_folder import read_json

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
    if set(settings) != set(KEPT):
        raise RunFolderError(f"'{folder / 'scene.json'}': does not say how the run was recorded; it cannot be resumed")
    settings["threads"] = min(settings["threads"], default_threads())
    if settings["pipeline_other"] is not None:
        settings["pipeline_other"] = Path(settings["pipeline_other"])
    run(
        record["scene"], module, record["parameters"], out=folder, device=record.get("device"),
        precision=record.get("precision", "float32"), live=live, quiet=quiet, going_on=True, **settings,
    )  # fmt: skip


def run(name: str, module, parameters: dict[str, Any], *, out, device, precision, live, frames, colour, network, rerun,
        usd, pipeline_vertical, pipeline_horizontal, pipeline_other, checkpoint_every, threads, quiet,
        going_on: bool = False) -> None:  # fmt: skip
    """Run a scene into a new folder; with `going_on`, from the checkpoint of the folder that is there."""
    from ..mps.scene import FluidScene
    from ..mps.simulation import FluidSimulation
    from ..core.device import default_threads
    from ..studies.pipeline import pipeline_estimate
    from ..core.progress import ProgressBar
    from ..core.provenance import write_json
    from ..record.recorders import recorder_types
    from ..record.run_folder import TableRecorder, check_new, next_folder, read_json
    from ..dem.simulation import Simulation

    folder = out if out is not None else next_folder(name)
    if not going_on:
        check_new(folder)
    positive("frames", frames, "1/s")
    between("checkpoint_every", checkpoint_every, 0, float("inf"), "s")
    for field, value in (("pipeline_vertical", pipeline_vertical), ("pipeline_horizontal", pipeline_horizontal)):
        if value is not None:
            between(field, value, 0, float("inf"), "m")
    other = read_json(pipeline_other / "result.json") if pipeline_other else None
    if other is not None and ("plateau_pressure" not in other or "concrete_length" not in other):
        raise RunFolderError(f"pipeline_other = '{pipeline_other}': is not the folder of a finished pipe run")

    if "precision" in inspect.signature(module.scene).parameters:
        parameters = parameters | {"precision": precision}
    scene = module.scene(**parameters)
    piped = pipeline_vertical is not None or pipeline_horizontal is not None
    source = str(pipeline_other.resolve()) if pipeline_other else None
    settings = dict(zip(KEPT, (frames, colour, network, rerun, usd, pipeline_vertical, pipeline_horizontal, source,
                               checkpoint_every, threads or default_threads())))  # fmt: skip
    fluid = isinstance(scene, FluidScene)
    rerun_type, usd_type, plot_type = recorder_types(fluid)
    one_of("colour", colour, rerun_type.COLOURINGS)
    if fluid and network:
        refuse("network", network, "draws the contacts of discrete elements; a flow has none")
    if fluid and piped:
        refuse("pipeline", pipeline_vertical or pipeline_horizontal, "is Eq. 13 of discrete elements' straight units")
    if piped:
        straight = ("vertical", "horizontal")
        one_of("unit", scene.notes.get("unit"), straight)
        if other is not None:
            one_of("unit of pipeline_other", other.get("unit"), [u for u in straight if u != scene.notes["unit"]])
    recorders: list[Any] = [TableRecorder(folder, settings)]
    if rerun or live:
        target = True if live == "spawn" else (live or False)
        recorders.append(
            rerun_type(folder / "run.rrd" if rerun else None, live=target, colouring=colour, network=network)
        )
    if usd:
        recorders.append(usd_type(folder / "scene.usdc", colouring=colour))
    recorders.append(
        plot_type(folder / "flow.png", colour)
        if fluid
        else plot_type(folder / "pressure.png", scene.notes.get("paper"))
    )

    progress = ProgressBar()
    simulation = (FluidSimulation if fluid else Simulation)(
        scene,
        device=device,
        precision=precision,
        threads=threads,
        recorders=recorders,
        frame_interval=1.0 / frames,
        progress=False if quiet else progress,
        checkpoint_path=folder / "checkpoint.npz" if checkpoint_every else None,
        checkpoint_every=checkpoint_every,
    )
    for line in scene.notes.get("simplified", ()):
        click.echo(f"note: {line}", err=True)

    def stop(signum, frame) -> None:
        # The first Ctrl-C ends the run at its next sample, a second one at once; none disturbs the writing.
        if simulation.finishing:
            return
        if simulation.stop_requested:
            raise KeyboardInterrupt
        simulation.stop_requested = True

    previous = signal.getsignal(signal.SIGINT)
    try:
        if going_on:
            try:
                simulation.resume(folder / "checkpoint.npz")
            except KeyboardInterrupt:
                raise RunFolderError(
                    f"resume = '{folder}': interrupted before the run went on; nothing changed"
                ) from None
        else:
            simulation.prepare()
        signal.signal(signal.SIGINT, stop)
        finished_run = simulation.run()
    finally:
        signal.signal(signal.SIGINT, previous)
        progress.close()
    if finished_run.folder is not None and piped and "plateau_pressure" in finished_run.result:
        finished_run.result["pipeline_estimate"] = pipeline_estimate(
            finished_run, pipeline_vertical or 0.0, pipeline_horizontal or 0.0, other
        )
        write_json(finished_run.folder / "result.json", finished_run.result)
    report(finished_run, module)
    if not finished_run.finished:
        raise SystemExit(130)


def report(run, module) -> None:
    """Print the figures that people look at first."""
    result = run.result

    def show(label: str, text: str) -> None:
        click.echo(f"{label:<20s} {text}")

    click.echo()
    if "plateau_pressure" in result:
        paper = run.scene.notes.get("paper", {})

        def beside(key: str) -> str:
            return f"   (Zhan et al. 2019: {paper[key] / 1e3:.2f} kPa)" if key in paper else ""

        peak, at = result["peak_pressure"]["value"], result["peak_travel"]["value"]
        show("peak pressure", f"{peak / 1e3:.2f} kPa at {at:.3f} m of piston travel{beside('peak')}")
        show("plateau pressure", f"{result['plateau_pressure']['value'] / 1e3:.2f} kPa{beside('plateau')}")
    if "slip_velocity" in result:

        def shown(name: str, factor: float, unit: str) -> str:
            theory, error = result[f"{name}_theory"]["value"] * factor, result[f"{name}_error"]
            return (f"{result[name]['value'] * factor:.4g} {unit}   (theory, {result['theory']}: {theory:.4g}; "
                    f"{100 * error:+.2f} %)")  # fmt: skip

        show("pressure", shown("pressure", 1e-3, "kPa"))
        show("slip velocity", shown("slip_velocity", 100, "cm/s"))
        show("profile", f"rms {100 * result['profile_error']:.2f} % of the mean velocity off theory")
    if "pipeline_estimate" in result:
        estimate = result["pipeline_estimate"]
        show("pipeline, Eq. 13", f"{estimate['total_pressure']['value'] / 1e6:.2f} MPa; other direction from "
             f"{estimate['other_direction_from']}")  # fmt: skip
    if run.packing:
        show("packing", f"{run.packing.bodies} aggregates, solid fraction {run.packing.solid_fraction:.3f}, "
             f"{run.packing.coordination_number:.1f} neighbours each")  # fmt: skip
    speed = result["speed"]
    total = sum(speed[k]["value"] for k in ("packing_time", "settling_time", "wall_time") if k in speed)
    show("time", f"{total:.0f} s for {result['steps']} steps ({speed['steps_per_second']['value']:.0f} a second) "
         f"on {result['provenance']['device']}")  # fmt: skip
    if run.finished:
        for name, (passed, found) in module.check(run).items():
            show("check", f"{'ok  ' if passed else 'FAIL'} {name}: {found}")
    else:
        show("interrupted", f"at t = {result['simulated_time']['value']:.3f} s; everything so far is written")
        if (run.folder / "checkpoint.npz").is_file():
            show("go on with", f"warpcrete run --resume {run.folder}")
    if run.folder is not None:
        show("run folder", f"{run.folder}   (warpcrete view {run.folder})")
