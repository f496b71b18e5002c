"""From tests of fresh concrete back to its yield stress and viscosity: the closed forms of slump and spread, inverted,
and what T500 tells; all of the cone of EN 12350-2.
"""

from __future__ import annotations

import math

import numpy as np

from .vessels import cone_volume, heap_volume, root, tall_cone_slump

TOP, BASE, HEIGHT = 0.05, 0.10, 0.30
"""Radii and height of the cone of EN 12350-2 [m]."""
VOLUME = cone_volume(TOP, BASE, HEIGHT)
STIFFEST = 1e4
"""Yield stress above any that such a cone tells of [Pa]: it bears itself from 2.4 kPa on."""
GRAVITY = 9.81

SPREADS = (0.500, 0.527, 0.562, 0.611, 0.694, 0.808, 1.132)
T500_FACTORS = (3.53e-4, 5.58e-4, 7.57e-4, 9.39e-4, 11.34e-4, 12.11e-4, 12.56e-4)
"""Viscosity over rho g T500 [m], by the spread at rest [m] that :func:`warpcrete.theory.vessels.heap_at_rest` has.

Measured with this program's own flow: `warpcrete run slump`, 300 Pa s, 2300 kg/m3, yield stresses of 80, 65, 50, 35,
20, 10 and 2 Pa, cells of 10 mm, the mould lifted in 1 s. Without yield stress a viscous heap (Huppert 1982, about an
axis: 0.894 (rho g V^3 t / (3 mu))^(1/8)) has 14.8e-4. With 30 Pa s, where inertia and the lift count, 50 Pa comes to
8.7e-4 if the mould is lifted in 1 s, and to 5.9e-4 in 3 s.
"""


def yield_of_long_heap(spread: float, density: float) -> float:
    """Yield stress [Pa] of a heap of this diameter [m]: 225 rho g V^2 / (128 pi^2 R^5) (Roussel & Coussot 2005)."""
    return 225 * density * GRAVITY * VOLUME**2 / (128 * math.pi**2 * (spread / 2) ** 5)


def yield_of_heap(spread: float, density: float) -> float:
    """The same of a heap that resists its stretch as well (:func:`warpcrete.theory.vessels.heap_at_rest`) [Pa]."""
    return root(lambda stress: heap_volume(spread / 2, stress, density) - VOLUME, 0.0, STIFFEST)


def yield_of_slump(slump: float, density: float, bears: float = math.sqrt(3)) -> float:
    """Yield stress [Pa] at which the cone slumps so far [m], by :func:`warpcrete.theory.vessels.tall_cone_slump`."""
    return root(lambda stress: slump - tall_cone_slump(TOP, BASE, HEIGHT, stress, density, bears=bears), 0.0, STIFFEST)


def yield_of_slump_measured(slump: float, density: float) -> float:
    """Yield stress [Pa] by rho (30 cm - slump) / 34.7 + 212, what the rheometer BTRHEOM had of some 80 mixes, with a
    mean deviation of 162 Pa (Ferraris & de Larrard 1998); Hu has rho (30 cm - slump) / 27 by finite elements.
    """
    return density * (30 - 100 * slump) / 34.7 + 212


def viscosity_of_t500(t500: float, spread: float, density: float) -> float:
    """Plastic viscosity [Pa s] from the time to 500 mm [s] and the spread at rest [m], by :data:`T500_FACTORS`."""
    return density * GRAVITY * t500 * float(np.interp(spread, SPREADS, T500_FACTORS))


def viscosity_of_t500_sedran(t500: float, spread: float, density: float) -> float:
    """The same by rho g T500 (0.026 spread - 2.39) / 10,000, spread in mm: a relation ascribed to Sedran & de Larrard
    (1999), who had it beside the rheometer BTRHEOM; their paper was not seen.
    """
    return density * GRAVITY * t500 * max(0.026 * 1e3 * spread - 2.39, 0.0) / 1e4
