"""Errors of the package; each message is one line that names field, value, what is allowed and what to try."""

from __future__ import annotations

import math
import sys
import warnings
from typing import Any, NoReturn

import numpy as np


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
            f"= {maximum}); residual {residual:.3g}, on the way {path}; usual cures: a smaller time step, {looser}more "
            "iterations, precision float64"
        )

    def __reduce__(self):
        # Processes of a study hand errors on as pickles, which would call with the message alone.
        return type(self), (self.time, self.what, self.iterations, self.history, self.residual, self.maximum)


class CapacityError(WarpcreteError):
    """A list of fixed size was too short and could not be grown."""


def warn_in_one_line() -> None:
    """Show the warnings of this process as lines on stderr, without the places in the code that they come from."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)

    warnings.showwarning = show


def refuse(field: str, value: Any, allowed: str, hint: str = "") -> NoReturn:
    """Raise :class:`SceneError` for `field`."""
    raise SceneError(f"{field} = {value!r}: {allowed}" + (f"; {hint}" if hint else ""))


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
    if value not in list(choices):  # what cannot be hashed is refused, too
        refuse(field, value, f"must be one of {', '.join(map(str, choices))}")


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
