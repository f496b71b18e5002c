"""Constants, default values and limits of all modules, kept (see `kept`).

A changed constant, such as a tolerance or a factor of an empirical formula, often changes no result of a small test
run by more than its scatter. This test notices it at its definition.
"""

import ast
import dataclasses
import enum
import functools
import importlib
import inspect
import pkgutil

import click
import kept

import warpcrete
from warpcrete import scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import WarpcreteError
from warpcrete.core.inputs.parameters import Above, Within, declared_fields
from warpcrete.methods import METHODS, method_of
from warpcrete.standards.standard_test import TESTS


@functools.cache
def modules():
    """Return all modules of the package except kernels, by name; `__main__` would run the command."""
    names = {"warpcrete"} | {each.name for each in pkgutil.walk_packages(warpcrete.__path__[:1], "warpcrete.")}
    # The links of tests/link_folders.py show the scenes a second time below the package.
    names = {each for each in names if not each.startswith("warpcrete.scenes")}
    names |= {f"warpcrete.scenes.{each.name}" for each in pkgutil.iter_modules(scenes.__path__)}
    names = sorted(each for each in names if not each.endswith(".__main__") and ".kernels" not in each)
    return {name: importlib.import_module(name) for name in names}


def plain(value):
    """Return whether a value consists of numbers, truth values and single words."""
    if isinstance(value, str):
        return " " not in value and len(value) < 40
    if isinstance(value, dict):
        return bool(value) and all(plain(key) and plain(each) for key, each in value.items())
    if isinstance(value, tuple | list | set | frozenset):
        return bool(value) and all(map(plain, value))
    return value is None or isinstance(value, bool | int | float | enum.Enum)


def short(value):
    """Return a value as text; sets are sorted, and numbers keep nine digits."""
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{short(key)}: {short(each)}" for key, each in value.items()) + "}"
    if isinstance(value, set | frozenset):
        return short(sorted(value, key=str))
    if isinstance(value, tuple | list):
        return "(" + ", ".join(map(short, value)) + ")"
    return str(value)


UNKEPT = ("cli.", "core.device.", "core.drawing.", "dem.measure.display", "record.", "verification.")
"""Beginnings of the names of modules whose constants and defaults concern looks, waiting times or test cases."""


def attempt(function, *arguments):
    """Return a result, or the message of a refusal."""
    try:
        return function(*arguments)
    except WarpcreteError as error:
        return str(error)


def constants(module):
    """Yield name and value of each constant that a module defines."""
    for node in ast.parse(inspect.getsource(module)).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and name.id.isupper():
                    yield name.id, getattr(module, name.id)


def defaults(module):
    """Yield the default values of all functions, methods and dataclasses that a module defines."""
    for name, found in vars(module).items():
        if getattr(found, "__module__", "") != module.__name__:
            continue
        methods = [(f"{name}.{key}", each) for key, each in vars(found).items()] if inspect.isclass(found) else []
        for called, function in [(name, found), *methods]:
            function = inspect.unwrap(getattr(function, "__func__", function))
            if inspect.isfunction(function) and not function.__name__.startswith("__"):
                yield from ((f"{called}({key})", each) for key, each in inspect.signature(function).parameters.items())
        if inspect.isclass(found) and dataclasses.is_dataclass(found):
            for field in dataclasses.fields(found):
                if field.name in found.__annotations__:
                    yield f"{name}.{field.name}", field.default


def limits(module):
    """Yield the rules that bound the parameters of a module's dataclasses."""
    for name, found in vars(module).items():
        if inspect.isclass(found) and found.__module__ == module.__name__ and dataclasses.is_dataclass(found):
            try:
                fields = declared_fields(found)
            except NameError:  # Only type checkers import the types of its fields, which therefore declare no rules.
                continue
            for key, field in fields.items():
                bounds = [each for rule in field.of_kind(Above | Within) for each in dataclasses.astuple(rule)[:-1]]
                if key in found.__annotations__ and bounds:
                    yield f"{name}.{key} within", tuple(bounds)


def test_kept_constants_defaults_and_limits():
    lines = []
    for where, module in modules().items():
        where = where.removeprefix("warpcrete.")
        if where.startswith(UNKEPT):
            continue
        for name, value in (*constants(module), *defaults(module), *limits(module)):
            private = any(part.startswith("_") for part in name.split("("))
            value = value.default if isinstance(value, inspect.Parameter) else value
            if not private and value is not None and value is not inspect.Parameter.empty and plain(value):
                lines.append(f"{where} {name} = {short(value)}")
    kept.compare("constants", "\n".join(lines))


def test_kept_quantities_and_tests():
    """Names, units and marks of all results, and what else methods, standard tests and scenes declare in words."""
    lines = [
        f"{method.name}: {each.name} [{each.unit}] {each.label!r} compared {each.compared} rare {each.rare} "
        f"own words {each.words is not None}, column {each.title!r}"
        for method in METHODS
        for each in method.quantities
    ]
    for name, test in sorted(TESTS.items()):
        lines += [f"{name}: {key} = {short(each)}" for key, each in vars(test).items() if plain(each)]
        lines += [f"{name}: {each.name} {each.label!r} estimate {each.is_estimate}" for each in test.forms]
        lines += [f"{name}: {short(dataclasses.astuple(test.outflow)[:-1])}"] if test.outflow else []
    for name, module in scenes.modules().items():
        methods = {method: attempt(scenes.by_method, name, method) for method in ("dem", "mps", "suspension")}
        lines.append(f"{name}: {method_of(module.scene()).name}, {short(methods)}")
    kept.compare("quantities", "\n".join(lines))


MARKS = ("required", "multiple", "is_flag", "show_default")
"""Attributes of a command's option that are true or false."""


def options(command, called):
    """Yield a line for each option of a command and of its subcommands."""
    context = click.Context(command)
    for each in command.params:
        kind = type(each.type).__name__
        limits = [*getattr(each.type, "choices", ()), getattr(each.type, "min", None), getattr(each.type, "max", None)]
        marks = [name for name in MARKS if getattr(each, name, None) is True]
        # An enumeration of click's stands for a value that is not given; older versions have None or False.
        values = [*limits, each.default, getattr(each, "flag_value", None)]
        given = [value for value in values if not isinstance(value, enum.Enum | bool)]
        shown = [short(value) for value in given if value is not None and plain(value)]
        yield f"{called} {' '.join((*each.opts, *each.secondary_opts))}: {kind} {' '.join((*marks, *shown))}".strip()
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            if called != "run" or name in ("pipe", "slump"):
                found = command.get_command(context, name)
                assert found is not None
                yield from options(found, f"{called} {name}".strip())


def test_kept_options_of_commands():
    kept.compare("options", "\n".join(options(cli, "")))
