"""Base class of contact laws: validated parameters, the same parameters on the device, and device functions of them."""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import warp as wp

from ...core.errors import between
from ...core.inputs.parameters import Declared, Field, OneOf, declared_fields

RESISTANCES = ("friction", "rolling_friction", "yield_stress", "viscosity", "plastic_viscosity")
"""Names of the parameters by which contact laws resist sliding and rolling."""


@dataclass(frozen=True)
class OnDevice:
    """Rule for a parameter whose device counterpart has another `name` and a value that the function `of` computes."""

    name: str
    of: Callable[[Any], Any] = lambda value: value


@dataclass(frozen=True, kw_only=True)
class ContactLaw(Declared, ABC):
    """Base class of all contact laws: frozen parameters of one pair of materials, annotated fields in SI units.

    Every field exists on the device under the same name. Numbers keep their value, words become their index among the
    choices, and a nested law becomes the struct of its parameters. :class:`OnDevice` declares exceptions.
    """

    rolls: ClassVar[bool] = False
    """True if contacts resist rolling; otherwise memory and code for rolling moments are left out."""

    @classmethod
    @abstractmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Callable]:
        """Return the Warp functions of the law.

        Their arguments are `p`, the struct `parameters`, and `touch`, a `Touch` of `kernels/dem/contact_law.py`:

        - `force(p, touch, history, dt)`: force on body a [N], the contact's new history (a vector in the contact
          plane, for springs the shear force), and the energy lost in the step [J];
        - `stiffness(p, touch)`: k_n, k_s [N/m] and dashpots c_n, c_s [N s/m] for the estimate of the stable time step;
          they must cover the coming steps, in which the overlap grows at the present closing speed;
        - `energy(p, touch, history)`: elastic energy [J].

        A law that `rolls` has two more functions:

        - `moment(p, touch, turning, history, dt)`: from the spin of body b relative to a [rad/s] and a separate
          history, the moment on a [N m], the new history (the moment of the spring), and the energy lost in the
          step [J];
        - `moment_energy(p, touch, history)`: elastic energy of that spring [J].

        They are called where `touch.gap` is negative, and in a bonded pair also at positive gaps, where a law must
        switch off its own forces. The energy must be zero at the gap 0 if there is no history.

        A CPU evaluates `force` and `moment` of several contacts at once in vector lanes. This works only if no branch
        assigns a vector or returns: a branch should choose a number, which the code then multiplies by.
        """

    @property
    @abstractmethod
    def stress_scale(self) -> float:
        """Stress scale of the law [Pa]: the order of magnitude of the stress in a deeply overlapping contact."""

    @property
    @abstractmethod
    def has_history(self) -> bool:
        """True if contacts must store their shear force from step to step; otherwise they need no memory for it."""

    @property
    def has_shear(self) -> bool:
        """True if contacts transmit shear forces; if no law does, the rotation of single spheres is not computed."""
        return self.has_history

    @abstractmethod
    def frictionless(self) -> "ContactLaw":
        """Return a copy of the law for packing aggregates, without friction and with enough damping to come to rest."""

    def gripped(self, grip: float) -> "ContactLaw":
        """Return the law for contacts with a wall that resists sliding and rolling `grip` times as much as bodies do.

        The fields named in RESISTANCES are multiplied by `grip`, also in nested laws.
        """
        changes: dict[str, Any] = {}
        for name in declared_fields(type(self)):
            value = getattr(self, name)
            if isinstance(value, ContactLaw):
                changes[name] = value.gripped(grip)
            elif name in RESISTANCES and value is not None:
                changes[name] = grip * value
        return replace(self, **changes)

    @classmethod
    def functions(cls, scalar: Any) -> SimpleNamespace:
        """Return the struct `Parameters` and the device functions of the law for the number type `scalar`."""
        return _functions(cls, scalar)

    def row(self) -> dict[str, Any]:
        """Return the parameters as they are stored on the device, by the field names of the struct `Parameters`."""
        values = {}
        for name, field in declared_fields(type(self)).items():
            value = getattr(self, name)
            place = next(field.of_kind(OnDevice), OnDevice(name))
            if isinstance(value, ContactLaw):
                values[place.name] = value.row()
            elif isinstance(value, str):
                values[place.name] = next(field.of_kind(OneOf)).choices.index(value)
            else:
                values[place.name] = place.of(value)
        return values


@functools.cache
def _functions(law: type[ContactLaw], scalar: Any) -> SimpleNamespace:
    types = {}
    for name, field in declared_fields(law).items():
        types[next(field.of_kind(OnDevice), OnDevice(name)).name] = _device_type(field, scalar)
    name = f"{law.__name__}Parameters"
    made = type(name, (), {"__annotations__": types, "__module__": law.__module__, "__qualname__": name})
    parameters = wp.struct(made)
    return SimpleNamespace(Parameters=parameters, **law.device_functions(scalar, parameters))


def _device_type(field: Field, scalar: Any) -> Any:
    if isinstance(field.kind, type) and issubclass(field.kind, ContactLaw):
        return field.kind.functions(scalar).Parameters
    return scalar if field.kind is float else wp.int32


def damping_ratio(restitution: float) -> float:
    """Return the damping, as a fraction of critical damping, that gives a coefficient of `restitution` from 0 to 1.

    It is exact for the linear and the Hertz-Mindlin law with a dashpot that may pull: -ln e / sqrt(ln^2 e + pi^2).
    """
    between("restitution", restitution, 0, 1)
    if restitution == 0:
        return 1.0
    loss = -math.log(restitution)
    return loss / math.hypot(loss, math.pi)
