"""Pages that are written from the program: the commands, the scenes, the contact laws, and all modules."""

import dataclasses
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

import warpcrete
from warpcrete import scenes
from warpcrete.cli import options
from warpcrete.cli.help_pages import summary
from warpcrete.cli.main import cli
from warpcrete.core.inputs.parameters import WORDS, Above, Field, OneOf, Within, declared_fields
from warpcrete.core.run.method import Quantity
from warpcrete.dem.laws.choice import LAWS
from warpcrete.methods import method_of
from warpcrete.standards import TESTS

OPTION = re.compile(r"(?<![\w-])(--[a-z][\w-]*)")
INTERNAL = ("warpcrete.kernels", "warpcrete.cli", "warpcrete.scenes", "warpcrete.__main__")
"""Packages without pages of their own: kernels are internal, commands and scenes have a reference of another kind."""
OPEN = ("warpcrete.kernels.dem.contact_law", "warpcrete.kernels.common.types")
"""Modules of internal packages that a contact law uses."""


def write(folder: Path) -> None:
    """Write all generated pages into `folder`; leave files alone whose text stays the same, and remove others."""
    pages = {**command_pages(), **scene_pages(), **law_pages(), **module_pages()}
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("*"):
        if path.is_file() and path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def cell(text: object) -> str:
    """Return a text as it stands in a cell of a Markdown table."""
    words = re.sub(r"\s+", " ", str(text)).strip()
    if "`" in words:
        return words.replace("|", r"\|").replace("<", "&lt;")
    return re.sub(r"([|<*_\\$~])", r"\\\1", words)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def toctree(names: Iterable[str]) -> str:
    """Return a hidden table of contents."""
    return "\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"


# Commands


def option_rows(params: Iterable[click.Parameter], context: click.Context) -> list[list[str]]:
    """Return a row for each option of a command: its names, and its help text with its default."""
    rows = []
    for param in params:
        if isinstance(param, click.Argument):
            rows.append([f"`{param.make_metavar(context)}`", "Argument"])
        elif (record := param.get_help_record(context)) is not None:
            names, _, kind = record[0].partition("  ")
            rows.append([f"`{names}{kind}`".replace("|", "\\|"), cell(record[1])])
    return rows


def prose(text: str) -> str:
    """Return a help text as Markdown: blocks that Click must not wrap become code."""
    text = inspect.cleandoc(text).replace("``", "`")
    parts = []
    for block in re.split(r"\n\s*\n", text):
        if block.startswith("\b"):
            parts.append("```\n" + block.lstrip("\b\n") + "\n```")
        elif all(line.startswith("  ") for line in block.splitlines()):
            parts.append("```\n" + inspect.cleandoc(block) + "\n```")
        else:
            block = re.sub(r":\w+:`([^`]+)`", r"`\1`", block)
            pieces = re.split(r"(`[^`]+`)", block)
            pieces[::2] = [OPTION.sub(r"`\1`", re.sub(r"([<*])", r"\\\1", piece)) for piece in pieces[::2]]
            parts.append("".join(pieces))
    return "\n\n".join(parts)


def command_pages() -> dict[str, str]:
    """Return a page for each command, and one for the options that every run has."""
    context = click.Context(cli, info_name="warpcrete")
    pages, rows = {}, []
    for name in sorted(cli.commands):
        command = cli.commands[name]
        child = click.Context(command, info_name=name, parent=context)
        usage = command.get_usage(child).removeprefix("Usage: ")
        rows.append([f"[`warpcrete {name}`](command-{name}.md)", cell(summary(command.help or ""))])
        text = f"# warpcrete {name}\n\nWhat does `warpcrete {name}` do, and which options does it have?\n\n"
        text += f"```text\n{usage}\n```\n\n{prose(command.help or '')}\n\n"
        listed = option_rows(command.get_params(child), child)
        if listed:
            text += "## Options\n\n" + table(["option", "meaning"], listed)
        if name in ("run", "study", "trade", "explain"):
            text += "\nThe parameters of a scene are options, too: see [scenes](scenes.md)."
            text += " [Options of every run](run-options.md) lists the options that all scenes share.\n"
        text += "\n## Not covered\n\nThe [how-to guides](../../how-to/index.md) show the command at work.\n"
        pages[f"command-{name}.md"] = text
    shared = click.Context(click.Command("run"), info_name="run", parent=context)
    pages["run-options.md"] = (
        "# Options of every run\n\nWhich options does `warpcrete run SCENE` have, whatever the scene is?\n\n"
        + table(["option", "meaning"], option_rows(options.run_options(), shared))
        + "\n## Not covered\n\nThe parameters of each scene are on the [page of the scene](scenes.md).\n"
    )
    general = option_rows(cli.get_params(context), context)
    pages["commands.md"] = (
        "# Commands\n\nWhich commands does `warpcrete` have? These pages are generated from the program.\n\n"
        + table(["command", "what it does"], rows)
        + "\nThe following options stand before the command:\n\n"
        + table(["option", "meaning"], general)
        + "\n## Not covered\n\n[Checks and exit codes](../exit-codes.md) explains what the commands return.\n"
        + toctree([*(f"command-{name}" for name in sorted(cli.commands)), "run-options"])
    )
    return pages


