"""Lines by theory of a concrete that slides as a plug, so that their friction follows by hand."""

import math

from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.run import run_line
from warpcrete.theory.pipe import Concrete

PLUG = Concrete(density=2400.0, viscosity=1e6, yield_stress=1e9, slip_viscosity=1000.0, slip_yield=50.0)
"""A plug that slides along the wall: friction per metre is 4 (50 + 1000 v) / d."""
FLOW = 0.005
METRE = 4 * (50 + 1000 * FLOW / (math.pi * 0.125**2 / 4)) / 0.125
"""Friction per metre of a pipe of 125 mm [Pa/m]."""


def line(*parts, **more):
    return line_of({"diameter": "125 mm", "parts": list(parts), **more})


def pumped(*parts, factor=1.0, stop=None, **more):
    return run_line(line(*parts, **more), PLUG, FLOW, simulate=False, layer_factor=factor, stop=stop)
