"""What pumped concrete is made of, from declared parameters: sizes, contacts, bonds."""

from __future__ import annotations

from dataclasses import replace

from ..core.errors import refuse
from .laws import Contact, ContactLaw, LubricationLayer
from .pumping import AggregateParameters, BondParameters, ContactParameters
from .scene import Bonds, Hydration
from .sizes import Gaussian, SieveCurve, Sizes, Uniform


def contact_of(given: ContactParameters) -> Contact:
    """Law of the contacts."""
    return Contact(
        effective_modulus=given.modulus,
        stiffness_ratio=given.stiffness_ratio,
        friction=given.friction,
        normal_damping_ratio=given.normal_damping,
        shear_damping_ratio=given.shear_damping,
        dashpot=given.dashpot,
    )


def wall_contact_of(given: ContactParameters) -> dict[tuple[str, str], ContactLaw]:
    """Contact with pipe and piston, where it differs."""
    contact = contact_of(given)
    if given.wall_friction is not None:
        contact = replace(contact, friction=given.wall_friction)
    if given.layer_yield or given.layer_viscosity:
        layer = LubricationLayer(contact=contact, yield_stress=given.layer_yield, viscosity=given.layer_viscosity)
        return {("aggregate", "wall"): layer}
    return {("aggregate", "wall"): contact} if given.wall_friction is not None else {}


def bonds_of(given: BondParameters) -> Bonds | None:
    """Bonds of the aggregates, if they have any."""
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
    """Hydrated bonds, if there are any."""
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
    """Sizes of the aggregates, all of which pass a pipe of this diameter [m]."""
    found = _distribution(given)
    if found.largest >= diameter:
        refuse("size_max", found.largest, f"must be below the pipe's diameter, {diameter:g} m")
    return found


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
    try:
        pairs = [tuple(map(float, part.split(":"))) for part in given.sizes.split(",")]
        openings, passing = zip(*pairs, strict=True)
    except ValueError:
        refuse("sizes", given.sizes, "must be gaussian, uniform or a sieve curve",
               "for example '5:0,10:0.4,20:1' (mm:passing)")  # fmt: skip
    return SieveCurve(tuple(1e-3 * o for o in openings), tuple(passing))


def fractions_of(text: str | None) -> tuple[float, ...] | None:
    """Volume fractions of shapes, from numbers joined by commas."""
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        refuse("fractions", text, "must be numbers joined by commas", "for example '2,1,1,1'")
