"""The `warpcrete` command and its subcommands; the other modules of this package do most of the work."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import signal
import threading
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from ..core.errors import DiskFullError, InstabilityError, WarpcreteError, one_line, warn_in_one_line
from .console import prepare_streams
from .texts import MIX_HELP

EXIT_TIMEOUT = 3.0
"""Time after which a command that has met a full disk is ended by force [s]."""

# Warp takes half a second to load, and so do the scenes. Each subcommand therefore loads the modules that it needs only
# when it is called.


def _part(name: str) -> ModuleType:
    return importlib.import_module(f"{__package__}.{name}")


class Completed(click.ParamType):
    """Type of a text whose values the function `by` of the module `completion` lists for the shell.

    The function's arguments are those of `first` and the text that is typed so far.
    """

    name = "text"

    def __init__(self, by: str, *first: str) -> None:
        self.by, self.first = by, first

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return getattr(_part("completion"), self.by)(*self.first, incomplete)


DEVICE = Completed("devices")
LENGTH, TIME, PRESSURE, POWER = (Completed("amounts", unit) for unit in ("m", "s", "Pa", "W"))
FLOW, GROWTH = Completed("amounts", "m3/s"), Completed("amounts", "Pa/s")


class WordCommand(click.Command):
    """Command that takes a scene, its parameters and its own options as plain words, all of which shells complete."""

    def __init__(self, name: str, **settings: Any) -> None:
        words = click.Argument(["arguments"], nargs=-1, type=click.UNPROCESSED, shell_complete=_complete_word)
        context = {"ignore_unknown_options": True}
        super().__init__(name, **settings | {"params": [words], "context_settings": context, "add_help_option": False})

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        return _part("word_completion").words(self.name, ctx.params.get("arguments") or (), incomplete, ctx)


def _complete_word(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    return context.command.shell_complete(context, incomplete)


def _scenes() -> dict[str, ModuleType]:
    return importlib.import_module("warpcrete.scenes").modules()


@click.group()
@click.version_option(package_name="warpcrete")
@click.option(
    "--trust", is_flag=True, help="Allow records and files to import your own contact laws (this runs their code)"
)
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
    """Remove `--method NAME` from a command's words and complete the scene's name with the method.

    For example, `slump --method dem` becomes `slump-dem`.
    """
    left, method = [], None
    words = iter(arguments)
    for word in words:
        name, given, value = word.partition("=")
        if name != "--method":
            left.append(word)
        elif method is not None or not (value := value if given else next(words, "")):
            raise click.UsageError("--method: must be given once and with one value; write, for example, --method dem")
        else:
            method = value
    if method is None:
        return left
    place = next((n for n, word in enumerate(left) if not word.startswith("-")), None)
    if place is None:
        raise click.UsageError("--method: needs the name of a scene; write, for example, 'slump --method dem'")
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
@click.option("--resume", type=click.Path(path_type=Path), help="Continue the interrupted run in this folder")
@click.option(
    "--live", is_flag=False, flag_value="spawn", help="With --resume: watch the run in a Rerun viewer, as for a scene"
)
@click.option("--bind", default="127.0.0.1", help="With --live: IP address that the viewer listens on")
@click.option("--quiet", is_flag=True, help="With --resume: show no progress bar")
@click.pass_context
def run_group(context: click.Context, resume: Path | None, live: str | None, bind: str, quiet: bool) -> None:
    """Run a scene, repeat a saved run, or continue an interrupted one.

    Run a scene with `warpcrete run SCENE [options]`. `slump --method dem` is the same scene as `slump-dem`. Repeat a
    run with `warpcrete run RUN/scene.json`. Continue an interrupted run with `warpcrete run --resume RUN`.

    The exit code is 0 if the run is finished and passes its checks, 1 if it became unstable, 2 for bad input, 3 if a
    check failed, and 130 if it was interrupted.
    """
    if context.invoked_subcommand is not None:
        if resume is not None or live is not None or quiet:
            raise click.UsageError(
                "--resume, --live, --quiet: must follow the scene's name; move these options behind the name"
            )
    elif resume is None:
        click.echo(context.get_help())
        raise SystemExit(2)
    else:
        _part("run").resume(resume, _scenes(), live=live, bind=bind, quiet=quiet)


def _scene_command(name: str, module: ModuleType) -> click.Command:
    options = _part("options")
    fields = importlib.import_module("warpcrete.core.inputs.parameters").declared_fields(module.scene.parameters)
    common = {option.name for option in options.run_options() if option.expose_value}

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
                parameters = module.scene.effective_values(module.scene.resolved(parameters) | changes)
            job.run(name, module, parameters, settings)
            return
        changed = [key for key in given if key not in ("resume", "quiet", "live", "bind")]
        if changed:
            raise click.UsageError(
                f"resume = '{resume}': a run continues with its own settings; leave out {', '.join(changed)}"
            )
        job.resume(resume, _scenes(), live=settings["live"], bind=settings["bind"], quiet=settings["quiet"])

    own = options.parameter_options(field for key, field in fields.items() if key not in common)
    return options.SceneCommand(
        name, module.scene, params=own + options.run_options(), callback=callback,
        help=help_text(module.scene.description),
    )  # fmt: skip


def help_text(docstring: str) -> str:
    """Return a docstring as help of a command, without the markup of Sphinx and the errors that Python raises."""
    kept = [part for part in docstring.split("\n\n") if not part.lstrip().startswith("Raises ")]
    text = re.sub(r"\s*Raises\s+:class:`[^`]*`[^.]*\.", "", "\n\n".join(kept))
    return re.sub(r":\w+:`~?\.*(?:[\w.]*\.)?(\w+)`", r"\1", text)


def _repeat_command(path: Path) -> click.Command:
    options = _part("options")

    def callback(**settings: Any) -> None:
        job = _part("run")
        if settings.pop("resume") is not None:
            raise click.UsageError(
                "--resume: cannot be combined with a scene.json; write 'warpcrete run --resume "
                "FOLDER' to continue a run"
            )
        if [settings.pop("accuracy"), settings.pop("trade")] != [None, None]:
            raise click.UsageError(
                "--accuracy, --trade: cannot be combined with a scene.json, which fixes all settings; leave out both "
                "options"
            )
        record, module = job.repeatable_scene(path, _scenes())
        kept = {key: record[key] for key in ("device", "precision") if key in record}
        if "threads" in record.get("command", {}):
            kept["threads"] = min(record["command"]["threads"], os.cpu_count() or 1)
        job.run(record["scene"], module, record["parameters"], settings | kept | options.given(settings))

    return options.GroupedCommand(
        str(path), params=options.run_options(), callback=callback, help="Repeat a saved run."
    )


class TheoryCommand(click.Command):
    """Command with one option for each parameter of the scene functions that simulate flows."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        return [*_part("options").parameter_options(_part("theory").fields().values()), *super().get_params(ctx)]


