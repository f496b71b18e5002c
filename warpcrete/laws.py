"""Contact laws as a scene names them: frozen, validated parameters of one pair of materials.

Each class belongs to a file of kernels/, `law_NAME.py`. Another law is such a file and a class like these.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from .errors import between, one_of, positive, refuse

DASHPOTS = ("full", "no-tension", "slip-cut", "both")


@dataclass(frozen=True, kw_only=True)
class ContactLaw:
    """Base of all laws."""

    law: ClassVar[str | Callable]
    """NAME of kernels/law_NAME.py, or a function like that file's `law`."""

    @classmethod
    def functions(cls) -> Callable:
        """The law's kernel functions, `law(scalar)`."""
        if isinstance(cls.law, str):
            return importlib.import_module(f"warpcrete.kernels.law_{cls.law}").law
        return cls.law

    @property
    def stress_scale(self) -> float:
        """Stress that a deep contact carries [Pa]; by default the field `effective_modulus`."""
        return float(getattr(self, "effective_modulus", 1e5))

    @property
    def has_history(self) -> bool:
        """Whether a contact must remember its shear; without that its memory is not allotted."""
        return getattr(self, "friction", 1.0) > 0

    @property
    def has_shear(self) -> bool:
        """Whether a contact can bear a force in its plane; without that single spheres are not turned."""
        return self.has_history or getattr(self, "shear_damping_ratio", 1.0) > 0

    def row(self) -> dict[str, Any]:
        """Fields of the law's `Parameters`; by default the fields of the same names."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def frictionless(self) -> ContactLaw:
        """The law for packing: without friction, and damped."""
        return replace(self, friction=0.0) if hasattr(self, "friction") else self


@dataclass(frozen=True, kw_only=True)
class Contact(ContactLaw):
    """Linear contact between two materials (Zhan et al. 2019, Eqs. 7-8); the default law."""

    law = "linear"

    effective_modulus: float = 1e5
    """E* [Pa]; k_n = A E*/L with A = pi r^2, r the smaller radius, L the distance of the centres at touch."""
    stiffness_ratio: float = 2.0
    """k_n / k_s."""
    friction: float = 0.05
    """Coulomb coefficient."""
    normal_damping_ratio: float = 0.5
    """Normal dashpot, as a share of critical damping; see :func:`damping_ratio`."""
    shear_damping_ratio: float = 0.0
    """Shear dashpot, as a share of critical damping."""
    dashpot: str = "full"
    """`full`; `no-tension` (normal total never pulls); `slip-cut` (no shear dashpot in slip); `both`."""

    def __post_init__(self) -> None:
        positive("effective_modulus", self.effective_modulus, "Pa")
        positive("stiffness_ratio", self.stiffness_ratio)
        between("friction", self.friction, 0, np.inf)
        between("normal_damping_ratio", self.normal_damping_ratio, 0, np.inf)
        between("shear_damping_ratio", self.shear_damping_ratio, 0, np.inf)
        one_of("dashpot", self.dashpot, DASHPOTS)

    def row(self) -> dict[str, Any]:
        from .kernels.law_linear import DASHPOT_MODES

        return {
            "effective_modulus": self.effective_modulus,
            "shear_to_normal": 1.0 / self.stiffness_ratio,
            "friction": self.friction,
            "damping_normal": self.normal_damping_ratio,
            "damping_shear": self.shear_damping_ratio,
            "dashpot_mode": DASHPOT_MODES[self.dashpot],
        }

    def frictionless(self) -> ContactLaw:
        return replace(self, friction=0.0, normal_damping_ratio=max(self.normal_damping_ratio, 0.5))


@dataclass(frozen=True, kw_only=True)
class HertzMindlin(ContactLaw):
    """Elastic spheres: Hertz' normal and Mindlin's tangent stiffness, Coulomb friction, constant restitution."""

    law = "hertz_mindlin"

    effective_modulus: float
    """E* [Pa]; 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2."""
    effective_shear_modulus: float
    """G* [Pa]; 1/G* = (2 - nu1)/G1 + (2 - nu2)/G2."""
    friction: float = 0.3
    """Coulomb coefficient."""
    restitution: float = 0.9
    """Of a normal impact, 0 to 1, at any speed."""
    unloading: str = "rescale"
    """Shear force while the normal load falls: `rescale` with the tangent stiffness, or `hold` (can create energy)."""

    def __post_init__(self) -> None:
        positive("effective_modulus", self.effective_modulus, "Pa")
        positive("effective_shear_modulus", self.effective_shear_modulus, "Pa")
        between("friction", self.friction, 0, np.inf)
        between("restitution", self.restitution, 0, 1)
        one_of("unloading", self.unloading, ("rescale", "hold"))

    @classmethod
    def of(cls, young_modulus: float, poisson_ratio: float, *, rigid_partner: bool = False, **others) -> HertzMindlin:
        """Contact of two bodies of one material, or of one with a rigid partner. Young's modulus in Pa."""
        positive("young_modulus", young_modulus, "Pa")
        between("poisson_ratio", poisson_ratio, 0, 0.5)
        bodies = 1 if rigid_partner else 2
        shear = young_modulus / (2 * (1 + poisson_ratio))
        return cls(
            effective_modulus=young_modulus / (bodies * (1 - poisson_ratio**2)),
            effective_shear_modulus=shear / (bodies * (2 - poisson_ratio)),
            **others,
        )

    def row(self) -> dict[str, Any]:
        return {
            "effective_modulus": self.effective_modulus,
            "effective_shear_modulus": self.effective_shear_modulus,
            "friction": self.friction,
            "damping": damping_ratio(self.restitution),
            "rescale": int(self.unloading == "rescale"),
        }

    def frictionless(self) -> ContactLaw:
        return replace(self, friction=0.0, restitution=min(self.restitution, 0.2))


