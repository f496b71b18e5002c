"""Parameters of discrete element tests of fresh concrete in a vessel, and the contact laws that follow from them."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from ...core.errors import refuse
from ...core.inputs.parameters import Above, Declared, Needs, OneOf, Within
from ...core.records import SceneArguments
from ...geometry.prisms import Solid
from ...standards import StandardTest
from ...theory.pipe import Concrete
from ..laws import OWN_LAW, BinghamMortar, Contact, ContactLaw, LawChoice, PlasticMortar, RollingResistance
from ..laws.base import RESISTANCES
from ..scene.clumps import templates
from ..scene.containers import Fill, MeshContainer
from ..scene.scene import Bonds, Settle, TimeStep, Vessel, Watch
from ..scene.sizes import Gaussian, Sizes, Uniform
from .parameter_groups import BY_ITSELF, EnergyBalance, FixedTimeStep, Precision, Safety, SampleInterval, Seed

LAWS = ("linear", "bonds", "mortar", "plastic", "rolling")
LAW_MODULUS = {"mortar": 1e6, "plastic": 1e6}
"""Default contact modulus [Pa] of the laws for which the modulus of Zhan, 1e5 Pa, is too small: the cores of
mortar-covered spheres must be stiffer than the shells."""
LAW_FRACTION = {"mortar": 0.66, "plastic": 0.66}
"""Solid fraction of packings, by contact law; laws that are not listed use DEFAULT_FRACTION.

The two listed laws need denser packings, in which the mortar shell of each sphere overlaps shells of neighbours on all
sides.
"""
DEFAULT_FRACTION = 0.6
LAW_FRICTION = {"mortar": 0.0, "plastic": 0.0, "rolling": 0.5}
"""Default friction coefficients of contact laws that do not use the value 0.05 of Zhan et al. 2019, by name of the law.
The law `rolling` needs high friction. With low friction its spheres would slide instead of roll, and the rolling
resistance would have no effect."""
CONTACTS = 6.9
"""Coordination number of mortar-covered spheres: mean number of neighbours whose shells touch the shell of a sphere.

