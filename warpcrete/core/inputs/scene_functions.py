"""Scene functions, which take declared parameters as keywords and return a scene."""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import sys
import textwrap
import types
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, ParamSpec, TypeVar

from ..errors import SceneError, known_names, quoted, refuse
from ..records import SceneArguments
from .origin import Arguments, files_read
from .parameters import WORDS, CompositeRule, Declared, Field, Needs, T, declared_fields
from .text_files import errors_located_at
from .yaml_files import merged

P = ParamSpec("P")
S = TypeVar("S")


def _listed(fields: Iterable[Field]) -> str:
    """Return the text about parameters for `help()`: by group, each with its type, default, help text and unit."""
    lines: list[str] = []
    group = ""
    for field in fields:
        if field.group != group:
            group = field.group
            lines += ["", group.rstrip(".")]
        lines += [
            f"    {field.name}: {_kind_of(field)}",
            *textwrap.wrap(field.described, 100, initial_indent=8 * " ", subsequent_indent=8 * " "),
        ]
    return "\n".join(["Parameters, all by name; a number may be a text with its unit, such as '125 mm':", *lines])


def _kind_of(field: Field) -> str:
    """Return the type and the default of a parameter as a text, such as "a number, default 0.15 m"."""
    kind = WORDS.get(field.kind, f"a name or an object of {field.kind.__name__}")
    if field.default is dataclasses.MISSING:
        return f"{kind}, required"
    if field.default is None:
        return f"{kind}, optional"
    unit = field.unit if field.kind is float and field.units != "1" else ""
    return f"{kind}, default {field.default!r}{unit}"


