"""Vector types of each precision, compiler flags, and small device functions that all kernels share."""

import functools
from pathlib import Path
from types import SimpleNamespace

import warp as wp

SPAN = 1024
"""Number of bodies that one task of a CPU kernel processes in a loop.

A few long tasks are faster than many short tasks: for each task Warp takes 10 to 20 ns to load the arguments. On a GPU
a task is a thread, which processes one body.
"""


vec8f, vec8d = wp.types.vector(8, wp.float32), wp.types.vector(8, wp.float64)


def module_of(name: str, *kind) -> str:
    """Return the name of a Warp module that holds all kernels made by one call of a kernel factory.

    `kind` contains the arguments of the factory. Every module takes at least a tenth of a second to compile, however
    small it is. Small kernels that are used together therefore share a module.
    """
    return "_".join(["warpcrete", name, *(getattr(each, "__name__", str(each)) for each in kind)])


@functools.cache
def types(scalar):
    """Return the vector, matrix and quaternion types of one scalar type (``wp.float32`` or ``wp.float64``)."""
    double = scalar is wp.float64
    return SimpleNamespace(
        vec2=wp.vec2d if double else wp.vec2f,
        vec3=wp.vec3d if double else wp.vec3f,
        vec4=wp.vec4d if double else wp.vec4f,
        vec8=vec8d if double else vec8f,
        mat33=wp.mat33d if double else wp.mat33f,
        quat=wp.quatd if double else wp.quatf,
    )


@functools.cache
def cpu_flags() -> str:
    """Return the compiler flags of the CPU kernels that take most of the time.

    Fused multiply-add makes these kernels 10 % faster. In single precision, AVX2 is 10 % faster than AVX-512. The LLVM
    options must be the same as the options of all other kernels: a process has only one set of them, and kernels with
    different options could not be compiled in parallel.
    """
    try:
        features = set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split())
    except OSError:
        features = set()
    target = "-target-cpu x86-64-v3" if {"avx2", "fma", "bmi2"} <= features else "-march=native"
    llvm = [flag for flag in (wp.config.cpu_compiler_flags or "").split() if flag.startswith("-mllvm=")]
    return " ".join([target, "-ffp-contract=fast", *llvm])


LOWEST_BIT = """
#if defined(__CUDA_ARCH__)
    return __ffs(bits) - 1;
#else
    return __builtin_ctz(bits);
#endif
"""


@wp.func_native(LOWEST_BIT)
def lowest_bit(bits: wp.int32) -> wp.int32:
    """Return the index of the lowest set bit; `bits` must not be 0."""


LENGTHENED = """
    using T = decltype(square);
    // Taylor series of 1 / sqrt(1 - shrink); where it is used, it is exact to the last digit of double precision.
    const T nearly = T(1) + shrink * (T(0.5) + shrink * (T(0.375) + shrink * T(0.3125)));
    const bool near = wp::abs(shrink) < T(1.0e-5);
#if defined(__CUDA_ARCH__)
    // On a GPU, branches that return save a sixth of the registers of bonded contacts.
    if (near) return u * nearly;
    const T after = wp::dot(u, u);
    if (after > T(0)) return u * wp::sqrt(square / after);
    return u;
#else
    // On a CPU, the compiler turns loops over contacts into vector instructions only if there are no branches.
    const T after = wp::dot(u, u);
    const T exactly = after > T(0) ? wp::sqrt(square / after) : T(1);
    return u * (near ? nearly : exactly);
#endif
"""


@functools.cache
def vector_functions(scalar):
    """Build small functions of vectors, in one precision.

    ``xyz`` returns the first three components of a 4-vector, and ``pack`` appends a fourth component to a 3-vector.
    ``safe_normalize`` returns a unit vector, or a fallback for the zero vector. ``rotated_with_normal`` rotates a shear
    vector together with its contact plane.
    """
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

    @wp.func_native(LENGTHENED)
    def lengthened(u: t.vec3, square: scalar, shrink: scalar) -> t.vec3: ...  # Scale `u` to the length sqrt(square).

    @wp.func
    def rotated_with_normal(v: t.vec3, n: t.vec3, twist: scalar):
        # Rotate the shear vector `v` with the contact plane. First remove the component normal to the plane, which
        # appears because the plane has tilted. Then rotate the vector by `twist` about the normal. Finally restore its
        # length, which a rotation must not change.
        one = scalar(1.0)
        square = wp.length_sq(v)
        out = wp.dot(v, n)
        u = v - out * n
        u = u + twist * wp.cross(n, u)
        # The projection and the rotation have changed the squared length |v|^2 to |u|^2 = |v|^2 (1 - tilt) (1 +
        # twist^2), where `tilt` is the fraction of |v|^2 that belonged to the removed normal component. The function
        # `lengthened` restores the length. Its last argument is the number `shrink` in |u|^2 = |v|^2 (1 - shrink).
        tilt = scalar(0.0)
        if square > scalar(0.0):
            tilt = out * out / square
        return lengthened(u, square, tilt - (one - tilt) * twist * twist)

    return SimpleNamespace(xyz=xyz, pack=pack, safe_normalize=safe_normalize, rotated_with_normal=rotated_with_normal)