In the packings that were examined it was 6.7 to 6.9.
"""

WITH_BONDS = Needs("law", lambda law: law == "bonds", "is bonds")
WITH_MORTAR = Needs("law", lambda law: law in ("mortar", "plastic"), "is mortar or plastic")
WITH_PLASTIC = Needs("law", lambda law: law == "plastic", "is plastic")
WITH_ROLLING = Needs("law", lambda law: law == "rolling", "is rolling")


@dataclass(frozen=True, kw_only=True)
class GrainParameters:
    """Grains.

    Sizes and density of the grains, and how densely they are packed.
    """

    common: ClassVar[tuple[str, ...]] = ("size_min", "size_max", "bulk_density")

    sizes: Annotated[
        str,
        "Size distribution: gaussian (mean at the middle, standard deviation half of the range) or uniform",
        OneOf(("gaussian", "uniform")),
    ] = "uniform"
    size_min: Annotated[float, "Smallest grain size [m]", Above()] = 10e-3
    size_max: Annotated[float, "Largest grain size [m]", Above()] = 16e-3
    bulk_density: Annotated[
        float | None,
        "Density of the concrete in the full vessel [kg/m3]; if given, the grains carry the mass of the mortar, too",
        Above(),
    ] = None
    density: Annotated[
        float, "Density of the grains, if they carry only their own mass [kg/m3]", Above(), BY_ITSELF
    ] = 2500.0
    solid_fraction: Annotated[
        float | None,
        "Solid fraction of the packing in the full vessel, before it settles; default: 0.66 with laws mortar and "
        "plastic, else 0.6",
    ] = None


@dataclass(frozen=True, kw_only=True)
class LawParameters:
    """Contacts.

    Contact law between grains with its parameters, and how strongly plate and mould resist sliding.
    """

    common: ClassVar[tuple[str, ...]] = ("law", "friction", "yield_stress", "viscosity", "rolling_friction")

    law: Annotated[
        str,
        "Contact law between grains: linear (springs and friction), bonds (the same with bonds that break "
        "and heal), mortar (hard cores in soft shells with a yield stress), plastic (as mortar, but the shells yield "
        "in all directions), rolling (friction and rolling resistance)",
        OneOf(LAWS),
        OWN_LAW,
    ] = "rolling"
    modulus: Annotated[float | None, "Effective modulus of contacts, or of the cores with the law mortar [Pa]; "
        "default: 1e6 with the laws mortar and plastic, else 1e5", Above(), OWN_LAW] = None  # fmt: skip
    stiffness_ratio: Annotated[float, "Ratio of normal to shear stiffness", Above(), OWN_LAW] = 2.0
    friction: Annotated[
        float | None,
        "Friction coefficient between grains; default: 0.5 with law rolling, 0 with mortar and plastic, else 0.05",
        Within(0),
        OWN_LAW,
    ] = None
    normal_damping: Annotated[
        float, "Damping of the normal dashpot as a fraction of critical damping", Within(0), OWN_LAW
    ] = 0.5
    yield_stress: Annotated[
        float,
        "Yield stress of the concrete [Pa]; the yield stress of a contact is chosen so that all slipping "
        "contacts together give this value",
        Within(0),
        WITH_MORTAR,
    ] = 200.0
    viscosity: Annotated[
        float,
        "Plastic viscosity of the concrete [Pa s]; the viscosity of a contact is chosen so that all contacts together "
        "give this value",
        Above(),
        WITH_MORTAR,
    ] = 30.0
    shell_fraction: Annotated[
        float,
        "Thickness of the two shells of a contact, divided by the distance of the centres",
        Above(),
        Within(0, 0.5),
        WITH_MORTAR,
    ] = 0.1
    shell_modulus: Annotated[float, "Stiffness of the shells [Pa]", Above(), WITH_MORTAR] = 1e4
    shell_tension: Annotated[
        float, "Tensile strength of the shells, divided by their yield stress", Within(0), WITH_PLASTIC
    ] = 2.5
    rolling_friction: Annotated[float, "Rolling friction: largest moment of a contact, divided by its normal force "
        "and radius", Within(0),
                                WITH_ROLLING, OWN_LAW] = 0.2  # fmt: skip
    bond_modulus: Annotated[float, "Effective modulus of bonds [Pa]", Above(), WITH_BONDS] = 2e4
    tensile_strength: Annotated[float, "Tensile strength of bonds [Pa]", Within(0), WITH_BONDS] = 10.0
    cohesion: Annotated[float, "Cohesion of bonds [Pa]", Within(0), WITH_BONDS] = 5.0
    friction_angle: Annotated[float, "Friction angle of bonds [degrees]", Within(0, 89), WITH_BONDS] = 30.0
    healing: Annotated[bool, "Bond bodies when they begin to touch each other during the run", WITH_BONDS] = True
    plate_grip: Annotated[
        float, "Friction, yield stress and viscosity on the plate, divided by their values between grains", Within(0)
    ] = 2.0
    mould_grip: Annotated[
        float | None,
        "Friction, yield stress and viscosity on mould, gate, bars and sides, divided by their values between grains; "
        "0: concrete slides freely; default: 1 in a funnel with laws mortar and plastic, else 0",
        Within(0),
    ] = None


@dataclass(frozen=True, kw_only=True)
class VesselRun(Declared):
    """Run.

    Duration and settings of the computation.
    """

    common: ClassVar[tuple[str, ...]] = ("seed",)

    duration: Annotated[
        float, "Longest simulated time [s]; the run ends earlier when the concrete is at rest", Above()
    ] = 10.0
    rest_speed: Annotated[
        float,
        "Grains count as at rest if all grains of the main body have been slower than this speed for one second [m/s]",
        Above(),
    ] = 1e-3
    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Above()] = 9.81
    settle: Annotated[
        float, "Longest time for which the grains settle in the closed vessel before the start [s]", Within(0)
    ] = 1.0
    time_step: FixedTimeStep = None
    safety: Safety = 0.8
    overlap_limit: Annotated[
        float,
        "Overlap at which the run stops, divided by the overlap at which one grain lies inside another; 0: no limit",
        Within(0),
    ] = 1.5
    energy_balance: EnergyBalance = False
    precision: Precision = "float32"
    sample_interval: SampleInterval = 0.02
    seed: Seed = 0


@dataclass(frozen=True, kw_only=True)
class VesselParameters(GrainParameters, LawChoice, LawParameters, VesselRun):
    """Parameters that all tests of fresh concrete in a vessel have in common."""

    HOLDING: ClassVar[dict[str, float]] = {}
    """Default of `mould_grip` by contact law, for tests with a funnel; the default of laws not listed is 0.

    `mould_grip` is the resistance of the walls to sliding, divided by the resistance between grains. Without resistance
    on the walls, mortar of any viscosity would fall out of a funnel in two seconds.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size_max < self.size_min:
            refuse("size_max", self.size_max, f"must be at least size_min = {self.size_min:g} m")
        for name, default in (("plate_grip", LawParameters.plate_grip), ("mould_grip", None)):
            if getattr(self, name) != default and self.contact is not None and not self.is_gripped:
                refuse(name, getattr(self, name), f"has no effect with contact {type(self.contact).__name__}, which "
                                                  "resists neither sliding nor rolling; laws that resist are "
                                                  f"{', '.join(RESISTANCES)}", f"leave out {name!r}, or choose one of "
                                                                               "these laws")  # fmt: skip
        if self.mould_grip_or_default > self.plate_grip:
            problem = f"must not exceed plate_grip = {self.plate_grip:g}"
            refuse("mould_grip", self.mould_grip, problem, "increase 'plate_grip', or reduce 'mould_grip'")

    @property
    def stiffness(self) -> float:
        """Effective modulus of contacts [Pa]: the parameter `modulus`, or the default of the contact law."""
        return self.modulus if self.modulus is not None else LAW_MODULUS.get(self.law, 1e5)

    @property
    def packed(self) -> float:
        """Solid fraction of the packing: the parameter `solid_fraction`, or the default of the contact law."""
        return self.solid_fraction if self.solid_fraction is not None else LAW_FRACTION.get(self.law, DEFAULT_FRACTION)

    @property
    def grain_friction(self) -> float:
        """Coefficient of friction between grains: the parameter `friction`, or the default of the contact law."""
        return self.friction if self.friction is not None else LAW_FRICTION.get(self.law, 0.05)

    @property
    def mould_grip_or_default(self) -> float:
        """Resistance of the mould to sliding, divided by the resistance between grains: the parameter, or its default.

        Friction, yield stress and viscosity of contacts with the mould are those between grains times this factor. The
        default depends on the contact law, and is at most `plate_grip`, the same factor for the plate.
        """
        if self.mould_grip is not None:
            return self.mould_grip
        return min(self.HOLDING.get(self.law, 0.0), self.plate_grip)

    @property
    def is_gripped(self) -> bool:
        """True if the resistance of walls to sliding can be scaled, relative to the resistance between grains.

        Only contact laws with parameters for friction, yield stress or viscosity can be scaled.
        """
        law = self.grain_law()
        return law.gripped(0.5) != law

    def grain_law(self) -> ContactLaw:
        """Return the contact law between grains."""
        if self.contact is not None:
            return self.contact
        linear = Contact(**_springs(self))
        if self.law == "rolling":
            return RollingResistance(contact=linear, rolling_friction=self.rolling_friction)
        if self.law in ("mortar", "plastic"):
            return mortar_law(self) if self.law == "mortar" else plastic_law(self)
        return linear

    def wall_laws(self) -> dict[tuple[str, str], ContactLaw]:
        """Return the contact laws of grains with the materials `plate` and `mould`."""
        grips = {"plate": self.plate_grip, "mould": self.mould_grip_or_default}
        return {("aggregate", name): self.grain_law().gripped(grip) for name, grip in grips.items()}

    def bonds(self) -> Bonds | None:
        """Return the properties of the bonds between grains, or None if the contact law has no bonds."""
        if self.law != "bonds":
            return None
        return Bonds(
            effective_modulus=self.bond_modulus, stiffness_ratio=self.stiffness_ratio, healing=self.healing,
            tensile_strength=self.tensile_strength, cohesion=self.cohesion, friction_angle=self.friction_angle,
        )  # fmt: skip

    def vessel(self, test: StandardTest, opened: float) -> Vessel:
        """Return the description of the vessel of a test, which releases the concrete at the time `opened` [s]."""
        return Vessel(
            test=test, opened=opened, rest_speed=self.rest_speed, dimensions=test.sizes(self), concrete=self.fluid()
        )

    def fluid(self) -> Concrete | None:
        """Return the Bingham fluid that a law with shells of mortar represents, without slip; None for other laws."""
        if self.contact is not None or self.law not in ("mortar", "plastic"):
            return None
        density = self.bulk_density or self.packed * self.density
        return Concrete(density=density, viscosity=self.viscosity, yield_stress=self.yield_stress, slip_viscosity=1e8,
                        slip_yield=0.0)  # fmt: skip

    def fill(self, inside: Solid) -> Fill:
        """Return a :class:`Fill` that describes the grains to be packed into the closed solid `inside`."""
        return Fill(
            container=MeshContainer(inside.trimesh()),
            sizes=self.distribution(),
            templates=templates("spheres", 1),
            density=self.density,
            bulk_density=self.bulk_density,
            solid_fraction=self.packed,
        )

    def distribution(self) -> Sizes:
        """Return the size distribution of the grains."""
        if self.sizes == "uniform":
            return Uniform(self.size_min, self.size_max)
        middle, half = 0.5 * (self.size_min + self.size_max), 0.5 * (self.size_max - self.size_min)
        return Gaussian(middle, max(half, 1e-6 * middle), self.size_min, self.size_max)

    def settings(self) -> SceneArguments:
        """Return arguments of a scene: duration, contact laws, bonds, gravity, settling, time step and output."""
        return {
            "duration": self.duration,
            "contact": self.grain_law(),
            "contacts": self.wall_laws(),
            "bonds": self.bonds(),
            "gravity": (0.0, 0.0, -self.gravity),
            "settle": Settle(duration=self.settle) if self.settle > 0 else None,
            "time_step": TimeStep(fixed=self.time_step, safety=self.safety),
            "watch": Watch(overlap=self.overlap_limit or None),
            "energy_balance": self.energy_balance,
            "precision": self.precision,
            "sample_interval": self.sample_interval,
            "seed": self.seed,
        }


