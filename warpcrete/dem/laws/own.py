"""Checks of a contact law's class and of its Warp functions, for laws that are defined outside this package.

A law of the package is tested before it is released. A law of a user is tested here, before its first run: first the
class itself, then its functions, which Warp compiles, and finally the forces and energies (in `trial`).
"""

import __future__

import functools
import inspect
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

import warp as wp

from ...core.errors import SceneError, known_names, one_line, refuse
from ...core.inputs.parameters import Field, OneOf, declared_fields
from ...core.narrowing import is_dict, is_number

FUNCTIONS: dict[str, tuple[str, ...]] = {
    "force": ("p", "touch", "history", "dt"),
    "stiffness": ("p", "touch"),
    "energy": ("p", "touch", "history"),
}
"""Warp functions that every contact law has, with the names of their arguments."""
ROLLING_FUNCTIONS: dict[str, tuple[str, ...]] = {
    "moment": ("p", "touch", "turning", "history", "dt"),
    "moment_energy": ("p", "touch", "history"),
}
"""Additional Warp functions of a contact law that resists rolling, with the names of their arguments."""
RETURNED: dict[str, tuple[str, ...]] = {
    "force": ("the force on body a [N], a t.vec3", "the new history, a t.vec3", "the energy lost in the step [J]"),
    "stiffness": ("one vector t.vec4(k_n, k_s, c_n, c_s) [N/m, N/m, N s/m, N s/m]",),
    "energy": ("the stored energy [J]",),
    "moment": ("the moment on body a [N m], a t.vec3", "the new history, a t.vec3", "the energy lost in the step [J]"),
    "moment_energy": ("the stored energy [J]",),
}
"""Values that each Warp function of a contact law returns."""
_STORED = {
    "forces[": ("force", 0),
    "histories[": ("force", 1),
    "losses[i, k] =": ("force", 2),
    "moments[": ("moment", 0),
    "turnings[": ("moment", 1),
    "losses[i, k] +=": ("moment", 2),
    "stiffnesses[": ("stiffness", 0),
    "energies[i, k] =": ("energy", 0),
    "energies[i, k] +=": ("moment_energy", 0),
    "on_a, ": ("force", 0),
    "torque, ": ("moment", 0),
}
"""Statements of `kernels/dem/law_trial.py` that store a result of a law's Warp functions.

The keys are the beginnings of the statements. The values are the name of the function and the index of the result.
"""
_WHERE = re.compile(r'Error while parsing function "([^"]+)" at (.*?):(\d+):\s*?\n(.*?)\n;', re.DOTALL)


@functools.cache
def check_class(law: type) -> None:
    """Raise :class:`SceneError` if the class of a user's contact law has an error, whatever its parameters are."""
    name = law.__name__
    for base in law.__mro__:
        if _without_decorator(base):
            words = ", ".join(inspect.get_annotations(base))
            refuse(
                base.__name__,
                words,
                "are annotated in a class without a @dataclass decorator of its own",
                "write @dataclass(frozen=True, kw_only=True) above the class",
            )
    code = getattr(inspect.unwrap(getattr(law.device_functions, "__func__", law.device_functions)), "__code__", None)
    if code is not None and code.co_flags & __future__.annotations.compiler_flag:
        refuse(
            f"{name}.device_functions",
            Path(code.co_filename).name,
            f"must be in a file without 'from {__future__.__name__} import annotations', because Warp needs types",
            "remove this line",
        )
    if not isinstance(inspect.getattr_static(law, "device_functions"), classmethod):
        refuse(
            f"{name}.device_functions",
            "an instance method",
            "must be a class method",
            "write @classmethod above it",
        )
    if not isinstance(law.rolls, bool):
        refuse(
            f"{name}.rolls",
            law.rolls,
            "must be True or False for the whole class",
            "write rolls = True, without @property",
        )
    for own, field in declared_fields(law).items():
        _check_field(f"{name}.{own}", field)


def _without_decorator(base: type) -> bool:
    """Return whether a class that inherits from a dataclass annotates new fields but is not a dataclass itself."""
    known = getattr(base, "__dataclass_fields__", None)
    own = {key for key, kind in inspect.get_annotations(base).items() if "ClassVar" not in str(kind)}
    return known is not None and "__dataclass_fields__" not in vars(base) and bool(own)


