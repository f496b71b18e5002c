"""Cooperative operations of the threads in a GPU warp; on a CPU a warp is one thread."""

import functools
from types import SimpleNamespace

import warp as wp

WARP = 32
"""Number of threads in a warp."""
LANES_BITS = """
    for (int away = lanes / 2; away > 0; away /= 2) value |= __shfl_xor_sync(0xffffffffu, value, away);
    return value;
"""
LANES_LEAST = """
    for (int away = lanes / 2; away > 0; away /= 2) {
        const auto other = __shfl_xor_sync(0xffffffffu, value, away);
        value = other < value ? other : value;
    }
    return value;
"""


ANY_ACTIVE = """
#if defined(__CUDA_ARCH__)
    return __any_sync(__activemask(), holds);
#else
    return holds;
#endif
"""


@wp.func_native(ANY_ACTIVE)
def any_active(holds: wp.bool) -> wp.bool:
    """Return True if a condition holds for any of the threads that run this call together in a warp.

    The compiler decides which threads run together, so the answer may only affect speed, never results.
    """


@functools.cache
def warp_functions(scalar, width: int) -> SimpleNamespace:
    """Return functions that all threads of a warp of `width` threads must call together.

    `any_in_warp` returns True if a condition holds for any thread. `from_lane` reads a number of another thread, and
    `energy_from_lane` does so in double precision. `sync_warp` is a memory barrier: after it, threads may overwrite
    what other threads have read. `bits_of_lanes` and `least_of_lanes` return the bitwise or and the minimum over groups
    of `lanes` adjacent threads, where `lanes` is a power of two.
    """
    alone = width == 1
    taken = "return value;" if alone else "return __shfl_sync(0xffffffffu, value, lane);"

    @wp.func_native("return holds;" if alone else "return __any_sync(0xffffffffu, holds);")
    def any_in_warp(holds: wp.bool) -> wp.bool: ...

    @wp.func_native(taken)
    def from_lane(value: scalar, lane: wp.int32) -> scalar: ...

    @wp.func_native(taken)
    def energy_from_lane(value: wp.float64, lane: wp.int32) -> wp.float64: ...

    @wp.func_native("" if alone else "__syncwarp();")
    def sync_warp(): ...

    @wp.func_native("return value;" if alone else LANES_BITS)
    def bits_of_lanes(value: wp.int32, lanes: wp.int32) -> wp.int32: ...

    @wp.func_native("return value;" if alone else LANES_LEAST)
    def least_of_lanes(value: scalar, lanes: wp.int32) -> scalar: ...

    return SimpleNamespace(
        any_in_warp=any_in_warp, from_lane=from_lane, energy_from_lane=energy_from_lane, sync_warp=sync_warp,
        bits_of_lanes=bits_of_lanes, least_of_lanes=least_of_lanes,
    )  # fmt: skip


@functools.cache
def group_functions(scalar, lanes: int) -> SimpleNamespace:
    """Return functions that a group of `lanes` adjacent threads must call together, without the rest of the warp.

    `lanes` is a power of two. `sum_of_group` adds up vectors of six numbers over the group, and `bits_of_group` returns
    the bitwise or over the group.
    """
    vec6 = wp.types.vector(6, scalar)
    way = f"""
#if defined(__CUDA_ARCH__)
    const unsigned group = {hex((1 << lanes) - 1)}u << (threadIdx.x & {WARP - lanes});
    for (int away = {lanes // 2}; away > 0; away /= 2) value %s __shfl_xor_sync(group, value, away);
#endif
    return value;
"""

    @wp.func_native(way % "+=")
    def sum_of(value: scalar) -> scalar: ...

    @wp.func_native(way % "|=")
    def bits_of_group(value: wp.int32) -> wp.int32: ...

    @wp.func
    def sum_of_group(part: vec6):
        total = vec6()
        for c in range(6):
            total[c] = sum_of(part[c])
        return total

    return SimpleNamespace(sum_of_group=sum_of_group, bits_of_group=bits_of_group)
