"""Errors of the package; each message is one line that names field, value, what is allowed and what to try."""

from __future__ import annotations

import difflib
import math
import sys
import warnings
from collections.abc import Iterable
from typing import Any, NoReturn

import numpy as np

LONGEST_VALUE = 160
"""Characters of a value, or of the name of a field, that a message quotes."""
LONGEST_MESSAGE = 2000
"""Characters of any other part of a message."""
LONGEST_NUMBER = 128
"""Bits of an integer that a message writes out."""
FEW = 12
"""Number of names that a message lists in full although it suggests one of them."""


class WarpcreteError(Exception):
    """Base of every error that warpcrete raises on purpose."""


class SceneError(WarpcreteError, ValueError):
    """A scene, or a part of one, asks for something that cannot be simulated."""


class DeviceError(WarpcreteError):
    """The device asked for does not exist here."""


class RunFolderError(WarpcreteError):
    """A run folder, or a file of one, cannot be created, read or written."""


class DiskFullError(RunFolderError):
    """A file could not be written because the disk, a quota or a limit of the process takes no more."""


class InstabilityError(WarpcreteError):
    """The simulated state left the range in which it means anything."""


class ConvergenceError(InstabilityError):
    """A solve did not converge; `history` holds the norms of its residual, from the start on."""

    def __init__(
        self, time: float, what: str, iterations: int, history: list[float], residual: float, maximum: int
    ) -> None:
        self.time, self.what, self.iterations, self.history, self.residual = time, what, iterations, history, residual
        self.maximum = maximum
        chosen = sorted({0, *(2**e - 1 for e in range(1, 12)), len(history) - 1})
        path = ", ".join(f"{history[k]:.2g}" for k in chosen if k < len(history))
        looser = "a larger tolerance, " if what == "pressure" else ""
        super().__init__(
            f"t = {time:.6g} s: the {what} solve did not converge in {iterations} iterations (maximum_iterations "
            f"= {maximum}); residual {residual:.3g} after {path}; usual cures: a smaller time step, {looser}more "
            "iterations, precision float64"
        )

    def __reduce__(self):
        # Processes of a study hand errors on as pickles, which would call with the message alone.
        return type(self), (self.time, self.what, self.iterations, self.history, self.residual, self.maximum)


class CapacityError(WarpcreteError):
    """A list of fixed size was too short and could not be grown."""


class PlausibilityWarning(UserWarning):
    """A value is possible but unlikely, as a pipe of 3 m would be."""


def one_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    """Return `text` without control characters and line breaks, and without its middle if it exceeds `longest`."""
    if len(text) > longest:
        half = longest // 2
        text = f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"
    return "".join(each if each.isprintable() else " " if each in "\r\n\t" else ascii(each)[1:-1] for each in text)


def quoted(value: Any) -> str:
    """Return `value` as a message quotes it, shortened if it is long."""
    if isinstance(value, int) and value.bit_length() > LONGEST_NUMBER:
        return f"a number of {value.bit_length()} bits"
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # nested too deeply, or holding an integer of thousands of digits
        text = f"<{type(value).__name__}>"
    return one_line(text, LONGEST_VALUE)


def warn_in_one_line() -> None:
    """Show each different warning of this process once, as a line on stderr without its place in the code."""
    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        text = one_line(str(message))
        if text not in shown:
            print(f"warning: {text}", file=sys.stderr)
        shown.add(text)

    warnings.showwarning = show


def refuse(field: str, value: Any, allowed: str, hint: str = "") -> NoReturn:
    """Raise :class:`SceneError` for `field`."""
    said = f"{one_line(field, LONGEST_VALUE)} = {quoted(value)}: {one_line(allowed)}"
    raise SceneError(said + (f"; {one_line(hint)}" if hint else ""))


def suggested(word: Any, known: Iterable[Any]) -> str:
    """Return "did you mean ...?" with the nearest of the `known` words, or nothing if none is near."""
    if not isinstance(word, str):
        return ""
    folded = {str(each).casefold().replace("-", "_"): str(each) for each in known}
    near = difflib.get_close_matches(word[:LONGEST_VALUE].casefold().replace("-", "_"), folded, 1, 0.6)
    return f"did you mean {folded[near[0]]!r}?" if near else ""


def known_names(word: Any, known: Iterable[Any]) -> str:
    """Return the `known` words to choose from; of many, only the one that was probably meant, if there is one."""
    names = [str(each) for each in known]
    meant = suggested(word, names)
    if meant and len(names) > FEW:
        return meant
    return f"must be one of {', '.join(names)}" + (f"; {meant}" if meant else "")


def positive(field: str, value: float, unit: str = "", hint: str = "") -> None:
    """Refuse anything but a finite number above zero."""
    if not _is_number(value) or not math.isfinite(value) or value <= 0:
        refuse(field, value, f"must be a finite number above 0{' ' + unit if unit else ''}", hint)


def between(field: str, value: float, lower: float, upper: float, unit: str = "", hint: str = "") -> None:
    """Refuse anything but a finite number in [lower, upper]."""
    if not _is_number(value) or not math.isfinite(value) or not lower <= value <= upper:
        span = f"in [{lower:g}, {upper:g}]" if math.isfinite(upper) else f"finite and at least {lower:g}"
        if not math.isfinite(lower):
            span = "a finite number"
        refuse(field, value, f"must be {span}{' ' + unit if unit else ''}", hint)


def one_of(field: str, value: Any, choices: Any) -> None:
    """Refuse anything but one of `choices`."""
    choices = list(choices)  # a list, because the value may not be hashable
    if value not in choices:
        refuse(field, value, f"must be one of {', '.join(map(str, choices))}", suggested(value, choices))


def vector(field: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers as a tuple, or :class:`SceneError`."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        refuse(field, value, "must be three finite numbers")
    return (float(array[0]), float(array[1]), float(array[2]))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
