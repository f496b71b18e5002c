"""Where concrete of a yield stress comes to rest: closed forms of slump and spread.

A long heap rests where the weight of its slope is borne by the plate (Roussel & Coussot 2005); a tall one where each
layer has grown wide enough to bear what is above it (Murata 1984; for cones Schowalter & Christensen 1998). Murata's
concrete yields where the largest shear stress is the yield stress, half of what presses (Tresca); a Bingham fluid in
three dimensions does where the invariant of all stresses is (von Mises), at the root of a third of it.
"""

from __future__ import annotations

import math

import numpy as np

LAYERS = 4000
"""Into which a cone is cut for the sum over its height."""


def cone_volume(top: float, base: float, height: float) -> float:
    """Of a truncated cone of these radii [m3]."""
    return math.pi * height / 3 * (top * top + top * base + base * base)


def long_heap_spread(volume: float, yield_stress: float, density: float, gravity: float = 9.81) -> float:
    """Diameter of a heap much wider than high [m]: tau = 225 rho g V^2 / (128 pi^2 R^5) (Roussel & Coussot 2005)."""
    return 2 * (225 * density * gravity * volume**2 / (128 * math.pi**2 * yield_stress)) ** 0.2


def tall_cone_slump(
    top: float, base: float, height: float, yield_stress: float, density: float, gravity: float = 9.81,
    bears: float = math.sqrt(3),
) -> float:  # fmt: skip
    """Fall of the top of a truncated cone [m], each layer of which widens until it bears what is above it.

    A layer bears a pressure of `bears` yield stresses: the root of 3 by von Mises, 2 by Tresca as Murata 1984 has it.
    """
    depth = (np.arange(LAYERS) + 0.5) * height / LAYERS
    radius = top + (base - top) * depth / height
    area = math.pi * radius**2
    load = density * gravity * math.pi * depth / 3 * (top * top + top * radius + radius * radius)
    stays = np.minimum(1.0, bears * yield_stress * area / load)  # of the layer's height
    return float(np.sum(1 - stays) * height / LAYERS)
