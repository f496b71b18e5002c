"""Errors of the package; each message is one line that names field, value, what is allowed and what to try."""

import difflib
import errno
import functools
import inspect
import math
import sys
import warnings
from collections.abc import Callable, Iterable
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import NoReturn, ParamSpec, TypeVar, cast

import numpy as np

from .narrowing import is_number
from .written_numbers import written_text

P = ParamSpec("P")
T = TypeVar("T")
LONGEST_VALUE = 160
"""Maximum number of characters of a value or of a field's name that a message quotes."""
LONGEST_MESSAGE = 2000
"""Maximum number of characters of each part of an error message. Quoted values and the names of fields are shorter:
their limit is `LONGEST_VALUE`."""
LONGEST_NUMBER = 128
"""Maximum number of bits of an integer that an error message writes out; for a larger integer, the message states only
the size."""
MOST_NAMES_LISTED = 12
"""Maximum number of allowed names that an error message lists if it can also suggest the name that was probably meant.
If there are more names, the message contains only the suggestion."""
NAMED_PARAMETERS = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
"""Kinds of parameters that a caller may pass by name."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""System error numbers (errno) of a full disk, an exceeded quota, and a file larger than the process may write."""


class WarpcreteError(Exception):
    """Base class of all errors that warpcrete raises on purpose."""


class SceneError(WarpcreteError, ValueError):
    """Error: a value of a scene is not valid, or the scene cannot be simulated."""


class DeviceError(WarpcreteError):
    """Error: the requested device does not exist, or Warp's files of compiled kernels cannot be read or written."""


class RunFolderError(WarpcreteError):
    """Error: a run folder, or a file in it, cannot be created, read or written."""


class DiskFullError(RunFolderError):
    """Error: a file could not be written because the disk is full, or because a quota or process limit is reached."""


def is_full(error: BaseException) -> bool:
    """Return whether a full disk, an exceeded quota or a process limit caused an error."""
    return isinstance(error, DiskFullError) or (isinstance(error, OSError) and error.errno in FULL)


class InstabilityError(WarpcreteError):
    """Error: the simulated state is no longer physically meaningful, so the run must end.

    `what` says what happened, `time` is the simulated time [s], and `body` is the permanent number of the body
    concerned. `time` and `body` are None if they are unknown. `cure` lists usual cures, or is empty. The message
    contains all these values except unknown or empty ones.
    """

    def __init__(self, what: str, *, time: float | None = None, body: int | None = None, cure: str = "") -> None:
        self.what, self.time, self.body, self.cure = what, time, body, cure
        known = [f"t = {time:.6g} s"] if time is not None else []
        known += [f"body {body}"] if body is not None else []
        place = f"{', '.join(known)}: " if known else ""
        super().__init__(place + what + (f"; usual cure{'s' * (',' in cure)}: {cure}" if cure else ""))


class ConvergenceError(InstabilityError):
    """Error: an iterative solve did not converge; `history` holds the residual's norm at each iteration.

    `what` is the name of the solve.
    """

    def __init__(
        self, time: float, what: str, iterations: int, history: list[float], residual: float, maximum: int
    ) -> None:
        chosen = sorted({0, *(2**e - 1 for e in range(1, 12)), len(history) - 1})
        path = ", ".join(f"{history[k]:.2g}" for k in chosen if k < len(history))
        limit, cures = f" (maximum_iterations = {maximum})", ["a smaller 'time_step'"]
        if what == "coupled":  # No parameter of a scene changes the limit of this solve.
            limit, cures = "", ["a smaller time step ('time_step' or 'courant')"]
        else:
            cures += ["a larger tolerance"] if what == "pressure" else []
            cures += ["more iterations ('maximum_iterations')"]
        super().__init__(
            f"the {what} solve did not converge in {iterations} iterations{limit}; its residual is {residual:.3g}, "
            f"after {path} in earlier iterations",
            time=time,
            cure=", ".join([*cures, "'precision' float64"]),
        )
        self.what, self.iterations, self.history, self.residual = what, iterations, history, residual
        self.maximum = maximum

    def __reduce__(self):
        # Processes of a study exchange errors as pickles. By default, unpickling would pass only the message to the
        # constructor, which needs all arguments.
        return type(self), (self.time, self.what, self.iterations, self.history, self.residual, self.maximum)


class CapacityError(WarpcreteError):
    """Error: a scene does not fit into the device's memory, or into an array or list of limited size."""