class SceneFunction(Generic[P, S]):
    """Function that makes a scene from keywords, which are the fields of the dataclass `parameters`.

    The decorator :func:`scene_function` creates such functions. Name, signature and docstring, which `help` and editors
    show, come from the declared parameters.
    """

    def __init__(self, parameters: type[Declared], build: Callable[[Any], S]) -> None:
        self.parameters, self._build = parameters, build
        self.description = inspect.getdoc(build) or ""
        # Replace Sphinx roles such as :class:`Run`, because `help` and editors would show them unchanged.
        text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", self.description)
        self.__doc__ = f"{text}\n\n{_listed(declared_fields(parameters).values())}"
        self.__name__ = self.__qualname__ = self.name.replace("-", "_")
        self.__module__ = build.__module__
        kind = inspect.Parameter.KEYWORD_ONLY
        self.__signature__ = inspect.Signature(
            [
                inspect.Parameter(f.name, kind, default=f.default, annotation=f.kind | None if f.optional else f.kind)
                for f in declared_fields(parameters).values()
            ]
        )

    def __get__(self, instance: object, owner: type | None = None) -> SceneFunction[P, S]:
        # Objects with this method are descriptors, which `help` and documentation tools show like functions.
        return self

    def __repr__(self) -> str:
        return f"<scene function {self.name}>"

    @property
    def module(self) -> types.ModuleType:
        """Python module with this scene function, the scene's checks and its settings that trade accuracy for time."""
        return sys.modules[self._module_name]

    @property
    def _module_name(self) -> str:
        """Name of the scene's Python module.

        A file NAME.py may contain the functions `scene` and `scene_dem`, for two simulation methods. The package
        `scenes` then makes a second module NAME_dem for `scene_dem`.
        """
        second = getattr(self._build, "__name__", "") == "scene_dem"
        return self._build.__module__ + ("_dem" if second else "")

    def __call__(self, *args: P.args, **given: P.kwargs) -> S:
        known = declared_fields(self.parameters)
        if args:
            hint = f"such as {next(iter(known))}=...; help(warpcrete.scenes.{self.__name__}) lists them"
            refuse("parameters", args, "must be given by name, as in name=value", hint)
        completed = self.completed(given)
        values = self.with_objects(completed)
        for name in values:
            if name not in known:
                problem = f"is not a parameter of scene {self.name}"
                refuse("parameter", name, problem, self._elsewhere(name) or known_names(name, known))
        try:
            for name, value in values.items():  # Check each value by itself before values are combined.
                with errors_located_at(completed, name):
                    made = known[name].converted(value, name)
                    known[name].check(made, name)
                    known[name].check_limits(made, name)
            parameters = self.parameters(**values)
            parameters.check_needed()
            with files_read() as files:
                scene = self._build(parameters)
                values, unwritable = self._plain_values(parameters)
            object.__setattr__(scene, "parameters", Arguments.of(scene, self.name, values, files, unwritable))
            return scene
        except MemoryError as error:
            raise SceneError(
                f"scene {self.name}: needs more memory than is available; make the scene smaller, or its bodies or "
                "cells larger"
            ) from error
        except (OverflowError, ZeroDivisionError) as error:
            numbers = {name: value for name, value in values.items()
                       if (isinstance(value, float) and value and math.isfinite(value))
                       or (isinstance(value, int) and 0 < value.bit_length() < 1000)}  # fmt: skip
            if not numbers:
                raise
            name = max(numbers, key=lambda each: abs(math.log(abs(numbers[each]))))
            raise SceneError(
                f"{name} = {quoted(numbers[name])}: is too large to compute with; give a smaller value, in SI units"
            ) from error

    def _elsewhere(self, name: str) -> str:
        """Return a hint if the same test by discrete elements has the parameter `name`; return an empty text if not."""
        package = sys.modules.get(self._build.__module__.rpartition(".")[0])
        other = getattr(package, f"{self.__name__}_dem", None)
        if isinstance(other, SceneFunction) and (name == "method" or name in declared_fields(other.parameters)):
            return f"use warpcrete.scenes.{other.__name__}, the same test by discrete elements"
        return ""

    @property
    def name(self) -> str:
        """Name of the scene on the command line, such as `pipe` in `warpcrete run pipe`."""
        return self._module_name.rpartition(".")[2].replace("_", "-")

    def _plain_values(self, parameters: Declared) -> tuple[dict[str, object], tuple[str, ...]]:
        """Return the parameters with each object replaced by its class name and numbers.

        The second result contains the names of parameters whose objects cannot be made again from these plain values.
        """
        values: dict[str, object] = {}
        unwritable: list[str] = []
        for name, field in declared_fields(self.parameters).items():
            values[name] = getattr(parameters, name)
            for rule in field.of_kind(CompositeRule):
                plain, same = rule.to_plain(field, values[name])
                values |= plain
                unwritable += [] if same else [name]
        return values, tuple(unwritable)

    def fields(self, given: Mapping[str, object]) -> dict[str, Field]:
        """Return all parameters that this scene function accepts, by name.

        The result contains the declared fields of the scene, and the fields of objects in `given`, for example of a
        contact law.
        """
        known = dict(declared_fields(self.parameters))
        for name, field in list(known.items()):
            for rule in field.of_kind(CompositeRule):
                known |= {key: each for key, each in rule.fields(field, given.get(name)).items() if key not in known}
        return known

    def with_objects(self, values: Mapping[str, object]) -> SceneArguments:
        """Return the parameters with an object, such as a contact law, in place of its class name and its parameters.

        Raises :class:`SceneError` for a parameter, such as `contact_FIELD`, that this object does not have.
        """
        found = dict(values)
        for field in declared_fields(self.parameters).values():
            for rule in field.of_kind(CompositeRule):
                found = rule.with_objects(field, found)
                for name in found:
                    if name.startswith(f"{field.name}_") and name not in declared_fields(self.parameters):
                        value = values.get(field.name)
                        own = ", ".join(rule.fields(field, value))
                        other = f"leave out {name!r}, or change {field.name!r}"
                        hint = f"the parameters of {value!r} are {own}" if own else other
                        refuse(name, found[name], f"has no effect with {field.name} = {value!r}", hint)
        return found

    def plain(self, scene: Any, given: Mapping[str, object]) -> dict[str, Any]:
        """Return the arguments with which `scene` was made, without parameters that the user left at their defaults.

        `given` holds the parameters that the user stated. The result also contains parameters that follow from these.
        """
        names = self.completed(given)
        declared = declared_fields(self.parameters)
        return {name: value for name, value in scene.parameters.items() if name in names or name not in declared}

    def declared(self, given: Mapping[str, object]) -> Any:
        """Return an object of the dataclass that declares the parameters of this scene.

        Each field has its value in `given`. A field that is not in `given` has the value that other parameters in
        `given` imply, or else its default.
        """
        return self.parameters(**self.with_objects(self.completed(given)))

    def completed(self, given: Mapping[str, object]) -> SceneArguments:
        """Return the parameters in `given`, by name, together with parameters that follow from them.

        For example, the name of a concrete implies its parameters. Implied parameters that have no effect are left out.
        The result knows the file and line of each parameter that comes from a file.
        """
        values = self.resolved(given)
        implied = merged(self.parameters.implied(values))
        for name in values:
            implied.pop(name, None)
        if not implied:
            return values
        meant = self._effective(merged(implied, values))
        for name in set(implied).difference(meant):
            del implied[name]
        return merged(values, implied)

    def effective_values(self, given: Mapping[str, object]) -> SceneArguments:
        """Return the parameters in `given` that have an effect, by name."""
        values = self.resolved(given)
        meant = self._effective({**self.parameters.implied(values), **values})
        return {name: value for name, value in values.items() if name in meant}

    def _effective(self, values: Mapping[str, object]) -> Mapping[str, Any]:
        """Return the parameters in `values` that have an effect; this may depend on the values of other parameters."""
        known, origins = declared_fields(self.parameters), values
        composite = {name: field for name, field in known.items() if any(field.of_kind(CompositeRule))}

        def meant(name: str) -> bool:
            if name not in known and any(name.startswith(f"{each}_") for each in composite):
                return name in self.fields({each: values[each] for each in composite if each in values})
            rules = known[name].of_kind(Needs) if name in known else iter(())
            return all(rule.holds(converted) for rule in rules)

        def converted(name: str) -> object:
            with errors_located_at(origins, name):
                return held(name) if name in composite else known[name].converted(held(name), name)

        def held(name: str) -> object:
            return values.get(name, known[name].default)

        # Repeat until nothing changes, because a removed parameter may be a condition for other parameters.
        while any(not meant(name) for name in values):
            values = {name: value for name, value in values.items() if meant(name)}
        return values

    def resolved(self, given: Mapping[str, object]) -> SceneArguments:
        """Return the parameters in `given` with texts such as "125 mm" converted to numbers."""
        return resolved(declared_fields(self.parameters), given)


def resolved(known: Mapping[str, Field], given: Mapping[str, object]) -> SceneArguments:
    """Return the values `given` with texts such as "125 mm" converted to numbers in the units of the fields `known`."""
    return {name: known[name].number(value, name) if name in known else value for name, value in given.items()}


def scene_function(parameters: Callable[P, T]) -> Callable[[Callable[[T], S]], SceneFunction[P, S]]:
    """Return a decorator for functions whose only argument is an object of the dataclass `parameters`.

    The decorated function is a :class:`SceneFunction`, which takes the fields of the dataclass as keywords. It refuses
    values that have the wrong type, are out of range or have no effect.
    """

    def decorate(build: Callable[[T], S]) -> SceneFunction[P, S]:
        return SceneFunction(parameters, build)  # type: ignore[arg-type]

    return decorate
