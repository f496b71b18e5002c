"""The `warpcrete` command and its subcommands; the other modules of this package do most of the work."""

import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import click

from ..core.errors import (
    RELATED,
    RENAMED,
    DiskFullError,
    InstabilityError,
    WarpcreteError,
    one_line,
    warn_in_one_line,
)
from .console import prepare_streams
from .help_pages import Commands, GroupedCommand, full_help_option
from .option_types import DEVICE, FLOW, GROWTH, LENGTH, PATH, POWER, PRESSURE, TIME, Completed
from .scene_commands import LazyGroup, WordCommand, by_method, load, scenes, titles
from .texts import CALIBRATE_HELP, EXPLAIN_HELP, LINE_HELP, MIX_HELP, STUDY_HELP, TRADE_HELP

EXIT_TIMEOUT = 3.0
"""Time that a command has to end by itself after the disk became full [s]. After this time, the process is killed,
because libraries may wait for disk space without end."""


@click.group(cls=Commands)
@click.version_option(package_name="warpcrete")
@click.option(
    "--trust",
    is_flag=True,
    help="Allow input files and saved runs to import contact laws of your own; this runs their code",
)
def cli(trust: bool) -> None:
    """Particle simulation of fresh concrete being pumped."""
    if trust:
        trusted = importlib.import_module("warpcrete.core.inputs.by_name").trusted_files()
        click.get_current_context().with_resource(trusted)


@cli.command("list")
def list_scenes() -> None:
    """List the scenes, one line each."""
    for name, title in titles().items():
        click.echo(f"{name:12s} {title}")


@cli.group("run", cls=LazyGroup, invoke_without_command=True, context_settings={"max_content_width": 110})
@click.option("--resume", type=PATH, help="Continue the interrupted run in this folder")
@click.option(
    "--live",
    is_flag=False,
    flag_value="spawn",
    help="With --resume: watch the run in a new Rerun viewer, or in a running one if its URL is given",
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
                "--resume, --live, --quiet: must follow the scene's name; write, for example, 'warpcrete run pipe "
                "--quiet'"
            )
    elif resume is None:
        click.echo(context.get_help())
        raise SystemExit(2)
    else:
        load("run").resume(resume, scenes(), live=live, bind=bind, quiet=quiet)


class TheoryCommand(GroupedCommand):
    """Command `theory`, which has an option for each scene parameter that enters the closed-form solution."""

    common = ("flow", "pressure", "fit", "rest")
    title = "Flow and pressure."

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        job = load("theory")
        parameters = [*load("options").parameter_options(job.fields().values()), job.rise_option()]
        help_option = super().get_params(ctx)[len(self.params) :]
        return [*self.params, *parameters, full_help_option(), *help_option]


@cli.command("theory", cls=TheoryCommand, context_settings={"max_content_width": 110})
@click.option("--flow", type=FLOW, multiple=True, help="Volume flow [m3/s], or with a unit such as '35 m3/h'; may be "
              "repeated  [default: 0.0015]")  # fmt: skip
@click.option("--pressure", type=PRESSURE, multiple=True, help="Pressure [Pa], or with a unit such as '50 bar', for "
              "which the flow is computed; may be repeated")  # fmt: skip
@click.option("--fit", type=PATH, help="CSV file of flows and pressures measured in this pipe, "
              "with a first line such as 'flow [m3/h],pressure [bar]', to which the slip layer is fitted")  # fmt: skip
@click.option("--rest", type=TIME, help="Time that the concrete has stood still [s], or with a unit such as '10 min'; "
              "also prints the pressure that restarts the flow")  # fmt: skip
@click.option("--thixotropy", type=GROWTH, help="Growth rate A_thix of the yield stress at rest [Pa/s]  [default: 0.5]")
@click.option("--segregation", multiple=True, help="Aggregate's share in the outer half of the radius minus its share "
              "in the inner half, divided by its mean share; also prints the effect on the pressure; may be "
              "repeated")  # fmt: skip
