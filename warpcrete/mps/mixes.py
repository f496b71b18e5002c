"""Concretes by name, and the mortar that is left of one without its coarse aggregate."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.concretes import concrete, is_file, known_only, shipped
from ..core.errors import between, one_of, refuse
from ..theory.pipe import THICKER_LAYERS, Concrete

CONSTANTS = ("density", "viscosity", "yield_stress", "slip_viscosity", "slip_yield")
"""Of a concrete, each of which may be given in place of a named one's."""
SUSPENSIONS = {"spheres": (2.5, 0.60), "discs": (2.0, 0.82)}
"""Intrinsic viscosity and densest random packing of rigid inclusions: in three dimensions, and in two."""


def concrete_of(name: str, slip_thickness: float = 0.0, **constants: float | None) -> Concrete:
    """A concrete by name or from a file, or `own` with all five of :data:`CONSTANTS`; those that are given replace the
    named one's.

    A slip layer of one of the thicknesses of the paper's Table 3 has the eta_L printed there.
    """
    given = {key: value for key, value in constants.items() if value is not None}
    known = {} if len(given) == len(CONSTANTS) else _flow_of(name)
    missing = sorted(set(CONSTANTS) - set(given) - set(known))
    if missing:
        refuse("concrete", name, f"needs {', '.join(missing)}", f"give them, or take one of {', '.join(flowing())}")
    if slip_thickness > 0 and "slip_viscosity" not in given and name in THICKER_LAYERS:
        table = THICKER_LAYERS[name]
        match = [eta for thickness, eta in table.items() if abs(thickness - slip_thickness) < 1e-9]
        if not match:
            printed = ", ".join(f"{x:g}" for x in table)
            refuse(
                "slip_thickness", slip_thickness, f"has no printed constants ({printed} have)", "give slip_viscosity"
            )
        given["slip_viscosity"] = match[0]
    return Concrete(name=Path(name).stem, **{**known, **given})


def flowing() -> list[str]:
    """Names of the shipped concretes whose flow is known."""
    return [name for name in shipped() if concrete(name).flow]


def file_constants(values: Mapping[str, Any]) -> dict[str, float]:
    """Constants of the concrete among a scene's parameters, if it is a file and does not have all of them already."""
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not isinstance(name, str) or not is_file(name) or all(values.get(each) is not None for each in CONSTANTS):
        return {}
    return _flow_of(name)


def _flow_of(name: str) -> dict[str, float]:
    """Constants of a concrete by name or from a file; `own` has none."""
    if name == "own":
        return {}
    if not is_file(name):
        one_of("concrete", name, (*flowing(), "own"))
    known = known_only("flow", concrete(name).flow, CONSTANTS, name)
    if not known:
        refuse("concrete", name, "has no section 'flow'", f"give it one: {', '.join(CONSTANTS)}")
    for key, value in known.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            refuse(f"concrete flow {key}", value, f"must be a number (in {name})")
    return known


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