@cli.command("theory", cls=TheoryCommand)
@click.option(
    "--flow",
    type=FLOW,
    multiple=True,
    help="Volume flow [m3/s], or with a unit such as '35 m3/h'; may be repeated  [default: 0.0015]",
)
@click.option(
    "--pressure",
    type=PRESSURE,
    multiple=True,
    help="Pressure [Pa], or with a unit such as '50 bar', for which the flow is computed; may be repeated",
)
@click.option("--fit", type=click.Path(path_type=Path), help="CSV file of flows and pressures measured in this pipe, "
              "with a first line such as 'flow [m3/h],pressure [bar]', to which the slip layer is fitted")  # fmt: skip
@click.option(
    "--rest",
    type=TIME,
    help="Time that the concrete has stood still [s], or with a unit such as '10 min'; adds the "
    "pressure of the restart",
)
@click.option("--thixotropy", type=GROWTH, help="Growth rate A_thix of the yield stress at rest [Pa/s]  [default: 0.5]")
@click.option("--segregation", multiple=True, help="Difference of the aggregate's share between the outer "
              "and the inner half of the radius, divided by its mean share; adds its effect on the pressure; may be "
              "repeated")  # fmt: skip
@click.option("--aggregate", help="Share of aggregate in the volume, for --segregation  [default: that of the mix]")
@click.pass_context
def theory(
    context: click.Context, flow: tuple[str, ...], pressure: tuple[str, ...], fit: Path | None,
    rest: str | None, thixotropy: str | None, segregation: tuple[str, ...], aggregate: str | None,
    **values: Any,
) -> None:  # fmt: skip
    """Compute the flow of a yield stress fluid with a slip layer in a pipe and a channel.

    The pressure follows from a flow, or the flow from a pressure. The concrete is a Bingham fluid by default; with
    --flow-index or --quadratic-viscosity it obeys the Herschel-Bulkley or the modified Bingham law.
    """
    job, amounts = _part("theory"), _part("option_amounts")
    one, several = amounts.option_amount, amounts.option_amounts
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
@click.option("--web", is_flag=True, help="Show it in a browser, at the printed address, until Ctrl-C; the default "
              "on a machine without a screen")  # fmt: skip
