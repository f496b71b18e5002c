"""The `warpcrete` command."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path
from typing import Any, get_type_hints

import click

from ..core.errors import InstabilityError, RunFolderError, WarpcreteError
from ..core.parameters import kind_and_help


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


@cli.command()
@click.option("--concrete", default="no1", show_default=True, help="no1, no2 or no3 of Xu, Li & Jiang 2021")
@click.option("--density", type=float, help="[kg/m3]; these five replace the named concrete's")
@click.option("--viscosity", type=float, help="plastic viscosity [Pa s]")
@click.option("--yield-stress", type=float, help="[Pa]")
@click.option("--slip-viscosity", type=float, help="[Pa s/m]")
@click.option("--slip-yield", type=float, help="[Pa]")
@click.option("--radius", default=0.05, show_default=True, help="of the pipe, or half the planes' distance [m]")
@click.option("--length", default=0.3, show_default=True, help="[m]")
@click.option("--slip-thickness", default=0.0, show_default=True, help="[m]")
@click.option("--rise", default=1.0, show_default=True, help="1 upright, 0 level")
@click.option("--flow", multiple=True, type=float, help="[m3/s]; may be repeated  [default: 0.0015]")
@click.option("--pressure", multiple=True, type=float, help="[Pa]; may be repeated: the flow that it drives")
def theory(concrete: str, flow: tuple[float, ...], pressure: tuple[float, ...], **values: Any) -> None:
    """Bingham flow with a slip layer: pressure from flow, flow from pressure, in pipe and channel."""
    import dataclasses

    from ..mps import theory as flows
    from ..core.errors import one_of

    one_of("concrete", concrete, flows.CONCRETES)
    names = {f.name for f in dataclasses.fields(flows.Line)}
    line = flows.Line(**{k: values.pop(k) for k in list(values) if k in names})
    given = {k: v for k, v in values.items() if v is not None}
    mix = flows.CONCRETES[concrete]
    if given:
        mix = dataclasses.replace(mix, name=f"{concrete}, changed", **given)
    click.echo(flows.table(mix, line, flow or (() if pressure else (1.5e-3,)), pressure))


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


@cli.group("run", cls=RunGroup, invoke_without_command=True, context_settings={"max_content_width": 110})
@click.option("--resume", type=click.Path(path_type=Path), help="go on with the interrupted run of this folder")
@click.option("--live", is_flag=False, flag_value="spawn", help="with --resume: watch, as for a scene")
@click.option("--quiet", is_flag=True, help="with --resume: no progress bar")
@click.pass_context
def run_group(context: click.Context, resume: Path | None, live: str | None, quiet: bool) -> None:
    """Run a scene: `warpcrete run SCENE [options]`, repeat one: `warpcrete run RUN/scene.json`, or go on with an
    interrupted one: `warpcrete run --resume RUN`."""
    if context.invoked_subcommand is not None:
        if resume is not None or live is not None or quiet:
            raise click.UsageError("--resume, --live, --quiet: before a scene they mean nothing; put them behind it")
    elif resume is None:
        click.echo(context.get_help())
        raise SystemExit(2)
    else:
        from ..cli import run as job

        job.resume(resume, scene_modules(), live=live, quiet=quiet)


@cli.command("view")
@click.argument("run", type=click.Path(path_type=Path))
def view_run(run: Path) -> None:
    """Open the recording of a run folder in the Rerun viewer."""
    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise RunFolderError(f"'{run}': holds no run.rrd; record one with 'warpcrete run SCENE --out {run}'")
    # An unfinished run lies in parts; they are one recording to the viewer.
    parts = sorted(run.glob("run-[0-9]*.rrd")) if run.is_dir() else []
    raise SystemExit(subprocess.call([sys.executable, "-m", "rerun", str(recording), *map(str, parts)]))


@cli.command("verify")
@click.option("--device", help="cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True)
@click.option("--only", default="", help="cases whose name or group contains this")
@click.option("--quick", is_flag=True, help="leave out the cases that take longer than a few seconds")
@click.option("--extremes", is_flag=True, help="also run the matrix of scenes at the edge of what makes sense")
@click.option("--out", type=click.Path(path_type=Path), help="new folder for verification.md and verification.png")
def verify(device: str | None, precision: str, only: str, quick: bool, extremes: bool, out: Path | None) -> None:
    """Compare with published and closed-form answers: one table, one figure; exits with 1 if a figure is off."""
    from ...warpcrete import verification
    from ..core.device import find_device
    from ..record.run_folder import check_new

    if out is not None:
        check_new(out)
    found = find_device(device)
    chosen = [case for case in verification.cases() if only.lower() in f"{case.group}: {case.name}".lower()]
    if not chosen:
        raise click.UsageError(f"only = {only!r}: names no case ({', '.join(c.name for c in verification.cases())})")
    if quick and all(case.slow for case in chosen):
        raise click.UsageError(f"only = {only!r}: names slow cases only; leave out --quick")
    results = []
    failed = 0
    for case, rows in verification.run_cases(chosen, str(found), precision, slow=not quick):
        results.append((case, rows))
        wrong = sum(not row.passed for row in rows)
        failed += wrong
        click.echo(
            f"{case.group + ': ' + case.name:48s} {f'{wrong} of {len(rows)} FAIL' if wrong else f'{len(rows)} ok'}"
        )
    text = f"{found.name}, {precision}\n\n{verification.summary(results)}\n{verification.table(results)}"
    if extremes:
        from ..verification import extremes as edge

        outcomes = edge.matrix(str(found), precision)
        failed += sum(not outcome.acceptable for outcome in outcomes)
        text += "\n" + edge.table(outcomes)
    click.echo("\n" + text)
    if out is not None:
        from ..verification.figure import draw

        out.mkdir(parents=True)
        (out / "verification.md").write_text(text)
        draw(results).savefig(out / "verification.png", dpi=110)
        click.echo(f"written: {out / 'verification.md'}, {out / 'verification.png'}")
    if failed:
        raise SystemExit(1)


STUDY_HELP = """A parameter study of a scene: `warpcrete study SCENE --PARAMETER VALUE VALUE ... [options]`.

