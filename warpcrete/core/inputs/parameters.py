"""Declared parameters: dataclass fields whose annotations give type, help text, unit and rules.

A field is annotated as `Annotated[type, help, rule, ...]` or `Annotated[type | None, help, rule, ...]`. The help text
contains the unit in brackets. These fields define the checks of a dataclass (:class:`Declared`), the keywords of a
scene function (:func:`scene_function`) and the options of the command.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import os
import re
import sys
import textwrap
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import SceneError, known_names, one_of, quoted, refuse
from ..narrowing import is_numpy_number
from .amounts import UNITS, amount
from .limits import check_limit, check_whole
from .origin import Arguments, files_read

WORDS = {float: "a number", int: "a whole number", str: "text", bool: "True or False"}

NUMERIC = re.compile(r"\s*[-+]?\.?\d")
"""Pattern of the beginning of a text that is meant as a number."""

P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True)
class Above:
    """Rule that a value must be a finite number above `lower`."""

    lower: float = 0.0
    hint: str = ""

    def check(self, name: str, value: float, unit: str) -> None:
        if not math.isfinite(value) or value <= self.lower:
            refuse(name, value, f"must be a finite number above {self.lower:g}{unit}", self.hint)


@dataclass(frozen=True)
class Within:
    """Rule that a value must be a finite number in [lower, upper]."""

    lower: float = -math.inf
    upper: float = math.inf
    hint: str = ""

    def check(self, name: str, value: float, unit: str) -> None:
        if math.isfinite(value) and self.lower <= value <= self.upper:
            return
        span = f"in [{self.lower:g}, {self.upper:g}]" if math.isfinite(self.upper) else "finite"
        if math.isfinite(self.lower) and not math.isfinite(self.upper):
            span = f"finite and at least {self.lower:g}"
        refuse(name, value, f"must be {span}{unit}", self.hint)


@dataclass(frozen=True)
class OneOf:
    """Rule that a value must be one of `choices`, which are words or numbers."""

    choices: tuple[object, ...]

    def check(self, name: str, value: object, unit: str) -> None:
        one_of(name, value, self.choices)


@dataclass(frozen=True)
class Needs:
    """Rule that a parameter has a meaning only if `test` holds for the value of another parameter, `field`.

    If there are further parameters `others`, it is enough that `test` holds for one of them.
    """

    field: str
    test: Callable[[Any], bool]
    words: str
    """Condition as words that follow the name of the parameter `field` in a message, such as "is given"."""
    others: tuple[str, ...] = ()

    def holds(self, value: Callable[[str], Any]) -> bool:
        """Return whether `test` holds for the parameter `field` or one of `others`; `value(name)` returns a value."""
        return any(self.test(value(name)) for name in (self.field, *self.others))


@dataclass(frozen=True)
class FileIf:
    """Rule that a text for which `test` holds names a file.

    The text is stored as an absolute path, which is valid in any working folder.
    """

    test: Callable[[str], bool]


@dataclass(frozen=True)
class Suggests:
    """Rule that lists usual values of a text, which shells complete; every other value remains allowed."""

    values: Callable[[], Iterable[str]]


@dataclass(frozen=True)
class Alias:
    """Another name of a parameter; `convert` turns a value given under this name into the parameter's value."""

    name: str
    convert: Callable[[Any], Any] | None = None


