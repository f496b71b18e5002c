"""Wear of walls by each sphere, as three quantities from which wear laws can be computed.

They are the work of sliding, the energy loss of impacts, and the integral of the load over the sliding distance.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types
from .contact_law import contact_functions


@functools.cache
def wear_functions(scalar, law) -> SimpleNamespace:
    """Return `contact_wear` (wear by one contact in one step) and `in_frame` (a point in the wall's frame)."""
    t = types(scalar)
    functions = law.functions(scalar)
    Parameters, contact_force = functions.Parameters, functions.force
    Touch, wall_touch = contact_functions(scalar).Touch, contact_functions(scalar).wall_touch

    @wp.func
    def contact_wear(p: Parameters, touch: Touch, f: t.vec3, lost: scalar, dt: scalar):
        """Return the sliding work [J], impact loss [J], and load times sliding distance [N m] of a contact in a step.

        `f` is the contact force [N] and `lost` the contact's total energy loss [J]. To split this loss, the contact law
        is evaluated once more without sliding. The loss without sliding is due to the impact, and the rest of `lost` is
        due to sliding. This works for any contact law.
        """
        n = touch.normal
        along = wp.dot(touch.velocity, n)
        head_on = wall_touch(n, touch.gap, along * n, scalar(0.0), touch.smaller_radius, touch.mass)
        unused, unused_history, bumped = contact_force(p, head_on, t.vec3(), dt)
        way = wp.length(touch.velocity - along * n) * dt
        load = wp.max(-wp.dot(f, n), scalar(0.0))
        return wp.vec3d(wp.float64(lost - bumped), wp.float64(bumped), wp.float64(load * way))

    @wp.func
    def in_frame(point: t.vec3, position: t.vec3, orientation: t.quat):
        return wp.quat_rotate_inv(orientation, point - position)

    return SimpleNamespace(contact_wear=contact_wear, in_frame=in_frame)