@click.option("--bind", default="127.0.0.1", show_default=True, help="IP address that the viewer listens on; 0.0.0.0 "
              "lets every machine connect that can reach this one")  # fmt: skip
def view_run(run: Path, web: bool, bind: str) -> None:
    """Open the recording of a run folder in the Rerun viewer."""
    from ..core.run.run import viewer

    opened = viewer(run, web, bind)
    process = opened.start()
    if opened.in_browser and not web:
        click.echo("note: this machine has no screen (DISPLAY is not set); open the following address in a browser",
                   err=True)  # fmt: skip
    if opened.in_browser:
        click.echo(opened.address)
    raise SystemExit(process.wait())


@cli.command("verify")
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True)
@click.option("--only", default="", help="Run only the cases whose name or group contains this text")
@click.option("--quick", is_flag=True, help="Leave out the cases that take longer than a few seconds")
@click.option("--extremes", is_flag=True, help="Also run a matrix of scenes with extreme parameters")
@click.option("--out", type=click.Path(path_type=Path), help="New folder for verification.md and verification.png")
def verify(**settings: Any) -> None:
    """Compare results with published and closed-form answers, in one table and one figure.

    The exit code is 1 if a result is wrong.
    """
    _part("verify").run(**settings)


@cli.command("validate")
@click.option(
    "--kind",
    type=Completed("kinds"),
    multiple=True,
    help="Compare only this kind of measurement, such as pipe or slump; repeatable",
)
@click.option("--quick", is_flag=True, help="Use closed forms only, and simulate no flow")
@click.option(
    "--cases", type=click.Path(path_type=Path), help="File of your own measured cases  [default: the shipped ones]"
)
@click.option("--every", is_flag=True, help="Also print the table of all cases")
@click.option(
    "--device", type=DEVICE, help="Device of the simulations: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]"
)
@click.option("--out", type=click.Path(path_type=Path), help="New folder for the tables and validation.png")
@click.option("--quiet", is_flag=True, help="Show no progress bar")
def validate_command(**settings: Any) -> None:
    """Compare blind predictions with measurements of pipes, lines, slip layers and fresh concrete.

    Each case is predicted from what was known before the measurement. The table gives, for each kind of measurement,
    the median ratio of prediction to measurement, the median error, and the fraction of the cases whose measured value
    lies in the uncertainty band of the prediction. Cases that are held out were never used to fit a constant of the
    program.
    """
    _part("validate").run(**settings)


