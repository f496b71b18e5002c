"""Command `warpcrete study`: runs a scene for all combinations of parameter values and prints a table."""

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from ..core.device.device import PRECISIONS
from ..core.errors import RunFolderError, SceneError, suggested
from ..core.inputs.amounts import listed
from ..core.inputs.by_name import trust_option
from ..core.inputs.parameters import CompositeRule, Field, OneOf, Suggests
from ..core.run.files import next_folder, read_record
from ..core.run.folder_kinds import wrong_folder
from ..core.run.progress import Progress
from ..core.run.scene_module import SceneModule
from ..record.recorders import RECORDERS
from ..studies.api import study_progress
from ..studies.study import resume_study, run_study, written_units
from ..studies.study_result import Study
from .exits import CHECK_FAILED, INTERRUPTED
from .options import check_scene, quantity_of

CASE_FAILED = 1
"""Exit code of a parameter study in which a case ended with an error."""
RECORDER_NAMES = tuple(kind.name for kind in RECORDERS)
FLAGS = ("one-at-a-time", *RECORDER_NAMES, "quiet")
ON_WORKERS = {"scheduler": str, "workers": int}
SETTINGS = {
    **ON_WORKERS,
    "repeat": int,
    "out": Path,
    "resume": Path,
    "device": str,
    "precision": str,
    "processes": int,
    "frames": str,
    "checkpoint-every": str,
}


EXECUTION_SETTINGS = ("processes", *ON_WORKERS)
"""Names of the settings that decide on which devices or machines the cases of a study run. These settings may change
when a study is continued."""


def _execution_settings(settings: Mapping[str, object]) -> dict[str, Any]:
    return {name: settings.get(name) for name in EXECUTION_SETTINGS}


def parsed(arguments: list[str]) -> tuple[str | None, dict[str, list[str]]]:
    """Split the words of a command line into the scene's name and the values that follow each `--option`.

    The name is None if it is missing. The keys of the dictionary are the names of the options without dashes.
    """
    scene = None
    options: dict[str, list[str]] = {}
    current: list[str] | None = None
    for word in arguments:
        if word.startswith("--"):
            name, given, value = word[2:].partition("=")
            name = name.replace("_", "-")
            if name in FLAGS:
                if given:
                    raise click.UsageError(f"--{name}: takes no value; leave out the value after it")
                options[name], current = [], None
                continue
            if name in options:
                raise click.UsageError(f"--{name}: is given twice; write --{name} once, with all values after it")
            current = options.setdefault(name, [value] if given else [])
        elif current is not None:
            current.append(word)
        elif scene is None:
            scene = word
        else:
            raise click.UsageError(
                f"{word!r}: follows no option; write every value after its option, as in --velocity 0.3 0.5"
            )
    return scene, options


def run(arguments: list[str], modules: dict[str, SceneModule]) -> None:
    """Start a new parameter study or continue an interrupted one, and print its table."""
    scene, options = parsed(arguments)
    settings = _take_settings(options)
    with study_progress(settings["quiet"]) as tell:
        if settings.get("resume") is not None:
            study = _resumed(scene, options, settings, modules, tell)
        else:
            study = _new_study(scene, options, settings, modules, tell)
    report(study)
    again = f"warpcrete {trust_option([case.parameters for case in study.cases])}study --resume {study.folder}"
    if not study.finished:
        click.echo(f"continue with: {again}")
        raise SystemExit(INTERRUPTED)
    if study.failures:
        if study.lost:
            click.echo(f"repeat {', '.join(study.lost)} with: {again}")
        raise SystemExit(CASE_FAILED)
    if study.suspect:
        click.echo("\n".join(failed_lines(study)))
        raise SystemExit(CHECK_FAILED)


NAMED_CASES = 2
"""Maximum number of cases that the output names for each failed check; `study.suspect` has all of them."""
SIZES = (
    "with the default stiffness of aggregates, pressures by discrete elements fall with their largest size, but they "
    "grow in the paper of Zhan et al., so do not draw conclusions from this trend; see the page "
    "'validation/pumping.md' of the documentation"
)
"""Warning that a study prints if it varies the largest size of aggregates and compares pressures."""


def report(study: Study) -> None:
    """Print the table of results, the failed cases with their reasons, and the folder of the study."""
    click.echo()
    if any(each.name in result for result in study.results.values() for each in study.quantities):
        click.echo(study.markdown())
    if "size_max" in study.varied and any("pressure" in each.name for each in study.compared):
        click.echo(f"note: {SIZES}")
    met = {name for result in study.results.values() for name in result}
    for each in study.quantities:
        # If no case has a value of this quantity, a value was possible only if its condition names a result of the
        # study.
        possible = each.name in met or any(f"'{other}'" in each.only_if for other in met)
        if each.only_if and possible and any(each.name not in result for result in study.results.values()):
            click.echo(f"note: a case has a value of {each.title} only if {each.only_if}")
    for name, message in study.failures.items():
        click.echo(f"failed: {name}: {message}")
    click.echo(f"\n{study.progress}; study folder: {study.folder}")


