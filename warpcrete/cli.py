"""The `warpcrete` command."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, get_type_hints

import click

from .errors import InstabilityError, RunFolderError, WarpcreteError
from .parameters import kind_and_help


def scene_modules() -> dict[str, Any]:
    """Scene name -> module, for every file of scenes/."""
    package = importlib.import_module("warpcrete.scenes")
    names = sorted(info.name for info in pkgutil.iter_modules(package.__path__))
    return {name: importlib.import_module(f"warpcrete.scenes.{name}") for name in names}


@click.group()
@click.version_option(package_name="warpcrete")
def cli() -> None:
    """Particle simulation of fresh concrete being pumped."""


@cli.command("list")
def list_scenes() -> None:
    """Scenes, one line each."""
    for name, module in scene_modules().items():
        click.echo(f"{name:12s} {inspect.getdoc(module).splitlines()[0]}")  # type: ignore[union-attr]


class RunGroup(click.Group):
    """Sub-commands are made from the scenes' parameters, or from a saved scene.json."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(scene_modules())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name.endswith(".json"):
            return _repeat_command(Path(cmd_name))
        modules = scene_modules()
        if cmd_name in modules:
            return _scene_command(cmd_name, modules[cmd_name])
        return None

    def resolve_command(self, ctx, args):
        if args and self.get_command(ctx, args[0]) is None:
            known = ", ".join(scene_modules())
            raise click.UsageError(f"scene = {args[0]!r}: must be one of {known}, or the path of a scene.json")
        return super().resolve_command(ctx, args)


@cli.group("run", cls=RunGroup, context_settings={"max_content_width": 110})
def run_group() -> None:
    """Run a scene: `warpcrete run SCENE [options]`, or repeat one: `warpcrete run RUN/scene.json`."""


@cli.command("view")
@click.argument("run", type=click.Path(path_type=Path))
def view_run(run: Path) -> None:
    """Open the recording of a run folder in the Rerun viewer."""
    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise RunFolderError(f"'{run}': holds no run.rrd; record one with 'warpcrete run SCENE --out {run}'")
    raise SystemExit(subprocess.call([sys.executable, "-m", "rerun", str(recording)]))


def _common_options() -> list[click.Parameter]:
    return [
        click.Option(["--out"], type=click.Path(path_type=Path), help="new run folder  [default: runs/SCENE-NNN]"),
        click.Option(["--device"], help="cpu, cuda, cuda:1 ...  [default: a GPU if there is one]"),
        click.Option(["--precision"], type=click.Choice(["float32", "float64"]), default="float32", show_default=True,
                     help="of positions and forces"),
        click.Option(["--live"], is_flag=False, flag_value="spawn",
                     help="watch while it runs: opens a Rerun viewer, or give the URL of a running one"),
        click.Option(["--frames"], type=float, default=25.0, show_default=True,
                     help="recorded frames a simulated second, at most one a sample"),
        click.Option(["--colour"], type=click.Choice(["speed", "size", "force"]), default="speed", show_default=True,
                     help="what colours the aggregates"),
        click.Option(["--network"], is_flag=True, help="record contacts and bonds as lines"),
        click.Option(["--rerun/--no-rerun"], default=True, show_default=True, help="write run.rrd"),
        click.Option(["--usd/--no-usd"], default=True, show_default=True, help="write scene.usdc"),
        click.Option(["--pipeline-vertical"], type=float, help="pipeline height [m] for the total pressure (Eq. 13)"),
        click.Option(["--pipeline-horizontal"], type=float, help="horizontal pipeline length [m] for Eq. 13"),
        click.Option(["--pipeline-other"], type=click.Path(path_type=Path),
                     help="run folder of the other straight unit, for Eq. 13"),
        click.Option(["--quiet"], is_flag=True, help="no progress bar"),
    ]  # fmt: skip


COMMON = {p.name for p in _common_options()}


