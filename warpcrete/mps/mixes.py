"""Concretes by name, and the mortar that is left of one without its coarse aggregate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..core.errors import between, one_of, refuse
from .theory import CONCRETES, THICKER_LAYERS, Concrete

CONSTANTS = ("density", "viscosity", "yield_stress", "slip_viscosity", "slip_yield")
"""Of a concrete, each of which may be given in place of a named one's."""
SUSPENSIONS = {"spheres": (2.5, 0.60), "discs": (2.0, 0.82)}
"""Intrinsic viscosity and densest random packing of rigid inclusions: in three dimensions, and in two."""


def concrete_of(name: str, slip_thickness: float = 0.0, **constants: float | None) -> Concrete:
    """A concrete by name, or `own` with all five of :data:`CONSTANTS`; those that are given replace the named one's.

    A slip layer of one of the thicknesses of the paper's Table 3 has the eta_L printed there.
    """
    one_of("concrete", name, (*CONCRETES, "own"))
    given = {key: value for key, value in constants.items() if value is not None}
    if name == "own":
        missing = sorted(set(CONSTANTS) - set(given))
        if missing:
            refuse("concrete", name, f"needs {', '.join(missing)}", f"give them, or take one of {', '.join(CONCRETES)}")
        return Concrete(name="own", **given)
    if slip_thickness > 0 and "slip_viscosity" not in given:
        table = THICKER_LAYERS[name]
        match = [eta for thickness, eta in table.items() if abs(thickness - slip_thickness) < 1e-9]
        if not match:
            printed = ", ".join(f"{x:g}" for x in table)
            refuse(
                "slip_thickness", slip_thickness, f"has no printed constants ({printed} have)", "give slip_viscosity"
            )
        given["slip_viscosity"] = match[0]
    return replace(CONCRETES[name], **given) if given else CONCRETES[name]


def mortar_of(concrete: Concrete, fraction: float, density: float, inclusions: str = "spheres") -> Concrete:
    """Mortar whose mix with a `fraction` of coarse aggregate of `density` gives `concrete`, by homogenisation.

    Krieger & Dougherty for the viscosity, f = (1 - fraction / densest)^(-intrinsic densest), and Chateau, Ovarlez &
    Trung (2008) for the yield stress, the root of (1 - fraction) f; `inclusions` names the constants in
    :data:`SUSPENSIONS`. An assumption: the paper measured its mortars and does not print them.
    """
    one_of("inclusions", inclusions, SUSPENSIONS)
    intrinsic, densest = SUSPENSIONS[inclusions]
    between("aggregate fraction", fraction, 0, np.nextafter(densest, 0), "", "less than the densest packing")
    factor = (1 - fraction / densest) ** (-intrinsic * densest)
    rest = (concrete.density - fraction * density) / (1 - fraction)
    return Concrete(
        name=f"mortar of {concrete.name}",
        density=rest,
        viscosity=concrete.viscosity / factor,
        yield_stress=concrete.yield_stress / np.sqrt((1 - fraction) * factor),
        slip_viscosity=concrete.slip_viscosity,
        slip_yield=concrete.slip_yield,
    )