def failed_lines(study: Study) -> list[str]:
    """Return lines about failed checks: their number, and for each check its cases and what the first one found.

    What a check found includes its usual cure.
    """
    lines = [f"FAILED: checks of {len(study.suspect)} of {len(study.cases)} cases; do not use their results"]
    for check in dict.fromkeys(name for checks in study.suspect.values() for name in checks):
        cases = [case for case, checks in study.suspect.items() if check in checks]
        several = f"  {check}, in {len(cases)} case{'s' * (len(cases) > 1)} ({', '.join(cases[:NAMED_CASES])}"
        more = f" and {len(cases) - NAMED_CASES} more" if len(cases) > NAMED_CASES else ""
        lines.append(f"{several}{more}); the first one: {study.results[cases[0]]['checks'][check]['found']}")
    return lines


def single(options: dict[str, list[str]], kinds: Mapping[str, object]) -> dict[str, Any]:
    """Remove the options that are keys of `kinds` from `options`, and return their values by name.

    Each of these options must have exactly one value, which is converted to the type that `kinds` states.
    """
    values_by_name = {}
    for name in kinds.keys() & options.keys():
        values = options.pop(name)
        if len(values) != 1:
            raise click.UsageError(f"--{name}: needs one value, but has {len(values)}; write one value after --{name}")
        values_by_name[name] = converted(name, values[0], kinds[name])
    return values_by_name


def _take_settings(options: dict[str, list[str]]) -> dict[str, Any]:
    """Remove the settings of the parameter study from `options`, and return the values of these settings by name.

    The options that remain in `options` are parameters of the scene.
    """
    settings: dict[str, Any] = {}
    for name in FLAGS:
        values = options.pop(name, None)
        if values:
            raise click.UsageError(f"--{name}: takes no value; leave out the value after it")
        settings[name] = values is not None
    settings |= single(options, SETTINGS)
    if settings.get("processes", 1) < 1:
        raise click.UsageError(f"--processes = {settings['processes']}: must be 1 or more")
    if settings.get("precision", PRECISIONS[0]) not in PRECISIONS:
        raise click.UsageError(f"precision = {settings['precision']!r}: must be {' or '.join(PRECISIONS)}")
    return settings


def _resumed(
    scene: str | None,
    options: dict[str, list[str]],
    settings: dict[str, Any],
    modules: dict[str, SceneModule],
    tell: Progress,
) -> Study:
    folder = settings["resume"]
    given = [n for n in settings if n not in ("resume", "quiet", *EXECUTION_SETTINGS) and settings[n]] + list(options)
    if scene is not None or given:
        raise click.UsageError(
            f"resume = '{folder}': a study continues with the settings with which it began; leave out the scene's name "
            "and all other options"
        )
    return resume_study(
        folder, recorded_module(folder, "study", modules), progress=tell, **_execution_settings(settings)
    )


def recorded_module(folder: Path, kind: str, modules: Mapping[str, SceneModule]) -> Any:
    """Return the Python module of the scene that an earlier study in `folder` simulated.

    `kind` is `study` or `trade`; the file study.json or trade.json in the folder names the scene. `modules` maps the
    name of each scene to its module. Raises :class:`RunFolderError` if this file is missing, or if the scene does not
    exist in this version.
    """
    record = f"{kind}.json"
    if not (folder / record).is_file():
        raise RunFolderError(f"resume = '{folder}': {wrong_folder(folder, record)}")
    name = read_record(folder / record).get("scene")
    if name not in modules:
        raise RunFolderError(
            f"'{folder}': its scene {name!r} does not exist in this version, which has "
            f"{', '.join(modules)}; start a new study"
        )
    return modules[name]


def _new_study(
    scene: str | None,
    options: dict[str, list[str]],
    settings: dict[str, Any],
    modules: dict[str, SceneModule],
    tell: Progress,
) -> Study:
    check_scene(scene, modules)
    module = modules[scene]
    lists = parameter_values(module, options, ("processes",))
    return run_study(
        scene,
        module,
        {name: values for name, values in lists.items() if len(values) > 1},
        base={name: values[0] for name, values in lists.items() if len(values) == 1},
        out=settings.get("out") or next_folder("study"),
        repeat=settings.get("repeat", 1),
        one_at_a_time=settings["one-at-a-time"],
        device=settings.get("device"),
        precision=settings.get("precision", PRECISIONS[0]),
        **_execution_settings(settings),
        frames=settings.get("frames"),
        checkpoint_every=settings.get("checkpoint-every", 60.0),
        progress=tell,
        units=written_units(module.scene, {name.replace("-", "_"): words for name, words in options.items()}),
        **{name: settings[name] for name in RECORDER_NAMES},
    )


