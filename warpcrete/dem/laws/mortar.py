# pyright: reportInvalidTypeForm=false
"""Aggregates in a shell of Bingham mortar: a hard core in a soft shell (idea: Remond & Pizette 2014).

A sphere's radius includes its shell. Where only shells overlap, mortar transmits a weak spring, a yield stress
and viscous drag; once the cores meet, the stiff spring of the aggregates joins. All mortar stresses act on
A = pi r^2 over the thickness h of the two shells: normal k A E_m/h with drag 3 mu A/h (Trouton's ratio), shear
yield tau_0 A and drag mu A/h.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import warp as wp

from ...core.parameters import Above, Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw, OnDevice


@dataclass(frozen=True, kw_only=True)
class BinghamMortar(ContactLaw):
    """Shell over a part of the centres' distance; core k_n = A E*/L; slider mu N_core + A tau_0."""

    called = "mortar"

    effective_modulus: Annotated[float, "E* of the cores [Pa]", Above()] = 1e7
    stiffness_ratio: Annotated[float, "normal over shear stiffness, of cores and shells", Above(),
                               OnDevice("shear_to_normal", lambda r: 1.0 / r)] = 2.0  # fmt: skip
    friction: Annotated[float, "Coulomb coefficient of the cores", Within(0)] = 0.3
    normal_damping_ratio: Annotated[float, "dashpot of the cores over the critical one", Within(0)] = 0.5
    shell_fraction: Annotated[float, "thickness of the two shells over the distance of the centres at touch",
                              Above(), Within(0, 0.5)] = 0.1  # fmt: skip
    shell_modulus: Annotated[float, "stiffness of the mortar against compression [Pa]", Above()] = 1e4
    yield_stress: Annotated[float, "tau_0 of the mortar [Pa]", Within(0)] = 50.0
    plastic_viscosity: Annotated[float, "mu of the mortar [Pa s]", Within(0)] = 5.0

    @property
    def stress_scale(self) -> float:
        return self.effective_modulus

    @property
    def has_history(self) -> bool:
        return self.friction > 0 or self.yield_stress > 0

    @property
    def has_shear(self) -> bool:
        return True  # mortar drags

    def frictionless(self) -> "BinghamMortar":
        return replace(self, friction=0.0, yield_stress=0.0)

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        f = contact_functions(scalar)
        Touch = f.Touch
        shear_spring = f.shear_spring
        Parameters = parameters

        @wp.func
        def area(touch: Touch):
            return scalar(wp.static(float(np.pi))) * touch.smaller_radius * touch.smaller_radius

        @wp.func
        def shell_stiffness(p: Parameters, touch: Touch):
            return p.shell_modulus * area(touch) / (p.shell_fraction * touch.length)

        @wp.func
        def core_overlap(p: Parameters, touch: Touch):
            return wp.max(-touch.gap - p.shell_fraction * touch.length, scalar(0.0))

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            # As if the cores touched: they may do so within the steps until the next estimate.
            core = p.effective_modulus * area(touch) / touch.length
            kn = shell_stiffness(p, touch) + core
            drag = p.plastic_viscosity * area(touch) / (p.shell_fraction * touch.length)
            cn = scalar(2.0) * p.normal_damping_ratio * wp.sqrt(touch.mass * core) + scalar(3.0) * drag
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
                drag = p.plastic_viscosity * area(touch) / (p.shell_fraction * touch.length)
                cn = scalar(3.0) * drag
                limit += p.yield_stress * area(touch)
            if deep > zero:
                cn += scalar(2.0) * p.normal_damping_ratio * wp.sqrt(touch.mass * core)
            shear, slips, lost = shear_spring(touch, history, (soft + core) * p.shear_to_normal, limit, dt)
            vn = wp.dot(touch.velocity, n)
            vs = touch.velocity - vn * n
            spring = soft * overlap + core * deep
            total = shear + drag * vs - (spring - cn * vn) * n
            return total, shear, lost + (cn * vn * vn + drag * wp.length_sq(vs)) * dt

        return {"force": force, "stiffness": stiffness, "energy": energy}
