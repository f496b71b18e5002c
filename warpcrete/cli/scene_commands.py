"""Subcommands `run SCENE` and `run RUN/scene.json`; their options are built only when such a subcommand is used."""

import importlib
import importlib.util
import os
import re
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any

import click
from click.shell_completion import CompletionItem

from ..core.errors import WarpcreteError
from ..core.inputs.scene_titles import scene_titles
from .help_pages import METHOD_DEFAULTS, Commands, GroupedCommand, WordHelp

# Warp takes half a second to load, and so do the scenes. Each subcommand therefore loads the modules that it needs only
# when it is called.


def load(name: str) -> ModuleType:
    """Import and return the module `name` of the package `warpcrete.cli`."""
    return importlib.import_module(f"{__package__}.{name}")


def scenes() -> dict[str, ModuleType]:
    """Return a dictionary from the name of each scene to the Python module that defines the scene."""
    return importlib.import_module("warpcrete.scenes").modules()


def by_method(arguments: list[str]) -> list[str]:
    """Remove `--method NAME` from a command's words, and append the simulation method to the scene's name if necessary.

    For example, `slump --method dem` becomes `slump-dem`. `slump --method suspension` becomes `slump` with the
    parameters of aggregates that the scene sets for this method, unless the words state them.
    """
    return _by_method(arguments)[0]


