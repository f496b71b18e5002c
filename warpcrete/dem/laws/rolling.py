# pyright: reportInvalidTypeForm=false
"""Linear contact with rolling resistance: elastic-plastic spring with dashpot, model C of Ai, Chen, Rotter & Ooi 2011.

The moment of the rolling spring grows with the relative rotation of the two bodies about axes in the contact plane. The
spring slips when its moment reaches mu_r R N. Here mu_r is the coefficient of rolling friction and N the force of the
normal spring. R is R1 R2 / (R1 + R2) for spheres of the radii R1 and R2, or the sphere's radius against a wall. The
stiffness of the rolling spring is k_s R^2, with the shear stiffness k_s of the contact (Iwashita & Oda 1998).

The dashpot is a fraction of the critical dashpot and acts while the spring does not slip. Unlike in the paper, the sum
of spring and dashpot is limited to mu_r R N. Otherwise, when a spinning sphere meets a floor, the dashpot would brake
the sphere in the first step by much more than friction could. Rotation about the normal (twist) is free, as in the
paper.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any

import warp as wp

from ...core.inputs.parameters import Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw
from .linear import Contact


@dataclass(frozen=True, kw_only=True)
class RollingResistance(ContactLaw):
    """Linear law with rolling resistance: a moment of up to mu_r R N acts against rolling.

    Here mu_r is the coefficient of rolling friction, R the reduced radius and N the normal spring force.
    """

    called = "rolling"

    contact: Annotated[Contact, "Law that supplies springs, dashpots and friction"] = field(default_factory=Contact)
    rolling_friction: Annotated[
        float, "Rolling friction mu_r: largest moment divided by the normal force and by R", Within(0)
    ] = 0.1
    rolling_damping_ratio: Annotated[
        float, "Damping of the rolling dashpot as a fraction of critical damping", Within(0)
    ] = 0.3

    rolls = True

    @property
    def stress_scale(self) -> float:
        return self.contact.stress_scale

    @property
    def has_history(self) -> bool:
        return self.contact.has_history or self.rolling_friction > 0

    @property
    def has_shear(self) -> bool:
        return self.has_history or self.contact.has_shear

    def frictionless(self) -> Contact:
        return self.contact.frictionless()

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        f = contact_functions(scalar)
        Touch, plane_spring, spring_energy = f.Touch, f.plane_spring, f.spring_energy
        linear = Contact.functions(scalar)
        linear_stiffness, linear_energy, linear_force = linear.stiffness, linear.energy, linear.force
        Parameters = parameters

        @wp.func
        def rolling_stiffness(p: Parameters, touch: Touch):
            """Return the stiffness [N m/rad] and the dashpot [N m s/rad] of the rolling spring.

            The dashpot is a fraction of the critical dashpot for two spheres that roll in place. The inertia of these
            spheres is 7/5 m r^2, with the reduced mass m and the smaller radius r.
            """
            k = linear_stiffness(p.contact, touch)
            kr = k[1] * touch.reduced_radius * touch.reduced_radius
            inertia = scalar(1.4) * touch.mass * touch.smaller_radius * touch.smaller_radius
            return kr, scalar(2.0) * p.rolling_damping_ratio * wp.sqrt(inertia * kr)

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            # The estimate of the stable step knows only normal and shear stiffness. A rotational stiffness k_r limits
            # the step at most as much as a shear stiffness k_r / r^2, so add k_r / r^2 to the shear stiffness.
            k = linear_stiffness(p.contact, touch)
            if p.rolling_friction > scalar(0.0):
                kr, cr = rolling_stiffness(p, touch)
                square = touch.smaller_radius * touch.smaller_radius
                k = t.vec4(k[0], k[1] + kr / square, k[2], k[3] + cr / square)
            return k

        @wp.func
        def energy(p: Parameters, touch: Touch, history: t.vec3):
            return linear_energy(p.contact, touch, history)

        @wp.func
        def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
            return linear_force(p.contact, touch, history, dt)

        @wp.func
        def moment(p: Parameters, touch: Touch, turning: t.vec3, history: t.vec3, dt: scalar):
            zero = scalar(0.0)
            k = linear_stiffness(p.contact, touch)
            kr, cr = rolling_stiffness(p, touch)
            limit = p.rolling_friction * touch.reduced_radius * k[0] * wp.max(-touch.gap, zero)
            rate = turning - wp.dot(turning, touch.normal) * touch.normal
            held, slips, lost = plane_spring(touch, rate, history, kr, limit, dt)
            drag = cr
            if slips:
                drag = zero
            total = held + drag * rate
            size = wp.length(total)
            kept = scalar(1.0)
            if size > limit and not slips:
                kept = limit / size
            total = kept * total
            return total, held, lost + wp.dot(total - held, rate) * dt

        @wp.func
        def moment_energy(p: Parameters, touch: Touch, history: t.vec3):
            kr, cr = rolling_stiffness(p, touch)
            return spring_energy(history, kr)

        return {"force": force, "stiffness": stiffness, "energy": energy, "moment": moment,
                "moment_energy": moment_energy}  # fmt: skip