NOT_THE_USERS = ("warpcrete", "contextlib", "functools", "dataclasses")
"""Packages whose code a warning never names as its origin. The warning names the line of the user's program from which
these packages were called."""


class PlausibilityWarning(UserWarning):
    """Warning about a value that is possible but unlikely, such as a pipe of 3 m in diameter."""


def one_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    """Return `text` without control characters and line breaks.

    If it has more than `longest` characters, leave out its middle part.
    """
    if len(text) > longest:
        half = longest // 2
        text = f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"
    return "".join(each if each.isprintable() else " " if each in "\r\n\t" else ascii(each)[1:-1] for each in text)


def quoted(value: object) -> str:
    """Return the `repr` of a value as one line for a message, shortened if it is long.

    If a number was converted from a text with a unit, return the `repr` of this text.
    """
    value = written_text(value) or value
    if isinstance(value, int) and value.bit_length() > LONGEST_NUMBER:
        return f"a number of {value.bit_length()} bits"
    try:
        text = repr(value)
    except Exception:  # `repr` fails for deep nesting, huge integers and some objects, so name only the type.
        text = f"<{type(value).__name__}>"
    return one_line(text, LONGEST_VALUE)


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Give a warning of the class `category` that names the line of the user's program that called this package."""
    frame, level = sys._getframe(1), 2  # pyright: ignore[reportPrivateUsage]
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in NOT_THE_USERS:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


def warn_in_one_line() -> None:
    """Make Python print each distinct warning once, as one line on stderr without file name and line number."""
    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: object, **more: object) -> None:
        text = one_line(str(message))
        if text not in shown:
            print(f"warning: {text}", file=sys.stderr)
        shown.add(text)

    warnings.showwarning = show


def at_least(value: float, digits: int = 3) -> str:
    """Return the lower limit `value` as text with `digits` digits, rounded up to a number that the limit allows."""
    return _rounded(value, digits, ROUND_CEILING)


def at_most(value: float, digits: int = 3) -> str:
    """Return the upper limit `value` as text with `digits` digits, rounded down to a number that the limit allows."""
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: float, digits: int, way: str) -> str:
    return f"{float(Context(prec=digits, rounding=way).create_decimal(repr(float(value)))):g}"


def refuse(field: str, value: object, problem: str, hint: str = "") -> NoReturn:
    """Raise :class:`SceneError` that names `field`, its value, the problem and an optional hint."""
    said = f"{one_line(field, LONGEST_VALUE)} = {quoted(value)}: {one_line(problem)}"
    raise SceneError(said + (f"; {one_line(hint)}" if hint else ""))


RENAMED = {
    "mix": "concrete", "radius": "diameter", "aggregate_share": "aggregate_fraction", "shares": "fractions",
    "most_iterations": "maximum_iterations",
}  # fmt: skip
"""Former names of parameters, which warpcrete 0.2 still accepted, with the present names. The value of `diameter` is
twice the value of the former `radius`."""


SHORTENED = {"yield": "yield_stress", "slip": "slip_viscosity", "stress": "yield_stress", "interval": "sample_interval"}
"""Incomplete names of parameters, with the complete names."""
RELATED = {
    "flow": ("velocity", "which is the flow divided by the area of the bore"),
    "velocity": ("flow", "which is the mean velocity times the area of the bore"),
    "threads": ("processes", "the number of cases that run at once, each on one thread"),
    "processes": ("threads", "the number of threads of the run"),
}
"""Parameters and options that users may confuse. Each key is such a name; the value is a pair of a related name, which
some commands have instead, and the meaning of that name."""


def suggested(word: object, known: Iterable[object]) -> str:
    """Return the question "did you mean ...?", which suggests one of the `known` words instead of `word`.

    The suggestion is the word that :data:`RELATED` or :data:`RENAMED` states for `word`, or else the word with the most
    similar spelling. The result is empty if there is no such word.
    """
    if not isinstance(word, str):
        return ""
    folded = {str(each).casefold().replace("-", "_"): str(each) for each in known}
    typed = word[:LONGEST_VALUE].casefold().replace("-", "_")
    other, meaning = RELATED.get(typed, ("", ""))
    if other in folded and typed not in folded:
        return f"did you mean {folded[other]!r}, {meaning}?"
    if SHORTENED.get(typed) in folded and typed not in folded:
        return f"did you mean {folded[SHORTENED[typed]]!r}?"
    near = difflib.get_close_matches(RENAMED.get(typed, typed), folded, 1, 0.6)
    return f"did you mean {folded[near[0]]!r}?" if near else ""


