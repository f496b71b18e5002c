"""The `warpcrete` command: its subcommands and options, which call functions in the other modules of this package."""

from __future__ import annotations

import importlib
import inspect
import os
import signal
import threading
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import click

from ..core.errors import DiskFullError, InstabilityError, WarpcreteError, one_line, warn_in_one_line
from .console import prepare_streams
from .texts import MIX_HELP

LAST_WORDS = 3.0
"""Time that a command has to end after it has reported a full disk [s]."""

# Warp takes half a second to load, and so do scenes. Each subcommand therefore loads its modules when it is called.


def _part(name: str) -> ModuleType:
    return importlib.import_module(f"{__package__}.{name}")


def _scenes() -> dict[str, ModuleType]:
    return importlib.import_module("warpcrete.scenes").modules()


@click.group()
@click.version_option(package_name="warpcrete")
@click.option("--trust", is_flag=True, help="import contact laws of your own that records and files name")
def cli(trust: bool) -> None:
    """Particle simulation of fresh concrete being pumped."""
    if trust:
        trusted = importlib.import_module("warpcrete.core.inputs.by_name").trusted_files()
        click.get_current_context().with_resource(trusted)


@cli.command("list")
def list_scenes() -> None:
    """List the scenes, one line each."""
    for name, module in _scenes().items():
        click.echo(f"{name:12s} {(inspect.getdoc(module) or '').partition(chr(10))[0]}")


def _by_method(arguments: list[str]) -> list[str]:
    """Remove `--method NAME` from a command's words and complete the scene's name with it.

    For example, `slump --method dem` becomes `slump-dem`.
    """
    left, method = [], None
    words = iter(arguments)
    for word in words:
        name, given, value = word.partition("=")
        if name != "--method":
            left.append(word)
        elif method is not None or not (value := value if given else next(words, "")):
            raise click.UsageError("--method: takes one value")
        else:
            method = value
    if method is None:
        return left
    place = next((n for n, word in enumerate(left) if not word.startswith("-")), None)
    if place is None:
        raise click.UsageError("--method: belongs to a scene, as in 'slump --method dem'")
    left[place] = importlib.import_module("warpcrete.scenes").by_method(left[place], method)
    return left


class LazyGroup(click.Group):
    """Group of subcommands whose options are built only when a subcommand is used."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, _by_method(args))

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_scenes())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name.endswith(".json"):
            return _repeat_command(Path(cmd_name))
        modules = _scenes()
        return _scene_command(cmd_name, modules[cmd_name]) if cmd_name in modules else None

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and self.get_command(ctx, args[0]) is None:
            _part("options").check_scene(args[0], _scenes(), ", or the path of a scene.json")
        return super().resolve_command(ctx, args)


@cli.group("run", cls=LazyGroup, invoke_without_command=True, context_settings={"max_content_width": 110})
@click.option("--resume", type=click.Path(path_type=Path), help="go on with the interrupted run of this folder")
@click.option("--live", is_flag=False, flag_value="spawn", help="with --resume: watch, as for a scene")
@click.option("--bind", default="127.0.0.1", help="with --live: as for a scene")
@click.option("--quiet", is_flag=True, help="with --resume: no progress bar")
@click.pass_context
def run_group(context: click.Context, resume: Path | None, live: str | None, bind: str, quiet: bool) -> None:
    """Run a scene, repeat a saved run, or continue an interrupted one.

    Run a scene with `warpcrete run SCENE [options]`; `slump --method dem` is `slump-dem`. Repeat a run with `warpcrete
    run RUN/scene.json`. Continue an interrupted run with `warpcrete run --resume RUN`.

    The exit code is 0 if the run is finished and passes its checks, 1 if it became unstable, 2 for bad input, 3 if a
    check failed, and 130 if it was interrupted.
    """
    if context.invoked_subcommand is not None:
        if resume is not None or live is not None or quiet:
            raise click.UsageError("--resume, --live, --quiet: before a scene they mean nothing; put them behind it")
    elif resume is None:
        click.echo(context.get_help())
        raise SystemExit(2)
    else:
        _part("run").resume(resume, _scenes(), live=live, bind=bind, quiet=quiet)


def _scene_command(name: str, module: ModuleType) -> click.Command:
    options = _part("options")
    fields = importlib.import_module("warpcrete.core.inputs.parameters").declared_fields(module.scene.parameters)
    common = {option.name for option in options.run_options()}

    def callback(**values: Any) -> None:
        given = options.given(values)
        settings = {key: values.pop(key) for key in common}
        resume = settings.pop("resume")
        accuracy, trade = settings.pop("accuracy"), settings.pop("trade")
        job = _part("run")
        if resume is None:
            parameters = {key: value for key, value in given.items() if key not in common}
            if accuracy is not None or trade is not None:
                asked = parameters | {key: given[key] for key in ("precision",) if key in given}
                changes = _part("advice").chosen(name, module, asked, accuracy, trade, settings["device"])
                if "precision" not in given:
                    settings["precision"] = changes.pop("precision", settings["precision"])
                parameters = module.scene.meaningful(module.scene.resolved(parameters) | changes)
            job.run(name, module, parameters, settings)
            return
        changed = [key for key in given if key not in ("resume", "quiet", "live", "bind")]
        if changed:
            raise click.UsageError(f"resume = '{resume}': goes on as the run began; leave out {', '.join(changed)}")
        job.resume(resume, _scenes(), live=settings["live"], bind=settings["bind"], quiet=settings["quiet"])

    own = options.parameter_options(field for key, field in fields.items() if key not in common)
    return options.SceneCommand(
        name, module.scene, params=own + options.run_options(), callback=callback, help=module.scene.description
    )


def _repeat_command(path: Path) -> click.Command:
    options = _part("options")

    def callback(**settings: Any) -> None:
        job = _part("run")
        if settings.pop("resume") is not None:
            raise click.UsageError("resume = RUN: goes without a scene.json; the folder holds one")
        if [settings.pop("accuracy"), settings.pop("trade")] != [None, None]:
            raise click.UsageError("--accuracy, --trade: mean nothing beside a scene.json, which says all settings")
        record, module = job.repeatable_scene(path, _scenes())
        kept = {key: record[key] for key in ("device", "precision") if key in record}
        if "threads" in record.get("command", {}):
            kept["threads"] = min(record["command"]["threads"], os.cpu_count() or 1)
        job.run(record["scene"], module, record["parameters"], settings | kept | options.given(settings))

    return click.Command(str(path), params=options.run_options(), callback=callback, help="Repeat a saved run.")


class TheoryCommand(click.Command):
    """Command that has an option for each parameter of the scene functions of flows."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        return [*_part("options").parameter_options(_part("theory").fields().values()), *super().get_params(ctx)]


