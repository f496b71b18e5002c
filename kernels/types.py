"""Scalar-dependent Warp types and the layout of the small control arrays shared by all kernels."""

import functools
from pathlib import Path
from types import SimpleNamespace

import warp as wp

SPAN = 1024
"""Bodies that one task of a CPU kernel takes in a loop of its own: Warp loads a kernel's arguments anew for each task,
which costs 10 to 20 ns. On a GPU a task is a thread, with one body."""

# Slots of the integer control array `flags`, one row a scene.
HALTED = wp.constant(0)  # every kernel passes the scene by: a list is stale, its goal is reached, or it failed
STALE = wp.constant(1)  # a neighbour list no longer covers every possible contact
FAILED = wp.constant(2)  # the state left the range in which it means anything (NaN, body lost)
STEPS = wp.constant(3)  # completed steps
GOAL = wp.constant(4)  # step count at which the scene halts
OVERFLOW = wp.constant(5)  # a fixed-size list was too short
LATE = wp.constant(6)  # set within a step; becomes STALE when the step is complete
FLAGS = 8

# Slots of the double-precision control array `clock`, one row a scene.
TIME = wp.constant(0)  # [s]
DT = wp.constant(1)  # step about to be taken [s]
DT_PREVIOUS = wp.constant(2)  # step taken before; 0 at the start, which makes the first kick a half one [s]
SINCE_BUILD = wp.constant(3)  # time since the neighbour lists were built [s]
FORCE_SCALE = wp.constant(4)  # fixed-point units per newton
STABLE = wp.constant(5)  # the stable step as last estimated, without safety factor [s]
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
def scene_struct(scalar):
    """What kernels must know of one scene of a batch: its numbers, and where its rows begin in the flat arrays.

    Indices that an array holds (`body_first`, `sphere_body`, list entries, `slot_wall`) count from the scene's
    first row, so a scene alone and in a batch holds the same numbers. Faces, corners and axis segments, which
    no state holds, count over the whole batch.
    """
    t = types(scalar)

    @wp.struct
    class SceneRow:
        gravity: t.vec3
        local_damping: scalar
        speed_limit: scalar
        skin: scalar  # of the pair lists
        mesh_skin: scalar  # of the mesh candidates
        sphere_share: scalar  # of the mesh skin, for spheres to go in; moving meshes take the rest
        growth_rate: scalar
        growth_end: scalar
        safety: wp.float64  # of the automatic time step
        largest_step: wp.float64
        fixed_step: wp.float64  # 0: automatic
        foreseen_speed: wp.float64  # that a wall will have or forces can give before the next estimate
        wall_stiffness: wp.float64  # least that a driven wall meets [N/m]
        largest_radius: scalar  # at full size
        bodies: wp.int32  # first rows, and how many
        body_count: wp.int32
        spheres: wp.int32
        sphere_count: wp.int32
        pairs: wp.int32
        candidates: wp.int32
        walls: wp.int32
        wall_count: wp.int32
        analytic: wp.int32  # planes and pipes, which come first
        still: wp.int32  # 1: none of those ever moves
        materials: wp.int32  # contact parameters form a square table of them
        laws: wp.int32  # first row of that table
        bonds: wp.int32
        groups: wp.int32

    return SceneRow


@functools.cache
def cpu_flags() -> str:
    """Compiler flags for the kernel that takes most of the time: fused multiply-add, worth a tenth.

    With AVX2 instead of all that the processor has (AVX-512) single precision is faster by another tenth.
    """
    try:
        features = set(Path("/proc/cpuinfo").read_text().split())
    except OSError:
        features = set()
    target = "-target-cpu x86-64-v3" if {"avx2", "fma", "bmi2"} <= features else "-march=native"
    return f"{target} -ffp-contract=fast"


LOWEST_BIT = """
#if defined(__CUDA_ARCH__)
    return __ffs(bits) - 1;
#else
    return __builtin_ctz(bits);
#endif
"""


@wp.func_native(LOWEST_BIT)
def lowest_bit(bits: wp.int32) -> wp.int32:
    """Place of the lowest bit that is set; `bits` is not 0."""


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
        one = scalar(1.0)
        square = wp.length_sq(v)
        if square == scalar(0.0):
            return v
        out = wp.dot(v, n)
        u = v - out * n
        u = u + twist * wp.cross(n, u)
        # |u|^2 = |v|^2 (1 - shrink)
        tilt = out * out / square
        shrink = tilt - (one - tilt) * twist * twist
        if wp.abs(shrink) < scalar(1.0e-5):
            # 1 / sqrt(1 - shrink), to the last digit of double precision.
            return u * (one + shrink * (scalar(0.5) + shrink * (scalar(0.375) + shrink * scalar(0.3125))))
        after = wp.length_sq(u)
        if after > scalar(0.0):
            u = u * wp.sqrt(square / after)
        return u

    return SimpleNamespace(xyz=xyz, pack=pack, safe_normalize=safe_normalize, rotated_with_normal=rotated_with_normal)