def fields_of(module: SceneModule, options: Mapping[str, list[str]]) -> dict[str, Field]:
    """Return a scene's parameters by name, including the parameters of the contact laws that the user chose.

    `module` is the scene's Python module. `options` maps the name of each option to the words that follow it; the words
    after an option such as `contact` are names of contact laws.
    """
    fields: dict[str, Field] = {}
    for name, field in module.scene.fields({}).items():
        fields[name] = field
        for word in options.get(name.replace("_", "-"), []) if any(field.of_kind(CompositeRule)) else []:
            fields = module.scene.fields({name: word}) | fields
    return fields


def parameter_values(
    module: SceneModule, options: dict[str, list[str]], settings: tuple[str, ...] = ()
) -> dict[str, list[Any]]:
    """Convert the words in `options` to values of the scene's parameters; return a list of values by parameter name.

    If `options` names an unknown parameter, the error message may suggest a parameter, or one of the command's other
    options, whose names are in `settings`.
    """
    known = fields_of(module, options)
    values: dict[str, list[Any]] = {}
    for option, words in options.items():
        negative = option.startswith("no-") and option[3:].replace("-", "_") in known
        name = (option[3:] if negative else option).replace("-", "_")
        if name not in known:
            hint = suggested(name, (*known, *settings))
            hint = hint.replace("_", "-").replace("'", "")
            raise click.UsageError(
                f"--{option}: is not a parameter of this scene; "
                + (hint or "'warpcrete run SCENE --help-all' lists its parameters").replace("you mean ", "you mean --")
            )
        kind = known[name].kind
        if negative and (words or kind is not bool):
            raise click.UsageError(f"--{option}: takes no value; leave out the value after it")
        if kind is bool:
            words = words or ["false" if negative else "true"]
        if not words:
            raise click.UsageError(f"--{option}: needs one or more values; write the values after it")
        values[name] = [_value(option, word, known[name]) for word in words]
    return values


def _value(option: str, word: str, field: Field) -> Any:
    """Return the value of a parameter from the text `word` that follows the option `option`.

    If `word` is a list such as "0.1,0.2", the error message says that spaces separate the values.
    """
    try:
        return _converted_value(option, word, field)
    except (SceneError, click.UsageError) as error:
        if field.kind in (int, float) and re.fullmatch(r"[-+.0-9eE]+(?::|\.\.)[-+.0-9eE:]+", word):
            raise click.UsageError(
                f"--{option} = {word!r}: is a range; write every value, separated by spaces"
            ) from None
        if "thousands" in str(error) or not _is_list(option, word, field):
            raise
    values = " ".join(f"'{each}'" if " " in each else each for each in listed(word))
    raise click.UsageError(
        f"--{option} = {word!r}: is a list; separate the values by spaces, as in --{option} {values}"
    )


def _is_list(option: str, word: str, field: Field) -> bool:
    """Return whether `word` consists of several values of a parameter, separated by commas or semicolons."""
    with suppress(SceneError, click.UsageError):
        pieces = listed(word)
        return len(pieces) > 1 and all(_converted_value(option, each, field) is not None for each in pieces)
    return False


def _converted_value(option: str, word: str, field: Field) -> Any:
    """Return `word` converted to the type of a parameter."""
    if field.kind is float:
        return quantity_of(word, field, option)
    usual = {str(each) for rule in field.of_kind(OneOf) for each in rule.choices}
    usual |= {each for rule in field.of_kind(Suggests) for each in rule.values()}
    if field.kind is str and len(names := listed(word)) > 1 and usual.issuperset(names):
        raise click.UsageError(f"--{option} = {word!r}: must be one name")
    return converted(option, word, field.kind)


def converted(name: str, word: str, kind: Any) -> Any:
    if kind is bool:
        if word.lower() not in ("true", "false", "yes", "no", "1", "0"):
            raise click.UsageError(f"--{name} = {word!r}: must be true or false")
        return word.lower() in ("true", "yes", "1")
    try:
        return kind(word) if kind in (int, float, Path) else word
    except ValueError:
        words = {float: "a number", int: "a whole number"}.get(kind, kind.__name__)
        raise click.UsageError(f"--{name} = {word!r}: must be {words}") from None
