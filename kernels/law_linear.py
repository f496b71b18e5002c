"""Linear contact law (Zhan et al. 2019, Eqs. 5-8; conventions of PFC 5.0)."""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from .contact_law import contact_functions
from .types import types

# Dashpot modes (Eq. 8): bit 0 forbids a tensile normal total, bit 1 cuts the shear dashpot in slip.
DASHPOT_MODES = {"full": 0, "no-tension": 1, "slip-cut": 2, "both": 3}


@functools.cache
def law(scalar):
    """Spring k_n = A E*/L with A = pi r^2, k_s = k_n / kappa, Coulomb slider, dashpots of critical ratio."""
    t = types(scalar)
    f = contact_functions(scalar)
    Touch = f.Touch
    shear_spring = f.shear_spring

    @wp.struct
    class Parameters:
        effective_modulus: scalar
        shear_to_normal: scalar
        friction: scalar
        damping_normal: scalar
        damping_shear: scalar
        dashpot_mode: wp.int32

    @wp.func
    def normal_stiffness(p: Parameters, touch: Touch):
        r = touch.smaller_radius
        return p.effective_modulus * scalar(wp.static(float(np.pi))) * r * r / touch.length

    @wp.func
    def stiffness(p: Parameters, touch: Touch):
        kn = normal_stiffness(p, touch)
        ks = kn * p.shear_to_normal
        two = scalar(2.0)
        return t.vec4(
            kn, ks, two * p.damping_normal * wp.sqrt(touch.mass * kn), two * p.damping_shear * wp.sqrt(touch.mass * ks)
        )

    @wp.func
    def energy(p: Parameters, touch: Touch, history: t.vec3):
        kn = normal_stiffness(p, touch)
        overlap = wp.max(-touch.gap, scalar(0.0))
        return scalar(0.5) * (kn * overlap * overlap + wp.length_sq(history) / (kn * p.shear_to_normal))

    @wp.func
    def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
        zero = scalar(0.0)
        n = touch.normal
        kn = normal_stiffness(p, touch)
        ks = kn * p.shear_to_normal
        spring = kn * wp.max(-touch.gap, zero)
        new_history, slips, lost = shear_spring(touch, history, ks, p.friction * spring, dt)
        vn = wp.dot(touch.velocity, n)
        dashpot = scalar(-2.0) * p.damping_normal * wp.sqrt(touch.mass * kn) * vn
        if (p.dashpot_mode & 1) != 0:
            dashpot = wp.max(dashpot, -spring)
        lost -= dashpot * vn * dt
        total = new_history - (spring + dashpot) * n
        if p.damping_shear > zero:
            if not (slips and (p.dashpot_mode & 2) != 0):
                vs = touch.velocity - vn * n
                cs = scalar(2.0) * p.damping_shear * wp.sqrt(touch.mass * ks)
                total = total + cs * vs
                lost += cs * wp.length_sq(vs) * dt
        return total, new_history, lost

    return SimpleNamespace(Parameters=Parameters, stiffness=stiffness, energy=energy, force=force)
