"""Concretes for flows, by name or from a file, and the parameters of a scene that select them."""

import functools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from ...core.errors import one_of, refuse
from ...core.inputs.concretes import is_file, shipped
from ...core.inputs.parameters import Above, FileIf, Suggests, Within
from ...core.inputs.text_files import name_of
from ...core.inputs.yaml_files import merged
from ...mix.mix import FACTORS, completed, flow_amounts, mix_named
from ...theory.pipe import SLIP_VISCOSITY_BY_THICKNESS, Concrete, scaled

BINGHAM_CONSTANTS = ("density", "viscosity", "yield_stress", "slip_viscosity", "slip_yield")
"""Names of the constants, such as density and yield stress, that every concrete has."""
LAW_DEFAULTS = {
    "flow_index": 1.0, "quadratic_viscosity": 0.0, "slip_flow_index": 1.0, "slip_quadratic_viscosity": 0.0,
}  # fmt: skip
"""Constants that Bingham's law lacks but other flow laws have, by name, with their default values. With these values,
the other laws are equal to Bingham's law."""
CONCRETE_CONSTANTS = (*BINGHAM_CONSTANTS, *LAW_DEFAULTS)
"""Names of all constants of a :class:`Concrete`."""
CONSTANTS = (*CONCRETE_CONSTANTS, *FACTORS)
"""Names of all constants of a concrete, and of the factors that multiply its yield stresses and viscosities. A scene
may have parameters with these names; their values replace the constants of the named concrete."""
NO_LAYER = {"slip_viscosity": 1e8, "slip_yield": 0.0}
"""Constants of a slip layer on which concrete hardly slips."""
AGGREGATES = ("aggregate_fraction", "aggregate_density", "mortar_viscosity", "mortar_yield")
"""Names of the parameters of the coarse aggregate in a two-phase flow."""


SELF_COMPACTING = "scc"
"""Name of the shipped self-compacting concrete, the default in tests of concrete of this kind."""


def concrete_names() -> tuple[str, ...]:
    """Return the names that the parameter `concrete` of a flow accepts in addition to paths of files."""
    return *flowing(), "own"


ConcreteName = Annotated[
    str,
    "Concrete: no1, no2, no3 (Xu et al. 2021), scc (self-compacting), the path of a .yaml file, or own, whose "
    "constants the next five parameters state",
    FileIf(is_file),
    Suggests(concrete_names),
]
"""Type of the parameter `concrete`. A scene may declare the parameter again with another default."""


@dataclass(frozen=True, kw_only=True)
class ConcreteParameters:
    """Parameters of the concrete and of its slip layer."""

    common: ClassVar[tuple[str, ...]] = (
        "concrete",
        "density",
        "viscosity",
        "yield_stress",
        "slip_viscosity",
        "slip_yield",
    )

    concrete: ConcreteName = "no1"
    density: Annotated[
        float | None,
        "Density of the concrete [kg/m3]. The density and the other constants of concrete and slip layer, if given, "
        "replace those of the named concrete",
        Above(),
    ] = None
    viscosity: Annotated[
        float | None, "Plastic viscosity [Pa s]; with a flow_index n, the consistency k [Pa s^n]", Above()
    ] = None
    yield_stress: Annotated[float | None, "Yield stress [Pa]", Within(0)] = None
    slip_viscosity: Annotated[
        float | None, "Viscosity of the slip layer divided by its thickness [Pa s/m]", Above()
    ] = None
    slip_yield: Annotated[float | None, "Yield stress of the slip layer [Pa]", Within(0)] = None
    flow_index: Annotated[
        float | None,
        "Flow index n of the Herschel-Bulkley law: stress = yield stress + k rate^n; default: 1 (Bingham law)",
        Above(),
    ] = None
    quadratic_viscosity: Annotated[
        float | None,
        "Coefficient c of the modified Bingham law [Pa s2]: stress = yield stress + viscosity rate + c rate^2; "
        "default: 0",
        Within(0, hint="use flow_index below 1 for shear-thinning concrete"),
    ] = None
    slip_flow_index: Annotated[
        float | None,
        "Flow index n of the slip layer: stress = slip_yield + slip_viscosity x (slip velocity)^n; default: 1",
        Above(),
    ] = None
    slip_quadratic_viscosity: Annotated[
        float | None,
        "Coefficient c of the slip layer [Pa s2/m2], which adds c x (slip velocity)^2 to its stress; default: 0",
        Within(0, hint="use slip_flow_index below 1 for a shear-thinning layer"),
    ] = None
    yield_factor: Annotated[
        float | None,
        "Factor on the yield stresses of concrete and slip layer, for another age or temperature; default: 1",
        Above(),
    ] = None
    viscosity_factor: Annotated[
        float | None,
        "Factor on the viscosities of concrete and slip layer, for another age or temperature; default: 1",
        Above(),
    ] = None
    slip_thickness: Annotated[
        float,
        "Thickness of the slip layer [m]; the simulated concrete fills the pipe's radius minus this thickness",
        Within(0),
    ] = 0.0

    @classmethod
    def of_concrete(cls) -> tuple[str, tuple[str, ...]]:
        """Return the name of the section of a concrete file that sets these parameters, and its possible entries."""
        return "flow", CONSTANTS

    @classmethod
    def implied(cls, values: Mapping[str, object]) -> Mapping[str, Any]:
        """Return the constants in the concrete file that the parameters `values` name, for the record of a run.

        The record then stays correct if the file changes later.
        """
        return file_constants(values)

    def make_concrete(self, slips: bool) -> Concrete:
        """Return the concrete with its constants.

        If `slips` is False, the concrete slips on no wall. Constants that the user states, in the parameters or in a
        file, then need not include the slip layer.
        """
        constants = {name: getattr(self, name) for name in CONSTANTS}
        if not slips and (self.concrete == "own" or is_file(self.concrete)):
            constants |= {name: value for name, value in NO_LAYER.items() if constants[name] is None}
        return concrete_of(self.concrete, self.slip_thickness, **constants)


