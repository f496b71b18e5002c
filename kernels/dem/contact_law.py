"""What contact laws share: the geometry of a touch, and a shear spring with slider.

A law is a class of `warpcrete/dem/laws`, which kernels are given: its `functions(scalar)` are what they call.

Sign conventions, for a contact between bodies a and b: the normal n points from a to b, forces and moments
are those on a (b gets the opposite force), relative velocity is that of b seen from a, so a positive normal
component separates. A bonded contact may have a positive gap: springs are then slack.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types, vector_functions


@functools.cache
def contact_functions(scalar):
    """The struct ``Touch`` and functions for laws: ``shear_spring``, ``plane_spring``, ``spring_energy``,
    ``sphere_touch``, ``wall_touch``."""
    t = types(scalar)
    rotated_with_normal = vector_functions(scalar).rotated_with_normal

    @wp.struct
    class Touch:
        normal: t.vec3
        gap: scalar  # negative where the surfaces overlap [m]
        velocity: t.vec3  # at the contact point [m/s]
        twist: scalar  # mean turn of the bodies about the normal in the step [rad]
        tilt: t.vec3  # turn of the normal itself in the step [rad]; nothing against a wall
        smaller_radius: scalar  # of the two spheres; the sphere's own against a wall [m]
        length: scalar  # distance of the centres at first touch; the radius against a wall [m]
        reduced_radius: scalar  # R1 R2 / (R1 + R2); the radius against a wall [m]
        mass: scalar  # reduced mass of the two bodies; the body's own against a wall [kg]

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
        """Spring that grows with a `rate` in the contact plane, cut at `limit`; also whether it slips and the work lost
        in slip [J].

        The history turns with the plane. Only the part of the step after first touch loads the spring. The loss
        is the trapezoidal work of the step less what the spring stores.
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
        """The same of the spring that sliding loads."""
        vn = wp.dot(touch.velocity, touch.normal)
        return plane_spring(touch, touch.velocity - vn * touch.normal, history, stiffness, limit, dt)

    @wp.func
    def spring_energy(history: t.vec3, stiffness: scalar):
        """What a spring stores at a force or moment `history` [J]; one without stiffness holds none."""
        square = wp.length_sq(history)
        stored = scalar(0.0)
        if square > scalar(0.0):
            stored = scalar(0.5) * square / stiffness
        return stored

    return SimpleNamespace(
        Touch=Touch, sphere_touch=sphere_touch, wall_touch=wall_touch, shear_spring=shear_spring,
        plane_spring=plane_spring, spring_energy=spring_energy,
    )  # fmt: skip
