"""Coarse aggregate in mortar: what the one makes of the other, and what is left of a concrete without it."""

from __future__ import annotations

import numpy as np

from ..core.errors import between, one_of
from .pipe import Concrete

SUSPENSIONS = {"spheres": (2.5, 0.60), "discs": (2.0, 0.82)}
"""Intrinsic viscosity and densest random packing of rigid inclusions: in three dimensions, and in two."""


def thickening(fraction: float, intrinsic: float, densest: float) -> tuple[float, float]:
    """How many times the viscosity and the yield stress of a mortar its mix has with a `fraction` of coarse aggregate.

    Krieger & Dougherty for the viscosity, f = (1 - fraction / densest)^(-intrinsic densest), and Chateau, Ovarlez &
    Trung (2008) for the yield stress, the root of (1 - fraction) f.
    """
    between("aggregate fraction", fraction, 0, np.nextafter(densest, 0), "", "use less than the densest packing")
    factor = (1 - fraction / densest) ** (-intrinsic * densest)
    return factor, float(np.sqrt((1 - fraction) * factor))


def mortar_of(concrete: Concrete, fraction: float, density: float, inclusions: str = "spheres") -> Concrete:
    """Mortar whose mix with a `fraction` of coarse aggregate of `density` gives `concrete`, by :func:`thickening`;
    `inclusions` names the constants in :data:`SUSPENSIONS`.

    An assumption: Xu, Li & Jiang 2021 measured their mortars and do not print them.
    """
    one_of("inclusions", inclusions, SUSPENSIONS)
    viscosity, yield_stress = thickening(fraction, *SUSPENSIONS[inclusions])
    return Concrete(
        name=f"mortar of {concrete.name}",
        density=(concrete.density - fraction * density) / (1 - fraction),
        viscosity=concrete.viscosity / viscosity,
        yield_stress=concrete.yield_stress / yield_stress,
        slip_viscosity=concrete.slip_viscosity,
        slip_yield=concrete.slip_yield,
    )
