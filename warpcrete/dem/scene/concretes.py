"""Translate a named concrete, or a concrete from a file, into parameters of discrete elements."""

import os
from collections.abc import Mapping, Sequence

from ...core.errors import refuse
from ...core.inputs.concretes import NamedConcrete, known_only
from ...core.inputs.limits import warn
from ...core.inputs.yaml_files import merged
from ...core.records import Record, SceneArguments
from ...mix.mix import FACTORS, completed, flow_amounts

SIZES = ("sizes", "size_min", "size_max")
"""Names of the parameters that set the sizes of the aggregates."""
COVERAGE = 0.8
"""Ratio of the area on which the lubrication layer acts to the area of the wall.

The layer acts on the area pi r^2 of every wall contact of a sphere with the radius r. For clumps with the contacts of
Zhan (2019, Table 1), `tests/bench/bench_layer.py` measures a ratio of 0.77 at a pressure of 2.8 kPa and 0.79 at 6.2
kPa. With 0.8, Zhan's pipe units A and B with the concretes no. 1 and no. 3 of Xu (2021) agree within 4 % with the
closed form for plug flow. Single spheres without friction between them roll along the layer, so that their effective
ratio is only 0.02.
"""


def elements_of(values: Mapping[str, object], known: Sequence[str], default: str) -> SceneArguments:
    """Return the parameters of discrete elements that follow from the concrete in the scene's parameters `values`.

    `known` lists the parameters that a concrete may set; `default` is the name used if `values` has no concrete. If
    `values` already contains all of these parameters, as in the stored scene of a run, the result is an empty
    dictionary. Raises :class:`SceneError` for a concrete that does not exist or that sets other parameters.
    """
    name = values.get("concrete", default)
    name = str(name) if isinstance(name, os.PathLike) else name
    if not isinstance(name, str) or all(each in values for each in known):
        return {}
    concrete = completed(name)
    section = concrete.elements or _of_flow(concrete)
    if concrete.mix is not None:
        layer_given = {"layer_yield", "layer_viscosity"} <= set(concrete.mix.elements)
        section = merged(concrete.elements, _of_flow(concrete, layer_given), concrete.mix.elements)
    sized = any(size in values or size in section for size in SIZES)
    if concrete.flow and not sized and (concrete.mix is not None or not concrete.elements):
        warn(
            f"concrete {concrete.name} has no sieve curve, so its aggregate has the default sizes of the scene; give "
            "sieve openings [mm] with the fractions that pass them, in a mix 'sieve: {4: 0, 8: 0.4, 16: 1}', or as "
            "the parameter sizes='4:0,8:0.4,16:1'"
        )
    # The elements get the bulk density of the concrete, unless the user gives a density.
    if "density" in values:
        section = merged(section)
        section.pop("bulk_density", None)
    return known_only("elements", section, known, name)


def _of_flow(concrete: NamedConcrete, layer_given: bool = False) -> Record:
    """Return bulk density and slip layer of `concrete`, of which only flow properties are known.

    The walls then have no friction and resist only by the slip layer. Parameters that are not returned keep the values
    of Zhan (2019, Table 1).

    Discrete elements support only Bingham's law for the slip layer. Raises :class:`SceneError` for another law, unless
    `layer_given` is True. The caller then replaces the values of the layer.
    """
    flow = flow_amounts(concrete)
    missing = [name for name in ("density", "slip_viscosity", "slip_yield") if name not in flow]
    if missing:
        problem = f"missing in the concrete {concrete.name!r}, but needed by discrete elements"
        hint = "add what is missing to the section 'flow' of the concrete's file, or add a section 'elements'"
        refuse("concrete flow", ", ".join(missing), problem, hint)
    for name, plain in (("slip_flow_index", 1.0), ("slip_quadratic_viscosity", 0.0)):
        if flow.get(name, plain) != plain and not layer_given:
            refuse(
                f"concrete flow {name}",
                flow[name],
                "cannot be simulated with discrete elements, because the stress of such a slip layer does not grow "
                "linearly with velocity",
                "give layer_yield and layer_viscosity in the section 'elements'",
            )
    stiffer, thicker = (flow.get(name, plain) for name, plain in FACTORS.items())
    return {
        "bulk_density": flow["density"],
        "wall_friction": 0.0,
        "layer_yield": stiffer * flow["slip_yield"] / COVERAGE,
        "layer_viscosity": thicker * flow["slip_viscosity"] / COVERAGE,
    }