@click.option("--aggregate", help="Share of aggregate in the volume, for --segregation  [default: that of the mix]")
@click.pass_context
def theory(
    context: click.Context, flow: tuple[str, ...], pressure: tuple[str, ...], fit: Path | None,
    rest: str | None, thixotropy: str | None, segregation: tuple[str, ...], aggregate: str | None,
    **values: object,
) -> None:  # fmt: skip
    """Compute the flow of a yield stress fluid with a slip layer in a pipe and a channel.

    The pressure follows from a flow, or the flow from a pressure. The concrete is a Bingham fluid by default; with
    --flow-index or --quadratic-viscosity it obeys the Herschel-Bulkley or the modified Bingham law.
    """
    job, amounts = load("theory"), load("option_amounts")
    one, several = amounts.option_amount, amounts.option_amounts
    job.run(
        load("options").given(values, context),
        several("flow", flow, "m3/s"),
        several("pressure", pressure, "Pa"),
        fit,
        one("rest", rest, "s"),
        one("thixotropy", thixotropy, "Pa/s"),
        several("segregation", segregation, "1"),
        one("aggregate", aggregate, "m3/m3"),
    )


@cli.command("view")
@click.argument("run", type=PATH)
@click.option("--web", is_flag=True, help="Show the recording in a browser, at the printed address, until Ctrl-C; the "
              "default on a machine without a screen")  # fmt: skip
@click.option("--bind", default="127.0.0.1", show_default=True, help="IP address that the viewer listens on; 0.0.0.0 "
              "lets every machine connect that can reach this one")  # fmt: skip
def view_run(run: Path, web: bool, bind: str) -> None:
    """Open the recording of a run folder in the Rerun viewer."""
    from ..core.run.run import viewer

    opened = viewer(run, web, bind)
    process = opened.start()
    if opened.in_browser and not web:
        click.echo(
            "note: this machine has no screen (DISPLAY is not set); open the following address in a browser", err=True
        )
    if opened.in_browser:
        click.echo(opened.address)
    raise SystemExit(process.wait())


@cli.command(
    "warm", context_settings={"ignore_unknown_options": True}, options_metavar="[--PARAMETER VALUE ...] [OPTIONS]"
)
@click.argument("scene", type=Completed("scene_names"), nargs=-1)
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
def warm_command(scene: tuple[str, ...], device: str | None) -> None:
    """Compile the kernels of each SCENE, by default of all scenes, so that its first run starts at once.

    Use it when you install warpcrete, or when you build a container. Parameters of a scene, such as a contact law of
    your own, may follow its name: `warpcrete warm pipe --contact sticky:Sticky`. Runs with other features, such as
    another flow law or precision, still compile the kernels that these features need.
    """
    load("warm").run(by_method(list(scene)), scenes(), device)


@cli.command("verify")
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True,
              help="Precision of positions and forces")  # fmt: skip
@click.option(
    "--only", type=Completed("checked"), default="", help="Run only the cases whose name or group contains this text"
)
@click.option("--quick", is_flag=True, help="Leave out the cases that take longer than a few seconds")
@click.option("--extremes", is_flag=True, help="Also run a matrix of scenes with extreme parameters")
@click.option("--out", type=PATH, help="New folder for verification.md and verification.png")
def verify(**settings: object) -> None:
    """Compare results with published values and closed-form solutions, in one table and one figure.

    The exit code is 1 if a result is wrong.
    """
    load("verify").run(**settings)


@cli.command("validate")
@click.option("--kind", type=Completed("kinds"), multiple=True, help="Compare only this kind of measurement, such as "
              "pipe or slump; repeatable")  # fmt: skip
