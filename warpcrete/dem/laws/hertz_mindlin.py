# pyright: reportInvalidTypeForm=false
"""Hertz-Mindlin contact: Hertz' normal force, Mindlin's tangent stiffness without micro-slip, Coulomb slider.

The dashpots follow Tsuji et al. 1992 in the form of Antypov & Elliott 2011, so that the coefficient of restitution does
not depend on speed. The shear force is incremental. The parameter `unloading` selects one of two rules for the shear
force while the normal load falls. With `rescale`, the shear force falls in proportion to the tangent stiffness. This
rule never creates energy (Thornton et al. 2013). With `hold`, the shear force stays constant, as in the simplest codes.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import warp as wp

from ...core.errors import between, flag, positive
from ...core.inputs.parameters import Above, OneOf, Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw, OnDevice, damping_ratio

UNLOADINGS = ("rescale", "hold")
RESCALE = wp.constant(0)


@dataclass(frozen=True, kw_only=True)
class HertzMindlin(ContactLaw):
    """Elastic spheres in Hertz-Mindlin contact, with Coulomb friction and a constant coefficient of restitution.

    At the overlap d the normal force is 4/3 E* sqrt(R* d) d and the shear stiffness is 8 G* sqrt(R* d). Here R* is the
    reduced radius, E* the effective modulus and G* the effective shear modulus.
    """

    effective_modulus: Annotated[float, "Effective modulus E* [Pa]; 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2", Above()]
    effective_shear_modulus: Annotated[
        float, "Effective shear modulus G* [Pa]; 1/G* = (2 - nu1)/G1 + (2 - nu2)/G2", Above()
    ]
    friction: Annotated[float, "Coulomb friction coefficient", Within(0)] = 0.3
    restitution: Annotated[float, "Coefficient of restitution of a normal impact, 0 to 1, at any speed", Within(0, 1),
                           OnDevice("damping", damping_ratio)] = 0.9  # fmt: skip
    unloading: Annotated[str, "Shear force while the normal load falls: rescale (in proportion to the tangent "
                              "stiffness) or hold (can create energy)", OneOf(UNLOADINGS)] = "rescale"  # fmt: skip

    @classmethod
    def of(
        cls, young_modulus: float, poisson_ratio: float, *, rigid_partner: bool = False, **others: Any
    ) -> "HertzMindlin":
        """Return the law for two bodies of one material or, with `rigid_partner`, for one such body and a rigid body.

        The material has the given Young's modulus [Pa] and Poisson ratio. `others` are further fields of the law.
        """
        positive("young_modulus", young_modulus, "Pa")
        flag("rigid_partner", rigid_partner)
        between("poisson_ratio", poisson_ratio, 0, 0.5)
        bodies = 1 if rigid_partner else 2
        shear = young_modulus / (2 * (1 + poisson_ratio))
        return cls(
            effective_modulus=young_modulus / (bodies * (1 - poisson_ratio**2)),
            effective_shear_modulus=shear / (bodies * (2 - poisson_ratio)),
            **others,
        )

    @property
    def stress_scale(self) -> float:
        return self.effective_modulus

    @property
    def has_history(self) -> bool:
        return self.friction > 0

    @property
    def has_shear(self) -> bool:
        return True  # Even without friction, the shear dashpot transmits a shear force.

    def frictionless(self) -> "HertzMindlin":
        return replace(self, friction=0.0, restitution=min(self.restitution, 0.2))

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        f = contact_functions(scalar)
        Touch = f.Touch
        shear_spring = f.shear_spring
        viscous = float(2.0 * np.sqrt(5.0 / 6.0))
        Parameters = parameters

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            # Use the stiffness at the largest overlap that an impact with the current closing speed will reach.
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
            kept = scalar(1.0)
            released = zero
            if before > zero and overlap > zero:
                # The energy stored in the shear spring changes with the spring's stiffness, which depends on the
                # overlap. While the overlap grows, the force stays constant and the spring becomes stiffer. While the
                # overlap shrinks, the force decreases in proportion to the stiffness if `unloading` is RESCALE;
                # otherwise it stays constant.
                ratio = wp.sqrt(overlap / before)
                stored = scalar(0.5) * wp.length_sq(history) / ks
                released = stored * (ratio - scalar(1.0))
                if ratio < scalar(1.0) and p.unloading == RESCALE:
                    kept = ratio
                    released = stored * ratio * (scalar(1.0) - ratio)
            new_history, slips, lost = shear_spring(touch, kept * history, ks, p.friction * spring, dt)
            c = scalar(wp.static(viscous)) * p.damping
            cn = c * wp.sqrt(kn * touch.mass)
            cs = zero
            if not slips:
                cs = c * wp.sqrt(ks * touch.mass)
            lost += released + (cn * vn * vn + cs * wp.length_sq(vs)) * dt
            return new_history - (spring - cn * vn) * n + cs * vs, new_history, lost

        return {"force": force, "stiffness": stiffness, "energy": energy}