# Scenes and laws


def rules(field: Field) -> str:
    """Return the values that a parameter allows, in words."""
    found = []
    for rule in field.rules:
        if isinstance(rule, Above):
            found.append(f"above {rule.lower:g}")
        elif isinstance(rule, Within):
            span = f"{rule.lower:g} to {rule.upper:g}"
            found.append(span.replace("-inf to inf", "finite").replace(" to inf", " or more"))
        elif isinstance(rule, OneOf):
            found.append(", ".join(f"`{choice}`" for choice in rule.choices))
    return "; ".join(found) or {bool: "yes or no"}.get(field.kind, WORDS.get(field.kind, field.kind.__name__))


def default(field: Field) -> str:
    """Return the default of a parameter, in words."""
    if field.default is dataclasses.MISSING:
        return "required"
    if field.default is None:
        return "-"
    return f"`{field.default:g}`" if isinstance(field.default, float) else f"`{field.default}`"


def parameter_tables(fields: Iterable[Field]) -> str:
    """Return tables of parameters, one for each group."""
    groups: dict[str, list[Field]] = {}
    for field in fields:
        groups.setdefault(field.group.rstrip("."), []).append(field)
    return "\n".join(f"## {title or 'Parameters'}\n\n{parameters(members)}" for title, members in groups.items())


def parameters(fields: Iterable[Field]) -> str:
    """Return a table of parameters: the meaning with its unit comes second, where a narrow screen still shows it."""
    rows = [[f"`{f.name}`", cell(f.help), default(f), rules(f)] for f in fields]
    return table(["parameter", "meaning", "default", "allowed"], rows)


def results(module: Any) -> str:
    """Return a table of the results of a scene, and one for `--method suspension` if its results differ."""
    plain, suspended = ([[f"`{each.name}`", "-" if each.unit == "1" else each.unit, cell(worded(each))]
                         for each in quantities_of(module.scene(**given))]
                        for given in ({}, getattr(module, "suspension", {})))  # fmt: skip
    head = ["result", "unit", "meaning"]
    if plain == suspended:
        return table(head, plain)
    return f"{table(head, plain)}\n### Results of `--method suspension`\n\n{table(head, suspended)}"


def worded(each: Quantity) -> str:
    """Return the meaning of a quantity, with the condition under which a run has it."""
    return f"{each.meaning}; only if {each.only_if}" if each.only_if else each.meaning


def quantities_of(made: Any) -> list[Quantity]:
    """Return the quantities that the method of a scene declares, without those of other standard tests."""
    test = getattr(made, "test", None) or getattr(getattr(made, "vessel", None), "test", None)
    own = {each.name for each in test.with_forms()} if test else set()
    others = {each.name for other in TESTS.values() for each in other.with_forms()} - own
    return [each for each in method_of(made).quantities if each.name not in others]


def scene_pages() -> dict[str, str]:
    """Return a page for each scene, and a list of scenes."""
    pages, rows = {}, []
    for name, module in scenes.modules().items():
        plain = name.replace("-", "_")
        rows.append([f"[`{name}`](scene-{name}.md)", cell((inspect.getdoc(module) or "").partition("\n")[0])])
        pages[f"scene-{name}.md"] = (
            f"# Scene {name}\n\nWhat does the scene `{name}` simulate, and which parameters does it have?\n\n"
            f"```text\nwarpcrete run {name} [options]\nwarpcrete.scenes.{plain}(parameter=value, ...)\n```\n\n"
            f"{prose(module.scene.description)}\n\n"
            "A parameter `some_name` is the option `--some-name` of the command and a keyword in Python. A number may "
            'have a unit, as in `--flow "30 m3/h"`.\n\n'
            f"{parameter_tables(declared_fields(module.scene.parameters).values())}\n"
            "## Results\n\nA run has those of the following results that its parameters determine. In Python, "
            '`run["name"]` returns a result. The name `suspect` in the table of a study counts finished runs in which '
            f"a check failed.\n\n{results(module)}\n"
            "## Not covered\n\n[Options of every run](run-options.md) lists device, precision and recording. "
            "[Input files](../input-files.md) lists the units that a number may have.\n"
        )
    pages["scenes.md"] = (
        "# Scenes\n\nWhich scenes can I run, and where are their parameters? These pages are generated from the "
        "declared parameters.\n\n"
        + table(["scene", "what it simulates"], rows)
        + "\n## Not covered\n\n[A scene of your own](../../how-to/own-scene.md) shows how to build other scenes.\n"
        + toctree(f"scene-{name}" for name in scenes.modules())
    )
    return pages


