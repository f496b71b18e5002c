"""Rules of practice (AIJ, JSCE, JGJ/T 10) for the pressure of a pump line, for comparison with the program's result.

AIJ and JSCE convert bends, reducers and hoses to lengths of straight pipe, and take the friction of straight pipe from
a measurement. Here, the friction that the program calculates replaces the measurement. JGJ/T 10 states the pressure
losses themselves, which depend neither on the concrete nor on the flow.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.inputs.amounts import PSI
from ...core.inputs.customary import both
from ...geometry.pipe_line import Part
from .fittings import AIJ, JGJ, JSCE
from .losses import course_of

GROUPS = {"straight": "straight pipe", "bend": "bends", "reducer": "reducers", "hose": "hoses", "valve": "valves",
          "bore": "bores"}  # fmt: skip
"""Headings of the columns in the table of rules, by the kind of part that a column sums up."""
AIJ_FACTORS = {"straight": 1.0, "bend": 3.0, "reducer": 2.0, "hose": 2.0}
"""Friction of each kind of part, divided by the friction of a straight pipe of the same length, by a rule of the
Architectural Institute of Japan (AIJ). Kinds that are not listed have the factor 1."""
AIJ_OTHERS, JSCE_OTHERS, JGJ_OTHERS = ("valve", "bore"), ("valve", "bore"), ("reducer", "bore")
"""Kinds of parts that the rules of the AIJ, the JSCE and JGJ/T 10 do not cover."""
JSCE_RISE = ((0.100, 0.125, 0.150), (3.0, 4.0, 5.0))
"""Rule of the JSCE for rising pipe. The first tuple holds diameters of the pipe [m]. The second tuple holds, for each
diameter, the length of level pipe [m] that has the same pressure loss as one metre of rise. The loss of the rise
includes the weight of the concrete."""
JSCE_BEND, JSCE_REDUCER = 6.0, 3.0
"""Rule of the JSCE: lengths of level pipe [m] with the same friction as a bend of 90 degrees, and as a reducer."""
JSCE_HOSE, JSCE_HOSE_LENGTHS = 20.0, (5.0, 8.0)
"""Rule of the JSCE for a hose: a metre of a hose of the length L [m] counts as 20 / L metres of level pipe, for L from
5 to 8 m. Every such hose therefore counts as JSCE_HOSE metres. JSCE_HOSE_LENGTHS holds the two ends of this range."""
JGJ_LEVEL, JGJ_RISE = 0.1e6 / 20, 0.1e6 / 5
"""Pressure loss of a metre of level pipe and of a metre of rise [Pa/m] (JGJ/T 10)."""
JGJ_BEND, JGJ_VALVE = 0.1e6, 0.8e6
"""Pressure loss of a bend of 90 degrees and of a stop valve [Pa] (JGJ/T 10)."""
JGJ_COUPLING, JGJ_PUMP = 1e5, 28e5
"""Pressure loss of a coupling of two pipes, and of the pump itself [Pa] (JGJ/T 10)."""
JGJ_HOSE, JGJ_HOSE_LENGTHS = 0.2e6, (3.0, 5.0)
"""Pressure loss of a rubber hose [Pa], and the ends of the range of lengths [m] for which JGJ/T 10 states it."""
OTHER_HOSES = "a shorter or longer hose counts in proportion to its length, which the rule does not cover"
"""Remark on a hose whose length is outside the range for which a rule of practice states a loss."""


@dataclass(frozen=True)
class PracticeRow:
    """Pressure of a line by one rule of practice, split by kind of part."""

    rule: str
    pressures: dict[str, float]
    """Pressure losses in the pump line [Pa], summed over the parts of each kind. The weight of rising concrete counts
    for the kind of the part in which the concrete rises."""
    pressure: float
    """Pressure at the pump by this rule of practice [Pa]. It is larger than the sum of the losses if concrete separates
    in falling pipe, because the pressure there is zero and not negative."""
    implies: str
    """Sentence that states which friction the rule assumes, and which pressure it adds where concrete rises."""
    source: str = ""


def _level(part: Part) -> float:
    """Return the horizontal distance between the ends of a straight part [m]; the part may slope."""
    return math.sqrt(max(part.length**2 - part.rise**2, 0.0))


def _hose(length: float, lengths: tuple[float, float]) -> float:
    """Return the loss of a hose of the given `length` [m], divided by the loss that a rule of practice states.

    The rule states one loss for all hoses whose length is between the two `lengths` [m]. The loss per metre of a
    shorter or longer hose is assumed to be that of the shortest or longest hose of the rule.
    """
    shortest, longest = lengths
    return max(min(1.0, length / shortest), length / longest)


def _row(rule: str, parts: Sequence[Part], loss: Callable[[Part], float], implies: str, source: str) -> PracticeRow:
    """Add up the losses of all parts of a pump line by a rule of practice.

    `loss` returns the pressure loss of a part by the rule [Pa]. :class:`PracticeRow` explains the other arguments.
    """
    by_kind: dict[str, float] = {}
    losses = [loss(part) for part in parts]
    for part, own in zip(parts, losses, strict=True):
        by_kind[part.kind] = by_kind.get(part.kind, 0.0) + own
    return PracticeRow(rule, by_kind, course_of(losses)[0], implies, source)


def practice_rows(
    parts: tuple[Part, ...], straight: dict[int, float], weight: float, customary: bool = False
) -> list[PracticeRow]:
    """Return the pressure of a pump line by each rule of practice, with the assumptions of the rule.

    `straight` maps the number of each part of the line to the friction [Pa] of a straight pipe with the length and
    bores of this part. `weight` is the pressure due to the concrete's weight per metre of rise [Pa/m]. If `customary`
    is true, the sentences on the rules state amounts also in US units.

    The friction of a part may be stated in the line's file, as `factor` or `equivalent`, or come from a fit. For such a
    part, each rule uses the rule's friction of straight pipe, multiplied by this factor, and adds the weight.
    """

    def per_metre(part: Part) -> float:
        return straight[part.number] / part.length

    def aij(part: Part) -> float:
        factor = AIJ_FACTORS.get(part.kind, 1.0) if part.factor is None else part.factor
        return factor * straight[part.number] + weight * part.rise

    def jsce(part: Part) -> float:
        rise = float(np.interp(part.diameter, *JSCE_RISE)) * max(part.rise, 0.0)
        if part.factor is not None:
            return part.factor * straight[part.number] + weight * part.rise
        if part.kind == "bend":
            return per_metre(part) * JSCE_BEND * part.angle / 90
        if part.kind == "reducer":
            return per_metre(part) * JSCE_REDUCER
        if part.kind == "hose":
            return per_metre(part) * JSCE_HOSE * _hose(part.length, JSCE_HOSE_LENGTHS)
        return per_metre(part) * (rise + _level(part) if part.rise >= 0 else part.length)

    def jgj(part: Part) -> float:
        if part.factor is not None:
            return part.factor * JGJ_LEVEL * part.length + weight * part.rise
        if part.kind == "bend":
            return JGJ_BEND * part.angle / 90
        if part.kind == "hose":
            return JGJ_HOSE * _hose(part.length, JGJ_HOSE_LENGTHS)
        if part.kind == "valve":
            return JGJ_VALVE
        return JGJ_LEVEL * (_level(part) if part.rise >= 0 else part.length) + JGJ_RISE * max(part.rise, 0.0)

    others = [part for part in parts if part.factor is None]
    kinds = {part.kind for part in others}

    def hoses(lengths: tuple[float, float]) -> str:
        outside = any(part.kind == "hose" and not lengths[0] <= part.length <= lengths[1] for part in others)
        return f"; {OTHER_HOSES}" if outside else ""

    def shown(unit: str, value: float) -> str:
        return both(customary, unit, value, digits=3)

    stated = "; parts with a stated or fitted friction keep it" if len(others) < len(parts) else ""
    longest = max(parts, key=lambda part: part.length if part.kind == "straight" else 0.0)
    metre, counted = per_metre(longest), float(np.interp(longest.diameter, *JSCE_RISE))
    return [
        _row("AIJ", parts, aij,
                    "bends count as 3 times, reducers and hoses as 2 times straight pipe of their length, with the "
                    f"friction of this result, {shown('kPa/m', metre)} in the longest part"
                    f"{_as_straight(kinds, AIJ_OTHERS)}{stated}", AIJ),
        _row("JSCE", parts, jsce,
                    f"rise counts as {counted:.3g} times its length of level pipe, or {shown('kPa/m', counted * metre)}"
                    f", while friction and weight are {shown('kPa/m', metre + weight)}; the rise of bends, "
                    f"reducers and hoses does not count, and falling pipe counts as level{hoses(JSCE_HOSE_LENGTHS)}"
                    f"{_as_straight(kinds, JSCE_OTHERS)}{stated}", JSCE),
        _row("JGJ/T 10", parts, jgj,
                    f"{shown('kPa/m', JGJ_LEVEL)} level and {shown('kPa/m', JGJ_RISE)} of rise, whatever the concrete "
                    "and the flow; only the rise of straight pipe counts; without the rule's "
                    f"{shown('bar', JGJ_COUPLING)} for each coupling and its {shown('bar', JGJ_PUMP)} for the pump "
                    "itself"
                    f"{hoses(JGJ_HOSE_LENGTHS)}{_as_straight(kinds, JGJ_OTHERS)}{stated}", JGJ),
    ]  # fmt: skip


def _as_straight(kinds: Collection[str], others: Sequence[str]) -> str:
    """Return a remark that names the kinds of parts in a line that a rule of practice treats as straight pipe.

    `others` are the kinds that the rule does not cover. `kinds` are the kinds of the line's parts, without parts whose
    friction the line's file states. The remark is empty if no such kind occurs.
    """
    names = [GROUPS[kind] for kind in others if kind in kinds]
    return f"; {' and '.join(names)} count as straight pipe, because the rule does not cover them" if names else ""


def practice_lines(ours: PracticeRow, rows: list[PracticeRow], customary: bool = False) -> list[str]:
    """Return a table of pressures as lines of Markdown, followed by what each rule assumes.

    The pressures are in psi if `customary` is true, and in bar otherwise. The table has one row for each rule and one
    for the program's result. It has one column for each kind of part.
    """
    unit, size = ("psi", PSI) if customary else ("bar", 1e5)
    kinds = [kind for kind in GROUPS if any(kind in row.pressures for row in (ours, *rows))]
    texts = [f"| | pressure [{unit}] | {' | '.join(GROUPS[kind] for kind in kinds)} |", "|" + "---|" * (2 + len(kinds))]
    for row in (ours, *rows):
        cells = [
            row.rule,
            f"{row.pressure / size:.3g}",
            *(f"{row.pressures.get(kind, 0.0) / size:.3g}" for kind in kinds),
        ]
        texts.append(f"| {' | '.join(cells)} |")
    return [*texts, "", *(f"- {row.rule}: {row.implies}" for row in rows)]
