"""Command-line options of scenes: one for each parameter that a scene declares, and those that every run has."""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, replace
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from ..core.errors import suggested
from ..core.inputs.amounts import amount
from ..core.inputs.parameters import CompositeRule, Field, FileIf, OneOf, Suggests
from ..core.run.scene_module import SceneModule
from ..methods import METHODS
from ..record.recorders import RECORDERS
from . import completion
from .help_pages import GroupedCommand, ParameterOption, full_help_option
from .option_types import AmountOption


class SceneCommand(GroupedCommand):
    """Command that runs a scene. A contact law chosen with `--contact LAW` adds the options of this law."""

    def __init__(self, name: str, scene: Any, **settings: Any) -> None:
        super().__init__(name, **settings)
        self._scene, self._own = scene, list(self.params)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        known = self._scene.fields({})
        words = {name: word for name, field in known.items() if any(field.of_kind(CompositeRule))
                 and (word := _value_of(flag(name), args)) is not None}  # fmt: skip
        more = [replace(field, help=f"{field.help}  [required]") if field.default is MISSING else field
                for name, field in self._scene.fields(words).items() if name not in known]  # fmt: skip
        own = [option for option in self._own if isinstance(option, ParameterOption)]
        rest = [option for option in self._own if not isinstance(option, ParameterOption)]
        self.params = [*own, *parameter_options(more), *rest]
        return super().parse_args(ctx, args)


def _value_of(option: str, words: list[str]) -> str | None:
    """Return the value that follows the option `option` in the `words` of a command line; None if it is missing."""
    for place, word in enumerate(words):
        if word == option and place + 1 < len(words):
            return words[place + 1]
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return None


def parameter_options(fields: Iterable[Field]) -> list[click.Parameter]:
    """Return one option for each declared parameter in `fields`."""
    options: list[click.Parameter] = []
    for field in fields:
        name, default = field.name, field.default if field.default is not MISSING else None
        settings: dict[str, Any] = {
            "default": default,
            "help": field.help,
            "show_default": default not in (None, ""),
        }
        if field.kind is bool:
            option = ParameterOption([f"{flag(name)}/--no-{flag(name)[2:]}", name], **settings)
        else:
            option = ParameterOption([flag(name), name], type=kind_of(field, name), **settings)
        option.group, option.common = field.group, field.common
        options.append(option)
    return options


class Quantity(click.ParamType):
    """Option type that accepts a number, or a number with a common unit, such as "125 mm"."""

    name = "number"

    def __init__(self, field: Field, called: str) -> None:
        self.field, self.called = field, called

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the option's value as a number in the unit of its parameter."""
        return quantity_of(value, self.field, self.called)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the typed number, followed by each unit that the parameter accepts, as completions."""
        return completion.amounts(self.field.units, incomplete)


NO_NUMBERS = ("nan", "inf", "infinity")


def quantity_of(value: object, field: Field, called: str) -> float:
    """Convert the value of an option to a number in the unit of `field`.

    The value is a number, or a text such as "125 mm". `called` is the name of the option in error messages.
    """
    if isinstance(value, str) and value.strip().lower().lstrip("+-") in NO_NUMBERS:
        return float(value)  # NaN and infinity are refused later, when the parameter is checked.
    return amount(called, value, field.units)


class Word(click.ParamType):
    """Option type of a text; the shell completes its usual values, and paths of files if the text may be a path."""

    name = "text"

    def __init__(self, field: Field) -> None:
        self.field = field

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the usual values that begin with the typed text."""
        usual = [value for rule in self.field.of_kind(Suggests) for value in rule.values()]
        usual += [name for rule in self.field.of_kind(CompositeRule) for name in rule.short_names()]
        files = any(self.field.of_kind(FileIf)) or any(rule.files for rule in self.field.of_kind(Suggests))
        return completion.names(usual, incomplete, files=files)


def kind_of(field: Field, called: str) -> Any:
    """Return the Click type of the option that sets a parameter; `called` is the option's name in error messages."""
    if any(field.of_kind(CompositeRule)):
        return Word(field)
    choices = next((rule.choices for rule in field.of_kind(OneOf)), None)
    if choices and field.kind is str:
        return click.Choice(list(choices))
    if field.kind is str:
        return Word(field)
    return Quantity(field, called) if field.kind is float else field.kind