def _by_method(arguments: list[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the result of :func:`by_method`, and the added options with their values."""
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
        return left, []
    place = next((n for n, word in enumerate(left) if not word.startswith("-")), None)
    if place is None:
        raise click.UsageError("--method: needs the name of a scene; write, for example, 'slump --method dem'")
    if any(not word.startswith("-") for word in left[place + 1 : place + 2]):
        raise click.UsageError(
            f"--method: applies to one scene; leave out '{left[place + 1]}', or write the full names of scenes without "
            "--method, such as 'slump-dem lbox-dem'"
        )
    scenes, name = importlib.import_module("warpcrete.scenes"), left[place]
    left[place] = scenes.by_method(name, method)
    known = {word.partition("=")[0] for word in left}
    bend = "--unit=bend" in "=".join(left)
    values = scenes.suspended(name, bend) if method == "suspension" else {}
    options = ((f"--{key.replace('_', '-')}", str(value)) for key, value in values.items())
    added = [(option, value) for option, value in options if option not in known]
    return [*left[: place + 1], *chain.from_iterable(added), *left[place + 1 :]], added


def titles() -> dict[str, str]:
    """Return the titles of all scenes by the scenes' names, without importing the scenes."""
    package = importlib.util.find_spec("warpcrete.scenes")
    assert package is not None and package.submodule_search_locations is not None
    return scene_titles(Path(package.submodule_search_locations[0]))


class LazyGroup(Commands):
    """Group of subcommands whose options are built only when a subcommand is used."""

    def descriptions(self, ctx: click.Context) -> dict[str, str]:
        return titles()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            args, ctx.meta[METHOD_DEFAULTS] = _by_method(args)
        except (click.UsageError, WarpcreteError):
            # Ignore errors while a shell completes the command line, because its last word is not complete yet.
            if not ctx.resilient_parsing:
                raise
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(scenes())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name.endswith(".json"):
            return _repeat_command(Path(cmd_name))
        modules = scenes()
        return _scene_command(cmd_name, modules[cmd_name]) if cmd_name in modules else None

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and not ctx.resilient_parsing and self.get_command(ctx, args[0]) is None:
            more = ", or the path of a scene.json"
            if args[0].endswith((".yaml", ".yml")):
                more += "; use the file of a line as 'warpcrete line FILE', and of a concrete as --concrete FILE"
            load("options").check_scene(args[0], scenes(), more)
        return super().resolve_command(ctx, args)


class WordCommand(WordHelp):
    """Command that passes its words (scene, parameters and options) to its own module, which parses them.

    A shell can still complete the words, with the functions of the module `word_completion`.
    """

    def __init__(self, name: str, **settings: Any) -> None:
        words = click.Argument(["arguments"], nargs=-1, type=click.UNPROCESSED, shell_complete=_complete_word)
        context = {"ignore_unknown_options": True}
        super().__init__(name, **settings | {"params": [words], "context_settings": context, "add_help_option": False})

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the scenes, options or values that begin with the typed text."""
        return load("word_completion").words(self.name, ctx.params.get("arguments") or (), incomplete, ctx)


def _complete_word(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    return context.command.shell_complete(context, incomplete)


def _scene_command(name: str, module: ModuleType) -> click.Command:
    options = load("options")
    fields = importlib.import_module("warpcrete.core.inputs.parameters").declared_fields(module.scene.parameters)
    common = {option.name for option in options.run_options() if option.expose_value}

    def callback(**values: object) -> None:
        given = options.given(values)
        settings = {key: values.pop(key) for key in common}
        resume = settings.pop("resume")
        accuracy, trade = settings.pop("accuracy"), settings.pop("trade")
        job = load("run")
        if resume is None:
            parameters = {key: value for key, value in given.items() if key not in common}
            if accuracy is not None or trade is not None:
                stated_parameters = parameters | {key: given[key] for key in ("precision",) if key in given}
                changes = load("advice").chosen(name, module, stated_parameters, accuracy, trade, settings["device"])
                if "precision" not in given:
                    settings["precision"] = changes.pop("precision", settings["precision"])
                parameters = module.scene.effective_values(module.scene.resolved(parameters) | changes)
            job.run(name, module, parameters, settings)
            return
        changed = [key for key in given if key not in ("resume", "quiet", "live", "bind")]
        if changed:
            raise click.UsageError(
                f"resume = '{resume}': a run continues with the settings with which it began; leave out "
                f"{', '.join(changed)}"
            )
        same_test = importlib.import_module("warpcrete.scenes").methods(name).values()
        job.resume(
            resume, scenes(), {name, *same_test}, live=settings["live"], bind=settings["bind"], quiet=settings["quiet"]
        )

    own = options.parameter_options(field for key, field in fields.items() if key not in common)
    return options.SceneCommand(
        name, module.scene, params=own + _method_options(name) + options.run_options(), callback=callback,
        help=help_text(module.scene.description),
    )  # fmt: skip


def _method_options(name: str) -> list[click.Parameter]:
    """Return a list with the option `--method`, or an empty list if only one method can simulate the scene.

    The option serves the help page and completion in a shell only, because :func:`by_method` removes it from the words
    before the command is parsed.
    """
    methods = importlib.import_module("warpcrete.scenes").methods(name)
    meanings = {
        "mps": "flow (mps)",
        "dem": "discrete elements (dem)",
        "suspension": "flow with aggregates (suspension)",
    }
    help_line = f"Simulate the same test by another method: {', '.join(meanings[each] for each in methods)}"
    choice = click.Choice(list(methods))
    return [click.Option(["--method"], type=choice, expose_value=False, help=help_line)] if len(methods) > 1 else []


def help_text(docstring: str) -> str:
    """Return the help text of a command from a docstring, without sentences on Python exceptions."""
    kept = [part for part in docstring.split("\n\n") if not part.lstrip().startswith("Raises ")]
    return re.sub(r"\s*Raises\s+:class:`[^`]*`[^.]*\.", "", "\n\n".join(kept))


def _repeat_command(path: Path) -> click.Command:
    options = load("options")

    def callback(**settings: object) -> None:
        job = load("run")
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
        record, module = job.repeatable_scene(path, scenes())
        kept = {key: record[key] for key in ("device", "precision") if key in record}
        if "threads" in record.get("command", {}):
            kept["threads"] = min(record["command"]["threads"], os.cpu_count() or 1)
        job.run(record["scene"], module, record["parameters"], settings | kept | options.given(settings))

    return GroupedCommand(str(path), params=options.run_options(), callback=callback, help="Repeat a saved run.")