@click.option("--quick", is_flag=True, help="Use closed forms only, and simulate no flow")
@click.option("--cases", type=PATH, help="File of your own measured cases  [default: the shipped ones]")
@click.option("--every", is_flag=True, help="Also print the table of all cases")
@click.option(
    "--device", type=DEVICE, help="Device of the simulations: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]"
)
@click.option("--out", type=PATH, help="New folder for the tables and validation.png")
@click.option("--quiet", is_flag=True, help="Show no progress bar")
def validate_command(**settings: object) -> None:
    """Compare blind predictions with measurements of pipes, lines, slip layers and fresh concrete.

    Each case is predicted from what was known before the measurement. The table gives, for each kind of measurement,
    the median ratio of prediction to measurement, the median error, and the fraction of the cases whose measured value
    lies in the uncertainty band of the prediction. Cases that are held out were never used to fit a constant of the
    program.
    """
    load("validate").run(**settings)


@cli.command("reproduce")
@click.argument("paper", type=Completed("papers"), required=False)
@click.option(
    "--quick", is_flag=True, help="Use coarse spheres instead of clumps, and fewer cases; takes minutes on a CPU"
)
@click.option(
    "--seeds", type=int, default=1, show_default=True, help="Number of seeds of each case of discrete elements"
)
@click.option("--only", type=Completed("compared"), multiple=True, help="With zhan: run only one column (stiff-stones, "
              "yielding-layer ...) or row (units, velocity ...) of the report; may be repeated  [default: all]"
              )  # fmt: skip
@click.option("--known", multiple=True, type=PATH, help="Folder of an earlier reproduction "
              "whose results are reused; may be repeated")  # fmt: skip
@click.option("--out", type=PATH, help="New folder  [default: runs/reproduce-PAPER-NNN]")
@click.option("--resume", type=PATH, help="Continue the reproduction in this folder; finished runs are kept")
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option(
    "--processes", type=click.IntRange(1, 1024), help="Number of parallel processes on a CPU  [default: one per core]"
)
@click.option("--quiet", is_flag=True, help="Show no progress bar")
def reproduce_command(**settings: object) -> None:
    """Repeat the runs of PAPER, zhan (discrete elements) or xu (flows), and compare the results with the paper's.

    The report shows the paper's values next to the values of the runs, and judges each trend that the paper reports.
    The runs of zhan use the concrete as printed in the paper and a calibrated concrete. The exit code is 130 if the
    command was interrupted.
    """
    load("reproduce").run(**settings)


@cli.command("line", help=LINE_HELP)
@click.argument("line", type=Completed("lines"), required=False)
@click.option("--diameter", type=LENGTH, help="Inner diameter of a straight line without a file, such as '125 mm'")
@click.option("--length", type=LENGTH, help="Length of a straight line without a file, such as '190 m'")
@click.option("--rise", type=LENGTH, help="Height of the end of a line without a file above its start  [default: 0 m]")
@click.option("--slump", type=LENGTH, help="Slump of a concrete of which nothing else is known, such as '180 mm'")
@click.option("--spread", type=LENGTH, help="Spread of a concrete of which nothing else is known, such as '600 mm'")
@click.option("--stone", type=LENGTH, help="Size of the largest stone, such as '20 mm', '3/4 in' or '#67'")
@click.option("--concrete", type=Completed("concretes"), help="Concrete, instead of the line's: no1, no2, no3, or a "
              "file with a section 'flow'; with --method dem, zhan or another concrete of 'pipe'")  # fmt: skip
@click.option("--flow", type=FLOW, help="Volume flow, instead of the line's, such as '30 m3/h'")
@click.option("--simulate", is_flag=True, help="Simulate each kind of part as a flow, which takes seconds to minutes, "
              "instead of the answer by theory and by factors of earlier simulations")  # fmt: skip
@click.option("--theory", is_flag=True, help="Answer by theory, and simulate no part, not even one that is sharper "
              "than all parts in the table of simulated parts")  # fmt: skip
@click.option("--fit", type=PATH, help="CSV file of pressures along a trial line, with a first "
              "line such as 'place [m],pressure [bar],flow [m3/h]', to which the slip layer and the factor of bends "
              "are fitted")  # fmt: skip
