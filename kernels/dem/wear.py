"""What contacts do to walls: work of sliding, losses of impacts, and load times way, by sphere and wall."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types
from .contact_law import contact_functions


@functools.cache
def wear_functions(scalar, law) -> SimpleNamespace:
    """`worn_by`: what a contact did to a wall in a step; `in_frame`: a point as the wall sees it."""
    t = types(scalar)
    functions = law.functions(scalar)
    Parameters, contact_force = functions.Parameters, functions.force
    Touch, wall_touch = contact_functions(scalar).Touch, contact_functions(scalar).wall_touch

    @wp.func
    def worn_by(p: Parameters, touch: Touch, f: t.vec3, lost: scalar, dt: scalar):
        """Work of sliding and loss of the impact [J], load times way slid [N m], of a force `f` that lost so much.

        Whatever the law: the same touch without any sliding loses what the impact does, and the rest is the slide's.
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

    return SimpleNamespace(worn_by=worn_by, in_frame=in_frame)