class CompositeRule:
    """Rule of a parameter whose value is an object with parameters of its own.

    For example, the contact law in the parameter `contact` has the parameters `contact_FIELD`. The module
    :mod:`warpcrete.core.inputs.by_name` explains these parameters.
    """

    def fields(self, field: Field, value: object) -> dict[str, Field]:
        """Return the parameters of the object `value` by name, such as `contact_FIELD` for the field `contact`."""
        raise NotImplementedError

    def short_names(self) -> tuple[str, ...]:
        """Return the names of classes whose objects the parameter accepts."""
        raise NotImplementedError

    def with_objects(self, field: Field, values: Mapping[str, object]) -> dict[str, object]:
        """Return a copy of the parameters `values` in which `field` has an object as its value.

        The object is made from the value of `field` and from the parameters that belong to it, which are removed.
        """
        raise NotImplementedError

    def to_plain(self, field: Field, value: object) -> tuple[dict[str, object], bool]:
        """Return the parameters that describe an object `value` of `field` as numbers and texts, by name.

        The second result is True if `with_objects` makes an equal object from these parameters.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Field:
    """Declared parameter, as parsed from the annotation of a dataclass field."""

    name: str
    kind: type
    optional: bool
    """True if the parameter may be None."""
    help: str
    rules: tuple[object, ...]
    default: Any
    """Default value of the parameter; `dataclasses.MISSING` if the parameter is required."""
    group: str
    """First line of the docstring of the class that declares the field; it is the heading of a group in help texts."""
    common: bool = True
    """True if the short help of the command shows the parameter."""

    @property
    def unit(self) -> str:
        """Unit from the brackets in the help text, with a leading space; empty if there is none."""
        found = re.search(r"\[([^\]]+)\]", self.help)
        return f" {found.group(1)}" if found else ""

    @property
    def units(self) -> str:
        """Unit of the field as a key of :data:`UNITS`, which lists the units that a user may write."""
        return self.unit.strip() if self.unit.strip() in UNITS else "1"

    @property
    def described(self) -> str:
        """Help text, followed by those choices and other names of the parameter that the text does not mention."""
        choices = [str(choice) for rule in self.of_kind(OneOf) for choice in rule.choices]
        words = re.findall(r"[\w.-]+", self.help)
        missing = [choice for choice in choices if choice not in words]
        others = [alias.name for alias in self.of_kind(Alias)]
        return (
            self.help
            + (f"; one of {', '.join(choices)}" if missing else "")
            + (f"; also {', '.join(others)}" if others else "")
        )

    def of_kind(self, kind: type[T]) -> Iterator[T]:
        """Return those rules of the field that are instances of `kind`."""
        return (rule for rule in self.rules if isinstance(rule, kind))

    def converted(self, value: object, name: str) -> Any:
        """Return `value` converted to the field's type; raises :class:`SceneError` if that is impossible.

        NumPy numbers become Python numbers, integers become floats if the field is a float, and texts such as "125 mm"
        become numbers in the field's unit.
        """
        if is_numpy_number(value):
            value = value.item()
        if value is None and self.optional:
            return None
        value = self.number(value, name)
        if self.kind is float and isinstance(value, int) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:
                refuse(name, value, "is too large to compute with", "give a smaller value, in SI units")
        if self.kind is int and isinstance(value, int) and not isinstance(value, bool):
            check_whole(name, value)
        if self.kind is float and isinstance(value, float):
            # Adding 0.0 turns -0.0 into 0.0, so that both zeros give the same text and fingerprint.
            return value + 0.0
        if self.kind is str and hasattr(value, "__fspath__"):
            return str(value)
        if not isinstance(value, self.kind) or (isinstance(value, bool) and self.kind is not bool):
            words = WORDS.get(self.kind, f"a {self.kind.__name__}")
            refuse(name, value, f"must be {words}{' or None' if self.optional else ''}")
        if isinstance(value, str) and "\0" in value:
            refuse(name, value, "contains a NUL character", "remove it")
        if isinstance(value, str) and any(rule.test(value) for rule in self.of_kind(FileIf)):
            return os.path.realpath(value)
        return value

    def number(self, value: object, name: str) -> object:
        """Return a text such as "125 mm" as a number in the field's unit; return anything else unchanged."""
        if self.kind is float and isinstance(value, str) and NUMERIC.match(value):
            return amount(name, value, self.units)
        return value

    def check_limits(self, value: object, name: str) -> None:
        """Refuse a number that is impossible in any scene, and warn about an unlikely number."""
        if isinstance(value, float):
            check_limit(name, value, self.unit.strip(), self.name)

    def check(self, value: Any, name: str) -> None:
        """Raise :class:`SceneError` if `value` breaks a rule of the field."""
        if value is not None:
            for rule in self.rules:
                if isinstance(rule, Above | Within | OneOf):
                    rule.check(name, value, self.unit)