@click.option("--gauge", type=PRESSURE, help="Error limit of the gauges of --fit, as '1 bar' or in % of the largest "
              "pressure  [default: 4 %, a gauge of class 2.5 whose scale ends at 1.6 times the largest "
              "pressure]")  # fmt: skip
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
@click.option("--coarse", type=float, help="Factor by which the elements are enlarged  [default: the largest element "
              "becomes 0.3 times as wide as the narrowest bore]")  # fmt: skip
@click.option("--stiffer", type=float, default=1.0, show_default=True, help="Factor by which the elastic modulus of "
              "the elements is multiplied: stiff elements need more steps, soft elements stay compressed for "
              "longer")  # fmt: skip
@click.option("--seeds", type=int, default=1, show_default=True, help="Number of random packings of elements; their "
              "scatter gives the band of the pressure")  # fmt: skip
@click.option("--out", type=PATH, help="New folder for the result  [default: runs/line-NNN for "
              "a simulation, none for an answer by theory]")  # fmt: skip
@click.option("--known", type=PATH, help="Folder of an earlier line, finished or interrupted, "
              "whose runs of the same parts are reused")  # fmt: skip
@click.option("--device", type=DEVICE, help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]")
@click.option("--threads", type=click.IntRange(1, 1024), help="Number of threads on a CPU, up to the number of cores  "
              "[default: all cores]")  # fmt: skip
@click.option("--rest", type=TIME, help="Time that the full line has stood still [s], or with a unit such as '10 "
              "min'; also prints the pressure, by theory, that restarts the line")  # fmt: skip
@click.option("--thixotropy", type=GROWTH, help="Growth rate A_thix of the yield stress at rest [Pa/s]  [default: 0.5, "
              "and a band of 0.1 to 1]")  # fmt: skip
@click.option("--pump-pressure", type=PRESSURE, help="Largest pressure of the pump on the concrete, from its data "
              "sheet, such as '85 bar'; also prints the margin")  # fmt: skip
@click.option("--pump-flow", type=FLOW, help="Largest flow of the pump, such as '90 m3/h'")
@click.option("--pump-power", type=POWER, help="Power of the pump's motor, such as '110 kW'")
@click.option("--practice", is_flag=True, help="Compare the result with the rules of AIJ, JSCE and JGJ/T 10")
@click.option("--blocking", type=click.IntRange(1, 10_000), help="Simulate the narrowest part with this number of "
              "seeds by discrete elements, stones in their true size, and print the probability that it is blocked; "
              "meant for a GPU")  # fmt: skip
@click.option("--quiet", is_flag=True, help="Show no progress bar")
def line_command(line: str | None, **settings: object) -> None:
    load("line").run(line, **settings)


@cli.command("mix", help=MIX_HELP)
@click.argument("name", metavar="MIX", type=Completed("mixes"))
@click.option("--out", type=PATH, help="Write the resulting concrete to this new file, for --concrete")
@click.option("--bore", type=LENGTH, help="Narrowest bore through which the concrete is pumped, such as '100 mm', "
              "for the rule on the largest stone")  # fmt: skip
def mix_command(name: str, out: Path | None, bore: str | None) -> None:
    load("mix").run(name, out, bore)


@cli.command("schema")
@click.argument("kind", type=Completed("schemas"), required=False)
@click.option("--path", is_flag=True, help="Print the path of the schema instead of its contents")
def schema_command(kind: str | None, path: bool) -> None:
    """Print the JSON schema of a kind of file: concrete, mix, line or targets.

    Editors use the schema to complete and check such files if their first line is '# yaml-language-server:
    $schema=PATH'.
    """
    if kind is None:
        raise click.UsageError("kind: the kind of file is missing; give 'concrete', 'mix', 'line' or 'targets'")
    schema = importlib.import_module("warpcrete.cli.schemas").shipped_schema(kind)
    click.echo(schema if path else schema.read_text(encoding="utf-8"), nl=path)


