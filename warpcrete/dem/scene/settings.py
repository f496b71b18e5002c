"""Groups of settings of a scene: bonds, time step, settling, rest, limits, wear and blockage."""

from dataclasses import dataclass, field
from typing import Annotated

from ...core.errors import positive, refuse
from ...core.inputs.parameters import Above, Declared, Within

MUCH_STIFFER = 200.0
"""Sub-cycling of hydrated bonds saves computing time if their modulus is at least this number times the largest
modulus of all other bonds and contacts. Without sub-cycling, all time steps must be as short as the stiff bonds
require. At a ratio of 100, runs with and without sub-cycling take equally long."""


@dataclass(frozen=True, kw_only=True)
class Bonds(Declared):
    """Parallel bonds between spheres: elastic cylinders with limited strength (Zhan et al. 2019, Eqs. 9-12)."""

    called = "bond"

    effective_modulus: Annotated[
        float,
        "Effective modulus [Pa]; the bond stiffness per area is this modulus divided by the distance L of the "
        "centres at touch",
        Above(),
    ] = 2e4
    stiffness_ratio: Annotated[float, "Ratio of normal to shear bond stiffness", Above()] = 2.0
    tensile_strength: Annotated[float, "Tensile strength [Pa]", Within(0)] = 10.0
    cohesion: Annotated[float, "Cohesion [Pa]", Within(0)] = 5.0
    friction_angle: Annotated[
        float,
        "Friction angle [degrees]; it raises the shear strength under compression and lowers it under tension",
        Within(0, 89),
    ] = 30.0
    radius_multiplier: Annotated[float, "Ratio of the bond radius to the radius of the smaller sphere", Above()] = 1.0
    moment_factor: Annotated[
        float,
        "Fraction of the bending and twisting moment that counts in the peak stresses (beta in Eq. 11)",
        Within(0, 1),
    ] = 1.0
    gap: Annotated[float, "Largest gap across which a bond is made [m]", Within(0)] = 0.0
    healing: Annotated[
        bool, "Bond new contacts when they first touch; otherwise only contacts at the start are bonded"
    ] = False


@dataclass(frozen=True, kw_only=True)
class Hydration(Declared):
    """Replacement of a random fraction of all bonds by hydrated, stiffer ones (Zhan et al. 2019, section 5.3.2)."""

    called = "hydration"

    fraction: Annotated[float, "Fraction of all bonded contacts that is hydrated, 0 to 1", Within(0, 1)]
    bonds: Bonds = field(default_factory=lambda: Bonds(effective_modulus=1e9, tensile_strength=1e6, cohesion=5e5))


