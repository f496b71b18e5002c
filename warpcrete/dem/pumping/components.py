"""Conversion of declared parameters into the components of a pumping scene: sizes, contacts, bonds, plug, settings."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...core.errors import refuse
from ...core.inputs.parameters import Above, Within
from ...geometry.axis import Axis
from ...geometry.walls import Driven, PlaneWall
from ..laws import Contact, ContactLaw, LubricationLayer
from ..scene.clumps import templates
from ..scene.containers import Fill, PipeContainer
from ..scene.scene import AxisDrive, Bodies, Bonds, Hydration, Settle, TimeStep, Watch
from ..scene.sizes import Gaussian, SieveCurve, Sizes, Uniform
from .parameter_groups import AggregateParameters, BondParameters
from .parameters import stiffness_of


def contact_of(given: Any) -> ContactLaw:
    """Return the contact law between aggregates that follows from the scene parameters `given`."""
    return given.contact if given.contact is not None else linear_of(given)


def linear_of(given: Any) -> Contact:
    """Return the linear contact law that follows from the contact parameters of the scene, such as `modulus`."""
    return Contact(
        effective_modulus=given.modulus,
        stiffness_ratio=given.stiffness_ratio,
        friction=given.friction,
        normal_damping_ratio=given.normal_damping,
        shear_damping_ratio=given.shear_damping,
        dashpot=given.dashpot,
    )


def wall_contact_of(given: Any) -> dict[tuple[str, str], ContactLaw]:
    """Return the contact law on pipe and piston, in a dictionary whose keys are pairs of materials.

    The result is empty if walls follow the same law as contacts between aggregates.
    """
    if given.wall_contact is not None:
        return {("aggregate", "wall"): given.wall_contact}
    if given.contact is not None:
        return {}
    contact = linear_of(given)
    if given.wall_friction is not None:
        contact = replace(contact, friction=given.wall_friction)
    if given.layer_yield or given.layer_viscosity:
        layer = LubricationLayer(contact=contact, yield_stress=given.layer_yield, viscosity=given.layer_viscosity)
        return {("aggregate", "wall"): layer}
    return {("aggregate", "wall"): contact} if given.wall_friction is not None else {}


def law_remarks(given: Any) -> Iterator[str]:
    """Yield remarks on parameters of the concrete that have no effect because a user has chosen another contact law."""
    law, wall = given.contact, given.wall_contact
    if law is not None:
        where = (
            "between aggregates"
            if wall is not None
            else ("between aggregates and on the wall, which has no lubrication layer")
        )
        yield (
            f"contact {type(law).__name__} acts {where}; the contact parameters of concrete {given.concrete} are "
            "ignored"
        )
        if given.bonds:
            yield "bonds of mortar act in addition to the contact law; --no-bonds (in Python bonds=False) removes them"
    elif wall is not None:
        yield f"wall_contact {type(wall).__name__} replaces the wall parameters of concrete {given.concrete}"


def bonds_of(given: BondParameters) -> Bonds | None:
    """Return the properties of the bonds between aggregates, or None if bonds are switched off."""
    if not given.bonds:
        return None
    return Bonds(
        effective_modulus=given.bond_modulus,
        stiffness_ratio=given.bond_stiffness_ratio,
        tensile_strength=given.tensile_strength,
        cohesion=given.cohesion,
        friction_angle=given.friction_angle,
        gap=given.bond_gap,
        healing=given.healing,
    )


def hydration_of(given: BondParameters) -> Hydration | None:
    """Return the fraction of bonds that hydrate and the properties of hydrated bonds; None if no bonds hydrate."""
    if not (given.bonds and given.hydration):
        return None
    return Hydration(
        fraction=given.hydration,
        bonds=Bonds(
            effective_modulus=given.hydration_modulus,
            stiffness_ratio=given.bond_stiffness_ratio,
            tensile_strength=given.hydration_strength,
            cohesion=given.hydration_strength / 2,
            friction_angle=given.friction_angle,
        ),
    )


def sizes_of(given: AggregateParameters, diameter: float) -> Sizes:
    """Return the size distribution of the aggregates.

    Raises :class:`SceneError` if the largest aggregate is not smaller than the `diameter` of the pipe [m].
    """
    sizes = _distribution(given)
    if sizes.largest >= diameter:
        problem = f"must be below the pipe's diameter, {diameter:g} m"
        refuse("size_max", sizes.largest, problem, "use smaller aggregates or a wider pipe")
    return sizes


def _distribution(given: AggregateParameters) -> Sizes:
    smallest, largest = given.size_min, given.size_max
    if given.sizes == "uniform":
        return Uniform(smallest, largest)
    if given.sizes == "gaussian":
        mean, deviation = given.size_mean, given.size_deviation
        if mean is None:
            mean = 0.5 * (smallest + largest)
        if deviation is None:
            deviation = max(0.5 * (largest - smallest), 1e-6 * largest)
        return Gaussian(mean, deviation, smallest, largest)
    return SieveCurve.from_text(given.sizes, "sizes", "must be 'gaussian', 'uniform' or a sieve curve")


def fractions_of(text: str | None) -> tuple[float, ...] | None:
    """Return the shapes' volume fractions from a text of numbers separated by commas, or None if there is no text."""
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        refuse("fractions", text, "must be numbers separated by commas, one for each shape", "for example '2,1,1,1'")


