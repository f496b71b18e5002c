# pyright: reportInvalidTypeForm=false
"""Aggregates in a shell of Bingham mortar: a hard core in a soft shell (idea: Remond & Pizette 2014).

A sphere's radius includes its shell. Where only shells overlap, the mortar transmits a weak spring force, a yield
stress and a viscous drag. Once the cores meet, the stiff spring of the aggregates acts as well.

The mortar between two cores is a disc: its area is A = pi r^2, where r is the radius of the smaller sphere, and its
thickness is the thickness h of the two shells. Mortar of modulus E_m, yield stress tau_0 and plastic viscosity mu has a
normal spring of stiffness A E_m/h and a normal drag 3 mu A/h (Trouton's ratio). In shear it yields at tau_0 A and has
the drag mu A/h.

Mortar that resists shear also resists pull and bending. A disc of radius r between two separating spheres yields at the
stress sqrt(3) tau_0 (von Mises), and a bent disc yields at the moment 4/3 r^3 sqrt(3) tau_0. The elastic and viscous
moments of a bent disc are r^2/4 times the normal stiffness and drag. Without pull and moment no heap would stand,
because spheres would roll on each other and separate.
"""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import warp as wp

from ...core.inputs.parameters import Above, Within
from ...kernels.common.types import types
from ...kernels.dem.contact_law import contact_functions
from .base import ContactLaw, OnDevice


@dataclass(frozen=True, kw_only=True)
class BinghamMortar(ContactLaw):
    """Hard cores in soft shells of Bingham mortar; core friction and yield stress limit the shear force.

    The cores' spring has the stiffness A E*/L. A contact slips when the force of the shear spring reaches mu N_core + A
    tau_0. Here A is the contact's area, E* the effective modulus, L the distance of the centres at first touch, mu the
    friction coefficient, N_core the force of the cores' spring, and tau_0 the yield stress of the mortar.
    """

    called = "mortar"

    effective_modulus: Annotated[float, "Effective modulus E* of the cores [Pa]", Above()] = 1e7
    stiffness_ratio: Annotated[float, "Ratio of normal to shear stiffness of cores and shells", Above(),
                               OnDevice("shear_to_normal", lambda r: 1.0 / r)] = 2.0  # fmt: skip
    friction: Annotated[float, "Coulomb friction coefficient of the cores", Within(0)] = 0.3
    normal_damping_ratio: Annotated[
        float, "Damping of the cores' dashpot as a fraction of critical damping", Within(0)
    ] = 0.5
    shell_fraction: Annotated[float, "Thickness of the two shells divided by the distance of the centres at touch",
                              Above(), Within(0, 0.5)] = 0.1  # fmt: skip
    shell_modulus: Annotated[float, "Stiffness of the mortar against compression [Pa]", Above()] = 1e4
    yield_stress: Annotated[float, "Yield stress tau_0 of the mortar [Pa]", Within(0)] = 50.0
    plastic_viscosity: Annotated[float, "Plastic viscosity mu of the mortar [Pa s]", Within(0)] = 5.0
    tension: Annotated[float, "Tensile strength of a shell divided by tau_0 A; 0: no tension", Within(0)] = math.sqrt(3)
    bending: Annotated[float, "Largest moment of a shell divided by tau_0 A r; 0: spheres roll freely", Within(0)] = (
        4 / math.sqrt(3) / math.pi
    )

    rolls = True

    @property
    def stress_scale(self) -> float:
        return self.effective_modulus

    @property
    def has_history(self) -> bool:
        return self.friction > 0 or self.yield_stress > 0

    @property
    def has_shear(self) -> bool:
        return True  # Even without friction, the viscous drag of the mortar transmits a shear force.

    def frictionless(self) -> "BinghamMortar":
        return replace(self, friction=0.0, yield_stress=0.0, bending=0.0)

    @classmethod
    def device_functions(cls, scalar: Any, parameters: Any) -> dict[str, Any]:
        t = types(scalar)
        f = contact_functions(scalar)
        Touch, shear_spring = f.Touch, f.shear_spring
        shells = shell_functions(scalar, parameters)
        area, shell_stiffness, shell_drag = shells.area, shells.shell_stiffness, shells.shell_drag
        with_bending, core_overlap = shells.with_bending, shells.core_overlap
        Parameters = parameters

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            # Include the stiffness of the hard cores, which may touch before the stable step is estimated again.
            core = p.effective_modulus * area(touch) / touch.length
            kn = shell_stiffness(p, touch) + core
            drag = shell_drag(p, touch)
            cn = scalar(2.0) * p.normal_damping_ratio * wp.sqrt(touch.mass * core) + scalar(3.0) * drag
            ks, cs = with_bending(p, touch, kn * p.shear_to_normal, drag)
            return t.vec4(kn, ks, cn, cs)

        @wp.func
        def energy(p: Parameters, touch: Touch, history: t.vec3):
            overlap = wp.max(-touch.gap, scalar(0.0))
            deep = core_overlap(p, touch)
            core = p.effective_modulus * area(touch) / touch.length
            soft = shell_stiffness(p, touch)
            total = soft * overlap * overlap + core * deep * deep
            pulled = p.tension * p.yield_stress * area(touch) * overlap
            return scalar(0.5) * (total + wp.length_sq(history) / ((soft + core) * p.shear_to_normal)) - pulled

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
            pull = zero
            limit = p.friction * core * deep
            if overlap > zero:
                drag = shell_drag(p, touch)
                cn = scalar(3.0) * drag
                limit += p.yield_stress * area(touch)
                pull = p.tension * p.yield_stress * area(touch)
            if deep > zero:
                cn += scalar(2.0) * p.normal_damping_ratio * wp.sqrt(touch.mass * core)
            shear, slips, lost = shear_spring(touch, history, (soft + core) * p.shear_to_normal, limit, dt)
            vn = wp.dot(touch.velocity, n)
            vs = touch.velocity - vn * n
            spring = soft * overlap + core * deep - pull
            total = shear + drag * vs - (spring - cn * vn) * n
            return total, shear, lost + (cn * vn * vn + drag * wp.length_sq(vs)) * dt

        return {"force": force, "stiffness": stiffness, "energy": energy, "moment": shells.moment,
                "moment_energy": shells.moment_energy}  # fmt: skip