def _check_field(name: str, field: Field) -> None:
    example = 'write, for example, Annotated[float, "friction coefficient", Within(0)]'
    if not isinstance(field.help, str):
        refuse(name, field.help, "must have a text with the meaning and unit of the field after the type", example)
    if field.optional:
        refuse(name, "None", "must always have a value, because kernels cannot handle None", "leave out '| None'")
    if field.kind in (float, int, bool) or hasattr(field.kind, "device_functions"):
        return
    if field.kind is str:
        if next(field.of_kind(OneOf), None) is None:
            refuse(
                name,
                "a text",
                "must be restricted to a list of words, because kernels cannot handle other text",
                "add OneOf((WORD, WORD)) with the allowed words after the help text",
            )
        return
    refuse(
        name,
        getattr(field.kind, "__name__", field.kind),
        "must be a float, an int, a bool, a text with OneOf, or another contact law",
        "declare several numbers instead, each with a name of its own",
    )


def check_object(law: Any) -> None:
    """Raise :class:`SceneError` if properties of a user's contact law have values that the program cannot use."""
    name = type(law).__name__
    for own in ("stress_scale", "has_history", "has_shear"):
        value = _called(f"{name}.{own}", lambda own=own: getattr(law, own))
        if callable(value):
            refuse(f"{name}.{own}", "a method", "must be a value or a property", "write @property above the method")
        if own == "stress_scale" and not (is_number(value) and 0 < value < float("inf")):
            refuse(
                f"{name}.{own}",
                value,
                "must be a finite number above 0 Pa",
                "return F / d^2, where F is the force between two spheres of diameter d at the overlap d",
            )
        if own != "stress_scale" and not isinstance(value, bool):
            refuse(f"{name}.{own}", value, "must be True or False", "compare numbers, as in self.friction > 0")


def packing_law(law: Any, kind: type) -> Any:
    """Return the contact law for packing, which the method `frictionless` of a user's contact law returns.

    `kind` is the base class of all contact laws. Raises :class:`SceneError` if `frictionless` is not a method, if it
    fails, or if it returns an object that is not a contact law.
    """
    name = f"{type(law).__name__}.frictionless"
    if not callable(law.frictionless):
        refuse(name, law.frictionless, "must be a method", "leave out @property above it")
    packing = _called(f"{name}()", law.frictionless)
    if not isinstance(packing, kind):
        refuse(f"{name}()", packing, "must return a contact law", "write, for example, replace(self, friction=0.0)")
    return packing


def _called(name: str, call: Callable[[], Any]) -> Any:
    """Call `call`, a piece of a user's code, and return the result.

    Raises :class:`SceneError` with a message that begins with `name` if the code fails.
    """
    try:
        return call()
    except SceneError:
        raise
    except Exception as error:  # The code of a user may raise any exception.
        raise SceneError(f"{name}: fails with {_said(error)}") from error


def _said(error: BaseException) -> str:
    return one_line(f"{type(error).__name__}: {' '.join(str(error).split())}")


def made_functions(law: Any, scalar: Any, parameters: Any) -> dict[str, Callable[..., Any]]:
    """Return the Warp functions of a user's contact law; raises :class:`SceneError` if one is missing or wrong."""
    check_class(law)
    name = f"{law.__name__}.device_functions()"
    made: object = _called(name, lambda: law.device_functions(scalar, parameters))
    needed = FUNCTIONS | (ROLLING_FUNCTIONS if law.rolls else {})
    if not is_dict(made):
        refuse(name, made, "must return a dictionary of Warp functions", f"return {{{', '.join(map(repr, needed))}}}")
    for function, arguments in needed.items():
        if function not in made:
            others = [key for key in made if key not in needed]
            near = f"; {known_names(function, others)}" if others else ""
            given = ", ".join(made) or "no function"
            refuse(
                name,
                given,
                f"must also return the function {function!r}{near}",
                f"write @wp.func def {function}({', '.join(arguments)})",
            )
        _check_function(law, function, made[function], arguments)
    return {key: value for key, value in made.items() if callable(value)}


