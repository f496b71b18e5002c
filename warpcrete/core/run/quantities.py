"""Quantities of a run as numbers with units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ..drawing.html import html_table
from ..errors import one_of
from ..inputs.amounts import UNITS
from ..narrowing import is_dict
from ..units import number

_conditions: dict[type, Callable[[], Mapping[str, str]]] = {}
"""Functions that return the conditions under which runs have certain quantities. The key is the type of the scene; see
:func:`conditions_of`."""


def declare_conditions(scene_type: type, conditions: Callable[[], Mapping[str, str]]) -> None:
    """Register the conditions under which runs have certain quantities, for all scenes of the type `scene_type`.

    The function `conditions` returns the conditions by the name of the quantity. It is called whenever they are needed,
    because a user may add standard tests with quantities of their own.
    """
    _conditions[scene_type] = conditions


def conditions_of(scene: object) -> Mapping[str, str]:
    """Return the conditions under which runs of a scene have certain quantities, by the name of the quantity.

    The conditions are texts for messages. Each simulation method declares its own conditions, because quantities of
    several methods may have the same name. If the type of the scene belongs to no method, for example because the scene
    of a folder cannot be built again, the result contains only conditions on which all methods agree.
    """
    for kind in type(scene).__mro__:
        if kind in _conditions:
            return _conditions[kind]()
    texts: dict[str, set[str]] = {}
    for conditions in _conditions.values():
        for name, text in conditions().items():
            texts.setdefault(name, set()).add(text)
    return {name: found.pop() for name, found in texts.items() if len(found) == 1}


class Amount(float):
    """Number with the attribute `unit`; it computes and compares like a plain number.

    Quantities of runs are in SI units. Results of arithmetic are plain numbers, because their units may differ.
    """

    unit: str
    """Unit of the number, such as "Pa"."""

    def __new__(cls, value: float, unit: str) -> Amount:
        """Return `value` as a number with a unit."""
        made = super().__new__(cls, value)
        made.unit = unit
        return made

    def __reduce__(self) -> tuple[type[Amount], tuple[float, str]]:
        return Amount, (float(self), self.unit)

    def __repr__(self) -> str:
        return f"{float(self):.6g} {self.unit}"

    def __str__(self) -> str:
        return repr(self)

    def to(self, unit: str) -> Amount:
        """Return the amount in another unit of the same kind, such as "kPa" or "bar" for a pressure.

        Raises :class:`SceneError` for a unit of another kind.
        """
        kinds = [factors for factors in UNITS.values() if self.unit in factors] or [{self.unit: 1.0}]
        kinds = [UNITS[self.unit]] if self.unit in UNITS else kinds
        factors = next((kind for kind in kinds if unit in kind), kinds[0])
        one_of("unit", unit, tuple(factors))
        return Amount(float(self) * factors[self.unit] / factors[unit], unit)


class Quantities(dict[str, float]):
    """Quantities of a run by name: an :class:`Amount` if the quantity has a unit, otherwise a plain number."""

    @classmethod
    def of(cls, result: Mapping[str, object]) -> Quantities:
        """Return the quantities in the contents of a result.json."""
        found = cls()
        for name, entry in result.items():
            if is_dict(entry) and set(entry) == {"value", "unit"} and isinstance(entry["value"], int | float):
                found[name] = Amount(number(entry), str(entry["unit"]))
            elif isinstance(entry, int | float) and not isinstance(entry, bool):
                found[name] = number(entry)
        return found

    def _texts(self) -> list[tuple[str, str]]:
        return [(name, repr(value) if isinstance(value, Amount) else f"{value:.6g}") for name, value in self.items()]

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in self._texts()) or "no quantities"

    def _repr_html_(self) -> str:
        """Return the quantities as an HTML table for notebooks."""
        return html_table(self._texts())


class Result(dict[str, Any]):
    """Contents of a result.json; `print` shows one line for each value, with names such as "a.b" for nested entries."""

    def __repr__(self) -> str:
        texts = list(_entry_texts(self))
        width = max((len(name) for name, _ in texts), default=0)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in texts) or "no results"


def _entry_texts(entries: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and the value of each entry as texts; an entry of a nested dictionary has a name such as "a.b"."""
    for name, entry in entries.items():
        if not is_dict(entry):
            yield prefix + name, f"{entry:.6g}" if isinstance(entry, float) else str(entry)
        elif set(entry) == {"value", "unit"} and isinstance(entry["value"], int | float):
            yield prefix + name, repr(Amount(number(entry), str(entry["unit"])))
        else:
            yield from _entry_texts(entry, f"{prefix}{name}.")