def law_pages() -> dict[str, str]:
    """Return one page with the parameters of all contact laws."""
    text = "# Contact laws\n\nWhich contact laws does the option `--contact` know, with which parameters?\n\n"
    text += "A parameter `some_name` of a law is the option `--contact-some-name`, and the keyword `some_name` of its "
    text += "class in Python.\n\n"
    for name, law in LAWS.classes.items():
        text += f"## {name}\n\nClass `{law.__module__}.{law.__name__}`\n\n{prose(inspect.getdoc(law) or '')}\n\n"
        text += parameters(declared_fields(law).values()) + "\n"
    text += "## Not covered\n\n[A contact law of your own](../../how-to/own-contact-law.md) shows how to write a law."
    text += " The [theory of discrete elements](../../theory/elements.md) derives the forces.\n"
    return {"laws.md": text}


# Modules


def all_modules() -> dict[str, list[str]]:
    """Return the public modules of each package, by the package's name."""
    found: dict[str, list[str]] = {}
    # In a checkout, kernels and scenes lie in the second folder of the package's path, next to folders that are no part
    # of the package.
    walked = {info.name: info.ispkg for info in pkgutil.walk_packages(warpcrete.__path__[:1], "warpcrete.")}
    for name, is_package in (walked | dict.fromkeys(OPEN, False)).items():
        if name in OPEN or (not name.startswith(INTERNAL) and not any(p.startswith("_") for p in name.split("."))):
            package = name if is_package else name.rpartition(".")[0]
            modules = found.setdefault(package, [])
            if not is_package and public_names(name):
                modules.append(name)
    return {name: modules for name, modules in found.items() if modules}


def public_names(module: str) -> list[str]:
    """Return the names of the classes, functions and documented constants that a module defines."""
    loaded = importlib.import_module(module)
    return [name for name, value in vars(loaded).items()
            if not name.startswith("_") and getattr(value, "__module__", None) == module]  # fmt: skip


def exported(module: str) -> set[str]:
    """Return the classes of a module that the package exports: they have pages of their own."""
    loaded = vars(importlib.import_module(module))
    named = loaded.get("__all__", ())
    return {name for name in dir(warpcrete) if inspect.isclass(loaded.get(name))
            and (loaded[name].__module__ == module or name in named)}  # fmt: skip


def module_pages() -> dict[str, str]:
    """Return a page for each package with all modules in it, and a list of packages."""
    pages, rows = {}, []
    for package, modules in sorted(all_modules().items()):
        about = inspect.getdoc(importlib.import_module(package)) or ""
        rows.append([f"[`{package}`](module-{package}.md)", cell(about.partition("\n")[0])])
        text = f"# {package}\n\nWhich classes and functions do the modules of `{package}` have?\n\n"
        text += f"```{{eval-rst}}\n.. automodule:: {package}\n   :no-members:\n```\n\n"
        for module in modules:
            left = ", ".join(sorted(exported(module)))
            text += f"## {module.removeprefix('warpcrete.')}\n\n```{{eval-rst}}\n.. automodule:: {module}\n"
            text += f"   :members:\n{f'   :exclude-members: {left}' if left else ''}\n```\n\n"
            text += f"{left}: see [Python interface](../python.md).\n\n" if left else ""
        text += "## Not covered\n\nThis page omits names that begin with an underscore, because they are internal. "
        text += "The page on [stability](../stability.md) says which parts may change.\n"
        pages[f"module-{package}.md"] = text
    pages["modules.md"] = (
        "# All modules\n\nWhere is the class or function that I look for? These pages list every module except the "
        "kernels. [Python interface](../python.md) lists the stable names.\n\n"
        + table(["package", "what lives there"], rows)
        + "\n## Not covered\n\nKernels, which run on the device, are internal; "
        "[architecture](../../development/architecture.md) shows where to start reading them.\n"
        + toctree(f"module-{package}" for package in sorted(all_modules()))
    )
    return pages
