"""Friction of bends, reducers, hoses, valves and bores over that of straight pipe: its range, and who found it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ...geometry.lines import Part

AIJ = "AIJ, rule for pumping (https://ga40077.com/concrete-engineer/calculation-pumping-load)"
JGJ = "JGJ/T 10, table of pressure losses (https://www.wendadaohang.com/zd/A5nWWn53n31WG51WdKW.html)"
JSCE = "JSCE, rule for pumping (https://ga40077.com/concrete-engineer/calculation-pumping-load)"
CALIBE = "Kaplan and CALIBE (NIST, Materials science of concrete 2000: 150 m, 12 elbows, more than 50 concretes)"
PARK = "Park et al., ACI Mater. J. 117-3 (2020) 205 (133, 369 and 560 m, four concretes)"
VALVE_PRESSURE = 0.8e6
"""Pressure loss of a stop valve [Pa] (JGJ/T 10)."""
METHODS_ON_BENDS = (
    "Simulated as a fluid, a bend of 90 degrees costs 2 to 13 % more than straight pipe of its length; simulated with "
    "stones, it costs the same for a radius of 0.5 m or more, and half as much again for 0.25 m; therefore count it "
    "by its length, and allow for three times that."
)
"""One sentence for site engineers about what flows and discrete elements find in pipes of 150 mm."""


@dataclass(frozen=True)
class ModelError:
    """Range of the friction of one kind of part, relative to straight pipe of its length."""

    cause: str
    """Name of this cause of uncertainty, such as 'bends'."""
    low: float
    high: float
    source: str
    """Publications and rules from which the ends of the range come."""


MODEL_ERRORS = {
    "bend": ModelError("bends", 1.0, 3.0, f"1: {CALIBE}; 2: {PARK}; 3: {AIJ}"),
    "reducer": ModelError("reducers", 1.0, 2.0, f"2: {AIJ}"),
    "hose": ModelError("hoses", 1.0, 2.0, f"2: {AIJ}"),
    "bore": ModelError("bores", 1.0, 2.0, f"as a reducer, 2: {AIJ}"),
    "valve": ModelError("valves", 1.0, 1.0, f"from straight pipe to 0.8 MPa: {JGJ}"),
}
"""Ranges of friction by kind of part; the upper end of a valve's range is :data:`VALVE_PRESSURE`."""


def range_of(part: Part, straight: float) -> tuple[float, float] | None:
    """Return the range of a part's friction relative to that of straight pipe of its length and bores.

    `straight` is the friction of this straight pipe [Pa]. The result is None for straight pipe and for a part whose
    friction the line's file states.
    """
    error = MODEL_ERRORS.get(part.kind)
    if error is None or part.factor is not None:
        return None
    return error.low, max(error.high, VALVE_PRESSURE / straight) if part.kind == "valve" else error.high


def uncertain_kinds(parts: Iterable[Part]) -> tuple[str, ...]:
    """Return the kinds of parts in a line whose friction is uncertain, in the order of the line."""
    return tuple(dict.fromkeys(p.kind for p in parts if p.kind in MODEL_ERRORS and p.factor is None))