def shear_means() -> tuple[float, float, float]:
    """Return three means over the directions of contacts, in a simple shear of rate 1.

    Let n be the direction of a contact and D the strain rate tensor. The vector D n has a part across n (sliding) and a
    part along n (approach). The results are:

    - the mean magnitude of the part across n,
    - the mean square of the part across n, which is 1/10 exactly,
    - the mean square of the part along n, which is 1/15 exactly.

    The means are computed over directions spread evenly on a Fibonacci lattice.
    """
    count = 20_000
    z = (2 * np.arange(count) + 1) / count - 1
    angle = np.pi * (1 + math.sqrt(5)) * np.arange(count)
    x, y = np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle)
    along = x * y
    across = 0.25 * (x * x + y * y) - along**2
    return float(np.mean(np.sqrt(np.maximum(across, 0)))), float(np.mean(across)), float(np.mean(along**2))


def _springs(given: VesselParameters) -> dict[str, float]:
    """Return the constants of springs, dashpots and friction between grains, which every contact law needs."""
    return {
        "effective_modulus": given.stiffness,
        "stiffness_ratio": given.stiffness_ratio,
        "friction": given.grain_friction,
        "normal_damping_ratio": given.normal_damping,
    }


def _core_and_shell(given: VesselParameters) -> dict[str, float]:
    """Return the constants of the cores and shells of grains, which both laws of mortar need."""
    return {**_springs(given), "shell_fraction": given.shell_fraction, "shell_modulus": given.shell_modulus}


