"""What the closed form of straight pipes makes of the parts of a line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.lines import Part, PipeLine, line_of, read_line, shipped_lines, with_stone
from ..theory.pipe import Concrete, Line, rested, steady

__all__ = [
    "Part", "PipeLine", "friction", "layered", "line_of", "read_line", "restart", "shipped_lines", "with_stone",
]  # fmt: skip

FINE = 200
"""Places at which a taper's friction is summed."""


def friction(part: Part, concrete: Concrete, flow: float) -> float:
    """What the closed form of a straight pipe of a part's bore and length loses, for a hose with its bends [Pa]."""
    concrete = layered(concrete, part.layer)
    at = (np.arange(FINE) + 0.5) / FINE if part.outlet != part.diameter else np.zeros(1)
    bores = part.diameter + at * (part.outlet - part.diameter)
    losses = [steady(concrete, Line(radius=d / 2, length=1.0, rise=0.0), flow).pressure for d in bores.tolist()]
    return float(np.mean(losses)) * part.length * part.curving


def layered(concrete: Concrete, factor: float) -> Concrete:
    """The same concrete with so many times the slip layer's resistance."""
    return replace(concrete, slip_viscosity=factor * concrete.slip_viscosity, slip_yield=factor * concrete.slip_yield)


def restart(line: PipeLine, concrete: Concrete, rest: float, thixotropy: float, flow: float = 0.0) -> float:
    """Pressure at the pump [Pa] that sets all of a line going after `rest` [s], by theory.

    Its yield stresses have grown by `thixotropy` [Pa/s]. Without a `flow` [m3/s] it is that from which the line moves;
    with one that at which it starts at that flow at once.
    """
    grown = rested(concrete, rest, thixotropy)
    weight = concrete.density * Line().gravity * line.rise
    return max(weight + sum(friction(part, grown, flow) for part in line.parts), 0.0)
