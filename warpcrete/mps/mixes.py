"""Concretes for flows, by name or from a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from ..core.errors import one_of, refuse
from ..core.inputs.amounts import amount
from ..core.inputs.concretes import is_file, known_only, shipped
from ..core.inputs.text_files import name_of
from ..mix.mix import UNITS as FLOW_UNITS
from ..mix.mix import completed, mix_named
from ..theory.pipe import SLIP_VISCOSITY_BY_THICKNESS, Concrete

CONSTANTS = ("density", "viscosity", "yield_stress", "slip_viscosity", "slip_yield")
"""Names of the constants of a concrete; a value given as a parameter replaces the named concrete's value."""
AGGREGATES = ("aggregate_fraction", "aggregate_density", "mortar_viscosity", "mortar_yield")
"""Names of the parameters of the coarse aggregate in a two-phase flow."""


def concrete_of(name: str, slip_thickness: float = 0.0, **constants: float | None) -> Concrete:
    """Return a concrete by name or from a file, or `own` with all five :data:`CONSTANTS`.

    Given constants replace those of the named concrete. For a concrete in Table 3 of Xu, Li & Jiang 2021, the slip
    viscosity is taken from that table if the slip layer has a thickness [m] and no slip viscosity is given. Raises
    :class:`SceneError` if constants are missing, or if the table does not list the thickness.
    """
    given = {key: value for key, value in constants.items() if value is not None}
    named = {} if len(given) == len(CONSTANTS) else _flow_of(name)
    missing = sorted(set(CONSTANTS) - set(given) - set(named))
    if missing:
        refuse(
            "concrete",
            name,
            f"has no value for {', '.join(missing)}",
            f"give these values, or use one of the concretes {', '.join(flowing())}",
        )
    if slip_thickness > 0 and "slip_viscosity" not in given and name in SLIP_VISCOSITY_BY_THICKNESS:
        table = SLIP_VISCOSITY_BY_THICKNESS[name]
        match = [eta for thickness, eta in table.items() if abs(thickness - slip_thickness) < 1e-9]
        if not match:
            printed = ", ".join(f"{x:g}" for x in table)
            refuse(
                "slip_thickness",
                slip_thickness,
                f"must be one of the published thicknesses ({printed} m) unless 'slip_viscosity' is given",
                "use a published thickness, or set 'slip_viscosity'",
            )
        given["slip_viscosity"] = match[0]
    return Concrete(name=name_of(name), **{**named, **given})


def flowing() -> list[str]:
    """Return the names of the shipped concretes that have flow constants."""
    return [name for name in shipped() if completed(name).flow]


def file_constants(values: Mapping[str, Any]) -> dict[str, float]:
    """Return the constants of the concrete file that a scene's parameters name.

    The result is empty if the concrete is not a file, or if all constants are given already.
    """
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not isinstance(name, str) or not is_file(name) or all(values.get(each) is not None for each in CONSTANTS):
        return {}
    return _flow_of(name)


def file_aggregates(values: Mapping[str, Any]) -> dict[str, float]:
    """Return the aggregate's parameters from the concrete file that a scene's parameters name.

    They are volume fraction and density of the coarse aggregate, and the constants of the mortar. The result is empty
    unless the scene has two phases, the file describes a mix, and the scene leaves out at least one of these values.
    """
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not values.get("aggregates") or not isinstance(name, str) or not is_file(name):
        return {}
    if all(each in values for each in AGGREGATES):
        return {}
    found = mix_named(name)
    return {} if found is None else found.aggregates


def _flow_of(name: str) -> dict[str, float]:
    """Return the flow constants of a concrete by name or from a file; the concrete `own` has none."""
    if name == "own":
        return {}
    if not is_file(name):
        one_of("concrete", name, (*flowing(), "own"))
    found = known_only("flow", completed(name).flow, CONSTANTS, name)
    if not found:
        refuse("concrete", name, "must have a section 'flow'", f"add a section 'flow' with {', '.join(CONSTANTS)}")
    return {key: amount(f"concrete flow {key}", value, FLOW_UNITS[key]) for key, value in found.items()}
