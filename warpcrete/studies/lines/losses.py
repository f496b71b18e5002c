"""Closed-form pressure losses of the parts of a pump line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...geometry.lines import Part, PipeLine, line_of, read_line, shipped_lines, with_stone
from ...theory.pipe import Concrete, Line, after_rest, steady

__all__ = [
    "Part",
    "PipeLine",
    "friction",
    "line_of",
    "read_line",
    "restart",
    "shipped_lines",
    "with_layer_factor",
    "with_stone",
]  # fmt: skip

FINE = 200
"""Number of places along a tapered part at which the friction is evaluated."""


def friction(part: Part, concrete: Concrete, flow: float) -> float:
    """Return a part's friction [Pa] by the closed form for a straight pipe of the same bore and length.

    For a hose, the result includes the additional loss of its bends.
    """
    concrete = with_layer_factor(concrete, part.layer)
    at = (np.arange(FINE) + 0.5) / FINE if part.outlet != part.diameter else np.zeros(1)
    bores = part.diameter + at * (part.outlet - part.diameter)
    losses = [steady(concrete, Line(radius=d / 2, length=1.0, rise=0.0), flow).pressure for d in bores.tolist()]
    return float(np.mean(losses)) * part.length * part.relative_loss


def with_layer_factor(concrete: Concrete, factor: float) -> Concrete:
    """Return a copy of the concrete whose slip layer has `factor` times the resistance."""
    return replace(
        concrete,
        slip_viscosity=factor * concrete.slip_viscosity,
        slip_yield=factor * concrete.slip_yield,
        slip_quadratic_viscosity=factor * concrete.slip_quadratic_viscosity,
    )


def restart(line: PipeLine, concrete: Concrete, rest: float, thixotropy: float, flow: float = 0.0) -> float:
    """Return the pressure at the pump [Pa] that sets a whole line in motion after a `rest` [s], by the closed form.

    During the rest, the yield stresses grow by `thixotropy` [Pa/s]. With a `flow` of 0 [m3/s], the result is the
    pressure at which motion begins; with a larger `flow`, it is the pressure for restarting at that flow at once.
    """
    grown = after_rest(concrete, rest, thixotropy)
    weight = concrete.density * Line().gravity * line.rise
    return max(weight + sum(friction(part, grown, flow) for part in line.parts), 0.0)
