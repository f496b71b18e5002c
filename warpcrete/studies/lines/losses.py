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
    "straight_friction",
    "with_layer_factor",
    "with_stone",
]  # fmt: skip

GRAVITY = 9.81
"""Gravitational acceleration [m/s2]."""
PLACES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Places between -1 and 1 along a tapered part at which the friction is evaluated, and their weights (Gauss)."""


def friction(part: Part, concrete: Concrete, flow: float) -> float:
    """Return a part's friction [Pa] by the closed form for a straight pipe of the same bore and length.

    The result is multiplied by the factor that the line's file states for the part, or by that of a hose.
    """
    return straight_friction(part, concrete, flow) * part.relative


def straight_friction(part: Part, concrete: Concrete, flow: float) -> float:
    """Return the friction [Pa] of a straight pipe with the bores, the length and the slip layer of a part."""
    concrete = with_layer_factor(concrete, part.layer)

    def per_metre(diameter: float) -> float:
        return steady(concrete, Line(radius=diameter / 2, length=1.0, rise=0.0), flow).pressure

    if part.outlet == part.diameter:
        return per_metre(part.diameter) * part.length
    bores = part.diameter + (PLACES + 1) / 2 * (part.outlet - part.diameter)
    losses = [per_metre(each) for each in bores.tolist()]
    return float(WEIGHTS @ losses) / 2 * part.length


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
    weight = concrete.density * GRAVITY * line.rise
    return max(weight + sum(friction(part, grown, flow) for part in line.parts), 0.0)