def shell_functions(scalar: Any, parameters: Any) -> SimpleNamespace:
    """Return device functions of contacts between mortar shells, for laws with parameters of :class:`BinghamMortar`.

    The functions are `area`, `shell_stiffness`, `shell_drag`, `with_bending`, `core_overlap`, `moment` and
    `moment_energy`.
    """
    t = types(scalar)
    f = contact_functions(scalar)
    Touch, plane_spring, spring_energy = f.Touch, f.plane_spring, f.spring_energy
    Parameters = parameters

    @wp.func
    def area(touch: Touch):
        return scalar(wp.static(float(np.pi))) * touch.smaller_radius * touch.smaller_radius

    @wp.func
    def shell_stiffness(p: Parameters, touch: Touch):
        return p.shell_modulus * area(touch) / (p.shell_fraction * touch.length)

    @wp.func
    def shell_drag(p: Parameters, touch: Touch):
        return p.plastic_viscosity * area(touch) / (p.shell_fraction * touch.length)

    @wp.func
    def bending(p: Parameters, touch: Touch):
        """Return the bending stiffness [N m/rad] and viscous damping [N m s/rad] of the mortar disc of a contact."""
        square = scalar(0.25) * touch.smaller_radius * touch.smaller_radius
        return square * shell_stiffness(p, touch), scalar(3.0) * square * shell_drag(p, touch)

    @wp.func
    def with_bending(p: Parameters, touch: Touch, shear: scalar, dashpot: scalar):
        """Add contributions of bending to the shear stiffness [N/m] and damping [N s/m] of a contact; return both sums.

        The estimate of the stable step knows only normal and shear stiffness. A rotational stiffness k_r limits the
        step at most as much as a shear stiffness k_r / r^2, so k_r / r^2 is added to the shear stiffness.
        """
        ks, cs = shear, dashpot
        if p.bending > scalar(0.0):
            kr, cr = bending(p, touch)
            square = touch.smaller_radius * touch.smaller_radius
            ks += kr / square
            cs += cr / square
        return ks, cs

    @wp.func
    def core_overlap(p: Parameters, touch: Touch):
        return wp.max(-touch.gap - p.shell_fraction * touch.length, scalar(0.0))

    @wp.func
    def moment(p: Parameters, touch: Touch, turning: t.vec3, history: t.vec3, dt: scalar):
        bears = scalar(0.0)
        if p.bending > scalar(0.0) and touch.gap < scalar(0.0):
            bears = scalar(1.0)
        kr, cr = bending(p, touch)
        limit = p.bending * p.yield_stress * area(touch) * touch.smaller_radius
        rate = turning - wp.dot(turning, touch.normal) * touch.normal
        held, slips, lost = plane_spring(touch, rate, history, kr, limit, dt)
        lost += cr * wp.length_sq(rate) * dt
        return bears * (held + cr * rate), bears * held, bears * lost

    @wp.func
    def moment_energy(p: Parameters, touch: Touch, history: t.vec3):
        kr, cr = bending(p, touch)
        return spring_energy(history, kr)

    return SimpleNamespace(
        area=area, shell_stiffness=shell_stiffness, shell_drag=shell_drag, with_bending=with_bending,
        core_overlap=core_overlap, moment=moment, moment_energy=moment_energy,
    )  # fmt: skip