@cli.command("theory", cls=TheoryCommand)
@click.option("--flow", multiple=True, help="[m3/s], or as '35 m3/h'; may be repeated  [default: 0.0015]")
@click.option("--pressure", multiple=True, help="[Pa], or as '50 bar'; may be repeated: the flow that it drives")
@click.option("--fit", type=click.Path(path_type=Path), help="CSV of flows and pressures that were measured in this "
              "pipe, with a first line as 'flow [m3/h],pressure [bar]': the slip layer that they ask for")  # fmt: skip
@click.option("--rest", help="that the concrete has stood [s], or as '10 min': what a restart then takes")
@click.option("--thixotropy", help="A_thix, by which yield stresses grow at rest [Pa/s]  [default: 0.5]")
@click.option("--segregation", multiple=True, help="aggregate in the outer half of the radius less that in "
              "the inner half, over its mean share: what it does to a pipe's pressure; may be repeated")  # fmt: skip
@click.option("--aggregate", help="its share of the volume, for --segregation  [default: a mix's own]")
@click.pass_context
def theory(
    context: click.Context, flow: tuple[str, ...], pressure: tuple[str, ...], fit: Path | None,
    rest: str | None, thixotropy: str | None, segregation: tuple[str, ...], aggregate: str | None,
    **values: Any,
) -> None:  # fmt: skip
    """Compute the flow of a Bingham fluid with a slip layer in a pipe and a channel.

    The pressure follows from a flow, or the flow from a pressure.
    """
    job = _part("theory")
    one, several = job.option_amount, job.option_amounts
    job.run(
        _part("options").given(values, context),
        several("flow", flow, "m3/s"),
        several("pressure", pressure, "Pa"),
        fit,
        one("rest", rest, "s"),
        one("thixotropy", thixotropy, "Pa/s"),
        several("segregation", segregation, "1"),
        one("aggregate", aggregate, "m3/m3"),
    )


@cli.command("view")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--web", is_flag=True, help="in a browser, at the address that is printed, until Ctrl-C")
@click.option("--bind", default="127.0.0.1", show_default=True, help="IP address to listen on: that of this machine "
              "alone, or 0.0.0.0 for everybody who can reach it")  # fmt: skip
def view_run(run: Path, web: bool, bind: str) -> None:
    """Open the recording of a run folder in the Rerun viewer."""
    from ..core.run.run import viewer

    opened = viewer(run, web, bind)
    process = opened.start()
    if web:
        click.echo(opened.address)
    raise SystemExit(process.wait())