Every option of `warpcrete run SCENE` that is a parameter of the scene takes one value or several; cases are all
combinations. On a GPU they run side by side as batches, on a CPU in processes, one a core. The folder holds
study.md, study.csv, study.png and a run folder for each case.

\b
  --repeat N             run every case with N seeds                                      [default: 1]
  --one-at-a-time        vary each parameter alone, the other varied ones at their defaults
  --out FOLDER           new folder                                                       [default: runs/study-NNN]
  --resume FOLDER        go on with a study: finished cases are not run again
  --device, --precision  as for run
  --processes N          at a time on a CPU                                               [default: one a core]
  --frames, --rerun, --usd, --checkpoint-every   as for run; no recordings unless asked for
  --quiet                no progress bar
"""


@cli.command("study", context_settings={"ignore_unknown_options": True}, add_help_option=False, help=STUDY_HELP)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def study_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(STUDY_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    from ..cli import study as study_job

    study_job.run(list(arguments), scene_modules())


def _common_options() -> list[click.Parameter]:
    return [
        click.Option(["--out"], type=click.Path(path_type=Path), help="new run folder  [default: runs/SCENE-NNN]"),
        click.Option(["--device"], help="cpu, cuda, cuda:1 ...  [default: a GPU if there is one]"),
        click.Option(["--precision"], type=click.Choice(["float32", "float64"]), default="float32", show_default=True,
                     help="of positions and forces"),
        click.Option(["--threads"], type=click.IntRange(1, 1024), help="of a CPU run  [default: one a core]"),
        click.Option(["--live"], is_flag=False, flag_value="spawn",
                     help="watch while it runs: opens a Rerun viewer, or give the URL of a running one"),
        click.Option(["--frames"], type=float, default=25.0, show_default=True,
                     help="recorded frames a simulated second, at most one a sample"),
        click.Option(["--colour"], type=click.Choice(["speed", "size", "force", "pressure", "phase"]), default="speed",
                     show_default=True, help="aggregates by speed, size or force, flows by speed, pressure or phase"),
        click.Option(["--network"], is_flag=True, help="record contacts and bonds as lines"),
        click.Option(["--rerun/--no-rerun"], default=True, show_default=True, help="write run.rrd"),
        click.Option(["--usd/--no-usd"], default=True, show_default=True, help="write scene.usdc"),
        click.Option(["--pipeline-vertical"], type=float, help="pipeline height [m] for the total pressure (Eq. 13)"),
        click.Option(["--pipeline-horizontal"], type=float, help="horizontal pipeline length [m] for Eq. 13"),
        click.Option(["--pipeline-other"], type=click.Path(path_type=Path),
                     help="run folder of the other straight unit, for Eq. 13"),
        click.Option(["--checkpoint-every"], type=float, default=60.0, show_default=True,
                     help="seconds of wall time between two checkpoints; 0 writes none"),
        click.Option(["--resume"], type=click.Path(path_type=Path),
                     help="go on with the interrupted run of this folder, as it began"),
        click.Option(["--quiet"], is_flag=True, help="no progress bar"),
    ]  # fmt: skip


COMMON = {p.name for p in _common_options()}


def _scene_command(name: str, module) -> click.Command:
    function = module.scene
    hints = get_type_hints(function, include_extras=True)
    options: list[click.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in COMMON:
            continue
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
        from ..cli import run as job

        common = {key: values.pop(key) for key in COMMON}
        resume = common.pop("resume")
        if resume is None:
            job.run(name, module, values, **common)
            return
        context = click.get_current_context()
        default = click.core.ParameterSource.DEFAULT
        free = ("quiet", "live")
        given = [k for k in (*values, *common) if k not in free and context.get_parameter_source(k) != default]
        if given:
            raise click.UsageError(f"resume = '{resume}': goes on as the run began; leave out {', '.join(given)}")
        job.resume(resume, scene_modules(), live=common["live"], quiet=common["quiet"])

    return click.Command(name, params=options + _common_options(), callback=callback, help=inspect.getdoc(function))


def _repeat_command(path: Path) -> click.Command:
    def callback(**common: Any) -> None:
        from ..cli import run as job

        if common.pop("resume") is not None:
            raise click.UsageError("resume = RUN: goes without a scene.json; the folder holds one")
        record, module = job.saved_scene(path, scene_modules())
        if common["device"] is None:
            common["device"] = record.get("device")
        context = click.get_current_context()
        if context.get_parameter_source("precision") == click.core.ParameterSource.DEFAULT:
            common["precision"] = record.get("precision", common["precision"])
        job.run(record["scene"], module, record["parameters"], **common)

    return click.Command(str(path), params=_common_options(), callback=callback, help="Repeat a saved run.")


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
