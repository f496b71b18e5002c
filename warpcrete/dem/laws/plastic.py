# pyright: reportInvalidTypeForm=false
"""Shells of a perfectly plastic mortar: one slider for all of a contact's motion, along its normal and across.

Between hard cores with soft shells, as :class:`BinghamMortar` has them, a spring that carries any relative motion of
the two surfaces grows up to a force F and then slips; a drag resists the whole velocity. Contacts in all directions n
that follow a rate of strain D lose F |D n| each: in simple shear the mean of |D n| is pi/8 of the rate, in uniaxial
extension 0.69 of it, so that both ask for the F of von Mises' rule within 1.5 %; the squares, for the drag, are one to
three, Trouton's ratio. Shells also pull, with a constant force `tension` tau A, which keeps a heap together; moments
they bear only where `bending` is not 0.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import warp as wp

from ...core.parameters import Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw
from .mortar import BinghamMortar, shell_functions

ROLLS_NOT = 4 / math.sqrt(3) / math.pi
"""Moment of a disc of mortar on the plate over tau A r, as :class:`BinghamMortar` has it everywhere."""


@dataclass(frozen=True, kw_only=True)
class PlasticMortar(BinghamMortar):
    """Shells as of the base, whose slider mu N_core + A tau_0 and drag mu A/h are for motion in any direction.

    The history is that spring's force on the first body [N], which turns with the pair.
    """

    called = "plastic"

    tension: Annotated[float, "Tensile strength of a shell in addition to its slider, over tau_0 A", Within(0)] = 2.5
    bending: Annotated[float, "Largest moment of a shell over tau_0 A r; 0: spheres roll freely", Within(0)] = 0.0

    def gripped(self, grip: float) -> ContactLaw:
        return replace(super().gripped(grip), bending=ROLLS_NOT)  # a lone sphere would roll away

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        Touch = contact_functions(scalar).Touch
        shells = shell_functions(scalar, parameters)
        area, shell_stiffness, shell_drag = shells.area, shells.shell_stiffness, shells.shell_drag
        bending, core_overlap = shells.bending, shells.core_overlap
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
            # As if the cores touched: they may do so within the steps until the next estimate.
            slider, drag = slider_stiffness(p, touch), shell_drag(p, touch)
            kn = shell_stiffness(p, touch) + core_stiffness(p, touch) + slider
            cn = core_dashpot(p, touch) + drag
            ks, cs = slider, drag
            if p.bending > scalar(0.0):
                # A moment k_r of a turn is no more than a force k_r / r^2 at the end of a radius.
                kr, cr = bending(p, touch)
                square = touch.smaller_radius * touch.smaller_radius
                ks += kr / square
                cs += cr / square
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
            """A force that turns with the pair, as long as it was."""
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
            # Only the part of the step after first touch loads the spring.
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
