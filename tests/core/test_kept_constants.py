"""Constants of all modules, and defaults of all dataclasses and functions, kept (see `kept`).

Whoever changes one of them, by intention or by a slip of the keyboard, reads it in the difference of a kept file.
"""

import ast
import dataclasses
import enum
import importlib
import inspect
import pkgutil
from pathlib import Path

import kept
import pytest

PACKAGES = (
    "core",
    "dem",
    "geometry",
    "kernels",
    "mix",
    "mps",
    "record",
    "scenes",
    "standards",
    "studies",
    "suspension",
    "theory",
    "verification",
    "cli",
)


def modules_of(package):
    """The modules of a package, those of its packages included."""
    root = importlib.import_module(f"warpcrete.{package}")
    yield root
    for found in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
        yield importlib.import_module(found.name)


def is_plain(value):
    if isinstance(value, tuple | list | set | frozenset):
        return all(is_plain(each) for each in value)
    if isinstance(value, dict):
        return all(is_plain(each) for pair in value.items() for each in pair)
    if isinstance(value, str):
        return "\n" not in value
    return value is None or isinstance(value, int | float | bool | enum.Enum)


def defaults_of(function):
    found = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.default is not parameter.empty and is_plain(parameter.default):
            found[name] = parameter.default
    return found


def own(module):
    """Constants, and defaults of what a module itself defines, by name."""
    source = Path(module.__file__).read_text(encoding="utf-8")
    targets = [each.targets[0] for each in ast.parse(source).body if isinstance(each, ast.Assign)]
    assigned = {each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)}
    for name, value in sorted(vars(module).items()):
        if name in assigned and name.isupper() and is_plain(value):
            yield name, value
        if getattr(value, "__module__", None) != module.__name__:
            continue
        if dataclasses.is_dataclass(value) and isinstance(value, type):
            fields = {field.name: field.default for field in dataclasses.fields(value) if is_plain(field.default)}
            if fields:
                yield name, fields
        elif inspect.isfunction(value) and (found := defaults_of(value)):
            yield name, found


@pytest.mark.parametrize("package", PACKAGES)
def test_constants_are_kept(package):
    found = {module.__name__.removeprefix("warpcrete."): dict(own(module)) for module in modules_of(package)}
    kept.compare(f"constants-{package}", {name: values for name, values in sorted(found.items()) if values})
