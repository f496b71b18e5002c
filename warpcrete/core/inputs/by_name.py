"""Parameters whose values are objects, such as contact laws, and their plain form: a class name and numbers.

A parameter `contact` takes an object, or the name of its class: either a short name, or `package.module:Class`. Each
field of that class becomes a parameter of its own, `contact_FIELD`; fields of nested objects are flattened in the same
way. Records and command lines describe an object only by its class name and these numbers.

Importing a class runs the code of its module. A class named in Python or on the command line is imported. A class named
in a file is imported only if its module is loaded already, or if the user trusts the file (`warpcrete --trust`).
"""

import importlib
import inspect
import os
import sys
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import SceneError, refuse
from ..narrowing import is_list_or_tuple, is_mapping
from ..records import SceneArguments
from .fingerprints import fingerprint
from .origin import note_file
from .parameters import CompositeRule, Field, declared_fields

_from_file: ContextVar[bool] = ContextVar("from_file", default=False)
_trusted: ContextVar[bool] = ContextVar("trusted", default=False)


@contextmanager
def names_from_file() -> Generator[None]:
    """Forbid, inside the `with` block, imports of modules that an input file names; also usable as a decorator.

    Modules that are loaded already stay usable. Inside a :func:`trusted_files` block, the imports are allowed.
    """
    token = _from_file.set(True)
    try:
        yield
    finally:
        _from_file.reset(token)


@contextmanager
def trusted_files() -> Generator[None]:
    """Allow, inside the `with` block, imports of modules that input files name, because the user trusts the files."""
    token = _trusted.set(True)
    try:
        yield
    finally:
        _trusted.reset(token)


@contextmanager
def _folder_on_path() -> Generator[None]:
    """Add the current folder to the end of Python's module search path, inside the `with` block.

    `python -m` puts the current folder first. Here it comes last, so that a local file cannot hide an installed
    package.
    """
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
class ByName(CompositeRule):
    """Rule for a parameter whose value is an object of one of the `classes` (by short name) or of a user's class."""

    classes: Mapping[str, type]

    def __hash__(self) -> int:
        return hash(tuple(self.classes.items()))

    def fields(self, field: Field, value: object) -> dict[str, Field]:
        """Return the scene parameters that set the fields of the object `value`, by parameter name.

        `value` is an object of one of the allowed classes, or the name of such a class. The class has one parameter for
        each of its fields; the result is empty if the parameter accepts no such class.
        """
        kind = self.class_of(field, value)
        return {} if kind is None else own_fields(field.name, kind)

    def short_names(self) -> tuple[str, ...]:
        return tuple(self.classes)

    def with_objects(self, field: Field, values: Mapping[str, object]) -> dict[str, object]:
        """Return the parameters `values` with an object in place of its class name and of the object's own parameters.

        For example, the entries `contact` and `contact_FIELD` become one entry `contact` that holds the contact law.
        """
        parameters, value = dict(values), values.get(field.name)
        kind = self.class_of(field, value)
        if kind is not None:
            own = {key: parameters.pop(key) for key in own_fields(field.name, kind) if key in parameters}
            parameters[field.name] = _object(field.name, kind, value if isinstance(value, kind) else None, own)
        return parameters

    def to_plain(self, field: Field, value: object) -> tuple[dict[str, object], bool]:
        """Return an object's class name and field values, and whether an equal object can be made from them.

        No equal object can be made if the class cannot be imported by its name, or if it has a field that no annotation
        declares as a parameter.
        """
        if value is None:
            return {field.name: None}, True
        kind: type[Any] = type(value)
        _note_source(kind)
        own: SceneArguments = {}
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
        """Return the name by which :meth:`class_of` finds the class `kind`: its short name, or `module:Class`."""
        short = {each: name for name, each in self.classes.items()}
        return short.get(kind, f"{kind.__module__}:{kind.__qualname__}")

    def class_of(self, field: Field, value: object) -> type | None:
        """Return the class that the text `value` names, or the class of the object `value`; None if `value` is None.

        Raises :class:`SceneError` if that class does not exist or is not of the type that `field` requires.
        """
        if value is None:
            return None
        if isinstance(value, field.kind):
            kind: type[Any] = type(value)
            return kind
        if isinstance(value, str) and value in self.classes:
            return self.classes[value]
        words = f"must be one of {', '.join(self.classes)}, or 'module:Class' for a class of your own module"
        if not isinstance(value, str):
            refuse(field.name, value, f"{words}, or an object of a class derived from {field.kind.__name__}")
        if not _names_class(value):
            refuse(field.name, value, words)
        module, _, name = value.partition(":")
        return _imported(field, value, module, name)