@dataclass(frozen=True, kw_only=True)
class TimeStep(Declared):
    """Choice of the time step: a fixed size, or an automatic size that follows from masses and current stiffness."""

    called = "time_step"

    fixed: Annotated[float | None, "Fixed time step [s]; None: computed from masses and current stiffness"] = None
    safety: Annotated[
        float,
        "Ratio of the time step to the estimated stable step; a value above 1 overrules the estimate, also for "
        "a fixed step",
        Within(1e-3, 10),
    ] = 0.8
    largest: Annotated[float, "Upper limit of the automatic time step [s]", Above()] = 1e-3
    interval: Annotated[int, "Number of steps between two estimates of the stable step"] = 20
    rounds: Annotated[
        int | None,
        "Number of sub-steps in which hydrated bonds are integrated within one time step; None: as many as needed if "
        "they are much stiffer than everything else; 1: no sub-steps, so that the stiffest bond limits the time step",
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rounds is not None and self.rounds < 1:
            problem = "must be a whole number, 1 or more"
            refuse("rounds", self.rounds, problem, "leave out 'rounds' to use as many as needed")
        if self.fixed is not None:
            positive("time_step", self.fixed, "s", "leave out the fixed time step for an automatic one")
        if self.interval < 1:
            refuse("interval", self.interval, "must be a whole number of steps, 1 or more")


@dataclass(frozen=True, kw_only=True)
class Settle(Declared):
    """Settling before t = 0. Gravity and driving forces act, motion is damped, and all walls stand still."""

    called = "settle"

    duration: Annotated[
        float,
        "Longest duration [s]; settling ends earlier once the kinetic energy is below 1e-5 of the elastic energy",
        Within(0),
    ] = 2.0
    local_damping: Annotated[
        float, "Fraction of the unbalanced force that opposes motion (PFC's local damping)", Within(0, 0.99)
    ] = 0.5


@dataclass(frozen=True, kw_only=True)
class Watch(Declared):
    """Limits beyond which a run stops with an InstabilityError; values that are not finite always stop a run."""

    called = "watch"

    overlap: Annotated[
        float | None,
        "Largest overlap, divided by the overlap at which the larger sphere contains the smaller one, the distance of "
        "the centres is halved, or a centre reaches a wall (the smallest of these); checked at every sample. "
        "None: no limit",
        Above(),
    ] = 1.0
    speed: Annotated[float, "Largest speed of any body [m/s], checked in every step", Above()] = 1e3
    energy: Annotated[
        float | None,
        "Largest energy that may appear without work of walls, drives or gravity, as a fraction of all energy in the "
        "scene; checked at every sample. None: no limit",
        Above(),
    ] = 0.5


@dataclass(frozen=True, kw_only=True)
class Wear(Declared):
    """Wear of the walls, summed per patch: along and around a pipe, and per triangle of a mesh.

    The worn depth follows Archard (1953, J. Appl. Phys. 24, 981): k times normal force times sliding distance, divided
    by the patch's area. Here k = K/H, the dimensionless wear coefficient K divided by the hardness H.
    """

    called = "wear"

    coefficient: Annotated[
        float,
        "Wear coefficient k, worn volume per load and sliding distance [m2/N]; 1e-13 to 1e-12 for steel worn by stones",
        Within(0),
    ] = 2e-13
    patch: Annotated[
        float | None, "Edge length of a patch of a pipe's wall [m]; default: 1/24 of its circumference", Above()
    ] = None


@dataclass(frozen=True, kw_only=True)
class Blockage(Declared):
    """Settings for detecting a blockage: part of the concrete in a pipe stands still while the piston advances."""

    called = "blockage"

    travel: Annotated[
        float | None,
        "Travel of the piston during which part of the concrete must stand still [m]; default: 1/20 of "
        "the concrete's length; for soft aggregates one diameter, but at most 1/5 of that length",
        Above(),
    ] = None
    stop: Annotated[bool, "End the run when the pipe is blocked"] = False


@dataclass(frozen=True, kw_only=True)
class Rest(Declared):
    """Rest of the concrete: it stands still for minutes and gains strength, which a formula gives without time steps.

    The static yield stress grows linearly, tau_0(t) = tau_0 + A_thix t, with the duration t of the rest and the growth
    rate A_thix (Roussel 2006). The increase A_thix t is also added to the tensile strength and cohesion of the scene's
    bonds, and to the yield stress of a lubrication layer on the walls. Existing bonds keep the forces that they carry,
    and contacts without a bond receive a bond without force. Hydrated bonds and the bonds inside a body group do not
    change. A bond that breaks after the rest stays broken, unless the scene lets bonds heal. A healed bond has the
    strength that bonds had before the rest.

    Slip on the wall reduces the gain of the layer: the gain is multiplied by exp(-slip / breakdown). As in plug flow,
    the travel of `wall` since the rest serves as the slip of the whole layer. Nothing moves during the rest, so it
    takes no time steps.
    """

    called = "rest"

    at: Annotated[float, "Simulated time at which the rest takes place [s]", Within(0)]
    duration: Annotated[float, "Duration of the rest [s]", Within(0)]
    growth: Annotated[float, "Growth rate A_thix of the yield stress [Pa/s]", Within(0)] = 0.5
    breakdown: Annotated[float, "Slip after which 1/e of the layer's gained yield stress is left [m]", Above()] = 0.1
    coverage: Annotated[
        float,
        "Area on which a layer acts (pi r^2 of every contact) divided by the area of the wall; the gained "
        "yield stress of the layer is divided by this ratio",
        Above(),
    ] = 1.0
    wall: Annotated[str, "Name of the wall whose travel is the slip"] = "piston"

    @property
    def gained(self) -> float:
        """Increase A_thix t of the yield stress and of the bonds' strengths during the rest [Pa]."""
        return self.growth * self.duration

    @property
    def layer_gained(self) -> float:
        """Increase of the yield stress of a wall's lubrication layer during the rest [Pa].

        The layer acts only where contacts are, on a fraction of the wall's area. To give the whole wall a mean increase
        of `gained`, the increase at the contacts is `gained` divided by this fraction.
        """
        return self.gained / self.coverage