@dataclass(frozen=True, kw_only=True)
class LubricationLayer(ContactLaw):
    """Linear contact with a lubrication layer in shear, tau = tau_L0 + eta_L V (Xu, Li & Jiang 2021, Eq. 8)."""

    law = "lubrication"

    contact: Contact = Contact()
    """Spring, dashpot and friction."""
    yield_stress: float = 0.0
    """tau_L0 [Pa], on pi r^2 of every contact."""
    viscosity: float = 0.0
    """eta_L [Pa s/m], viscosity of the layer over its thickness."""

    def __post_init__(self) -> None:
        if not isinstance(self.contact, Contact):
            refuse("layer contact", type(self.contact).__name__, "must be a Contact, the linear law")
        between("layer yield_stress", self.yield_stress, 0, np.inf, "Pa")
        between("layer viscosity", self.viscosity, 0, np.inf, "Pa s/m")

    @property
    def stress_scale(self) -> float:
        return self.contact.stress_scale

    @property
    def has_history(self) -> bool:
        return self.contact.has_history or self.yield_stress > 0

    def row(self) -> dict[str, Any]:
        return {"linear": self.contact.row(), "yield_stress": self.yield_stress, "viscosity": self.viscosity}

    def frictionless(self) -> ContactLaw:
        return LubricationLayer(contact=self.contact.frictionless())  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True)
class BinghamMortar(ContactLaw):
    """Aggregates in a shell of Bingham mortar: hard core, soft shell with yield stress and viscosity.

    A sphere's radius includes its shell; see kernels/law_mortar.py for the forces.
    """

    law = "mortar"

    effective_modulus: float = 1e7
    """E* of the cores [Pa]."""
    stiffness_ratio: float = 2.0
    """Normal over shear stiffness, of cores and shells."""
    friction: float = 0.3
    """Coulomb coefficient of the cores."""
    normal_damping_ratio: float = 0.5
    """Dashpot of the cores, as a share of critical damping."""
    shell_share: float = 0.1
    """Thickness of the two shells over the distance of the centres at touch."""
    shell_modulus: float = 1e4
    """Stiffness of the mortar against compression [Pa]."""
    yield_stress: float = 50.0
    """tau_0 of the mortar [Pa]."""
    plastic_viscosity: float = 5.0
    """mu of the mortar [Pa s]."""

    def __post_init__(self) -> None:
        positive("effective_modulus", self.effective_modulus, "Pa")
        positive("stiffness_ratio", self.stiffness_ratio)
        between("friction", self.friction, 0, np.inf)
        between("normal_damping_ratio", self.normal_damping_ratio, 0, np.inf)
        positive("shell_share", self.shell_share)
        between("shell_share", self.shell_share, 0, 0.5)
        positive("shell_modulus", self.shell_modulus, "Pa")
        between("mortar yield_stress", self.yield_stress, 0, np.inf, "Pa")
        between("plastic_viscosity", self.plastic_viscosity, 0, np.inf, "Pa s")

    @property
    def has_history(self) -> bool:
        return self.friction > 0 or self.yield_stress > 0

    def row(self) -> dict[str, Any]:
        return {
            "effective_modulus": self.effective_modulus,
            "shear_to_normal": 1.0 / self.stiffness_ratio,
            "friction": self.friction,
            "damping_normal": self.normal_damping_ratio,
            "shell_share": self.shell_share,
            "shell_modulus": self.shell_modulus,
            "yield_stress": self.yield_stress,
            "plastic_viscosity": self.plastic_viscosity,
        }

    def frictionless(self) -> ContactLaw:
        return replace(self, friction=0.0, yield_stress=0.0)


def damping_ratio(restitution: float) -> float:
    """Critical damping ratio that gives a restitution coefficient in 0..1.

    Exact for the linear and the Hertz-Mindlin law with a dashpot that may pull: -ln e / sqrt(ln^2 e + pi^2).
    """
    between("restitution", restitution, 0, 1)
    if restitution == 0:
        return 1.0
    loss = -math.log(restitution)
    return loss / math.hypot(loss, math.pi)
