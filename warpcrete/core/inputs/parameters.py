"""Declared parameters: dataclass fields whose annotations give type, help text, unit and rules.

A field is annotated as `Annotated[type, help, rule, ...]` or `Annotated[type | None, help, rule, ...]`. The help text
contains the unit in brackets. These fields define the checks of a dataclass (:class:`Declared`), the keywords of a
scene function (:mod:`.scene_functions`) and the options of the command.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import os
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import one_of, refuse
from ..narrowing import is_host_array, is_list_or_tuple, is_numpy_number
from ..written_numbers import WrittenNumber, written_text
from .amounts import amount
from .limits import check_limit, check_whole, warn

WORDS = {float: "a number", int: "a whole number", str: "text", bool: "True or False"}

NUMERIC = re.compile(r"\s*[-+]?\.?\d")
"""Pattern of the beginning of a text that is meant as a number."""
T = TypeVar("T")


@dataclass(frozen=True)
class Above:
    """Rule that a value must be a finite number above `lower`."""

    lower: float = 0.0
    hint: str = ""

    def check(self, name: str, value: float, unit: str) -> None:
        """Refuse a value that is not a finite number above `lower`."""
        if not math.isfinite(value) or value <= self.lower:
            refuse(name, value, f"must be a finite number above {self.lower:g}{unit}", self.hint)


@dataclass(frozen=True)
class Within:
    """Rule that a value must be a finite number in [lower, upper]."""

    lower: float = -math.inf
    upper: float = math.inf
    hint: str = ""

    def check(self, name: str, value: float, unit: str) -> None:
        """Refuse a value outside [lower, upper]."""
        if self.lower <= value <= self.upper and math.isfinite(value):
            return
        span = f"in [{self.lower:g}, {self.upper:g}]" if math.isfinite(self.upper) else "finite"
        if math.isfinite(self.lower) and not math.isfinite(self.upper):
            span = f"{'' if isinstance(value, int) else 'finite and '}at least {self.lower:g}"
        refuse(name, value, f"must be {span}{unit}", self.hint)


@dataclass(frozen=True)
class OneOf:
    """Rule that a value must be one of `choices`, which are words or numbers."""

    choices: tuple[object, ...]

    def check(self, name: str, value: object, unit: str) -> None:
        """Refuse a value that is not one of the choices."""
        one_of(name, value, self.choices)


@dataclass(frozen=True)
class Needs:
    """Rule for a parameter that has an effect only if the value of another parameter passes a test.

    The other parameter is `field`, and `test` is a function of its value. If `others` names further parameters, it is
    enough that `field` or one of `others` passes the test.
    """

    field: str
    test: Callable[[Any], bool]
    words: str
    """Text of the condition, such as "is given"; a message shows it after the name of the parameter `field`."""
    others: tuple[str, ...] = ()
    refused: bool = True
    """True if a parameter without effect is an error.

    If False, it only causes a warning, because a study may vary this parameter together with another one, so that it
    has no effect in some cases.
    """

    @property
    def condition(self) -> str:
        """Text of the condition, with the names of the parameters, such as "'aggregate_fraction' is above 0"."""
        return f"{' or '.join(map(repr, (self.field, *self.others)))} {self.words}"

    def holds(self, value: Callable[[str], Any]) -> bool:
        """Return whether at least one of the parameters `field` and `others` passes the test.

        `value` is a function that takes the name of a parameter and returns its value.
        """
        return any(self.test(value(name)) for name in (self.field, *self.others))


@dataclass(frozen=True)
class FileIf:
    """Rule that the value of a parameter is the path of a file if the function `test` returns true for the value.

    The path is stored as an absolute path, which is valid in any working folder.
    """

    test: Callable[[str], bool]


@dataclass(frozen=True)
class Suggests:
    """Rule with suggestions for a text parameter, which shells offer as completions; other values are also allowed."""

    values: Callable[[], Iterable[str]]
    files: bool = False
    """True if the text may also be the path of a file."""


class CompositeRule:
    """Rule for a parameter whose value is an object.

    Each field of the object becomes a parameter of its own. For example, the parameter `contact` holds a contact law,
    whose field FIELD is the parameter `contact_FIELD`. The module :mod:`warpcrete.core.inputs.by_name` explains these
    parameters.
    """

    def fields(self, field: Field, value: object) -> dict[str, Field]:
        """Return the fields of the object `value` as parameters, by name.

        For example, the field FIELD of the contact law is the parameter `contact_FIELD`.
        """
        raise NotImplementedError

    def short_names(self) -> tuple[str, ...]:
        """Return the names of classes whose objects the parameter accepts."""
        raise NotImplementedError

    def with_objects(self, field: Field, values: Mapping[str, object]) -> dict[str, object]:
        """Return a copy of the parameters `values` in which the value of `field` is an object.

        In `values`, the value may be the name of a class. The object is then made from this name and from its own
        parameters in `values`; the copy does not contain these parameters.
        """
        raise NotImplementedError

    def to_plain(self, field: Field, value: object) -> tuple[dict[str, object], bool]:
        """Return parameters (numbers and texts, by name) that describe the object `value` of `field`.

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
    """Heading under which help texts list the parameter: the first line of the docstring of the declaring class."""
    common: bool = True
    """True if the short help of the command shows the parameter."""

    @functools.cached_property
    def unit(self) -> str:
        """Unit from the brackets in the help text, with a leading space; empty if there is none."""
        found = re.search(r"\[([^\]]+)\]", self.help)
        return f" {found.group(1)}" if found else ""

    @property
    def units(self) -> str:
        """Internal unit of the parameter, as :func:`amount` requires it; "1" for a ratio."""
        return self.unit.strip() or "1"

    @property
    def described(self) -> str:
        """Help text of the parameter, followed by its choices unless the help text mentions all of them."""
        choices = [str(choice) for rule in self.of_kind(OneOf) for choice in rule.choices]
        words = re.findall(r"[\w.-]+", self.help)
        missing = [choice for choice in choices if choice not in words]
        return self.help + (f"; one of {', '.join(choices)}" if missing else "")

    def of_kind(self, kind: type[T]) -> Iterator[T]:
        """Return the rules of this parameter that are instances of the class `kind`."""
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
            for rule in self.of_kind(Within):
                if not rule.lower <= value <= rule.upper:
                    rule.check(name, value, self.unit)
            check_whole(name, value)
        if self.kind is float and isinstance(value, float):
            # Adding 0.0 turns -0.0 into 0.0, so that both zeros give the same text and fingerprint.
            return value if isinstance(value, WrittenNumber) else value + 0.0
        if self.kind is str and hasattr(value, "__fspath__"):
            return str(value)
        if not isinstance(value, self.kind) or (isinstance(value, bool) and self.kind is not bool):
            words = WORDS.get(self.kind, f"a {self.kind.__name__}")
            hint = f"write a number in{self.unit}" if self.kind is float and self.unit else ""
            several = is_list_or_tuple(value) or is_host_array(value)
            if several and self.kind in WORDS:
                hint = f"a study simulates several values: warpcrete.study(..., vary={{{name!r}: [...]}})"
            refuse(name, value, f"must be {words}{' or None' if self.optional else ''}", hint)
        if isinstance(value, str) and "\0" in value:
            refuse(name, value, "contains a NUL character", "remove this character")
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
    """Return the annotated fields of the dataclass `owner` by name, in order of definition, base classes first.

    An attribute `common` of a dataclass names the fields of this class that `--help` shows. Without this attribute,
    `--help` shows all its fields.
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

        Both are empty if a concrete's file sets no field of this dataclass.
        """
        return "", ()

    @classmethod
    def implied(cls, values: Mapping[str, object]) -> Mapping[str, object]:
        """Return further parameters that follow from `values`; for example, a concrete determines its yield stress."""
        return {}

    def check_needed(self) -> None:
        """Raise :class:`SceneError` if a parameter differs from its default although it has no effect.

        If the rule of the parameter has `refused` = False, give a warning instead.
        """
        for name, field in declared_fields(type(self)).items():
            for rule in field.of_kind(Needs):
                if getattr(self, name) != field.default and not rule.holds(lambda each: getattr(self, each)):
                    other = getattr(self, rule.field)
                    same = isinstance(other, Declared) and name in declared_fields(type(other))
                    instead = f"give '{rule.field}_{name}' instead" if same else f"change {rule.field!r}"
                    why, cure = f"has no effect unless {rule.condition}", f"leave out {name!r}, or {instead}"
                    if rule.refused:
                        refuse(name, getattr(self, name), why, cure)
                    value = getattr(self, name)
                    warn(f"{name} = {written_text(value) or value}: {why}; {cure}")
