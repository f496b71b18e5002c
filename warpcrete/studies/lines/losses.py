"""Friction of the parts of a pump line by closed forms, and its dependence on the slip layer."""

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...geometry.lines import line_of, read_line, shipped_lines, with_stone
from ...geometry.pipe_line import Part, PipeLine
from ...theory.pipe import Concrete, Line, steady

__all__ = [
    "Part",
    "PipeLine",
    "course_of",
    "friction",
    "line_of",
    "read_line",
    "shipped_lines",
    "straight_friction",
    "with_layer_factor",
    "with_stone",
]

GRAVITY = 9.81
"""Gravitational acceleration [m/s2]."""
ASSUMED_DENSITY = 2350.0
"""Density [kg/m3] that is assumed for a concrete if neither its density nor its composition is stated. The density
determines the weight of concrete in a line and affects its slump, but hardly affects its friction."""
PLACES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Positions between -1 and 1 along a tapered part at which the friction is evaluated, and the weights with which the
values are summed (Gauss-Legendre quadrature)."""


def friction(part: Part, concrete: Concrete, flow: float) -> float:
    """Return a part's friction [Pa]: the closed form for straight pipe of the same bore and length, times a factor.

    The line's file may state the factor for the part. Otherwise, a hose gets the factor of the program's model of
    hoses, and all other parts get 1.
    """
    return straight_friction(part, concrete, flow) * part.relative


def straight_friction(part: Part, concrete: Concrete, flow: float) -> float:
    """Return the friction [Pa] of a straight pipe with the bores, the length and the slip layer of a part."""
    concrete = with_layer_factor(concrete, part.layer)

    return _friction_per_metre(concrete, part.diameter, part.outlet, flow) * part.length


@functools.lru_cache(maxsize=4096)
def _friction_per_metre(concrete: Concrete, diameter: float, outlet: float, flow: float) -> float:
    """Return the mean friction per metre [Pa/m] of a pipe whose bore changes evenly from `diameter` to `outlet` [m].

    The results are cached, because most parts of a line have the same bores, and because the uncertainty band needs the
    friction of the same parts for many concretes.
    """

    def per_metre(bore: float) -> float:
        return steady(concrete, Line(radius=bore / 2, length=1.0, rise=0.0), flow).pressure

    if outlet == diameter:
        return per_metre(diameter)
    bores = diameter + (PLACES + 1) / 2 * (outlet - diameter)
    return float(WEIGHTS @ [per_metre(each) for each in bores.tolist()]) / 2


def course_of(losses: Sequence[float]) -> list[float]:
    """Return the pressures at the start of a line and at the ends of its parts [Pa], shape (parts + 1,).

    `losses` holds the pressure loss of each part [Pa], in the order from the start of the line to its end. The pressure
    at the end of the line is zero. No pressure is below zero, because the concrete column transmits no tension: it
    breaks where concrete runs down faster than it is pumped.
    """
    pressures = [0.0]
    for loss in reversed(losses):
        pressures.append(max(pressures[-1] + loss, 0.0))
    return pressures[::-1]


def with_layer_factor(concrete: Concrete, factor: float) -> Concrete:
    """Return the concrete with a slip layer that has `factor` times the resistance; for 1, the unchanged concrete."""
    if factor == 1:
        return concrete
    return replace(
        concrete,
        slip_viscosity=factor * concrete.slip_viscosity,
        slip_yield=factor * concrete.slip_yield,
        slip_quadratic_viscosity=factor * concrete.slip_quadratic_viscosity,
    )