def _check_function(law: type, name: str, function: Any, arguments: tuple[str, ...]) -> None:
    called = f"{law.__name__}.{name}"
    if not isinstance(function, wp.Function):
        refuse(called, function, "must be a Warp function", "write @wp.func above it")
    known = list(inspect.signature(function.func).parameters)
    if len(known) != len(arguments):
        refuse(
            f"{called}()",
            ", ".join(known) or "no argument",
            f"must take {len(arguments)} arguments: {', '.join(arguments)}",
            "change the arguments",
        )


def explained(law: type, error: Exception) -> NoReturn:
    """Raise a :class:`SceneError` with one line on why Warp cannot compile the functions of a user's contact law."""
    text = str(error)
    found = list(_WHERE.finditer(text))
    reason = " ".join(text[found[-1].end() :].split()) if found else _said(error)
    inner = found[-1] if found else None
    if inner is None or inner[2].endswith("law_trial.py"):
        statement = inner[4].strip() if inner is not None else ""
        place = next((value for key, value in _STORED.items() if statement.startswith(key)), None)
        if place is not None:
            _wrong_value(law, *place, reason, error)
        raise SceneError(f"{law.__name__}: Warp cannot compile its functions: {one_line(reason)}") from error
    where = f"{Path(inner[2]).name}, line {inner[3]}: {' '.join(inner[4].split())}"
    raise SceneError(
        f"{law.__name__}.{inner[1]}() = {where!r}: cannot be compiled by Warp, which says {reason!r}; "
        f"{_hint(law, reason)}"
    ) from error


def _hint(law: type, reason: str) -> str:
    """Return a hint on how to correct a statement that Warp could not compile; `reason` is the message of Warp."""
    known = declared_fields(law)
    plain = [field.name for field in fields(law) if field.name not in known]
    if (wrong := re.search(r"`(\w+)` is not an attribute of '(\w+)'", reason)) is not None:
        if wrong[1] in plain:
            return f'declare {wrong[1]}: Annotated[float, "meaning [unit]"], so that kernels can use this parameter'
        names = list(known) if wrong[2] == "p" else TOUCH
        return f"{wrong[2]}.{wrong[1]}: {known_names(wrong[1], names)}"
    if "float32" in reason and "float64" in reason:
        return "write scalar(0.5) instead of 0.5, because numbers must have the precision of the run"
    return "use only functions of Warp, and numbers of the type scalar"


TOUCH = ("normal", "gap", "velocity", "twist", "tilt", "smaller_radius", "length", "reduced_radius", "mass")
"""Fields of the struct `Touch` of `kernels/dem/contact_law.py`."""


def _wrong_value(law: type, name: str, number: int, reason: str, error: Exception) -> NoReturn:
    """Raise a :class:`SceneError` for a value of the wrong type that a Warp function of a user's law returns.

    `name` is the name of the function, `number` is the index of the wrong value, `error` is the exception that Warp
    raised, and `reason` is its text.
    """
    values = RETURNED[name]
    allowed = values[0] if len(values) == 1 else "; ".join(f"{n + 1}. {value}" for n, value in enumerate(values))
    count = re.search(r"expected (\d+), got \d+", reason)
    types = re.search(r"type \((\w+)\) must be of the same type as the array \((\w+)\)", reason)
    if count is not None or "'list' object" in reason or "not enough values" in reason or "NoneType" in reason:
        got = f"{count[1]} values" if count is not None else "no value" if "NoneType" in reason else "several values"
        problem = f"must return {len(values)} value{'s' * (len(values) > 1)}: {allowed}"
        hint = "change its return statement"
    elif types is not None:
        got = f"{types[1]} as value {number + 1}"
        problem, hint = f"must return a {types[2]} there: {values[number]}", "write scalar(...) around plain numbers"
    else:
        got, problem, hint = _said(error), f"must return {allowed}", "change its return statement"
    try:
        refuse(f"{law.__name__}.{name}()", got, problem, hint)
    except SceneError as made:
        raise made from error
