# pyright: reportInvalidTypeForm=false
"""Perfectly plastic mortar shells: one slider for all relative motion of a contact, along its normal and across it.

Spheres have hard cores with soft shells, as in :class:`BinghamMortar`. A spring resists any relative motion of the two
surfaces. Once the spring's force has reached a limit F, the contact slips and the force stays F. A drag resists the
whole relative velocity.

If contacts in all directions n follow a flow with the strain rate tensor D, the slider of each contact dissipates F |D
n| per unit of the contact's length. The mean of |D n| over all directions is pi/8 of the rate in simple shear and 0.69
of the rate in uniaxial extension, so one F satisfies von Mises' rule for both flows within 1.5 %. The drag dissipates
in proportion to the mean of |D n|^2, which is three times as large in extension as in shear (Trouton's ratio). Shells
also pull with a constant force `tension` tau_0 A, which keeps a heap together. They transmit moments only if `bending`
is not 0.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import warp as wp

from ...core.inputs.parameters import Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw
from .mortar import BinghamMortar, shell_functions

WALL_BENDING = 4 / math.sqrt(3) / math.pi
"""Largest moment that a contact with a rough wall transmits, divided by tau_0 A r (yield stress, contact area, radius).

A bent disc of mortar with the radius r yields under this moment.
"""


@dataclass(frozen=True, kw_only=True)
class PlasticMortar(BinghamMortar):
    """Mortar shells with one slider and one drag for relative motion in any direction, along the normal and across it.

    The slider's limit is mu N_core + A tau_0 and the drag is mu_p A/h times the velocity. Here mu is the friction
    coefficient, N_core the force of the cores' spring, A the contact's area, tau_0 and mu_p the yield stress and
    plastic viscosity of the mortar, and h the thickness of the two shells. The history is the spring's force on the
    first body [N], which rotates with the pair.
    """

    called = "plastic"

    tension: Annotated[
        float, "Tensile strength of a shell in addition to its slider, divided by tau_0 A", Within(0)
    ] = 2.5
    bending: Annotated[float, "Largest moment of a shell divided by tau_0 A r; 0: spheres roll freely", Within(0)] = 0.0

    def gripped(self, grip: float) -> ContactLaw:
        # Give the wall contacts a rolling resistance, because a single sphere would otherwise roll away along the wall.
        return replace(super().gripped(grip), bending=WALL_BENDING)

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        Touch = contact_functions(scalar).Touch
        shells = shell_functions(scalar, parameters)
        area, shell_stiffness, shell_drag = shells.area, shells.shell_stiffness, shells.shell_drag
        with_bending, core_overlap = shells.with_bending, shells.core_overlap
        Parameters = parameters

        @wp.func
        def core_stiffness(p: Parameters, touch: Touch):
            return p.effective_modulus * area(touch) / touch.length

        @wp.func
        def slider_stiffness(p: Parameters, touch: Touch):
            return (shell_stiffness(p, touch) + core_stiffness(p, touch)) * p.shear_to_normal

        @wp.func
        def core_dashpot(p: Parameters, touch: Touch):
            return scalar(2.0) * p.normal_damping_ratio * wp.sqrt(touch.mass * core_stiffness(p, touch))

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            # Include the stiffness of the hard cores, which may touch before the stable step is estimated again.
            slider, drag = slider_stiffness(p, touch), shell_drag(p, touch)
            kn = shell_stiffness(p, touch) + core_stiffness(p, touch) + slider
            cn = core_dashpot(p, touch) + drag
            ks, cs = with_bending(p, touch, slider, drag)
            return t.vec4(kn, ks, cn, cs)

        @wp.func
        def energy(p: Parameters, touch: Touch, history: t.vec3):
            overlap = wp.max(-touch.gap, scalar(0.0))
            deep = core_overlap(p, touch)
            total = shell_stiffness(p, touch) * overlap * overlap + core_stiffness(p, touch) * deep * deep
            pulled = p.tension * p.yield_stress * area(touch) * overlap
            return scalar(0.5) * (total + wp.length_sq(history) / slider_stiffness(p, touch)) - pulled

        @wp.func
        def turned(touch: Touch, v: t.vec3):
            """Return the force `v` rotated by the rotation of the pair of bodies in the last step; keep its length."""
            square = wp.length_sq(v)
            after = v + wp.cross(touch.tilt + touch.twist * touch.normal, v)
            longer = scalar(1.0)
            if square > scalar(0.0):
                longer = wp.sqrt(square / wp.length_sq(after))
            return longer * after

        @wp.func
        def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
            zero = scalar(0.0)
            n = touch.normal
            overlap = wp.max(-touch.gap, zero)
            deep = core_overlap(p, touch)
            core = core_stiffness(p, touch) * deep
            vn = wp.dot(touch.velocity, n)
            drag = zero
            cn = zero
            pull = zero
            limit = p.friction * core
            if overlap > zero:
                drag = shell_drag(p, touch)
                limit += p.yield_stress * area(touch)
                pull = p.tension * p.yield_stress * area(touch)
            if deep > zero:
                cn = core_dashpot(p, touch)
            stiff = slider_stiffness(p, touch)
            # If the spheres first touched within this step, extend the spring only over the time since the first touch.
            loading = dt
            if -vn * dt > overlap:
                loading = overlap / -vn
            old = turned(touch, history)
            trial = old + (stiff * loading) * touch.velocity
            kept = scalar(1.0)
            square = wp.length_sq(trial)
            if square > limit * limit:
                kept = limit / wp.sqrt(square)
            held = kept * trial
            lost = zero
            if square > limit * limit:
                lost = scalar(0.5) * wp.dot(old + held, trial - held) / stiff
            spring = shell_stiffness(p, touch) * overlap + core - pull
            total = held + drag * touch.velocity - (spring - cn * vn) * n
            return total, held, lost + (cn * vn * vn + drag * wp.length_sq(touch.velocity)) * dt

        return {"force": force, "stiffness": stiffness, "energy": energy, "moment": shells.moment,
                "moment_energy": shells.moment_energy}  # fmt: skip