@cli.command("verify")
@click.option("--device", help="cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True)
@click.option("--only", default="", help="cases whose name or group contains this")
@click.option("--quick", is_flag=True, help="leave out the cases that take longer than a few seconds")
@click.option("--extremes", is_flag=True, help="also run the matrix of scenes at the edge of what makes sense")
@click.option("--out", type=click.Path(path_type=Path), help="new folder for verification.md and verification.png")
def verify(**settings: Any) -> None:
    """Compare results with published and closed-form answers, in one table and one figure.

    The exit code is 1 if a result is wrong.
    """
    _part("verify").run(**settings)


ON_WORKERS = """\
  --scheduler WHICH      run on workers of Dask (pip install 'warpcrete[cluster]'): 'local' starts one a GPU or a core,
                         'slurm' submits jobs as Dask's configuration has them, else a scheduler's address
  --workers N            that a scheduler is to start
"""

STUDY_HELP = f"""A parameter study of a scene: `warpcrete study SCENE --PARAMETER VALUE VALUE ... [options]`.

Every option of `warpcrete run SCENE` that is a parameter of the scene takes one value or several; cases are all
combinations. On a GPU those of discrete elements run side by side as batches and flows in turn, on a CPU all run in
processes, one a core. The folder holds study.md, study.csv, study.png and a run folder for each case.

\b
  --repeat N             run every case with N seeds                                      [default: 1]
  --one-at-a-time        vary each parameter alone, the other varied ones at their defaults
  --out FOLDER           new folder                                                       [default: runs/study-NNN]
  --resume FOLDER        go on with a study: finished cases are not run again
  --device, --precision  as for run
  --processes N          at a time on a CPU                                               [default: one a core]
{ON_WORKERS}  --frames, --checkpoint-every, and recorders   as for run; no recordings unless asked for, as with --rerun
  --quiet                no progress bar

Exits with 1 if a case failed, with 3 if every case ended but a check of one failed, with 130 if it was interrupted.
"""


@cli.command("study", context_settings={"ignore_unknown_options": True}, add_help_option=False, help=STUDY_HELP)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def study_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(STUDY_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("study").run(_by_method(list(arguments)), _scenes())


TRADE_HELP = f"""Speed against accuracy of a scene, measured: `warpcrete trade SCENE [--PARAMETER VALUE ...] [options]`.

Turns what costs accuracy in the scene (time step, precision, sizes, walls, spacing, ...), each alone, then together,
and finds the cheapest settings for errors of 20 to 1 %, which it tries with fresh seeds. Runs are made one at a time,
or one on each worker. The folder holds trade.md, trade.csv, trade.json, trade.png and a run folder for each run.

\b
  --budget TIME          wall time, however many workers, as 90s, 20min or 2h             [default: 20min]
  --quantity NAME ...    of result.json, whose errors count                               [default: the scene's]
  --knob NAME ...        only these, as 'time step'                                       [default: all of the scene]
  --repeat N             seeds of each setting                                            [default: 3]
  --out FOLDER           new folder                                                       [default: runs/trade-NNN]
  --resume FOLDER        go on with a trade for another --budget: runs that are there are used
  --device, --threads    as for run; on workers the threads of each                        [default there: 1]
{ON_WORKERS}  --quiet                no progress bar

Exits with 2 for bad input, with 130 if it was interrupted.
"""


@cli.command("trade", context_settings={"ignore_unknown_options": True}, add_help_option=False, help=TRADE_HELP)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def trade_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(TRADE_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("trade").run(_by_method(list(arguments)), _scenes())


@cli.command("reproduce")
@click.argument("paper", required=False)
@click.option("--quick", is_flag=True, help="coarse spheres for clumps and fewer cases: minutes on a CPU")
@click.option("--seeds", type=int, default=1, show_default=True, help="of each case of discrete elements")
@click.option("--only", multiple=True, help="of zhan: one column ('stiff stones', 'yielding layer' ...) or row (units, "
              "velocity ...); several times for several  [default: all]")  # fmt: skip
@click.option("--known", multiple=True, type=click.Path(path_type=Path), help="folder of an earlier reproduction whose "
              "results are taken")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path), help="new folder  [default: runs/reproduce-PAPER-NNN]")
@click.option("--resume", type=click.Path(path_type=Path), help="go on: finished runs are used")
@click.option("--device", help="cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--processes", type=click.IntRange(1, 1024), help="at a time on a CPU  [default: one a core]")
@click.option("--quiet", is_flag=True, help="no progress bar")
def reproduce_command(**settings: Any) -> None:
    """Repeat the runs of PAPER, zhan (discrete elements) or xu (flows), and compare the results with the paper's.

    The report shows the paper's values next to those of literal and calibrated runs, and judges each of its trends. The
    exit code is 130 if the command was interrupted.
    """
    _part("reproduce").run(**settings)


CALIBRATE_HELP = f"""From what was measured to a concrete's parameters: `warpcrete calibrate TARGETS.yaml [options]`.

The file names quantities of scenes with their values and uncertainties, and parameters with the range of each. Runs go
where the answer may lie, until more of them would not change it. The folder holds calibration.md and calibration.png
(what the data allow, and what they do not tell), answer.json, concrete.yaml (for --concrete), and all runs.

\b
  vary:
    viscosity: [10, 100]
    yield_stress: [20, 200]
  targets:
    - {{scene: slump, parameters: {{concrete: own, density: 2350}}, quantity: spread, value: 0.55, uncertainty: 2%}}
    - {{scene: funnel, parameters: {{concrete: own, density: 2350}}, quantity: funnel_time, value: 9, uncertainty: 5%}}
    - {{scene: slump, parameters: {{concrete: own, density: 2350}}, quantity: t500, value: 4, uncertainty: 10%,
       held_out: true}}

\b
  --trials N             at most, each of which runs every scene once    [default: 10 and 10 for each parameter]
  --batch N              at a time                                       [default: 4 and 2 for each parameter]
  --repeat N             seeds with which the answer is tried in the end [default: 3]
  --seed N               of the search                                   [default: 0]
  --out FOLDER           new folder                                      [default: runs/calibration-NNN]
  --resume FOLDER        go on with a calibration, also with more --trials: runs that are there are used
  --device, --precision, --processes   as for study
{ON_WORKERS}  --quiet                no progress bar

Exits with 2 for bad input, with 130 if it was interrupted. Needs pip install 'warpcrete[calibrate]'.
"""


@cli.command("calibrate", context_settings={"ignore_unknown_options": True}, add_help_option=False, help=CALIBRATE_HELP)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def calibrate_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(CALIBRATE_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("calibrate").run(list(arguments), _scenes())


LINE_HELP = """Pressure that a line of pipes needs: `warpcrete line LINE.yaml [options]`.

The file lists the parts in order. Each kind of part is simulated once, as a flow, straight pipe by the metre; the
folder holds line.md, line.json, line.png (pressure along the line, theory beside it) and the runs, which another line
takes with --known. burj-khalifa and shanghai-tower are shipped. --method dem does it by discrete elements, --method
both by both, in one table.

\b
  diameter: 125 mm
  flow: 30 m3/h
  concrete: no1                 # or a file, as for run
  largest_stone: 16 mm
  begin: level                  # up, down
  parts:
    - straight: 10 m
    - bend: {to: up, radius: 0.5 m}               # to: up, down, left, right, level, back; angle: 45 goes part of
                                                  # the way there
    - straight: {length: 20 m}
    - reducer: {to: 100 mm, length: 1 m}
    - hose: {points: [[1, 0, -0.2], [2, 0.5, -1]]}    # from where it begins: ahead, to the left, up
    - bore: {file: valve.stl, scale: 0.001, length: 0.6, outlet: 100 mm}
    - straight: 5 m

A bore is a mesh that begins at its origin and leads along its x; its file is sought beside LINE.yaml, its outlet is the
line's diameter unless told. It holds the bore alone: straight pipe is put before and behind it.

A short line as one scene: warpcrete run part --line LINE.yaml, as a flow or with --method dem.

Amounts without a unit are in m, m3/s, Pa and degrees. Exits with 3 if a check of a part failed.
"""


@cli.command("line", help=LINE_HELP)
@click.argument("line", type=str)
@click.option("--concrete", help="in place of the line's: no1, no2, no3, or a file with a section 'flow'; by "
              "elements, zhan or any that run pipe takes")  # fmt: skip
@click.option("--flow", help="in place of the line's, as '30 m3/h'")
@click.option("--theory", is_flag=True, help="closed form alone: bends and reducers as straight pipe, at once")
@click.option("--layer-factor", type=float, help="by which the slip layer's constants may be off, for the band; 1 "
              "where they were measured  [default: 2; of a mix the bands of all its constants]")  # fmt: skip
@click.option("--cells", type=int, default=12, show_default=True, help="across the bore of bends and reducers")
@click.option("--method", type=click.Choice(["flow", "dem", "both"]), default="flow", show_default=True,
              help="a Bingham fluid with a slip layer, discrete elements, or both")  # fmt: skip
@click.option("--shapes", default="spheres", show_default=True, help="of elements, as for run pipe; a concrete whose "
              "walls have a layer and no friction wants 'reference', as spheres roll along it")  # fmt: skip
@click.option("--coarse", type=float, help="times the sizes of elements  [default: until the largest is 0.3 of the "
              "narrowest bore]")  # fmt: skip
@click.option("--stiffer", type=float, default=5.0, show_default=True, help="times the modulus of elements: soft "
              "ones are pressed together for longer, stiff ones take more steps")  # fmt: skip
@click.option("--seeds", type=int, default=1, show_default=True, help="packings of elements, whose scatter is a band")
@click.option("--out", type=click.Path(path_type=Path), help="new folder  [default: runs/line-NNN]")
@click.option("--known", type=click.Path(path_type=Path), help="folder of an earlier line, finished or cut: its runs "
              "of the same parts are taken")  # fmt: skip
@click.option("--device", help="cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--threads", type=click.IntRange(1, 1024), help="on a CPU  [default: all cores]")
@click.option("--rest", help="that the line has stood full [s], or as '10 min': what a restart then takes, by theory")
@click.option("--thixotropy", help="A_thix, by which yield stresses grow at rest [Pa/s]  [default: 0.5]")
@click.option("--quiet", is_flag=True, help="no progress bar")
def line_command(line: str, **settings: Any) -> None:
    _part("line").run(line, **settings)


@cli.command("mix", help=MIX_HELP)
@click.argument("name", metavar="MIX", type=str)
@click.option(
    "--out", type=click.Path(path_type=Path), help="new file: the plain concrete, as --concrete takes it, too"
)
def mix_command(name: str, out: Path | None) -> None:
    _part("mix").run(name, out)


@cli.command("schema")
@click.argument("kind", required=False)
@click.option("--path", is_flag=True, help="print the path of the shipped file instead")
def schema_command(kind: str | None, path: bool) -> None:
    """Print the JSON schema of a kind of file: concrete, mix, line or targets.

    Editors use the schema to complete and check such files if their first line is '# yaml-language-server:
    $schema=PATH'.
    """
    if kind is None:
        raise click.UsageError("kind: name concrete, mix, line or targets")
    found = importlib.import_module("warpcrete.studies.schemas").shipped_schema(kind)
    click.echo(found if path else found.read_text(encoding="utf-8"), nl=path)


EXPLAIN_HELP = """What a scene will take, before it runs: `warpcrete explain SCENE [--PARAMETER VALUE ...] [options]`.

Which features are compiled in and why, memory by part, the time step and what governs it, steps and wall time on this
device, and what would save most. Measured within some seconds and kept in the user's cache.

\b
  --trade FOLDER         of a 'warpcrete trade' of this scene, for the errors of savings    [default: a shipped one]
  --device, --threads    as for run
  --fresh                measure again, whatever the cache has
"""


@cli.command("explain", context_settings={"ignore_unknown_options": True}, add_help_option=False, help=EXPLAIN_HELP)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def explain_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(EXPLAIN_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("explain").run(_by_method(list(arguments)), _scenes())


def _fail(text: str, code: int) -> NoReturn:
    """Print an error as one line and exit."""
    click.echo(f"error: {one_line(text)}", err=True)
    raise SystemExit(code) from None


def main() -> None:
    """Run the command, and report every expected error as one line on stderr.

    Bad input leads to exit code 2, and an unstable run to 1.
    """
    prepare_streams()
    warn_in_one_line()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # Treat SIGTERM like Ctrl-C, which saves unwritten data.
    try:
        cli(prog_name="warpcrete", standalone_mode=False)
    except click.exceptions.Exit as request:
        raise SystemExit(request.exit_code) from None
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        raise SystemExit(2) from None
    except click.UsageError as error:
        _fail(" ".join(error.format_message().split()), 2)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        raise SystemExit(130) from None
    except InstabilityError as error:
        _fail(str(error), 1)
    except WarpcreteError as error:
        if isinstance(error, DiskFullError):  # Libraries may wait for the disk when the program ends.
            end = threading.Timer(LAST_WORDS, os._exit, [2])
            end.daemon = True
            end.start()
        _fail(str(error), 2)
    except UnicodeError as error:
        _fail(f"{error}; use a UTF-8 locale (LC_ALL=C.UTF-8), or names of plain letters", 2)
    except OSError as error:
        _fail(f"{error.filename or 'file system'}: {error.strerror or error}", 2)