def concrete_of(name: str, slip_thickness: float = 0.0, **constants: float | None) -> Concrete:
    """Return the concrete called `name`: a shipped one, one from a file, or `own` with all values in `constants`.

    Values in `constants` replace the constants of the named concrete, and factors among them multiply the result
    (:func:`scaled`). `slip_thickness` is the thickness of the slip layer [m]. If it is above 0 and `constants` has no
    slip viscosity, the slip viscosity of a concrete of Xu, Li & Jiang 2021 is taken from their Table 3. Raises
    :class:`SceneError` if one of :data:`BINGHAM_CONSTANTS` is missing, or if the table does not list the thickness.
    """
    given = {key: value for key, value in constants.items() if value is not None}
    named = {} if _is_complete(name, given) else _flow_of(name)
    missing = sorted(set(BINGHAM_CONSTANTS) - set(given) - set(named))
    if missing:
        problem = f"has no value for {', '.join(missing)}"
        refuse("concrete", name, problem, f"state these values, or use one of the concretes {', '.join(flowing())}")
    if slip_thickness > 0 and "slip_viscosity" not in given and name in SLIP_VISCOSITY_BY_THICKNESS:
        table = SLIP_VISCOSITY_BY_THICKNESS[name]
        match = [eta for thickness, eta in table.items() if abs(thickness - slip_thickness) < 1e-9]
        if not match:
            printed = ", ".join(f"{x:g}" for x in table)
            problem = f"must be one of the published thicknesses ({printed} m), unless 'slip_viscosity' is set"
            refuse("slip_thickness", slip_thickness, problem, "use a published thickness, or set 'slip_viscosity'")
        given["slip_viscosity"] = match[0]
    known = {**FACTORS, **named, **given}
    factors = [known.pop(key) for key in FACTORS]
    return scaled(Concrete(name=name_of(name), **known), *factors)


def _is_complete(name: str, given: Mapping[str, object]) -> bool:
    """Return whether the constants in `given` describe the concrete, so that `name` need not be looked up.

    `given` maps names of constants to values. It must contain all constants in `CONSTANTS`. If `name` is the path of a
    file that no longer exists, Bingham's constants are enough, because the records of runs of earlier versions contain
    only these.
    """
    known = [each for each in CONSTANTS if given.get(each) is not None]
    return len(known) == len(CONSTANTS) or (
        set(BINGHAM_CONSTANTS) <= set(known) and is_file(name) and not os.path.isfile(name)
    )


@functools.cache
def flowing() -> tuple[str, ...]:
    """Return the names of the shipped concretes that have flow constants."""
    return tuple(name for name in shipped() if completed(name).flow)


def file_constants(values: Mapping[str, object]) -> dict[str, float]:
    """Return the constants in the file of the concrete that a scene's parameters name.

    The result is empty if the concrete is not described by a file, or if the parameters already state all constants. If
    the file omits constants of a flow law, they get the values with which this law equals Bingham's.
    """
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not isinstance(name, str) or not is_file(name) or _is_complete(name, values):
        return {}
    return merged(LAW_DEFAULTS, FACTORS, _flow_of(name))


def file_aggregates(values: Mapping[str, object]) -> dict[str, float]:
    """Return the aggregate's parameters from the concrete file that a scene's parameters name.

    The parameters are the volume fraction and density of the coarse aggregate, and the constants of the mortar. The
    result is empty unless the scene has two phases, the file describes a mix, and the scene leaves out at least one of
    these values.
    """
    name = values.get("concrete")
    name = str(name) if isinstance(name, os.PathLike) else name
    if not values.get("aggregates") or not isinstance(name, str) or not is_file(name):
        return {}
    if all(each in values for each in AGGREGATES):
        return {}
    mix = mix_named(name)
    return {} if mix is None else mix.aggregates


def _flow_of(name: str) -> dict[str, float]:
    """Return the flow constants of a concrete by name or from a file; for the name `own` the result is empty."""
    if name == "own":
        return {}
    if not is_file(name):
        one_of("concrete", name, (*flowing(), "own"))
    constants = flow_amounts(completed(name))
    if not constants:
        hint = f"add a section 'mix', or a section 'flow' with {', '.join(BINGHAM_CONSTANTS)}"
        refuse("concrete", name, "must have a section 'mix' or 'flow' to be simulated as a flow", hint)
    return constants
