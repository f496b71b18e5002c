"""Functions that all contact laws share: the geometry of a contact, and shear springs with Coulomb sliders.

Contact laws are classes in `warpcrete/dem/laws`. A kernel factory receives such a class and calls the functions that
its method `functions(scalar)` returns.

Sign conventions for a contact between bodies a and b: The normal n points from a to b. Forces and moments act on a; b
receives the opposite force. The relative velocity is the velocity of b minus the velocity of a, so a positive normal
component means separation. A bonded contact may have a positive gap; the contact's own springs are then unloaded.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types, vector_functions


@functools.cache
def contact_functions(scalar):
    """Return the struct ``Touch``, which describes a contact, and the functions from which contact laws are built.

    The functions are ``shear_spring``, ``plane_spring``, ``spring_energy``, ``sphere_touch`` and ``wall_touch``.
    """
    t = types(scalar)
    rotated_with_normal = vector_functions(scalar).rotated_with_normal

    @wp.struct
    class Touch:
        normal: t.vec3
        gap: scalar  # distance between the surfaces, negative where they overlap [m]
        velocity: t.vec3  # velocity of body b relative to body a at the contact point [m/s]
        twist: scalar  # mean rotation of the two bodies about the normal in this step [rad]
        tilt: t.vec3  # rotation of the normal itself in this step [rad]; zero at a wall
        smaller_radius: scalar  # smaller radius of the two spheres; at a wall, the sphere's radius [m]
        length: scalar  # distance of the centres at first contact; at a wall, the sphere's radius [m]
        reduced_radius: scalar  # reduced radius R1 R2 / (R1 + R2); at a wall, the sphere's radius [m]
        mass: scalar  # reduced mass of the two bodies; at a wall, the body's own mass [kg]

    @wp.func
    def sphere_touch(
        normal: t.vec3,
        gap: scalar,
        velocity: t.vec3,
        twist: scalar,
        radius_a: scalar,
        radius_b: scalar,
        mass_a: scalar,
        mass_b: scalar,
    ):
        touch = Touch()
        touch.normal = normal
        touch.gap = gap
        touch.velocity = velocity
        touch.twist = twist
        touch.smaller_radius = wp.min(radius_a, radius_b)
        touch.length = radius_a + radius_b
        touch.reduced_radius = radius_a * radius_b / touch.length
        touch.mass = mass_a * mass_b / (mass_a + mass_b)
        return touch

    @wp.func
    def wall_touch(normal: t.vec3, gap: scalar, velocity: t.vec3, twist: scalar, radius: scalar, mass: scalar):
        touch = Touch()
        touch.normal = normal
        touch.gap = gap
        touch.velocity = velocity
        touch.twist = twist
        touch.smaller_radius = radius
        touch.length = radius
        touch.reduced_radius = radius
        touch.mass = mass
        return touch

    @wp.func
    def plane_spring(touch: Touch, rate: t.vec3, history: t.vec3, stiffness: scalar, limit: scalar, dt: scalar):
        """Advance a spring in the contact plane by one step.

        Return the spring's new force, True if the spring slips, and the energy lost by slip [J].

        `rate` is the velocity at which the spring's ends move apart [m/s]. `history` is the spring's old force [N], and
        `limit` is the largest force that the spring can bear [N]. The old force rotates with the contact plane. In the
        first step of a contact, the spring is loaded only during the part of the step after first touch. The energy
        lost is the mean spring force of the step times the slip distance.
        """
        overlap = wp.max(-touch.gap, scalar(0.0))
        loading = dt
        closing = -wp.dot(touch.velocity, touch.normal) * dt
        if closing > overlap:
            loading = dt * overlap / closing
        old = rotated_with_normal(history, touch.normal, touch.twist)
        trial = old + (stiffness * loading) * rate
        square = wp.length_sq(trial)
        slips = square > limit * limit
        kept = scalar(1.0)
        if slips:
            kept = limit / wp.sqrt(square)
        new = kept * trial
        lost = scalar(0.0)
        if stiffness > scalar(0.0):
            lost = scalar(0.5) * wp.dot(old + new, trial - new) / stiffness
        return new, slips, lost

    @wp.func
    def shear_spring(touch: Touch, history: t.vec3, stiffness: scalar, limit: scalar, dt: scalar):
        """Advance the shear spring of a contact by one step.

        Return the spring's new force, True if the spring slips, and the energy lost by slip [J].
        """
        vn = wp.dot(touch.velocity, touch.normal)
        return plane_spring(touch, touch.velocity - vn * touch.normal, history, stiffness, limit, dt)

    @wp.func
    def spring_energy(history: t.vec3, stiffness: scalar):
        """Return the elastic energy of a spring with force or moment `history` [J], or 0 if its stiffness is 0."""
        square = wp.length_sq(history)
        stored = scalar(0.0)
        if square > scalar(0.0):
            stored = scalar(0.5) * square / stiffness
        return stored

    return SimpleNamespace(
        Touch=Touch, sphere_touch=sphere_touch, wall_touch=wall_touch, shear_spring=shear_spring,
        plane_spring=plane_spring, spring_energy=spring_energy,
    )  # fmt: skip