def flag(name: str) -> str:
    """Return the command-line option of a parameter, such as `--slip-yield` for `slip_yield`."""
    return "--" + name.replace("_", "-")


def given(values: Mapping[str, object], context: click.Context | None = None) -> dict[str, Any]:
    """Return the values of the options that the user stated on the command line, without defaults."""
    context = context or click.get_current_context()
    default = click.core.ParameterSource.DEFAULT
    return {name: value for name, value in values.items() if context.get_parameter_source(name) != default}


def check_scene(name: str | None, modules: Mapping[str, SceneModule], more: str = "") -> None:
    """Raise an error if no scene has this name; the error message lists the scenes, followed by the text `more`."""
    if name not in modules:
        hint = suggested(name, modules)
        raise click.UsageError(
            f"scene = {name!r}: must be one of {', '.join(modules)}{more}" + f"; {hint}" * bool(hint)
        )


def run_options() -> list[click.Parameter]:
    """Return the options that the runs of all scenes have."""
    colourings = list(dict.fromkeys(colour for method in METHODS for colour in method.display.colourings))
    return [
        click.Option(["--out"], type=click.Path(path_type=Path), help="New run folder  [default: runs/SCENE-NNN]"),
        click.Option(["--device"], help="Device: cpu, cuda, cuda:1 ...  [default: a GPU if there is one]",
                     shell_complete=lambda ctx, param, incomplete: completion.devices(incomplete)),
        click.Option(["--precision"], type=click.Choice(["float32", "float64"]), default="float32", show_default=True,
                     help="Precision of positions and forces"),
        click.Option(["--threads"], type=click.IntRange(1, 1024),
                     help="Number of threads of a CPU run, up to the number of cores  [default: one per core]"),
        click.Option(["--live"], is_flag=False, flag_value="spawn",
                     help="Watch the run in a new Rerun viewer, or in a running one if its URL is given"),
        click.Option(["--bind"], default="127.0.0.1", show_default=True,
                     help="IP address that the viewer of --live listens on"),
        click.Option(["--frames"], type=AmountOption("1/s"),
                     help="Recorded frames per simulated second; at most one per sample, or for flows one per step  "
                     "[default: 25, but at least 30 in the planned duration]"),
        click.Option(["--colour"], type=click.Choice(colourings),
                     help="Colour of aggregates (force, speed, size) or of a flow (speed, pressure, phase, shear)  "
                     "[default: force for aggregates; for flows shear with a free surface, phase with two phases, "
                     "else speed]"),
        click.Option(["--network"], is_flag=True,
                     help="Record bonds and force chains; the width of a chain shows its contact force"),
        *(
            click.Option([f"--{kind.name}/--no-{kind.name}"], default=kind.default, show_default=True, help=kind.help)
            for kind in RECORDERS
        ),
        click.Option(["--accuracy"],
                     shell_complete=lambda ctx, param, incomplete: completion.accuracies(incomplete),
                     help="Use the fastest settings whose error is at most this value, such as 5%, according to the "
                         "trade of --trade or to one that comes with the package"),
        click.Option(["--trade"], type=click.Path(path_type=Path),
                     help="Folder of a 'warpcrete trade' of this scene, for --accuracy"),
        click.Option(["--pipeline-vertical"], type=AmountOption("m"),
                     help="Height of a whole pipeline [m], for its total pressure (Eq. 13 of Zhan et al. 2019)"),
        click.Option(["--pipeline-horizontal"], type=AmountOption("m"),
                     help="Horizontal length of the whole pipeline [m], for its total pressure"),
        click.Option(["--pipeline-other"], type=click.Path(path_type=Path),
                     help="Run folder of a straight pipe in the other direction (level or vertical), for the total "
                         "pressure"),
        click.Option(["--checkpoint-every"], type=AmountOption("s"), default=60.0, show_default=True,
                     help="Wall time between two checkpoints [s]; 0 writes none"),
        click.Option(["--resume"], type=click.Path(path_type=Path),
                     help="Continue the interrupted run in this folder with the settings with which it began"),
        click.Option(["--quiet"], is_flag=True, help="Show no progress bar"),
        full_help_option(),
    ]  # fmt: skip