def known_names(word: object, known: Iterable[object]) -> str:
    """Return a text that lists the `known` words and suggests the one with the spelling most similar to `word`.

    If there are more than `MOST_NAMES_LISTED` words and one of them is similar, the text only suggests that word.
    """
    names = [str(each) for each in known]
    suggestion = suggested(word, names)
    if suggestion and len(names) > MOST_NAMES_LISTED:
        return suggestion
    return f"must be one of {', '.join(names)}" + (f"; {suggestion}" if suggestion else "")


def refuse_unknown_settings(function: Callable[..., object], settings: Iterable[str]) -> None:
    """Raise :class:`SceneError` about the first of the `settings` that `function` does not accept as a keyword."""
    parameters = inspect.signature(function).parameters.values()
    if any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters):
        return
    known = [each.name for each in parameters if each.kind in NAMED_PARAMETERS and each.name != "self"]
    for name in settings:
        if name not in known:
            owner = function.__qualname__.removesuffix(".__init__").removeprefix("run_")
            refuse("setting", name, f"is not a setting of {owner}", known_names(name, known))


def with_suggestions(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that calls `function`, but suggests a name if it gets an unknown keyword."""

    @functools.wraps(function)
    def checked_call(*args: P.args, **settings: P.kwargs) -> T:
        refuse_unknown_settings(function, settings)
        return function(*args, **settings)

    return checked_call


def _after(unit: str) -> str:
    """Return a unit as the text that follows a number; empty for no unit and for the unit 1 of ratios."""
    return f" {unit}" if unit not in ("", "1") else ""


def positive(field: str, value: float, unit: str = "", hint: str = "") -> None:
    """Raise :class:`SceneError` about `field` unless `value` is a finite number above zero."""
    if not is_number(value) or not math.isfinite(value) or value <= 0:
        refuse(field, value, f"must be a finite number above 0{_after(unit)}", hint)


def at_least_and_below(field: str, value: float, lower: float, end: float, unit: str = "", hint: str = "") -> None:
    """Raise :class:`SceneError` about `field` unless `value` is at least `lower` and below `end`."""
    if not is_number(value) or not lower <= value < end:
        refuse(field, value, f"must be at least {lower:g} and below {end:g}{_after(unit)}", hint)


def between(field: str, value: float, lower: float, upper: float, unit: str = "", hint: str = "") -> None:
    """Raise :class:`SceneError` about `field` unless `value` is a finite number in [lower, upper]."""
    if not is_number(value) or not math.isfinite(value) or not lower <= value <= upper:
        if math.isfinite(lower):
            span = f"in [{lower:g}, {upper:g}]" if math.isfinite(upper) else f"finite and at least {lower:g}"
        elif math.isfinite(upper):
            span = f"finite and at most {upper:g}"
        else:
            span = "a finite number in" if _after(unit) else "a finite number"
        refuse(field, value, f"must be {span}{_after(unit)}", hint)


def whole(field: str, value: object, lower: int, upper: int | None = None) -> None:
    """Raise :class:`SceneError` about `field` unless `value` is a whole number in [lower, upper].

    If `upper` is None, there is no upper limit.
    """
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    count = int(cast(int, value)) if is_whole else None
    if count is None or count < lower or (upper is not None and count > upper):
        span = f"of at least {lower}" if upper is None else f"from {lower} to {upper}"
        refuse(field, cast(object, value), f"must be a whole number {span}")


def flag(field: str, value: object) -> None:
    """Raise :class:`SceneError` about `field` unless `value` is True or False."""
    if not isinstance(value, bool | np.bool_):
        refuse(field, value, "must be True or False")


def callback(field: str, value: object) -> None:
    """Raise :class:`SceneError` about `field` unless `value` is a function, or None or False for no function."""
    if value is not None and value is not False and not callable(value):
        refuse(field, value, "must be a function, or None")


def one_of(field: str, value: object, choices: Iterable[object]) -> None:
    """Raise :class:`SceneError` about `field` unless `value` is one of `choices`."""
    choices = list(choices)  # Search in a list, which works even if `value` is not hashable.
    if value not in choices:
        refuse(field, value, f"must be one of {', '.join(map(str, choices))}", suggested(value, choices))


def vector(field: str, value: object) -> tuple[float, float, float]:
    """Return three finite numbers as a tuple; raises :class:`SceneError` about `field` for any other value."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        refuse(field, value, "must be three finite numbers")
    return (float(array[0]), float(array[1]), float(array[2]))