@functools.cache
def declared_fields(owner: type) -> dict[str, Field]:
    """Return the annotated fields of a dataclass by name, first those of its bases, each in order of definition.

    A dataclass may have an attribute `common` with the names of those of its own fields that the short help of the
    command shows; without it, the help shows all of them.
    """
    hints = get_type_hints(owner, include_extras=True)
    own = [base for base in owner.__mro__ if dataclasses.is_dataclass(base)]
    found: dict[str, Field] = {}
    defaults = {f.name: f.default for f in dataclasses.fields(owner)}
    for base in [*own[1:], owner]:
        group = (inspect.getdoc(base) or "").partition("\n")[0]
        for name in inspect.get_annotations(base):
            if name in defaults and hasattr(hints[name], "__metadata__") and name not in found:
                kind, text, *rules = get_args(hints[name])
                optional = get_origin(kind) in (Union, types.UnionType)
                if optional:
                    kind = next(k for k in get_args(kind) if k is not type(None))
                common = name in base.__dict__.get("common", (name,))
                found[name] = Field(name, kind, optional, text, tuple(rules), defaults[name], group, common)
    return found


class Declared:
    """Base class of frozen dataclasses that convert and check their annotated fields when an object is made."""

    called: ClassVar[str] = ""
    """Word that error messages put before the name of a field."""

    def __post_init__(self) -> None:
        for name, field in declared_fields(type(self)).items():
            shown = f"{self.called} {name}".strip()
            value = field.converted(getattr(self, name), shown)
            object.__setattr__(self, name, value)
            field.check(value, shown)

    @classmethod
    def of_concrete(cls) -> tuple[str, tuple[str, ...]]:
        """Return the section of a concrete's file that can set fields of this dataclass, and the names of these fields.

        Both are empty for a dataclass whose fields a concrete's file cannot set.
        """
        return "", ()

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> Mapping[str, object]:
        """Return parameters that follow from the given ones, such as those of a concrete that is given by name."""
        return {}

    def check_needed(self) -> None:
        """Raise :class:`SceneError` if a parameter has no effect but differs from its default."""
        for name, field in declared_fields(type(self)).items():
            for rule in field.of_kind(Needs):
                if getattr(self, name) != field.default and not rule.holds(lambda each: getattr(self, each)):
                    either = " or ".join(map(repr, (rule.field, *rule.others)))
                    refuse(name, getattr(self, name), f"has no effect unless {either} {rule.words}",
                           f"leave out {name!r}, or change {rule.field!r}")  # fmt: skip


def _listed(fields: Iterable[Field]) -> str:
    """Return the text about parameters for `help()`, by group, with type, default, help text and unit of each."""
    lines: list[str] = []
    group = ""
    for field in fields:
        if field.group != group:
            group = field.group
            lines += ["", group.rstrip(".")]
        lines += [f"    {field.name}: {_kind_of(field)}", *textwrap.wrap(
            field.described, 100, initial_indent=8 * " ", subsequent_indent=8 * " ")]  # fmt: skip
    return "\n".join(["Parameters, all by name; a number may be a text with its unit, such as '125 mm':", *lines])