MOST_BALLS = 600_000
"""Maximum number of balls in the plug that closes the front of the concrete."""


@dataclass(frozen=True)
class Plug:
    """Plug that closes the front of the concrete: bonded balls or a plate, pressed against the flow.

    All fields are empty if the scene has no plug.
    """

    bodies: tuple[Bodies, ...] = ()
    drives: tuple[AxisDrive, ...] = ()
    bonds: Mapping[str, Bonds] = field(default_factory=dict)
    plates: tuple[PlaneWall, ...] = ()


def plug_of(given: Any, axis: Axis, at: float, radius: float, layers: int, inner: float) -> Plug:
    """Return the plug that closes the front of the concrete at the arc length `at` [m] of a pipe's axis.

    `given` holds the parameters of the scene. A plug of balls has `layers` layers and fills a bore of radius `inner`
    [m]. The plug resists the flow with a constant force: the plug pressure times the area of a circle of radius
    `radius` [m].
    """
    area, density = math.pi * radius**2, given.bulk_density or given.density
    if given.plug == "balls":
        points = plug_points(axis, inner, at, given.plug_ball, layers)
        bodies = Bodies(positions=points, sizes=given.plug_ball, density=density, group="plug")
        drive = AxisDrive(group="plug", axis=axis, force=-given.plug_pressure * area)
        # The balls of the plug close the front of the concrete. Their bonds are stiff enough for the plug to keep its
        # shape, but so soft that they do not limit the time step.
        bonds = Bonds(
            effective_modulus=2 * stiffness_of(given), tensile_strength=1e12, cohesion=1e12, gap=0.35 * given.plug_ball
        )
        return Plug((bodies,), (drive,), {"plug": bonds})
    if given.plug == "plate":
        points, tangents = axis.at(at)
        back = tuple((-tangents[0]).tolist())
        motion = Driven(direction=back, force=given.plug_pressure * area, mass=density * area * 2 * given.plug_ball)
        place = tuple(points[0].tolist())
        return Plug(plates=(PlaneWall(name="plug", point=place, normal=back, motion=motion, drawn_radius=radius),))
    return Plug()


def plug_points(axis: Axis, radius: float, at: float, ball: float, layers: int) -> np.ndarray:
    """Return the centres of the balls of a plug, which fills the pipe's cross-section, shape (n, 3) [m].

    The plug closes the front of the concrete, at the arc length `at` [m] of a pipe of the given `radius` [m]. It
    consists of layers across the pipe. Each layer consists of concentric rings of balls. Raises :class:`SceneError` if
    `ball` [m] does not fit the pipe or is so small that the plug has too many balls.
    """
    Within(0, radius).check("plug_ball", ball, f" m, the pipe's radius being {radius:g} m")
    Above().check("plug_ball", ball, " m")
    across = radius / ball
    # Use a product: for a very large number, `across**2` would raise OverflowError, but a product becomes infinite.
    count = layers * math.pi * across * across
    if count > MOST_BALLS:
        problem = f"would need {count:.2g} balls to plug the pipe"
        refuse("plug_ball", ball, problem, "increase 'plug_ball', or set 'plug' to plate or none")
    local = []
    for layer in range(layers):
        ring = radius - ball / 2
        while ring > ball / 4:
            count = max(1, int(2 * math.pi * ring / ball))
            for k in range(count):
                angle = 2 * math.pi * (k + 0.5 * layer) / count
                local.append((at + (layer + 0.5) * ball, ring * math.cos(angle), ring * math.sin(angle)))
            ring -= ball
        if ring > -ball / 4:
            local.append((at + (layer + 0.5) * ball, 0.0, 0.0))
    s, a, b = np.array(local).T
    points, _, normal, side = axis.frame(s)
    return points + a[:, None] * normal + b[:, None] * side


def fill_of(given: Any, container: PipeContainer, sizes: Sizes) -> Fill:
    """Return the filling of a container with aggregates.

    `given` contains the parameters of the aggregates and of their contacts. If it has no solid fraction, the aggregates
    are packed until they reach the pressure `plug_pressure`, which acts on the front of the concrete.
    """
    return Fill(
        container=container,
        sizes=sizes,
        templates=templates(given.shapes, given.shape_spheres),
        fractions=fractions_of(given.fractions),
        density=given.density,
        bulk_density=given.bulk_density,
        solid_fraction=given.solid_fraction,
        # A pressure below 2e-3 times the contact modulus does not define how dense a packing is, so use at least this
        # pressure.
        pressure=max(given.plug_pressure, 2e-3 * stiffness_of(given)) if given.solid_fraction is None else None,
    )


def settings_of(given: Any) -> dict[str, Any]:
    """Return arguments of a :class:`Scene` that follow from the parameters `given`, such as contacts and bonds."""
    return {
        "contact": contact_of(given),
        "contacts": wall_contact_of(given),
        "bonds": bonds_of(given),
        "hydration": hydration_of(given),
        "gravity": (0.0, 0.0, -given.gravity),
        "settle": Settle(duration=given.settle) if given.settle > 0 else None,
        "time_step": TimeStep(fixed=given.time_step, safety=given.safety, rounds=given.hydration_rounds),
        "watch": Watch(overlap=given.overlap_limit or None),
        "energy_balance": given.energy_balance,
        "precision": given.precision,
        "sample_interval": given.sample_interval,
        "seed": given.seed,
    }