ON_WORKERS = """\
  --scheduler WHICH      run on Dask workers (pip install 'warpcrete[cluster]'): 'local' starts one per GPU or core,
                         'slurm' submits jobs by Dask's configuration; or the address of a running scheduler
  --workers N            number of workers that the scheduler starts
"""

STUDY_HELP = f"""A parameter study of a scene: `warpcrete study SCENE --PARAMETER VALUE VALUE ... [options]`.

Every parameter of the scene, as in `warpcrete run SCENE --help-all`, takes one value or several. Every combination of
the values is a case. On a GPU, cases of discrete elements run side by side in batches, and flows one after another. On
a CPU, cases run in parallel processes, one per core. The folder holds study.md, study.csv, study.png and a run folder
for each case.

\b
  --repeat N             run every case with N seeds                                      [default: 1]
  --one-at-a-time        vary one parameter at a time and keep the others at their defaults
  --out FOLDER           new folder                                                       [default: runs/study-NNN]
  --resume FOLDER        continue a study; finished cases are not run again
  --device, --precision  as for run
  --processes N          number of parallel processes on a CPU                            [default: one per core]
{ON_WORKERS}  --frames, --checkpoint-every, --rerun and other recorders   as for run; recordings are off by default
  --quiet                show no progress bar

The exit code is 1 if a case failed, 3 if all cases finished but one of them failed a check, and 130 if the study was
interrupted.
"""


@cli.command("study", cls=WordCommand, help=STUDY_HELP)
def study_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(STUDY_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("study").run(_by_method(list(arguments)), _scenes())


TRADE_HELP = f"""Measure speed against accuracy of a scene: `warpcrete trade SCENE [--PARAMETER VALUE ...] [options]`.

The command varies the settings that trade accuracy for speed (time step, precision, sizes, walls, spacing ...), first
each alone, then together. It finds the cheapest settings for errors of 20 % down to 1 % and verifies them with new
seeds. Runs take place one at a time, or one on each worker. The folder holds trade.md, trade.csv, trade.json, trade.png
and a run folder for each run.

\b
  --budget TIME          total wall time, such as 90s, 20min or 2h                        [default: 20min]
  --quantity NAME ...    quantities of result.json whose errors are measured              [default: the scene's]
  --knob NAME ...        settings that are varied, such as 'time step'                    [default: all of the scene]
  --repeat N             number of seeds of each setting                                  [default: 3]
  --out FOLDER           new folder                                                       [default: runs/trade-NNN]
  --resume FOLDER        continue a trade for another --budget; its finished runs are kept
  --device, --threads    as for run; with workers, --threads holds for each worker        [default there: 1]
{ON_WORKERS}  --quiet                show no progress bar

The exit code is 2 for bad input and 130 if the trade was interrupted.
"""


@cli.command("trade", cls=WordCommand, help=TRADE_HELP)
def trade_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(TRADE_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("trade").run(_by_method(list(arguments)), _scenes())


@cli.command("reproduce")
@click.argument("paper", type=Completed("papers"), required=False)
@click.option(
    "--quick", is_flag=True, help="Use coarse spheres instead of clumps, and fewer cases; takes minutes on a CPU"
)
@click.option(
    "--seeds", type=int, default=1, show_default=True, help="Number of seeds of each case of discrete elements"
)
@click.option("--only", multiple=True, help="With zhan: run only one column ('stiff stones', 'yielding layer' ...) or "
              "row (units, velocity ...) of the report; may be repeated  [default: all]")  # fmt: skip
@click.option("--known", multiple=True, type=click.Path(path_type=Path), help="Folder of an earlier reproduction "
              "whose results are reused; may be repeated")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path), help="New folder  [default: runs/reproduce-PAPER-NNN]")
