"""What a contact law is: parameters that check themselves, the same on the device, and functions of them there."""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import warp as wp

from ...core.errors import between
from ...core.parameters import Declared, Field, OneOf, declared_fields

RESISTANCES = ("friction", "rolling_friction", "yield_stress", "viscosity", "plastic_viscosity")
"""Names of the fields by which laws resist sliding and rolling."""


@dataclass(frozen=True)
class OnDevice:
    """Rule of a field that a device has under another name, as a function of its value."""

    name: str
    of: Callable[[Any], Any] = lambda value: value


@dataclass(frozen=True, kw_only=True)
class ContactLaw(Declared, ABC):
    """Base of all laws: frozen parameters of one pair of materials, annotated fields in SI units.

    A field is there on the device under the same name: numbers as they are, words as their place among the choices,
    a law as its own parameters; :class:`OnDevice` says otherwise.
    """

    rolls: ClassVar[bool] = False
    """Contacts resist rolling; without that neither its memory nor its code is there."""

    @classmethod
    @abstractmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Callable]:
        """Warp functions of `p`, the struct `parameters`, and a `Touch` of `kernels/dem/contact_law.py`:

        - `force(p, touch, history, dt)`: force on body a [N], the contact's new history (a vector in the contact
          plane, for springs the shear force), and the energy lost in the step [J];
        - `stiffness(p, touch)`: k_n, k_s [N/m] and dashpots c_n, c_s [N s/m] as they are, or soon will be, at the
          touch's closing speed, for the stable time step;
        - `energy(p, touch, history)`: elastic energy [J].

        A law that `rolls` has two more:

        - `moment(p, touch, turning, history, dt)`: of the spin of body b seen from a [rad/s] and a history of its own,
          the moment on a [N m], the new history, the moment of springs, and the energy lost in the step [J];
        - `moment_energy(p, touch, history)`: elastic energy of that [J].

        A CPU evaluates `force` and `moment` of several contacts at once as long as no branch in them assigns a vector
        or returns: let branches choose a number, and multiply by it.
        """

    @property
    @abstractmethod
    def stress_scale(self) -> float:
        """Stress that a deep contact carries [Pa]."""

    @property
    @abstractmethod
    def has_history(self) -> bool:
        """Whether a contact must remember its shear; without that its memory is not allotted."""

    @property
    def has_shear(self) -> bool:
        """Whether a contact can bear a force in its plane; without that single spheres are not turned."""
        return self.has_history

    @abstractmethod
    def frictionless(self) -> "ContactLaw":
        """The law for packing: without friction, and damped."""

    def gripped(self, grip: float) -> "ContactLaw":
        """Return the law for a wall that resists sliding and rolling `grip` times as much as the bodies do.

        Fields named as in RESISTANCES are multiplied, those of laws inside this one as well.
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
        """The struct `Parameters`, and `force`, `stiffness` and `energy`, in one precision."""
        return _functions(cls, scalar)

    def row(self) -> dict[str, Any]:
        """Values of the fields of `Parameters`."""
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
    """Critical damping ratio that gives a restitution coefficient in 0..1.

    Exact for the linear and the Hertz-Mindlin law with a dashpot that may pull: -ln e / sqrt(ln^2 e + pi^2).
    """
    between("restitution", restitution, 0, 1)
    if restitution == 0:
        return 1.0
    loss = -math.log(restitution)
    return loss / math.hypot(loss, math.pi)
