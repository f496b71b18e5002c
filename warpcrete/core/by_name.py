"""Parameters whose values are objects of a declared class, such as contact laws: the class by name, its fields beside.

A parameter `contact` takes an object, or the name of its class: a short one, or `package.module:Class`. The class's own
fields are parameters as well, `contact_FIELD`, and so are the fields of an object among them. Records and the command
know the object by these names and numbers alone.

To import a class runs the code of its module. A name that Python or the command line gives is imported; one that a file
names only if its module is imported already, or the user trusts the file.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from .errors import SceneError, refuse
from .fingerprints import fingerprint
from .origin import note_file
from .parameters import Field, Spread, declared_fields

_from_file: ContextVar[bool] = ContextVar("from_file", default=False)
_trusted: ContextVar[bool] = ContextVar("trusted", default=False)


@contextmanager
def names_from_file() -> Iterator[None]:
    """Import no module, while the block runs, because a file names it; also a decorator."""
    token = _from_file.set(True)
    try:
        yield
    finally:
        _from_file.reset(token)


@contextmanager
def trusted_files() -> Iterator[None]:
    """Import the modules that files name all the same, while the block runs."""
    token = _trusted.set(True)
    try:
        yield
    finally:
        _trusted.reset(token)


@contextmanager
def _folder_on_path() -> Iterator[None]:
    """Find modules in the current folder as `python -m` does, but behind everything that is installed."""
    here = os.getcwd()
    if here in sys.path or "" in sys.path:
        yield
        return
    sys.path.append(here)
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(here)


@dataclass(frozen=True)
class ByName(Spread):
    """Rule of a parameter whose values are objects of the classes in `classes`, by short names, or of a user's own."""

    classes: Mapping[str, type]

    def __hash__(self) -> int:
        return hash(tuple(self.classes.items()))

    def fields(self, field: Field, value: Any) -> dict[str, Field]:
        """Return the fields of the class that a value names or belongs to, as parameters."""
        kind = self.class_of(field, value)
        return {} if kind is None else own_fields(field.name, kind)

    def assembled(self, field: Field, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return parameters with an object in place of its class's name and the parameters that belong to it."""
        found, value = dict(values), values.get(field.name)
        kind = self.class_of(field, value)
        if kind is not None:
            own = {key: found.pop(key) for key in own_fields(field.name, kind) if key in found}
            found[field.name] = _object(field.name, kind, value if isinstance(value, kind) else None, own)
        return found

    def written(self, field: Field, value: Any) -> tuple[dict[str, Any], bool]:
        """Return the name of an object's class and its fields, and whether these make the object again.

        They do not if the class cannot be found by its name, or has fields that are not declared.
        """
        if value is None:
            return {field.name: None}, True
        kind = type(value)
        _note_source(kind)
        own = {}
        for key, (_, path) in _leaves(field.name, kind):
            own[key] = value
            for step in path:
                own[key] = getattr(own[key], step)
        try:
            same = self.class_of(field, self.name_of(kind)) is kind
            same = same and fingerprint(_object(field.name, kind, None, own)) == fingerprint(value)
        except SceneError:
            same = False
        return {field.name: self.name_of(kind), **own}, same

    def name_of(self, kind: type) -> str:
        """Return the name by which :meth:`class_of` finds a class."""
        short = {each: name for name, each in self.classes.items()}
        return short.get(kind, f"{kind.__module__}:{kind.__qualname__}")

    def class_of(self, field: Field, value: Any) -> type | None:
        """Return the class that a value of `field` names or belongs to; None where it is not given.

        Raises :class:`SceneError` for a name that leads to no class of the field's kind.
        """
        if value is None:
            return None
        if isinstance(value, field.kind):
            return type(value)
        if isinstance(value, str) and value in self.classes:
            return self.classes[value]
        words = f"must be one of {', '.join(self.classes)}, or package.module:Class for your own class"
        if not isinstance(value, str):
            refuse(field.name, value, f"{words}, or an object of one of these classes")
        module, colon, name = value.partition(":")
        if not (colon and name.isidentifier() and all(part.isidentifier() for part in module.split("."))):
            refuse(field.name, value, words)
        return _imported(field, value, module, name)


def _imported(field: Field, value: str, module: str, name: str) -> type:
    if module not in sys.modules and _from_file.get() and not _trusted.get():
        refuse(field.name, value, "comes from a file and would run the code of this module",
               f"if you trust it, import {module} first, or use 'warpcrete --trust ...'")  # fmt: skip
    try:
        with _folder_on_path():
            found = getattr(importlib.import_module(module), name, None)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise SceneError(f"{field.name} = {value!r}: cannot be imported: {error}") from error
        refuse(field.name, value, f"there is no module {error.name!r} on Python's path",
               "start the program in the folder of the module, or set PYTHONPATH to that folder")  # fmt: skip
    except Exception as error:  # whatever a module of the user's raises
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise SceneError(f"{field.name} = {value!r}: cannot be imported ({said})") from error
    if found is None:
        hint = "move the class to a module file of its own" if module == "__main__" else "check the name of the class"
        refuse(field.name, value, f"the module {module!r} has no {name!r}", hint)
    return _checked(field, found, value)


def _checked(field: Field, found: Any, name: str) -> type:
    kind: type = field.kind
    if not (isinstance(found, type) and issubclass(found, kind) and is_dataclass(found)):
        refuse(field.name, name, f"must be a frozen dataclass that derives from {kind.__module__}:{kind.__name__}")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        refuse(field.name, name, f"does not define {', '.join(missing)}", "define them in the class")
    return found


def _note_source(kind: type) -> None:
    """Count the file of a user's class among the files that a scene reads."""
    if kind.__module__ == "__main__":
        return
    with suppress(TypeError, OSError):
        if source := inspect.getsourcefile(kind):
            note_file(Path(source))


def own_fields(name: str, kind: type) -> dict[str, Field]:
    """Return the fields of a class as parameters, whose names begin with `name`."""
    group = f"Parameters of {name.replace('_', ' ')} {kind.__name__}."
    return {key: replace(field, name=key, group=group) for key, (field, _) in _leaves(name, kind)}


def _leaves(name: str, kind: type) -> Iterator[tuple[str, tuple[Field, tuple[str, ...]]]]:
    """Yield parameter name, field and path from the object for each field that holds a plain value."""
    for own, field in declared_fields(kind).items():
        if is_dataclass(field.kind):
            for key, (leaf, path) in _leaves(f"{name}_{own}", field.kind):
                yield key, (leaf, (own, *path))
        else:
            yield f"{name}_{own}", (field, (own,))


def _object(name: str, kind: type, given: Any, values: Mapping[str, Any]) -> Any:
    """Return an object of a class: as `given`, with `values` in place of its own ones."""
    changes: dict[str, Any] = {}
    factories = {f.name for f in fields(kind) if f.default_factory is not MISSING}
    for own, field in declared_fields(kind).items():
        key = f"{name}_{own}"
        if is_dataclass(field.kind):
            inner = {k: v for k, v in values.items() if k in own_fields(key, field.kind)}
            if inner or (given is None and field.default is MISSING and own not in factories):
                changes[own] = _object(key, field.kind, getattr(given, own, None), inner)
        elif key in values:
            changes[own] = values[key]
        elif given is None and field.default is MISSING and own not in factories:
            refuse(key, None, f"is required by {name} {kind.__name__}: {field.help}")
    try:
        return kind(**changes) if given is None else replace(given, **changes)
    except SceneError as error:
        said = str(error).removeprefix(f"{getattr(kind, 'called', '')} ".lstrip())
        own = said.partition(" ")[0]
        raise SceneError(f"{name}_{said}" if own in declared_fields(kind) else str(error)) from error