@click.option(
    "--resume", type=click.Path(path_type=Path), help="Continue the reproduction in this folder; finished runs are kept"
)
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option(
    "--processes", type=click.IntRange(1, 1024), help="Number of parallel processes on a CPU  [default: one per core]"
)
@click.option("--quiet", is_flag=True, help="Show no progress bar")
def reproduce_command(**settings: Any) -> None:
    """Repeat the runs of PAPER, zhan (discrete elements) or xu (flows), and compare the results with the paper's.

    The report shows the paper's values next to those of literal and calibrated runs, and judges each of its trends. The
    exit code is 130 if the command was interrupted.
    """
    _part("reproduce").run(**settings)


CALIBRATE_HELP = f"""Find a concrete's parameters from measured results: `warpcrete calibrate TARGETS.yaml [options]`.

The file lists the measured quantities of scenes with their uncertainties, and the parameters to find with the range of
each. New runs are placed where the answer is likely, until further runs would no longer change it. The folder holds
calibration.md and calibration.png (the parameters that fit the data, and those that the data do not determine),
answer.json, concrete.yaml (for --concrete), and all runs.

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
  --trials N             maximum number of trials; each runs all scenes  [default: 10 + 10 per parameter]
  --batch N              number of trials that run at the same time      [default: 4 + 2 per parameter]
  --repeat N             number of seeds of the final check              [default: 3]
  --seed N               seed of the search                              [default: 0]
  --out FOLDER           new folder                                      [default: runs/calibration-NNN]
  --resume FOLDER        continue a calibration, also with more --trials; its finished runs are kept
  --device, --precision, --processes   as for study
{ON_WORKERS}  --quiet                show no progress bar

The exit code is 2 for bad input and 130 if the calibration was interrupted. The command needs pip install
'warpcrete[calibrate]'.
"""


@cli.command("calibrate", cls=WordCommand, help=CALIBRATE_HELP)
def calibrate_command(arguments: tuple[str, ...]) -> None:
    if not arguments or "--help" in arguments:
        click.echo(CALIBRATE_HELP.replace("\b\n", ""))
        raise SystemExit(0 if arguments else 2)
    _part("calibrate").run(list(arguments), _scenes())


LINE_HELP = """Compute the pressure that a pipeline needs: `warpcrete line LINE.yaml [options]`.

Without a file, a straight line and a slump suffice: `warpcrete line --slump 180mm --stone 20mm --diameter 125mm
--length 190m --rise 20m --flow 30m3/h`.

The file lists the parts of the pipeline in order. The answer comes at once, from theory and from factors of earlier
simulations. With --simulate, each different part is simulated once as a flow; a straight pipe is simulated once and its
pressure scaled with its length. --method dem simulates the parts with discrete elements, --method both with both
methods, in one table. A folder (--out) holds line.md, line.json, line.png (pressure along the line) and the runs, which
another line can reuse with --known. Two lines are shipped: burj-khalifa and shanghai-tower.

\b
  diameter: 125 mm
  flow: 30 m3/h
  concrete: no1                 # or a file, as for run
  largest_stone: 16 mm
  pump: {pressure: 85 bar, flow: 90 m3/h, power: 110 kW}      # optional, from its data sheet
  begin: level                  # up, down
  parts:
    - straight: 10 m
    - bend: {to: up, radius: 0.5 m}               # to: up, down, left, right, level, back; with angle: 45 it turns
                                                  # only 45 degrees towards it
    - straight: {length: 20 m}
    - reducer: {to: 100 mm, length: 1 m}
    - hose: {points: [[1, 0, -0.2], [2, 0.5, -1]]}    # relative to its start: ahead, left, up [m]
    - bend: level                 # radius 0.5 m, or two diameters if these are larger
    - valve: {equivalent: 20 m}   # as much friction as 20 m of straight pipe; any part may state it
    - hose: {length: 4 m, factor: 2.5}            # or its friction over that of straight pipe of its length
    - bore: {file: valve.stl, scale: 0.001, length: 0.6, outlet: 100 mm}
    - straight: 5 m

A bore is a mesh of the inner surface that begins at its origin and leads along its x axis. Its path is relative to the
folder of LINE.yaml. Its outlet has the diameter of the line unless `outlet` is given. The mesh must hold the bore
alone; straight pipe is added before and behind it.

Rules of practice say whether the mix may block the narrowest part. --blocking 50 also simulates that part with 50 seeds
and prints the probability of a blockage.

To simulate a short line as one scene: warpcrete run part --line LINE.yaml, as a flow or with --method dem.

Values without a unit are in m, m3/s, Pa and degrees. The exit code is 3 if a check of a part failed.
"""