def _scene_command(name: str, module) -> click.Command:
    function = module.scene
    hints = get_type_hints(function, include_extras=True)
    options: list[click.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        kind, _, text = kind_and_help(hints[parameter.name])
        flag = "--" + parameter.name.replace("_", "-")
        if kind is bool:
            options.append(
                click.Option([f"{flag}/--no-{flag[2:]}"], default=parameter.default, show_default=True, help=text)
            )
        else:
            options.append(
                click.Option([flag], type=kind, default=parameter.default, help=text,
                             show_default=parameter.default is not None)
            )  # fmt: skip

    def callback(**values: Any) -> None:
        common = {key: values.pop(key) for key in COMMON}
        _run(name, module, values, **common)

    return click.Command(name, params=options + _common_options(), callback=callback, help=inspect.getdoc(function))


def _repeat_command(path: Path) -> click.Command:
    def callback(**common: Any) -> None:
        from .run_folder import read_json

        record = read_json(path)
        modules = scene_modules()
        if record.get("scene") not in modules or not isinstance(record.get("parameters"), dict):
            raise RunFolderError(f"'{path}': names no scene of this version ({', '.join(modules)})")
        module = modules[record["scene"]]
        known = inspect.signature(module.scene).parameters
        unknown = sorted(set(record["parameters"]) - set(known))
        if unknown:
            raise RunFolderError(f"'{path}': has parameters that {record['scene']} does not: {', '.join(unknown)}")
        if common["device"] is None:
            common["device"] = record.get("device")
        context = click.get_current_context()
        if context.get_parameter_source("precision") == click.core.ParameterSource.DEFAULT:
            common["precision"] = record.get("precision", common["precision"])
        _run(record["scene"], module, record["parameters"], **common)

    return click.Command(str(path), params=_common_options(), callback=callback, help="Repeat a saved run.")


def _run(name: str, module, parameters: dict[str, Any], *, out, device, precision, live, frames, colour, network, rerun,
         usd, pipeline_vertical, pipeline_horizontal, pipeline_other, quiet) -> None:  # fmt: skip
    from .errors import between, one_of, positive
    from .pipeline import pipeline_estimate
    from .progress import ProgressBar
    from .record_plot import PlotRecorder
    from .run_folder import TableRecorder, check_new, next_folder, read_json
    from .simulation import Recorder, Simulation, write_json

    folder = out if out is not None else next_folder(name)
    check_new(folder)
    positive("frames", frames, "1/s")
    for field, value in (("pipeline_vertical", pipeline_vertical), ("pipeline_horizontal", pipeline_horizontal)):
        if value is not None:
            between(field, value, 0, float("inf"), "m")
    other = read_json(pipeline_other / "result.json") if pipeline_other else None
    if other is not None and ("plateau_pressure" not in other or "concrete_length" not in other):
        raise RunFolderError(f"pipeline_other = '{pipeline_other}': is not the folder of a finished pipe run")

    scene = module.scene(**parameters)
    piped = pipeline_vertical is not None or pipeline_horizontal is not None
    if piped:
        straight = ("vertical", "horizontal")
        one_of("unit", scene.notes.get("unit"), straight)
        if other is not None:
            one_of("unit of pipeline_other", other.get("unit"), [u for u in straight if u != scene.notes["unit"]])
    recorders: list[Recorder] = [TableRecorder(folder)]
    if rerun or live:
        from .record_rerun import RerunRecorder

        target = True if live == "spawn" else (live or False)
        recorders.append(
            RerunRecorder(folder / "run.rrd" if rerun else None, live=target, colouring=colour, network=network)
        )
    if usd:
        from .record_usd import UsdRecorder

        recorders.append(UsdRecorder(folder / "scene.usdc", colouring=colour))
    recorders.append(PlotRecorder(folder / "pressure.png", scene.notes.get("paper")))

    progress = ProgressBar()
    simulation = Simulation(
        scene,
        device=device,
        precision=precision,
        recorders=recorders,
        frame_interval=1.0 / frames,
        progress=False if quiet else progress,
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
        simulation.prepare()
        signal.signal(signal.SIGINT, stop)
        run = simulation.run()
    finally:
        signal.signal(signal.SIGINT, previous)
        progress.close()
    if run.folder is not None and piped and "plateau_pressure" in run.result:
        run.result["pipeline_estimate"] = pipeline_estimate(
            run, pipeline_vertical or 0.0, pipeline_horizontal or 0.0, other
        )
        write_json(run.folder / "result.json", run.result)
    _report(run, module)
    if not run.finished:
        raise SystemExit(130)


def _report(run, module) -> None:
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
    if "pipeline_estimate" in result:
        estimate = result["pipeline_estimate"]
        show("pipeline, Eq. 13", f"{estimate['total_pressure']['value'] / 1e6:.2f} MPa; other direction from "
             f"{estimate['other_direction_from']}")  # fmt: skip
    if run.packing:
        show("packing", f"{run.packing.bodies} aggregates, solid fraction {run.packing.solid_fraction:.3f}, "
             f"{run.packing.coordination_number:.1f} neighbours each")  # fmt: skip
    speed = result["speed"]
    total = sum(speed[k]["value"] for k in ("packing_time", "settling_time", "wall_time"))
    show("time", f"{total:.0f} s for {result['steps']} steps ({speed['steps_per_second']['value']:.0f} a second) "
         f"on {result['provenance']['device']}")  # fmt: skip
    if run.finished:
        for name, (passed, found) in module.check(run).items():
            show("check", f"{'ok  ' if passed else 'FAIL'} {name}: {found}")
    else:
        show("interrupted", f"at t = {result['simulated_time']['value']:.3f} s; everything so far is written")
    if run.folder is not None:
        show("run folder", f"{run.folder}   (warpcrete view {run.folder})")


def main() -> None:
    """Entry point: every expected error is one line on stderr; bad input exits with 2, an unstable run with 1."""
    try:
        cli(standalone_mode=False)
    except click.exceptions.Exit as request:
        raise SystemExit(request.exit_code) from None
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        raise SystemExit(2) from None
    except click.UsageError as error:
        click.echo(f"error: {' '.join(error.format_message().split())}", err=True)
        raise SystemExit(2) from None
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted before the run began; nothing was written", err=True)
        raise SystemExit(130) from None
    except InstabilityError as error:
        click.echo(f"error: {error}", err=True)
        raise SystemExit(1) from None
    except WarpcreteError as error:
        click.echo(f"error: {error}", err=True)
        raise SystemExit(2) from None
    except OSError as error:
        click.echo(f"error: {error.filename or 'file system'}: {error.strerror}", err=True)
        raise SystemExit(1) from None