def _add_command(name: str, text: str, words_of: Callable[[list[str]], list[str]]) -> None:
    """Add the subcommand `name` with the help page `text`.

    `words_of` converts the words of the command line before the subcommand's own module parses them. Click cannot parse
    them, because the options depend on the scene.
    """

    @cli.command(name, cls=WordCommand, help=text)
    @click.pass_context
    def command(context: click.Context, arguments: tuple[str, ...]) -> None:
        if not arguments or "--help" in arguments:
            click.echo(context.get_help())
            raise SystemExit(0 if arguments else 2)
        load(name).run(words_of(list(arguments)), scenes())


for _name, _text in {"study": STUDY_HELP, "trade": TRADE_HELP, "explain": EXPLAIN_HELP}.items():
    _add_command(_name, _text, by_method)
_add_command("calibrate", CALIBRATE_HELP, list)


def _fail(text: str, code: int) -> NoReturn:
    """Print an error message as one line to stderr, and end the program with the exit code `code`."""
    click.echo(f"error: {one_line(text)}", err=True)
    raise SystemExit(code) from None


def _unknown_option(error: click.NoSuchOption, text: str) -> str:
    """Return the message for an unknown option.

    If the command has another option for the same purpose, or the option was renamed, the message names that option.
    Otherwise the message is `text`.
    """
    wrong = error.option_name[2:].replace("-", "_")
    known = [] if error.ctx is None else [f"--{each.name}" for each in error.ctx.command.params]
    if (name := RENAMED.get(wrong)) is not None:
        return f"No such option {error.option_name!r}; use '--{name.replace('_', '-')}', which has replaced it"
    name, meaning = RELATED.get(wrong, ("", ""))
    return f"No such option {error.option_name!r}; use '--{name}', {meaning}" if f"--{name}" in known else text


def main() -> None:
    """Run the command, and report every expected error as one line on stderr.

    Bad input leads to exit code 2, and an unstable run to 1.
    """
    prepare_streams()
    warn_in_one_line()
    # The command draws into files only. The environment may select a Matplotlib backend that is not installed, with
    # which Matplotlib fails.
    os.environ["MPLBACKEND"] = "agg"
    # Treat SIGTERM, and SIGHUP from a closed terminal, like Ctrl-C, so that the run saves its data before it ends. A
    # process under 'nohup' ignores SIGHUP; it must continue to ignore this signal.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    try:
        cli(prog_name="warpcrete", standalone_mode=False)
    except click.exceptions.Exit as request:
        raise SystemExit(request.exit_code) from None
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        raise SystemExit(2) from None
    except click.UsageError as error:
        text = " ".join(error.format_message().split())
        if isinstance(error, click.NoSuchOption):
            text = _unknown_option(error, text)
        elif "unexpected extra argument" in text:
            text += "; put a value that contains a space in quotes, as in --flow '5 m3/h'"
        elif "requires an argument" in text and "'--stone'" in text:
            text = f"{text.rstrip('.')}; put a value that begins with # in quotes, as in --stone '#57'"
        _fail(text, 2)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        raise SystemExit(130) from None
    except InstabilityError as error:
        _fail(str(error), 1)
    except WarpcreteError as error:
        # Kill the process after a time limit, because libraries may wait for disk space forever.
        if isinstance(error, DiskFullError):
            end = threading.Timer(EXIT_TIMEOUT, os._exit, [2])
            end.daemon = True
            end.start()
        _fail(str(error), 2)
    except UnicodeError as error:
        _fail(f"{error}; use a UTF-8 locale (LC_ALL=C.UTF-8), or names of ASCII letters", 2)
    except OSError as error:
        if "warp" in sys.modules:
            files = importlib.import_module("warpcrete.core.device.kernel_files")
            if files.in_kernel_cache(error):
                _fail(files.kernel_cache_problem(error), 2)
        _fail(f"{error.filename or 'file system'}: {error.strerror or error}", 2)
