"""Linear contact with a lubrication layer in shear: yield stress and viscous drag (Xu, Li & Jiang 2021, Eq. 8).

On a wall, the layer that pumped concrete leaves there: shear stress tau = tau_L0 + eta_L V at slip velocity V,
on the area A = pi r^2 of every contact. The yield part adds to the slider of the shear spring, so a layer at
rest carries any stress up to tau_L0.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from .contact_law import contact_functions
from .law_linear import law as linear_law
from .types import types


@functools.cache
def law(scalar):
    """The linear law's normal part; slider mu N + A tau_L0 and drag A eta_L V in shear."""
    t = types(scalar)
    f = contact_functions(scalar)
    Touch = f.Touch
    shear_spring = f.shear_spring
    linear = linear_law(scalar)
    Linear = linear.Parameters
    linear_stiffness = linear.stiffness
    linear_energy = linear.energy
    linear_force = linear.force

    @wp.struct
    class Parameters:
        linear: Linear
        yield_stress: scalar  # tau_L0 [Pa]
        viscosity: scalar  # eta_L [Pa s/m]

    @wp.func
    def area(touch: Touch):
        return scalar(wp.static(float(np.pi))) * touch.smaller_radius * touch.smaller_radius

    @wp.func
    def stiffness(p: Parameters, touch: Touch):
        k = linear_stiffness(p.linear, touch)
        return t.vec4(k[0], k[1], k[2], k[3] + p.viscosity * area(touch))

    @wp.func
    def energy(p: Parameters, touch: Touch, history: t.vec3):
        return linear_energy(p.linear, touch, history)

    @wp.func
    def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
        zero = scalar(0.0)
        n = touch.normal
        # The linear law without shear: its slider is replaced by one with the layer's yield stress.
        alone, unused, unused_loss = linear_force(p.linear, touch, t.vec3(), zero)
        normal_part = wp.dot(alone, n) * n
        k = linear_stiffness(p.linear, touch)
        vn = wp.dot(touch.velocity, n)
        vs = touch.velocity - vn * n
        spring = k[0] * wp.max(-touch.gap, zero)
        limit = p.linear.friction * spring
        drag = k[3]
        if touch.gap < zero:
            limit += p.yield_stress * area(touch)
        shear, slips, slid = shear_spring(touch, history, k[1], limit, dt)
        if slips and (p.linear.dashpot_mode & 2) != 0:
            drag = zero
        if touch.gap < zero:
            drag += p.viscosity * area(touch)
        resisting = wp.dot(alone, n) + spring  # the normal dashpot alone
        return (
            normal_part + shear + drag * vs,
            shear,
            slid + (resisting * vn + drag * wp.length_sq(vs)) * dt,
        )

    return SimpleNamespace(Parameters=Parameters, stiffness=stiffness, energy=energy, force=force)
