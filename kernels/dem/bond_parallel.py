"""Parallel bond between two spheres (Zhan et al. 2019, Eqs. 9-12; conventions of PFC 5.0). Tension is positive."""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from ..common.types import types, vector_functions
from .contact_law import contact_functions

# The state of a pair's bond is an integer. It is 0 without a bond and negative if the bond broke. A positive state
# packs two numbers: the bond's kind, which selects the bond parameters, and the index in `pairs.load` at which the
# bond's force and moment are stored.
UNBONDED: int = wp.constant(0)
BROKEN_IN_TENSION: int = wp.constant(-1)
BROKEN_IN_SHEAR: int = wp.constant(-2)
# HYDRATED is the number of the stiff kind of bond. It stands for contacts that have hardened by cement hydration.
# Ordinary bonds have the number 1.
HYDRATED: int = wp.constant(2)

# The lowest KIND_BITS bits of a bond state are the bond's kind. The bits above hold an index in `pairs.load`, where the
# bond's force and moment are stored. Few pairs of a neighbour list are bonded, so `pairs.load` has room for bonded
# pairs only.
KIND_BITS: int = wp.constant(4)
MOST_KINDS = 2 ** int(KIND_BITS) - 1
MOST_ROWS = 2 ** (31 - int(KIND_BITS))


@wp.func
def kind_of(bond: wp.int32):
    """Return the kind of a pair's bond from its state.

    Without an intact bond, the result is the state itself: 0 if the pair is unbonded, negative if the bond broke.
    """
    return wp.where(bond > 0, bond & wp.static(MOST_KINDS), bond)


@wp.func
def load_row(bond: wp.int32):
    """Return the row of `pairs.load` that holds the bond's force and moment, counted from the scene's first row."""
    return bond >> KIND_BITS


@wp.func
def bond_with(kind: wp.int32, row: wp.int32):
    """Return the bond state, an integer that packs the bond's `kind` and its `row` of `pairs.load`."""
    return kind | (row << KIND_BITS)


@functools.cache
def bond_functions(scalar):
    """Return the struct ``Bond`` of the bond parameters, and functions for force, stiffness and energy of a bond."""
    t = types(scalar)
    Touch = contact_functions(scalar).Touch
    rotated_with_normal = vector_functions(scalar).rotated_with_normal
    xyz = vector_functions(scalar).xyz

    @wp.struct
    class Bond:
        effective_modulus: scalar  # bond modulus E, with normal stiffness E area / length [Pa]
        shear_to_normal: scalar  # shear stiffness of the bond divided by its normal stiffness
        tensile_strength: scalar  # normal stress at which the bond breaks [Pa]
        cohesion: scalar  # shear strength at zero normal stress [Pa]

        # tangent of the friction angle: increase of the shear strength divided by the increase of the compressive
        # stress
        tan_friction_angle: scalar
        radius_multiplier: scalar  # bond radius divided by the radius of the smaller sphere

        # fraction of the stresses due to bending and torsion that is included when the peak stresses are compared with
        # the strengths
        moment_factor: scalar

    @wp.func
    def bond_stiffness(p: Bond, touch: Touch):
        """Return the four stiffnesses of a bond: normal and shear [N/m], bending and torsion [N m]."""
        radius = p.radius_multiplier * touch.smaller_radius
        normal = p.effective_modulus / touch.length * scalar(wp.static(float(np.pi))) * radius * radius
        bending = scalar(0.25) * normal * radius * radius
        return t.vec4(normal, normal * p.shear_to_normal, bending, scalar(2.0) * bending * p.shear_to_normal)

    @wp.func
    def bond_energy(p: Bond, touch: Touch, force: t.vec4, moment: t.vec4):
        """Return the elastic energy stored in a bond [J]."""
        k = bond_stiffness(p, touch)
        total = force[3] * force[3] / k[0] + wp.length_sq(xyz(force)) / k[1]
        return scalar(0.5) * (total + wp.length_sq(xyz(moment)) / k[2] + moment[3] * moment[3] / k[3])

    @wp.func
    def bond_force(
        p: Bond, touch: Touch, stretch: scalar, relative_spin: t.vec3, force: t.vec4, moment: t.vec4, dt: scalar
    ):
        """Return the new force and moment of a bond, and 1 if it holds or the negative code of its failure mode.

        If the bond breaks, the returned force and moment are those at which it broke. `force` consists of the shear
        force vector and the tension [N], `moment` of the bending moment vector and the torsion [N m]. `stretch` is the
        exact change of the distance between the centres in this step [m]. The normal velocity times dt would be a poor
        approximation: it counts a rotation of the pair as stretch, with an error of first order in dt.
        """
        n = touch.normal
        k = bond_stiffness(p, touch)
        vn = wp.dot(touch.velocity, n)
        spin_n = wp.dot(relative_spin, n)
        shear = rotated_with_normal(xyz(force), n, touch.twist) + (k[1] * dt) * (touch.velocity - vn * n)
        tension = force[3] + k[0] * stretch
        bending = rotated_with_normal(xyz(moment), n, touch.twist) + (k[2] * dt) * (relative_spin - spin_n * n)
        torsion = moment[3] + k[3] * dt * spin_n

        radius = p.radius_multiplier * touch.smaller_radius
        per_area = scalar(wp.static(float(1.0 / np.pi))) / (radius * radius)
        # A bending moment M causes the largest normal stress M R / I = 4 M / (A R), with the bond's radius R, the area
        # A of its circular cross-section, and the second moment of area I = A R^2 / 4.
        per_section = scalar(4.0) * per_area / radius
        stress = tension * per_area
        peak_tension = stress + p.moment_factor * wp.length(bending) * per_section
        peak_shear = wp.length(shear) * per_area + scalar(0.5) * p.moment_factor * wp.abs(torsion) * per_section
        outcome = wp.int32(1)
        if peak_tension > p.tensile_strength:
            outcome = wp.static(int(BROKEN_IN_TENSION))
        elif peak_shear > p.cohesion - stress * p.tan_friction_angle:
            outcome = wp.static(int(BROKEN_IN_SHEAR))
        return (
            t.vec4(shear[0], shear[1], shear[2], tension),
            t.vec4(bending[0], bending[1], bending[2], torsion),
            outcome,
        )

    return SimpleNamespace(Bond=Bond, bond_force=bond_force, bond_stiffness=bond_stiffness, bond_energy=bond_energy)