@cli.command("line", help=LINE_HELP)
@click.argument("line", type=Completed("lines"), required=False)
@click.option("--diameter", type=LENGTH, help="Inner diameter of a straight line without a file, such as '125 mm'")
@click.option("--length", type=LENGTH, help="Length of a straight line without a file, such as '190 m'")
@click.option("--rise", type=LENGTH, help="Height of the end of a line without a file above its start  [default: 0 m]")
@click.option("--slump", type=LENGTH, help="Slump of a concrete of which nothing else is known, such as '180 mm'")
@click.option("--spread", type=LENGTH, help="Spread of a concrete of which nothing else is known, such as '600 mm'")
@click.option("--stone", type=LENGTH, help="Size of the largest stone, such as '20 mm'")
@click.option("--concrete", type=Completed("concretes"), help="Concrete, instead of the line's: no1, no2, no3, or a "
              "file with a section 'flow'; with --method dem, zhan or another concrete of 'pipe'")  # fmt: skip
@click.option("--flow", type=FLOW, help="Volume flow, instead of the line's, such as '30 m3/h'")
@click.option(
    "--simulate",
    is_flag=True,
    help="Simulate each kind of part as a flow, which takes seconds to minutes, instead of the answer by theory and "
    "by factors of earlier simulations",
)
@click.option("--theory", is_flag=True, help="Answer by theory, as without --simulate")
@click.option("--fit", type=click.Path(path_type=Path), help="CSV file of pressures along a trial line, with a first "
              "line such as 'place [m],pressure [bar],flow [m3/h]', to which the slip layer and the factor of bends "
              "are fitted")  # fmt: skip
@click.option("--layer-factor", type=float, help="Factor by which the slip layer's constants may be wrong, for the "
              "band of the pressure; 1 if they were measured  [default: 2; for a mix, the bands of all its "
              "constants]")  # fmt: skip
@click.option(
    "--cells", type=int, default=12, show_default=True, help="Number of cells across the bore of bends and reducers"
)
@click.option("--method", type=click.Choice(["flow", "dem", "both"]), default="flow", show_default=True,
              help="Simulate a Bingham fluid with a slip layer, discrete elements, or both")  # fmt: skip
@click.option("--shapes", default="spheres", show_default=True, help="Shapes of the elements, as for the scene 'pipe'; "
              "use 'reference' for a concrete with a slip layer but no wall friction, because spheres roll along the "
              "layer")  # fmt: skip
@click.option("--coarse", type=float, help="Factor by which the elements are enlarged  [default: such that the largest "
              "is 0.3 of the narrowest bore]")  # fmt: skip
@click.option("--stiffer", type=float, default=5.0, show_default=True, help="Factor on the modulus of the elements: "
              "stiff elements need more steps, soft elements stay compressed for longer")  # fmt: skip
@click.option(
    "--seeds",
    type=int,
    default=1,
    show_default=True,
    help="Number of random packings of elements, whose scatter gives a band",
)
@click.option("--out", type=click.Path(path_type=Path), help="New folder for the result  [default: runs/line-NNN for "
              "a simulation, none for an answer by theory]")  # fmt: skip