def _kind_of(field: Field) -> str:
    """Return type and default of a parameter in words, such as "a number, default 0.15 m"."""
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
        self.__doc__ = f"{self.description}\n\n{_listed(declared_fields(parameters).values())}"
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
        # With this method, `help` and documentation tools treat a scene function as a function and show its signature.
        return self

    def __repr__(self) -> str:
        return f"<scene function {self.name}>"

    @property
    def module(self) -> types.ModuleType:
        """Python module that contains this scene function, the scene's checks and the scene's knobs."""
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
            refuse("parameters", args, "must be given by name, as in name=value", f"the names are {', '.join(known)}")
        values = self.with_objects(self.completed(given))
        for name in values:
            if name not in known:
                refuse("parameter", name, f"is not a parameter of scene {self.name}",
                       known_names(name, known))  # fmt: skip
        try:
            for name, value in values.items():  # Check each value by itself before values are combined.
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

    @property
    def name(self) -> str:
        """Name of the scene on the command line, such as `pipe` in `warpcrete run pipe`."""
        return self._module_name.rpartition(".")[2].replace("_", "-")

    def _plain_values(self, parameters: Declared) -> tuple[dict[str, object], tuple[str, ...]]:
        """Return the parameters with each object replaced by its class name and numbers.

        The second result has the names of parameters whose objects cannot be made again from these plain values.
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
        """Return all parameters that can be given, by name.

        These are the declared fields of the scene, and the fields of the objects in `given`, such as those of a contact
        law.
        """
        known = dict(declared_fields(self.parameters))
        for name, field in list(known.items()):
            for rule in field.of_kind(CompositeRule):
                known |= {key: each for key, each in rule.fields(field, given.get(name)).items() if key not in known}
        return known

    def with_objects(self, values: Mapping[str, object]) -> dict[str, Any]:
        """Return parameters with an object, such as a contact law, in place of its name and its own parameters.

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
        """Return the arguments with which a scene was made, without parameters that were left at their defaults."""
        names = self.completed(given)
        declared = declared_fields(self.parameters)
        return {name: value for name, value in scene.parameters.items() if name in names or name not in declared}

    def declared(self, given: Mapping[str, object]) -> Any:
        """Return an instance of the parameters' dataclass.

        Each field has the given value, or else a value that the given ones imply, or else its default.
        """
        return self.parameters(**self.with_objects(self.completed(given)))

    def completed(self, given: Mapping[str, object]) -> dict[str, Any]:
        """Return parameters by name, with aliases replaced, together with parameters that follow from the given ones.

        For example, the name of a concrete implies its parameters. Implied parameters that have no effect are left out.
        """
        values = self.resolved(given)
        implied = {name: value for name, value in self.parameters.implied(values).items() if name not in values}
        if not implied:
            return values
        meant = self._effective(implied | values)
        return values | {name: value for name, value in implied.items() if name in meant}

    def effective_values(self, given: Mapping[str, object]) -> dict[str, Any]:
        """Return the given parameters by name, with aliases replaced, without parameters that have no effect."""
        values = self.resolved(given)
        meant = self._effective({**self.parameters.implied(values), **values})
        return {name: value for name, value in values.items() if name in meant}

    def _effective(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return those parameters in `values` that have an effect, given the values of the others."""
        known = declared_fields(self.parameters)
        composite = {name: field for name, field in known.items() if any(field.of_kind(CompositeRule))}

        def meant(name: str) -> bool:
            if name not in known and any(name.startswith(f"{each}_") for each in composite):
                return name in self.fields({each: values[each] for each in composite if each in values})
            rules = known[name].of_kind(Needs) if name in known else iter(())
            return all(rule.holds(converted) for rule in rules)

        def converted(name: str) -> object:
            return held(name) if name in composite else known[name].converted(held(name), name)

        def held(name: str) -> object:
            return values.get(name, known[name].default)

        # Repeat until nothing changes, because a removed parameter may be a condition for other parameters.
        while any(not meant(name) for name in values):
            values = {name: value for name, value in values.items() if meant(name)}
        return values

    def resolved(self, given: Mapping[str, object]) -> dict[str, Any]:
        """Return the parameters with each alias replaced by the parameter's own name.

        Texts such as "125 mm" are converted to numbers.
        """
        return resolved(declared_fields(self.parameters), given)


def resolved(known: Mapping[str, Field], given: Mapping[str, object]) -> dict[str, Any]:
    """Return the values `given` with each alias replaced by the field's own name.

    Texts such as "125 mm" are converted to numbers.
    """
    values: dict[str, Any] = dict(given)
    for name, field in known.items():
        if name in values:
            values[name] = field.number(values[name], name)
        for alias in field.of_kind(Alias):
            if alias.name in values:
                value = field.number(values.pop(alias.name), alias.name)
                if name in values:
                    refuse(
                        alias.name,
                        value,
                        f"is another name of {name!r}, which is given too",
                        f"leave out {alias.name!r} or {name!r}",
                    )
                try:
                    values[name] = alias.convert(value) if alias.convert and value is not None else value
                except TypeError as error:
                    raise SceneError(f"{alias.name} = {value!r}: {error}") from error
    return values


def scene_function(parameters: Callable[P, T]) -> Callable[[Callable[[T], S]], SceneFunction[P, S]]:
    """Return a decorator that turns a function of one :class:`Declared` dataclass into a function of its fields.

    The resulting :class:`SceneFunction` takes the fields as keywords, accepts their aliases and has the dataclass as
    attribute `parameters`. It refuses values that have the wrong type, are out of range or have no effect.
    """

    def decorate(build: Callable[[T], S]) -> SceneFunction[P, S]:
        return SceneFunction(parameters, build)  # type: ignore[arg-type]

    return decorate
