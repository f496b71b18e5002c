"""Aggregates in a shell of Bingham mortar: a hard core in a soft shell (idea: Remond & Pizette 2014).

A sphere's radius includes its shell. Where only shells overlap, mortar transmits a weak spring, a yield stress
and viscous drag; once the cores meet, the stiff spring of the aggregates joins. All mortar stresses act on
A = pi r^2 over the thickness h of the two shells: normal k A E_m/h with drag 3 mu A/h (Trouton's ratio), shear
yield tau_0 A and drag mu A/h.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from .contact_law import contact_functions
from .types import types


@functools.cache
def law(scalar):
    """Shell over a share of the centres' distance; core k_n = A E*/L; slider mu N_core + A tau_0."""
    t = types(scalar)
    f = contact_functions(scalar)
    Touch = f.Touch
    shear_spring = f.shear_spring

    @wp.struct
    class Parameters:
        effective_modulus: scalar  # of the cores [Pa]
        shear_to_normal: scalar
        friction: scalar  # of the cores
        damping_normal: scalar  # of the cores
        shell_share: scalar  # thickness of the shells over the distance of the centres at touch
        shell_modulus: scalar  # [Pa]
        yield_stress: scalar  # tau_0 [Pa]
        plastic_viscosity: scalar  # mu [Pa s]

    @wp.func
    def area(touch: Touch):
        return scalar(wp.static(float(np.pi))) * touch.smaller_radius * touch.smaller_radius

    @wp.func
    def shell_stiffness(p: Parameters, touch: Touch):
        return p.shell_modulus * area(touch) / (p.shell_share * touch.length)

    @wp.func
    def core_overlap(p: Parameters, touch: Touch):
        return wp.max(-touch.gap - p.shell_share * touch.length, scalar(0.0))

    @wp.func
    def stiffness(p: Parameters, touch: Touch):
        # As if the cores touched: they may do so within the steps until the next estimate.
        core = p.effective_modulus * area(touch) / touch.length
        kn = shell_stiffness(p, touch) + core
        drag = p.plastic_viscosity * area(touch) / (p.shell_share * touch.length)
        cn = scalar(2.0) * p.damping_normal * wp.sqrt(touch.mass * core) + scalar(3.0) * drag
        return t.vec4(kn, kn * p.shear_to_normal, cn, drag)

    @wp.func
    def energy(p: Parameters, touch: Touch, history: t.vec3):
        overlap = wp.max(-touch.gap, scalar(0.0))
        deep = core_overlap(p, touch)
        core = p.effective_modulus * area(touch) / touch.length
        soft = shell_stiffness(p, touch)
        total = soft * overlap * overlap + core * deep * deep
        return scalar(0.5) * (total + wp.length_sq(history) / ((soft + core) * p.shear_to_normal))

    @wp.func
    def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
        zero = scalar(0.0)
        n = touch.normal
        overlap = wp.max(-touch.gap, zero)
        core = p.effective_modulus * area(touch) / touch.length
        soft = shell_stiffness(p, touch)
        deep = core_overlap(p, touch)
        drag = zero
        cn = zero
        limit = p.friction * core * deep
        if overlap > zero:
            drag = p.plastic_viscosity * area(touch) / (p.shell_share * touch.length)
            cn = scalar(3.0) * drag
            limit += p.yield_stress * area(touch)
        if deep > zero:
            cn += scalar(2.0) * p.damping_normal * wp.sqrt(touch.mass * core)
        shear, slips, lost = shear_spring(touch, history, (soft + core) * p.shear_to_normal, limit, dt)
        vn = wp.dot(touch.velocity, n)
        vs = touch.velocity - vn * n
        spring = soft * overlap + core * deep
        total = shear + drag * vs - (spring - cn * vn) * n
        return total, shear, lost + (cn * vn * vn + drag * wp.length_sq(vs)) * dt

    return SimpleNamespace(Parameters=Parameters, stiffness=stiffness, energy=energy, force=force)