def mortar_law(given: VesselParameters) -> BinghamMortar:
    """Return a contact law whose stresses add up to the yield stress and viscosity of the concrete.

    The derivation assumes that neighbours follow the mean flow of a simple shear. Each grain of diameter d touches Z
    neighbours, so there are Z/2 contacts per grain. Each contact has an area of pi d^2/4 and spans the distance d. At
    the solid fraction phi all contacts together fill 3/4 Z phi of the volume. The power that a contact dissipates per
    volume has two parts. The yield stress contributes in proportion to the sliding velocity across the contact's
    normal. The viscosity contributes in proportion to the square of the sliding velocity plus three times (Trouton's
    ratio) the square of the closing velocity. The constants are chosen so that all contacts together dissipate as much
    as the concrete.

    Shells also pull and bend (:class:`BinghamMortar`), so that a heap can stand. Compared with closed forms, slumps
    deviate by 7 to 25 % at yield stresses of 20 to 500 Pa, and spreads deviate by less than 7 % at 100 to 200 Pa. At
    1000 Pa a cone does not slump, where the closed form gives a slump of 78 mm.
    """
    slides, square, closes = shear_means()
    filled = 0.75 * CONTACTS * given.packed
    return BinghamMortar(
        **_core_and_shell(given),
        yield_stress=given.yield_stress / (filled * slides),
        plastic_viscosity=given.viscosity * given.shell_fraction / (filled * (square + 3 * closes)),
    )


def plastic_law(given: VesselParameters) -> PlasticMortar:
    """Return the law of :class:`PlasticMortar` that has the yield stress and viscosity of the concrete.

    In a simple shear of rate 1, all contacts together dissipate as much as the concrete, as in :func:`mortar_law`. Let
    n be the direction of a contact and D the strain rate tensor. The dissipation of a contact has two parts. One part
    is the yield stress times |D n|, whose mean is pi/8. The other part is the viscosity divided by the shell thickness,
    times |D n|^2, whose mean is 1/6.

    The tension of the shells, in units of the yield stress, does not follow from properties of the concrete. It was
    chosen by trial simulations of a slump cone with a yield stress of 1000 Pa. With a tension of 2.5 the cone slumps by
    120 mm, and with 3.5 it does not slump. For comparison, the closed form of a tall cone gives 78 mm, and the implicit
    material point method of the simulator Newton 1.8 gives 104 mm. Slumps at other yield stresses are predicted, not
    fitted.
    """
    filled = 0.75 * CONTACTS * given.packed
    return PlasticMortar(
        **_core_and_shell(given),
        yield_stress=given.yield_stress / (filled * math.pi / 8),
        plastic_viscosity=given.viscosity * given.shell_fraction / (filled / 6),
        tension=given.shell_tension,
    )
