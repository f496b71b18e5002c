"""Yield stress and viscosity of fresh concrete, estimated from its slump, its spread and T500.

The yield stress follows from slump or spread, by inversion of the closed forms of :mod:`.vessels`. All formulas are for
the cone of EN 12350-2.
"""

import functools
import math

import numpy as np

from .vessels import cone_volume, heap_volume, root, tall_cone_slump

TOP, BASE, HEIGHT = 0.05, 0.10, 0.30
"""Top radius, base radius and height of the cone of EN 12350-2 [m]."""
VOLUME = cone_volume(TOP, BASE, HEIGHT)
STIFFEST = 1e4
"""Upper bound of the search for a yield stress [Pa]. A cone with a yield stress above 2.4 kPa does not slump at all."""
GRAVITY = 9.81

SPREADS = (0.500, 0.527, 0.562, 0.611, 0.694, 0.808, 1.132)
T500_FACTORS = (3.53e-4, 5.58e-4, 7.57e-4, 9.39e-4, 11.34e-4, 12.11e-4, 12.56e-4)
"""Ratio of the viscosity to rho g T500 [m], for each diameter of the spread at rest in `SPREADS` [m].

Here rho is the density, g gravity, and T500 the time until the spread reaches 500 mm. The function
:func:`warpcrete.theory.vessels.heap_at_rest` gives the spreads at rest. The factors were measured with this program's
own flow: `warpcrete run slump` with 300 Pa s, 2300 kg/m3, yield stresses of 80, 65, 50, 35, 20, 10 and 2 Pa, cells of
10 mm, and a mould lifted in 1 s. For comparison, the factor of a viscous heap without yield stress is 14.8e-4 m
(Huppert 1982, about an axis: radius 0.894 (rho g V^3 t / (3 mu))^(1/8)). At 30 Pa s inertia and the lift matter: with a
yield stress of 50 Pa the factor is 8.7e-4 m for a lift in 1 s, and 5.9e-4 m for a lift in 3 s.
"""


def yield_of_long_heap(spread: float, density: float) -> float:
    """Return the yield stress [Pa] of a heap that is much wider than high, from its diameter `spread` [m].

    The formula of Roussel & Coussot (2005) is 225 rho g V^2 / (128 pi^2 R^5), with the density rho, gravity g, the
    volume V of the cone of the slump test, and the radius R of the heap.
    """
    return 225 * density * GRAVITY * VOLUME**2 / (128 * math.pi**2 * (spread / 2) ** 5)


@functools.lru_cache(1024)
def yield_of_heap(spread: float, density: float) -> float:
    """Return the yield stress [Pa] of concrete whose heap in a slump test comes to rest at a diameter of `spread` [m].

    The theory is :func:`warpcrete.theory.vessels.heap_at_rest`. It includes the resistance of the heap to stretching,
    which :func:`yield_of_long_heap` neglects.
    """
    return root(lambda stress: heap_volume(spread / 2, stress, density) - VOLUME, 0.0, STIFFEST)


@functools.lru_cache(maxsize=256)
def yield_of_slump(slump: float, density: float, bears: float = math.sqrt(3)) -> float:
    """Return the yield stress [Pa] at which the cone slumps by `slump` [m].

    The theory is :func:`warpcrete.theory.vessels.tall_cone_slump`, in which a layer yields if the vertical pressure on
    it exceeds `bears` times the yield stress.
    """
    return root(lambda stress: slump - tall_cone_slump(TOP, BASE, HEIGHT, stress, density, bears=bears), 0.0, STIFFEST)


def yield_of_slump_measured(slump: float, density: float) -> float:
    """Return the yield stress [Pa] for a `slump` [m], by the empirical relation of Ferraris & de Larrard (1998).

    With the density rho [kg/m3] and the slump in cm, the yield stress is rho (30 - slump) / 34.7 + 212. The relation
    was fitted to measurements of some 80 mixes with the rheometer BTRHEOM; the mean deviation is 162 Pa.
    """
    return density * (30 - 100 * slump) / 34.7 + 212


def viscosity_of_t500(t500: float, spread: float, density: float) -> float:
    """Return the plastic viscosity [Pa s] from T500 [s] and the spread at rest [m], by :data:`T500_FACTORS`.

    T500 is the time until the spread reaches 500 mm.
    """
    return density * GRAVITY * t500 * float(np.interp(spread, SPREADS, T500_FACTORS))


def viscosity_of_t500_sedran(t500: float, spread: float, density: float) -> float:
    """Return the plastic viscosity [Pa s] from T500 [s] and the spread at rest [m], by an empirical relation.

    The relation, rho g T500 (0.026 spread - 2.39) / 10,000 with the spread in mm, is ascribed to Sedran & de Larrard
    (1999), who compared T500 with the rheometer BTRHEOM. Their paper itself was not available.
    """
    return density * GRAVITY * t500 * max(0.026 * 1e3 * spread - 2.39, 0.0) / 1e4
