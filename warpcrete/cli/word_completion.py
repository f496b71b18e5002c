"""Completion in a shell for commands such as `study`, whose own modules parse the scene, parameters and options."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from ..core.device.device import PRECISIONS
from ..core.errors import WarpcreteError
from ..core.inputs.hyphens import hyphenated
from ..core.inputs.parameters import Field
from ..core.run.scene_module import SceneModule
from ..methods import method_of
from ..scenes import METHODS, modules
from . import calibrate, explain, study, trade
from .completion import DEVICES, names, with_units
from .options import flag, kind_of
from .scene_commands import by_method

SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "study": dict.fromkeys(study.FLAGS, bool) | study.SETTINGS,
    "trade": trade.ONE | dict.fromkeys((*trade.SEVERAL, "quiet"), bool),
    "explain": explain.ONE | {"fresh": bool},
    "calibrate": calibrate.ONE | {"quiet": bool},
}
"""Options of each command whose own module parses its words: `SETTINGS[command][option]` is the type of the option's
value."""
VALUES: Mapping[str, Sequence[str]] = {
    "device": DEVICES, "precision": PRECISIONS, "scheduler": ("local", "slurm"), "method": METHODS,
}  # fmt: skip


def words(command: str, given: Sequence[str], incomplete: str, context: click.Context) -> list[CompletionItem]:
    """Return completions for a command whose own module parses the scene, the parameters and the options.

    `incomplete` is the word to be completed, and `given` holds the words before it. The last option in `given` decides
    which values are suggested, even if values follow it, because an option of `study` may have several values.
    """
    last = next((word for word in reversed(given) if word.startswith("--")), "--")[2:]
    if list(given[-2:-1]) == ["--method"]:
        # `--method` has one value, and this value is complete, so the word to be completed is not a further value.
        last = ""
    with suppress(click.UsageError, WarpcreteError):
        given = by_method(list(given))
    scene = next((word for word in given[:1] if not word.startswith("-")), None)
    module = None if scene is None else modules().get(scene)
    fields = {} if module is None else _fields(module, given)
    own = SETTINGS[command]
    if incomplete.startswith("-"):
        options = [flag(name) for name in dict.fromkeys([*own, *fields, *(() if scene is None else ("method",))])]
        return names(["--help", *options], incomplete)
    if last in VALUES:
        return names(VALUES[last], incomplete)
    if command == "trade" and last == "budget":
        return with_units(trade.UNITS, incomplete)
    if command == "trade" and last == "quantity" and module is not None:
        return names([each.name for each in method_of(module.scene()).quantities], incomplete)
    if command == "trade" and last == "knob" and module is not None:
        return names(map(hyphenated, _knobs(module, given)), incomplete)
    if last.replace("-", "_") in fields:
        field = fields[last.replace("-", "_")]
        if field.kind is bool:
            return names(("true", "false"), incomplete)
        kind = click.types.convert_type(kind_of(field, last))
        return kind.shell_complete(context, click.Option([f"--{last}"]), incomplete)
    if own.get(last) is Path or (scene is None and command == "calibrate"):
        return names((), incomplete, files=True)
    return names(modules(), incomplete) if scene is None else []


def _knobs(module: SceneModule, given: Sequence[str]) -> list[str]:
    """Return the names of the accuracy parameters (knobs) that `warpcrete trade` may vary for a scene.

    The words `given` hold the values of the scene's parameters, on which the list of knobs depends.
    """
    try:
        _, options = study.parsed(list(given))
        options = {name: each for name, each in options.items() if name not in (*trade.ONE, *trade.SEVERAL)}
        values = {name: each[0] for name, each in study.parameter_values(module, options).items()}
        scene = module.scene.declared(values)
    except (WarpcreteError, click.UsageError):
        scene = module.scene.declared({})
    trading = getattr(module, "trading", None)
    return [knob.name for knob in trading.knobs(scene) if len(knob.levels) > 1] if trading else []


def _fields(module: SceneModule, given: Sequence[str]) -> Mapping[str, Field]:
    """Return the parameters of a scene, including parameters of contact laws that the words `given` name.

    If these words are not a valid command yet, return only the scene's own parameters.
    """
    try:
        return study.fields_of(module, study.parsed(list(given))[1])
    except (WarpcreteError, click.UsageError):
        return study.fields_of(module, {})
