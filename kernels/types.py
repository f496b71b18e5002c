"""Scalar-dependent Warp types and the layout of the small control arrays shared by all kernels."""

import functools
from types import SimpleNamespace

import warp as wp

# Slots of the integer control array `flags`.
STALE = wp.constant(0)  # a neighbour list no longer covers every possible contact
FAILED = wp.constant(1)  # the state left the range in which it means anything (NaN, body lost)
STEPS = wp.constant(2)  # completed steps
OVERFLOW = wp.constant(3)  # a fixed-size list was too short
BROKEN_TENSION = wp.constant(4)  # bonds broken by tension since the start
BROKEN_SHEAR = wp.constant(5)  # bonds broken by shear since the start
LATE = wp.constant(6)  # set by a wall within a step; becomes STALE when the step is complete
FLAGS = 8

# Slots of the double-precision control array `clock`.
TIME = wp.constant(0)  # [s]
DT = wp.constant(1)  # step about to be taken [s]
DT_PREVIOUS = wp.constant(2)  # step taken before; 0 at the start, which makes the first kick a half one [s]
SINCE_BUILD = wp.constant(3)  # time since the neighbour lists were built [s]
FORCE_SCALE = wp.constant(4)  # fixed-point units per newton
CLOCK = 8


@functools.cache
def types(scalar):
    """Vector, matrix and quaternion types of one scalar type (``wp.float32`` or ``wp.float64``)."""
    double = scalar is wp.float64
    return SimpleNamespace(
        vec2=wp.vec2d if double else wp.vec2f,
        vec3=wp.vec3d if double else wp.vec3f,
        vec4=wp.vec4d if double else wp.vec4f,
        mat33=wp.mat33d if double else wp.mat33f,
        quat=wp.quatd if double else wp.quatf,
    )


@functools.cache
def vector_functions(scalar):
    """Small helpers of one precision: ``xyz`` of a 4-vector, ``pack`` the reverse."""
    t = types(scalar)

    @wp.func
    def xyz(v: t.vec4):
        return t.vec3(v[0], v[1], v[2])

    @wp.func
    def pack(v: t.vec3, w: scalar):
        return t.vec4(v[0], v[1], v[2], w)

    @wp.func
    def safe_normalize(v: t.vec3, fallback: t.vec3):
        length = wp.length(v)
        if length > scalar(0.0):
            return v / length
        return fallback

    @wp.func
    def rotated_with_normal(v: t.vec3, n: t.vec3, twist: scalar):
        # Follow the contact plane: drop what the plane's tilt turned into a normal part, turn by
        # `twist` about the normal, and keep the length (the plane turns, it does not stretch).
        length = wp.length(v)
        u = v - wp.dot(v, n) * n
        u = u + twist * wp.cross(n, u)
        new_length = wp.length(u)
        if new_length > scalar(0.0):
            u = u * (length / new_length)
        return u

    return SimpleNamespace(xyz=xyz, pack=pack, safe_normalize=safe_normalize, rotated_with_normal=rotated_with_normal)