@click.option("--known", type=click.Path(path_type=Path), help="Folder of an earlier line, finished or interrupted, "
              "whose runs of the same parts are reused")  # fmt: skip
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--threads", type=click.IntRange(1, 1024), help="Number of threads on a CPU  [default: all cores]")
@click.option(
    "--rest",
    type=TIME,
    help="Time that the full line has stood still [s], or with a unit such as '10 min'; adds the "
    "theoretical pressure of the restart",
)
@click.option("--thixotropy", type=GROWTH, help="Growth rate A_thix of the yield stress at rest [Pa/s]  [default: 0.5, "
              "and a band of 0.1 to 1]")  # fmt: skip
@click.option("--pump-pressure", type=PRESSURE, help="Largest pressure of the pump on the concrete, from its data "
              "sheet, such as '85 bar'; shows the margin")  # fmt: skip
@click.option("--pump-flow", type=FLOW, help="Largest flow of the pump, such as '90 m3/h'")
@click.option("--pump-power", type=POWER, help="Power of the pump's motor, such as '110 kW'")
@click.option("--practice", is_flag=True, help="Compare the result with the rules of AIJ, JSCE and JGJ/T 10")
@click.option("--blocking", type=click.IntRange(1, 10_000), help="Simulate the narrowest part with this number of "
              "seeds by discrete elements, stones in their true size, and print the probability that it is blocked; "
              "meant for a GPU")  # fmt: skip
@click.option("--quiet", is_flag=True, help="Show no progress bar")
def line_command(line: str | None, **settings: Any) -> None:
    _part("line").run(line, **settings)


@cli.command("mix", help=MIX_HELP)
@click.argument("name", metavar="MIX", type=Completed("mixes"))
@click.option(
    "--out", type=click.Path(path_type=Path), help="Write the resulting concrete to this new file, for --concrete"
)
@click.option("--bore", type=LENGTH, help="Narrowest bore through which the concrete is pumped, such as '100 mm', "
              "for the rule on the largest stone")  # fmt: skip
def mix_command(name: str, out: Path | None, bore: str | None) -> None:
    _part("mix").run(name, out, bore)


@cli.command("schema")
@click.argument("kind", type=Completed("schemas"), required=False)
@click.option("--path", is_flag=True, help="Print the path of the schema instead")
def schema_command(kind: str | None, path: bool) -> None:
    """Print the JSON schema of a kind of file: concrete, mix, line or targets.

    Editors use the schema to complete and check such files if their first line is '# yaml-language-server:
    $schema=PATH'.
    """
    if kind is None:
        raise click.UsageError("kind: the kind of file is missing; give 'concrete', 'mix', 'line' or 'targets'")
    found = importlib.import_module("warpcrete.studies.schemas").shipped_schema(kind)
    click.echo(found if path else found.read_text(encoding="utf-8"), nl=path)


EXPLAIN_HELP = """Estimate the cost of a run beforehand: `warpcrete explain SCENE [--PARAMETER VALUE ...] [options]`.

The command prints the compiled features and why they are needed, the memory by part, the time step and what limits it,
the number of steps and the wall time on this device, and the changes that would save most. It measures for some seconds
and keeps the result in the user's cache.

\b
  --trade FOLDER         folder of a 'warpcrete trade' of this scene, which gives the errors
                         of the proposed changes                                          [default: a shipped one]
  --device, --threads    as for run
  --fresh                measure again and ignore the cache
"""


@cli.command("explain", cls=WordCommand, help=EXPLAIN_HELP)
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
    # Treat SIGTERM like Ctrl-C, so that the run saves its data before it ends.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
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
        # While the program exits, libraries may wait without end for space on the full disk.
        if isinstance(error, DiskFullError):
            end = threading.Timer(EXIT_TIMEOUT, os._exit, [2])
            end.daemon = True
            end.start()
        _fail(str(error), 2)
    except UnicodeError as error:
        _fail(f"{error}; use a UTF-8 locale (LC_ALL=C.UTF-8), or names of ASCII letters", 2)
    except OSError as error:
        _fail(f"{error.filename or 'file system'}: {error.strerror or error}", 2)
