"""Hertz-Mindlin contact: Hertz' normal force, Mindlin's tangent stiffness without micro-slip, Coulomb slider.

Dashpots after Tsuji et al. 1992 in the form of Antypov & Elliott 2011, whose restitution coefficient does not
depend on speed. Shear force is incremental; when the normal load falls it either falls with the tangent stiffness
(`rescale`; Thornton et al. 2013), which never creates energy, or holds, as in the simplest codes.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from .contact_law import contact_functions
from .types import types


@functools.cache
def law(scalar):
    """F_n = 4/3 E* sqrt(R* d) d, k_s = 8 G* sqrt(R* d), c = 2 sqrt(5/6) beta sqrt(k m), k_n = 2 E* sqrt(R* d)."""
    t = types(scalar)
    f = contact_functions(scalar)
    Touch = f.Touch
    shear_spring = f.shear_spring
    viscous = float(2.0 * np.sqrt(5.0 / 6.0))

    @wp.struct
    class Parameters:
        effective_modulus: scalar  # E* [Pa]
        effective_shear_modulus: scalar  # G* [Pa]
        friction: scalar
        damping: scalar  # beta
        rescale: wp.int32

    @wp.func
    def stiffness(p: Parameters, touch: Touch):
        # At the deepest point of an impact with the present closing speed and overlap.
        zero = scalar(0.0)
        root = wp.sqrt(touch.reduced_radius)
        overlap = wp.max(-touch.gap, zero)
        closing = wp.min(wp.dot(touch.velocity, touch.normal), zero)
        impact = scalar(0.9375) * touch.mass * closing * closing / (root * p.effective_modulus)
        deepest = wp.pow(wp.pow(overlap, scalar(2.5)) + impact, scalar(0.4))
        contact_radius = root * wp.sqrt(deepest)
        kn = scalar(2.0) * p.effective_modulus * contact_radius
        ks = scalar(8.0) * p.effective_shear_modulus * contact_radius
        c = scalar(wp.static(viscous)) * p.damping
        return t.vec4(kn, ks, c * wp.sqrt(kn * touch.mass), c * wp.sqrt(ks * touch.mass))

    @wp.func
    def energy(p: Parameters, touch: Touch, history: t.vec3):
        overlap = wp.max(-touch.gap, scalar(0.0))
        contact_radius = wp.sqrt(touch.reduced_radius * overlap)
        total = scalar(8.0) / scalar(15.0) * p.effective_modulus * contact_radius * overlap * overlap
        if contact_radius > scalar(0.0):
            total += wp.length_sq(history) / (scalar(16.0) * p.effective_shear_modulus * contact_radius)
        return total

    @wp.func
    def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
        zero = scalar(0.0)
        n = touch.normal
        overlap = wp.max(-touch.gap, zero)
        contact_radius = wp.sqrt(touch.reduced_radius * overlap)
        kn = scalar(2.0) * p.effective_modulus * contact_radius
        ks = scalar(8.0) * p.effective_shear_modulus * contact_radius
        spring = scalar(2.0) / scalar(3.0) * kn * overlap
        vn = wp.dot(touch.velocity, n)
        vs = touch.velocity - vn * n
        before = overlap + vn * dt
        kept = history
        released = zero
        if before > zero and overlap > zero:
            # What the spring held less what it holds with the new stiffness: the same force on a stiffer one
            # when loading, a force that falls with the stiffness when unloading.
            share = wp.sqrt(overlap / before)
            stored = scalar(0.5) * wp.length_sq(history) / ks
            released = stored * (share - scalar(1.0))
            if share < scalar(1.0) and p.rescale != 0:
                kept = share * history
                released = stored * share * (scalar(1.0) - share)
        new_history, slips, lost = shear_spring(touch, kept, ks, p.friction * spring, dt)
        c = scalar(wp.static(viscous)) * p.damping
        cn = c * wp.sqrt(kn * touch.mass)
        total = new_history - (spring - cn * vn) * n
        lost += released + cn * vn * vn * dt
        if not slips:
            cs = c * wp.sqrt(ks * touch.mass)
            total = total + cs * vs
            lost += cs * wp.length_sq(vs) * dt
        return total, new_history, lost

    return SimpleNamespace(Parameters=Parameters, stiffness=stiffness, energy=energy, force=force)
