"""Coarse aggregate in mortar: how aggregate thickens mortar, and which mortar a concrete contains."""

from dataclasses import replace

import numpy as np

from ..core.errors import at_least_and_below, one_of
from .pipe import Concrete

SUSPENSIONS = {"spheres": (2.5, 0.60), "discs": (2.0, 0.82)}
"""Pairs of intrinsic viscosity and densest random packing (a volume fraction) of rigid inclusions: spheres in three
dimensions, discs in two."""


def thickening(fraction: float, intrinsic: float, densest: float) -> tuple[float, float]:
    """Return the factors by which a volume `fraction` of coarse aggregate raises a mortar's viscosity and yield stress.

    The viscosity factor is Krieger & Dougherty's, f = (1 - fraction / densest)^(-intrinsic densest), with the intrinsic
    viscosity and the densest packing. The yield stress factor is sqrt((1 - fraction) f) (Chateau, Ovarlez & Trung
    2008).
    """
    at_least_and_below("aggregate fraction", fraction, 0, densest, "", "the end is the fraction of the densest packing")
    factor = (1 - fraction / densest) ** (-intrinsic * densest)
    return factor, float(np.sqrt((1 - fraction) * factor))


def power_thickening(factor: float, fraction: float, index: float) -> float:
    """Return the factor by which a volume `fraction` of aggregate raises the consistency k in the stress k g^n.

    Here g is the shear rate and n the flow `index`. `factor` is the viscosity factor f of :func:`thickening`. The
    mortar between the aggregates is sheared sqrt(f / (1 - fraction)) times as fast as the whole concrete. The result is
    therefore sqrt(f^(n + 1) (1 - fraction)^(1 - n)) (Chateau, Ovarlez & Trung 2008), which is f for n = 1.
    """
    if index == 1.0:
        return factor
    return float(np.sqrt(factor ** (index + 1) * (1 - fraction) ** (1 - index)))


def mortar_of(concrete: Concrete, fraction: float, density: float, inclusions: str = "spheres") -> Concrete:
    """Return the mortar that becomes `concrete` when a volume `fraction` of coarse aggregate is added.

    The relation is :func:`thickening` with the constants of `inclusions` in :data:`SUSPENSIONS`; `density` is the
    density of the aggregate [kg/m3]. The relation is an assumption: Xu, Li & Jiang 2021 measured their mortars but do
    not print the values.
    """
    one_of("inclusions", inclusions, SUSPENSIONS)
    viscosity, yield_stress = thickening(fraction, *SUSPENSIONS[inclusions])
    return replace(
        concrete,
        name=f"mortar of {concrete.name}",
        density=(concrete.density - fraction * density) / (1 - fraction),
        viscosity=concrete.viscosity / power_thickening(viscosity, fraction, concrete.flow_index),
        yield_stress=concrete.yield_stress / yield_stress,
        quadratic_viscosity=concrete.quadratic_viscosity / power_thickening(viscosity, fraction, 2.0),
    )


def concrete_of_mortar(mortar: Concrete, fraction: float, density: float, inclusions: str = "spheres") -> Concrete:
    """Return the concrete that results when a volume `fraction` of coarse aggregate is added to `mortar`.

    This is the inverse of :func:`mortar_of`, with the same assumptions. The concrete keeps the slip layer of the
    mortar.
    """
    one_of("inclusions", inclusions, SUSPENSIONS)
    viscosity, yield_stress = thickening(fraction, *SUSPENSIONS[inclusions])
    return replace(
        mortar,
        name=f"{mortar.name} with aggregate",
        density=(1 - fraction) * mortar.density + fraction * density,
        viscosity=mortar.viscosity * power_thickening(viscosity, fraction, mortar.flow_index),
        yield_stress=mortar.yield_stress * yield_stress,
        quadratic_viscosity=mortar.quadratic_viscosity * power_thickening(viscosity, fraction, 2.0),
    )
