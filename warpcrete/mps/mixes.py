"""Concretes by name, as flows take them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from ..core.amounts import amount
from ..core.concretes import is_file, known_only, shipped
from ..core.errors import one_of, refuse
from ..core.text_files import name_of
from ..mix.mix import UNITS as FLOW_UNITS
from ..mix.mix import completed, mix_named
from ..theory.pipe import THICKER_LAYERS, Concrete

CONSTANTS = ("density", "viscosity", "yield_stress", "slip_viscosity", "slip_yield")
"""Of a concrete, each of which may be given in place of a named one's."""
AGGREGATES = ("aggregate_fraction", "aggregate_density", "mortar_viscosity", "mortar_yield")
"""Of its coarse aggregate in a flow of two phases."""


def concrete_of(name: str, slip_thickness: float = 0.0, **constants: float | None) -> Concrete:
    """A concrete by name or from a file, or `own` with all five of :data:`CONSTANTS`; those that are given replace the
    named one's.

    A slip layer of one of the thicknesses of the paper's Table 3 has the eta_L printed there.
    """
    given = {key: value for key, value in constants.items() if value is not None}
    named = {} if len(given) == len(CONSTANTS) else _flow_of(name)
    missing = sorted(set(CONSTANTS) - set(given) - set(named))
    if missing:
        refuse(
            "concrete",
            name,
            f"has no value for {', '.join(missing)}",
            f"give them, or use one of {', '.join(flowing())}",
        )
    if slip_thickness > 0 and "slip_viscosity" not in given and name in THICKER_LAYERS:
        table = THICKER_LAYERS[name]
        match = [eta for thickness, eta in table.items() if abs(thickness - slip_thickness) < 1e-9]
        if not match:
            printed = ", ".join(f"{x:g}" for x in table)
            refuse(
                "slip_thickness",
                slip_thickness,
                f"must be a thickness with printed constants ({printed}), or slip_viscosity must be given",
                "give slip_viscosity",
            )
        given["slip_viscosity"] = match[0]
    return Concrete(name=name_of(name), **{**named, **given})


def flowing() -> list[str]:
    """Names of the shipped concretes whose flow is known."""
    return [name for name in shipped() if completed(name).flow]


def file_constants(values: Mapping[str, Any]) -> dict[str, float]:
    """Constants of the concrete among a scene's parameters, if it is a file and does not have all of them already."""
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not isinstance(name, str) or not is_file(name) or all(values.get(each) is not None for each in CONSTANTS):
        return {}
    return _flow_of(name)


def file_aggregates(values: Mapping[str, Any]) -> dict[str, float]:
    """Share, density and mortar of the coarse aggregate, where two phases are asked for and the concrete among a
    scene's parameters is a file that describes a mix."""
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not values.get("aggregates") or not isinstance(name, str) or not is_file(name):
        return {}
    if all(each in values for each in AGGREGATES):
        return {}
    found = mix_named(name)
    return {} if found is None else found.aggregates


def _flow_of(name: str) -> dict[str, float]:
    """Constants of a concrete by name or from a file; `own` has none."""
    if name == "own":
        return {}
    if not is_file(name):
        one_of("concrete", name, (*flowing(), "own"))
    found = known_only("flow", completed(name).flow, CONSTANTS, name)
    if not found:
        refuse("concrete", name, "must have a section 'flow'", f"add it with {', '.join(CONSTANTS)}")
    return {key: amount(f"concrete flow {key}", value, FLOW_UNITS[key]) for key, value in found.items()}
