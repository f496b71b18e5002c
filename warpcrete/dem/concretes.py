"""What a concrete by its name, or from a file, is to discrete elements."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from ..core.concretes import NamedConcrete, known_only
from ..core.errors import refuse
from ..core.limits import warn
from ..mix.mix import completed

SIZES = ("sizes", "size_min", "size_max")
"""Parameters that tell the sizes of the aggregate."""
COVERAGE = 0.8
"""Area on which a lubrication layer acts (pi r^2 of every contact with the wall) over that of the wall, of clumps with
the contacts of Zhan's Table 1: 0.77 at 2.8 and 0.79 at 6.2 kPa, by `tests/bench_layer.py`. With it units A and B of
no. 1 and no. 3 come within 4 % of a plug's closed form. Single spheres roll along a layer: 0.02 where nothing rubs."""


def elements_of(values: Mapping[str, Any], known: Sequence[str], default: str) -> dict[str, Any]:
    """Parameters of discrete elements that the concrete among `values` stands for.

    `known` are those that a concrete may set, `default` the concrete's name where none is given. A
    concrete of which all of these are given is not looked up: a run's record says everything itself. Raises
    :class:`SceneError` for a concrete that does not exist, or sets anything else.
    """
    name = values.get("concrete", default)
    name = str(name) if isinstance(name, os.PathLike) else name
    if not isinstance(name, str) or all(each in values for each in known):
        return {}
    found = completed(name)
    section = found.elements or _of_flow(found)
    if found.mix is not None:
        section = {**found.elements, **_of_flow(found), **found.mix.elements}
    sized = any(size in values or size in section for size in SIZES)
    if found.flow and not sized and (found.mix is not None or not found.elements):
        warn(f"concrete {found.name} has no sieve curve: its aggregate has the default sizes of the scene; "
             "sizes = '4:0,8:0.4,16:1' gives one")  # fmt: skip
    if "density" in values:  # of the aggregates: the concrete's own then says nothing
        section = {key: value for key, value in section.items() if key != "bulk_density"}
    return known_only("elements", section, known, name)


def _of_flow(found: NamedConcrete) -> dict[str, Any]:
    """Of a concrete whose flow alone is known: its density, and its slip layer, which is all that walls do to it; all
    else is Zhan's Table 1."""
    flow = found.flow
    missing = [name for name in ("density", "slip_viscosity", "slip_yield") if name not in flow]
    if missing:
        refuse("concrete flow", ", ".join(missing), f"is missing (in {found.name})", "elements need it, or `elements`")
    return {
        "bulk_density": flow["density"],
        "wall_friction": 0.0,
        "layer_yield": flow["slip_yield"] / COVERAGE,
        "layer_viscosity": flow["slip_viscosity"] / COVERAGE,
    }
