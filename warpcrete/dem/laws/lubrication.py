# pyright: reportInvalidTypeForm=false
"""Linear contact with a lubrication layer in shear: yield stress and viscous drag (Xu, Li & Jiang 2021, Eq. 8).

On a wall the layer represents the fine mortar that collects there in pumped concrete. Its shear stress is tau = tau_L0
+ eta_L V, with the yield stress tau_L0, the viscosity per thickness eta_L, and the slip velocity V. The stress acts on
the area A = pi r^2 of every contact, where r is the radius of the smaller sphere. The force A tau_L0 is added to the
friction limit of the contact's shear spring. A layer at rest therefore carries any stress up to tau_L0.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import warp as wp

from ...core.inputs.parameters import Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw
from .linear import Contact


@dataclass(frozen=True, kw_only=True)
class LubricationLayer(ContactLaw):
    """Linear law in the normal direction, and a lubrication layer in shear.

    In shear a slider has the limit mu N + A tau_L0, and a drag A eta_L V acts in addition. Here mu is the friction
    coefficient, N the normal spring force, A the contact's area, tau_L0 the yield stress of the layer, eta_L the
    viscosity of the layer divided by its thickness, and V the slip velocity.
    """

    called = "layer"

    contact: Annotated[Contact, "Law that supplies spring, dashpot and friction"] = field(default_factory=Contact)
    yield_stress: Annotated[
        float, "Yield stress tau_L0 of the layer [Pa], on the area pi r^2 of every contact", Within(0)
    ] = 0.0
    viscosity: Annotated[float, "Viscosity eta_L of the layer divided by its thickness [Pa s/m]", Within(0)] = 0.0

    @property
    def stress_scale(self) -> float:
        return self.contact.stress_scale

    @property
    def has_history(self) -> bool:
        return self.contact.has_history or self.yield_stress > 0

    @property
    def has_shear(self) -> bool:
        return self.has_history or self.contact.has_shear or self.viscosity > 0

    def frictionless(self) -> "LubricationLayer":
        return LubricationLayer(contact=self.contact.frictionless())

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        f = contact_functions(scalar)
        Touch = f.Touch
        shear_spring = f.shear_spring
        linear = Contact.functions(scalar)
        linear_stiffness = linear.stiffness
        linear_energy = linear.energy
        linear_force = linear.force
        Parameters = parameters

        @wp.func
        def area(touch: Touch):
            return scalar(wp.static(float(np.pi))) * touch.smaller_radius * touch.smaller_radius

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            k = linear_stiffness(p.contact, touch)
            return t.vec4(k[0], k[1], k[2], k[3] + p.viscosity * area(touch))

        @wp.func
        def energy(p: Parameters, touch: Touch, history: t.vec3):
            return linear_energy(p.contact, touch, history)

        @wp.func
        def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
            zero = scalar(0.0)
            n = touch.normal
            # Take only the normal force from the linear law. The shear force is computed below, because its limit
            # includes the yield stress of the lubrication layer.
            alone, unused, unused_loss = linear_force(p.contact, touch, t.vec3(), zero)
            normal_part = wp.dot(alone, n) * n
            k = linear_stiffness(p.contact, touch)
            vn = wp.dot(touch.velocity, n)
            vs = touch.velocity - vn * n
            spring = k[0] * wp.max(-touch.gap, zero)
            limit = p.contact.friction * spring
            drag = k[3]
            if touch.gap < zero:
                limit += p.yield_stress * area(touch)
            shear, slips, slid = shear_spring(touch, history, k[1], limit, dt)
            if slips and (p.contact.dashpot & 2) != 0:
                drag = zero
            if touch.gap < zero:
                drag += p.viscosity * area(touch)
            # Subtract the spring's normal force from the total normal force; the difference is the dashpot's normal
            # force.
            resisting = wp.dot(alone, n) + spring
            return (normal_part + shear + drag * vs, shear, slid + (resisting * vn + drag * wp.length_sq(vs)) * dt)

        return {"force": force, "stiffness": stiffness, "energy": energy}