def _names_class(text: str) -> bool:
    """Return whether a text has the form `package.module:Class`."""
    module, colon, name = text.partition(":")
    return bool(colon) and name.isidentifier() and all(part.isidentifier() for part in module.split("."))


def trust_option(record: object) -> str:
    """Return the option that a command needs before it may read `record` from a file: "--trust ", or an empty text.

    The option is needed if the record of parameters names, at any depth, a user's class as `package.module:Class`.
    """
    if isinstance(record, str):
        return "--trust " if _names_class(record) else ""
    inner: Iterable[object] = record.values() if is_mapping(record) else record if is_list_or_tuple(record) else ()
    return "--trust " if any(trust_option(each) for each in inner) else ""


def _imported(field: Field, value: str, module: str, name: str) -> type:
    if module not in sys.modules and _from_file.get() and not _trusted.get():
        problem = f"comes from a file, and loading the file would run the code of the module {module}"
        refuse(field.name, value, problem, f"if you trust it, import {module} first, or use 'warpcrete --trust ...'")
    try:
        with _folder_on_path():
            imported_class = getattr(importlib.import_module(module), name, None)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise SceneError(f"{field.name} = {value!r}: cannot be imported: {error}") from error
        refuse(field.name, value, f"there is no module {error.name!r} on Python's path",
               "run the command in the folder of the module, or set PYTHONPATH to this folder")  # fmt: skip
    except Exception as error:  # The import of a user's module may raise any exception.
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise SceneError(f"{field.name} = {value!r}: cannot be imported ({said})") from error
    if imported_class is None:
        hint = "move the class to a module file of its own" if module == "__main__" else "check the name of the class"
        refuse(field.name, value, f"the module {module!r} has no {name!r}", hint)
    return _checked(field, imported_class, value)


def _checked(field: Field, found: object, name: str) -> type:
    kind: type = field.kind
    if not (isinstance(found, type) and issubclass(found, kind) and is_dataclass(found)):
        refuse(field.name, name, f"must be a frozen dataclass that derives from {kind.__module__}:{kind.__name__}")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        refuse(field.name, name, f"does not define {', '.join(missing)}", "define these methods in the class")
    return found


def _note_source(kind: type) -> None:
    """Record the source file of a user's class among the input files of the scene."""
    if kind.__module__ == "__main__":
        return
    with suppress(TypeError, OSError):
        if source := inspect.getsourcefile(kind):
            note_file(Path(source))


def own_fields(name: str, kind: type) -> dict[str, Field]:
    """Return the fields of the class `kind` as parameters of a scene, each called `name` + "_" + its field name."""
    group = f"Parameters of {name.replace('_', ' ')} {kind.__name__}."
    return {key: replace(field, name=key, group=group) for key, (field, _) in _leaves(name, kind)}


def _leaves(name: str, kind: type) -> Iterator[tuple[str, tuple[Field, tuple[str, ...]]]]:
    """Yield a parameter for each number or text that an object of the dataclass `kind` holds.

    A field that holds another dataclass is replaced by the fields of that dataclass, and so on. Each result is (name of
    the parameter, (field, path)), where the path names the attributes that lead from the object to the value.
    """
    for own, field in declared_fields(kind).items():
        if is_dataclass(field.kind):
            for key, (leaf, path) in _leaves(f"{name}_{own}", field.kind):
                yield key, (leaf, (own, *path))
        else:
            yield f"{name}_{own}", (field, (own,))


def _object(name: str, kind: type, given: Any, values: Mapping[str, object]) -> object:
    """Return a new object of class `kind` with the field values in `values`.

    Other fields get their values from the object `given`, or their defaults if `given` is None. `name` is the scene's
    parameter for the object. The keys of `values` are the scene's parameters for the fields, each `name` + "_" + field.
    """
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
