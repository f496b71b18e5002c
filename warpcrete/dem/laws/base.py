"""Base class of contact laws: parameters with their limits, their copy on the device, and functions for kernels."""

import functools
import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import warp as wp

from ...core.errors import between
from ...core.inputs.parameters import Declared, Field, OneOf, declared_fields
from .own import check_class, made_functions

PACKAGE = __name__.rpartition(".")[0]
"""Name of the package that contains the contact laws of warpcrete."""
RESISTANCES = ("friction", "rolling_friction", "yield_stress", "viscosity", "plastic_viscosity")
"""Names of all parameters, in any contact law, that determine the resistance to sliding and rolling."""


@dataclass(frozen=True)
class OnDevice:
    """Rule that a device stores a parameter under another name or with another value.

    `name` is the parameter's name on the device. The function `of` takes the parameter and returns its value on the
    device.
    """

    name: str
    of: Callable[[Any], Any] = lambda value: value


@dataclass(frozen=True, kw_only=True)
class ContactLaw(Declared, ABC):
    """Base class of all contact laws; an object holds the parameters of the law for one pair of materials.

    The parameters are annotated fields in SI units and cannot be changed. Every field exists on the device under the
    same name. A number keeps its value. A choice between words is stored as the index of the chosen word. A nested law
    is stored as the struct of its parameters. :class:`OnDevice` declares exceptions.
    """

    rolls: ClassVar[bool] = False
    """True if contacts resist rolling; otherwise memory and code for rolling moments are left out."""

    def __post_init__(self) -> None:
        if _is_own(type(self)):
            check_class(type(self))
        super().__post_init__()

    @classmethod
    @abstractmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Callable]:
        """Return the Warp functions of the law, by name.

        Every function takes `p`, the struct `parameters`, and `touch`, a `Touch` of `kernels/dem/contact_law.py`. Each
        law has three functions:

        - `force(p, touch, history, dt)` returns the force on body a [N], the contact's new history, and the energy lost
          in the step [J]. The history is any vector that the law needs in the next step. In laws with a shear spring it
          is the shear force.
        - `stiffness(p, touch)` returns the stiffnesses k_n, k_s [N/m] and the dashpots c_n, c_s [N s/m] for the
          estimate of the stable time step. They must be large enough for the next steps, in which the overlap may
          grow. For a normal force k d^n with n > 1 at the overlap d, return the tangent stiffness n k D^(n - 1) at the
          deepest overlap D of an impact with the current closing speed v: D^(n + 1) = d^(n + 1) + (n + 1) m v^2 /
          (2 k), with the reduced mass m. None of the four values may be negative. If an attractive force decreases with
          distance, leave out its negative slope: the stiffnesses of a body's contacts are added up, and a negative
          value would reduce the sum.
        - `energy(p, touch, history)` returns the energy that the force stores [J].

        A law that `rolls` has two more functions:

        - `moment(p, touch, turning, history, dt)` takes the spin of body b relative to body a [rad/s] and a separate
          history. It returns the moment on body a [N m], the new history (the moment of the rolling spring), and the
          energy lost in the step [J].
        - `moment_energy(p, touch, history)` returns the elastic energy of the rolling spring [J].

        The functions are called for contacts with a negative `touch.gap`. For a bonded pair they are also called at
        positive gaps, where a law must switch off its own forces. If the history is zero, the energy must be zero at
        the gap 0.

        A CPU evaluates `force` and `moment` of several contacts at once with vector instructions. This works only if
        branches neither assign vectors nor return. Let a branch assign a number instead, and multiply the vector by
        this number.
        """

    @property
    @abstractmethod
    def stress_scale(self) -> float:
        """Order of magnitude of the stress in a strongly compressed contact [Pa]; the modulus in a linear law."""

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
        """Return a copy of the law for packing, without friction, but with enough damping to bring bodies to rest."""

    def gripped(self, grip: float) -> "ContactLaw":
        """Return a copy of the law for a rough wall, with `grip` times the resistance of a body to sliding and rolling.

        The fields named in RESISTANCES are multiplied by `grip`, also in fields that are themselves contact laws.
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
        """Return the struct `Parameters` and the device functions of the law for the floating-point type `scalar`."""
        return _functions(cls, scalar)

    def row(self) -> dict[str, Any]:
        """Return the values of the parameters on the device, by their names in the struct `Parameters`."""
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

    def on_device(self, scalar: Any) -> Any:
        """Return the struct `Parameters` with the values of this law, for the floating-point type `scalar`."""
        return _filled(self.functions(scalar).Parameters(), self.row())


def own_laws(laws: Iterable[ContactLaw]) -> str:
    """Return the names of the classes of `laws`, and of laws inside them, that are defined outside this package."""
    found: list[str] = []
    for law in laws:
        nested = [value for name in declared_fields(type(law)) if isinstance(value := getattr(law, name), ContactLaw)]
        own = type(law).__name__ if _is_own(type(law)) else ""
        found += [name for name in (own, own_laws(nested)) if name]
    return " and ".join(dict.fromkeys(found))


def _is_own(law: type[ContactLaw]) -> bool:
    """Return whether a class of contact laws is defined outside this package."""
    return not law.__module__.startswith(f"{PACKAGE}.")


def _filled(row: Any, values: dict[str, Any]) -> Any:
    for name, value in values.items():
        if isinstance(value, dict):
            _filled(getattr(row, name), value)
        else:
            setattr(row, name, value)
    return row


@functools.cache
def _functions(law: type[ContactLaw], scalar: Any) -> SimpleNamespace:
    types = {}
    for name, field in declared_fields(law).items():
        types[next(field.of_kind(OnDevice), OnDevice(name)).name] = _device_type(field, scalar)
    parameters = _struct(f"{law.__name__}Parameters", tuple(types.items()))
    own = _is_own(law)
    functions = made_functions(law, scalar, parameters) if own else law.device_functions(scalar, parameters)
    return SimpleNamespace(Parameters=parameters, **functions)


@functools.cache
def _struct(name: str, fields: tuple[tuple[str, Any], ...]) -> Any:
    """Return the Warp struct with the given name and fields; calls with equal arguments return the same object.

    Warp uses one kernel for all functions with equal code, and this kernel accepts arrays of one struct object only,
    not of an equal struct. Two equal structs would arise if a notebook cell that defines a law is run again, or if two
    files define equal laws. Structs with different fields get different names, because one kernel may contain two laws.
    """
    text = " ".join(f"{field} {getattr(kind, 'key', None) or kind.__name__}" for field, kind in fields)
    mark = hashlib.sha256(text.encode()).hexdigest()[:8]
    made = type(name, (), {"__annotations__": dict(fields), "__module__": __name__, "__qualname__": f"{name}_{mark}"})
    return wp.struct(made)


def _device_type(field: Field, scalar: Any) -> Any:
    if isinstance(field.kind, type) and issubclass(field.kind, ContactLaw):
        return field.kind.functions(scalar).Parameters
    return scalar if field.kind is float else wp.int32


def damping_ratio(restitution: float) -> float:
    """Return the damping, as a fraction of critical damping, that gives a coefficient of `restitution` from 0 to 1.

    With the coefficient of restitution e, the damping is -ln e / sqrt(ln^2 e + pi^2). This formula is exact for the
    linear and the Hertz-Mindlin law if the dashpot may make the total normal force tensile at the end of an impact.
    """
    between("restitution", restitution, 0, 1)
    if restitution == 0:
        return 1.0
    loss = -math.log(restitution)
    return loss / math.hypot(loss, math.pi)
