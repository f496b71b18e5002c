# pyright: reportInvalidTypeForm=false
"""Linear contact law (Zhan et al. 2019, Eqs. 5-8; conventions of PFC 5.0)."""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import warp as wp

from ...core.inputs.parameters import Above, OneOf, Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw, OnDevice

# The index of a dashpot mode in this tuple consists of two bits. If bit 0 is set (modes 1 and 3), the total normal
# force may not be tensile. If bit 1 is set (modes 2 and 3), the shear dashpot does not act while the contact slips
# (Zhan et al. 2019, Eq. 8).
DASHPOTS = ("full", "no-tension", "slip-cut", "both")


@dataclass(frozen=True, kw_only=True)
class Contact(ContactLaw):
    """Linear contact between two materials: springs, Coulomb slider and dashpots; the default law."""

    effective_modulus: Annotated[
        float,
        "Effective modulus E* [Pa]; k_n = A E*/L with A = pi r^2, r the smaller radius, L the distance of the "
        "centres at touch",
        Above(),
    ] = 1e5
    stiffness_ratio: Annotated[
        float, "Ratio of normal to shear stiffness, k_n / k_s", Above(), OnDevice("shear_to_normal", lambda r: 1.0 / r)
    ] = 2.0
    friction: Annotated[float, "Coulomb friction coefficient", Within(0)] = 0.05
    normal_damping_ratio: Annotated[
        float, "Damping of the normal dashpot as a fraction of critical damping; see damping_ratio", Within(0)
    ] = 0.5
    shear_damping_ratio: Annotated[
        float, "Damping of the shear dashpot as a fraction of critical damping", Within(0)
    ] = 0.0
    dashpot: Annotated[str, "Mode of the dashpots: full, no-tension (the total normal force never pulls), slip-cut "
                            "(no shear dashpot in slip), both",
                       OneOf(DASHPOTS)] = "full"  # fmt: skip

    @property
    def stress_scale(self) -> float:
        return self.effective_modulus

    @property
    def has_history(self) -> bool:
        return self.friction > 0

    @property
    def has_shear(self) -> bool:
        return self.friction > 0 or self.shear_damping_ratio > 0

    def frictionless(self) -> "Contact":
        return replace(self, friction=0.0, normal_damping_ratio=max(self.normal_damping_ratio, 0.5))

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        f = contact_functions(scalar)
        Touch = f.Touch
        shear_spring = f.shear_spring
        Parameters = parameters

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
                kn,
                ks,
                two * p.normal_damping_ratio * wp.sqrt(touch.mass * kn),
                two * p.shear_damping_ratio * wp.sqrt(touch.mass * ks),
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
            dashpot = scalar(-2.0) * p.normal_damping_ratio * wp.sqrt(touch.mass * kn) * vn
            if (p.dashpot & 1) != 0:
                dashpot = wp.max(dashpot, -spring)
            lost -= dashpot * vn * dt
            vs = touch.velocity - vn * n
            cs = zero
            if p.shear_damping_ratio > zero:
                cs = scalar(2.0) * p.shear_damping_ratio * wp.sqrt(touch.mass * ks)
            if slips and (p.dashpot & 2) != 0:
                cs = zero
            lost += cs * wp.length_sq(vs) * dt
            return new_history - (spring + dashpot) * n + cs * vs, new_history, lost

        return {"force": force, "stiffness": stiffness, "energy": energy}
