"""Linear contact law with parallel bond (Zhan et al. 2019, Eqs. 5-12; conventions of PFC 5.0).

Sign conventions, for a contact between bodies a and b: the normal n points from a to b, forces and
moments are those on a (b gets the opposite force), relative velocity is that of b seen from a, so a
positive normal component separates. Bond tension is positive.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from .types import types, vector_functions

# Dashpot modes (Eq. 8): bit 0 forbids a tensile normal total, bit 1 cuts the shear dashpot in slip.
DASHPOT_MODES = {"full": 0, "no-tension": 1, "slip-cut": 2, "both": 3}

# State of a contact's bond. Positive values number the bond properties in use.
UNBONDED = wp.constant(0)
BROKEN_IN_TENSION = wp.constant(-1)
BROKEN_IN_SHEAR = wp.constant(-2)


@functools.cache
def law(scalar):
    """Structs and functions of the law in one precision."""
    t = types(scalar)
    rotated_with_normal = vector_functions(scalar).rotated_with_normal

    @wp.struct
    class ContactParameters:
        effective_modulus: scalar
        shear_to_normal: scalar
        friction: scalar
        damping_normal: scalar
        damping_shear: scalar
        dashpot_mode: wp.int32

    @wp.struct
    class BondParameters:
        effective_modulus: scalar
        shear_to_normal: scalar
        tensile_strength: scalar
        cohesion: scalar
        tan_friction_angle: scalar
        radius_multiplier: scalar
        moment_factor: scalar

    @wp.func
    def normal_stiffness(p: ContactParameters, radius: scalar, length: scalar):
        return p.effective_modulus * scalar(wp.static(float(np.pi))) * radius * radius / length

    @wp.func
    def linear_force(
        p: ContactParameters,
        n: t.vec3,
        gap: scalar,
        velocity: t.vec3,
        twist: scalar,
        radius: scalar,
        length: scalar,
        mass: scalar,
        shear: t.vec3,
        dt: scalar,
    ):
        """Spring, slider and dashpot (Eqs. 6-8). Returns the force on a and the new shear spring force.

        `gap` may be positive for a bonded contact: the spring is then slack, the dashpot still acts.
        `radius` and `length` are r and L of A E*/L, `mass` is m_c, `twist` the turn about n in the step.
        """
        zero = scalar(0.0)
        kn = normal_stiffness(p, radius, length)
        ks = kn * p.shear_to_normal
        overlap = wp.max(-gap, zero)
        vn = wp.dot(velocity, n)
        vs = velocity - vn * n

        # Only the part of the step after first touch loads the shear spring.
        loading = dt
        closing = -vn * dt
        if closing > overlap:
            loading = dt * overlap / closing

        spring = kn * overlap
        trial = rotated_with_normal(shear, n, twist) + (ks * loading) * vs
        limit = p.friction * spring
        magnitude = wp.length(trial)
        slipping = magnitude > limit
        new_shear = trial
        if slipping:
            new_shear = trial * (limit / magnitude)

        dashpot = scalar(-2.0) * p.damping_normal * wp.sqrt(mass * kn) * vn
        if (p.dashpot_mode & 1) != 0:
            dashpot = wp.max(dashpot, -spring)
        force = new_shear - (spring + dashpot) * n
        if p.damping_shear > zero:
            if not (slipping and (p.dashpot_mode & 2) != 0):
                force = force + (scalar(2.0) * p.damping_shear * wp.sqrt(mass * ks)) * vs
        return force, new_shear

    @wp.func
    def bond_force(
        p: BondParameters,
        n: t.vec3,
        stretch: scalar,
        velocity: t.vec3,
        relative_spin: t.vec3,
        twist: scalar,
        smaller_radius: scalar,
        length: scalar,
        force: t.vec4,
        moment: t.vec4,
        dt: scalar,
    ):
        """Parallel bond (Eqs. 9-12). Returns new force, new moment and the state of the bond.

        `force` and `moment` hold the shear (bending) vector and, last, the normal (twisting) part. `stretch` is
        the step's change of the centres' distance; `velocity dt` along the normal would count a rotation of the
        pair as stretch, in first order of dt.
        """
        one = scalar(1.0)
        radius = p.radius_multiplier * smaller_radius
        area = scalar(wp.static(float(np.pi))) * radius * radius
        inertia = scalar(0.25) * area * radius * radius
        kn = p.effective_modulus / length
        ks = kn * p.shear_to_normal

        vn = wp.dot(velocity, n)
        spin_n = wp.dot(relative_spin, n)
        shear = rotated_with_normal(t.vec3(force[0], force[1], force[2]), n, twist)
        shear = shear + (ks * area * dt) * (velocity - vn * n)
        tension = force[3] + kn * area * stretch
        bending = rotated_with_normal(t.vec3(moment[0], moment[1], moment[2]), n, twist)
        bending = bending + (kn * inertia * dt) * (relative_spin - spin_n * n)
        torsion = moment[3] + ks * scalar(2.0) * inertia * dt * spin_n

        stress = tension / area
        peak_tension = stress + p.moment_factor * wp.length(bending) * radius / inertia
        peak_shear = wp.length(shear) / area + p.moment_factor * wp.abs(torsion) * radius / (scalar(2.0) * inertia)
        outcome = wp.int32(1)
        if peak_tension > p.tensile_strength:
            outcome = wp.static(int(BROKEN_IN_TENSION))
        elif peak_shear > p.cohesion - stress * p.tan_friction_angle:
            outcome = wp.static(int(BROKEN_IN_SHEAR))
        keep = one
        if outcome < 0:
            keep = scalar(0.0)
        return (
            keep * t.vec4(shear[0], shear[1], shear[2], tension),
            keep * t.vec4(bending[0], bending[1], bending[2], torsion),
            outcome,
        )

    return SimpleNamespace(
        ContactParameters=ContactParameters,
        BondParameters=BondParameters,
        normal_stiffness=normal_stiffness,
        linear_force=linear_force,
        bond_force=bond_force,
    )
