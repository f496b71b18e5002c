"""The end of a step on a GPU where spheres are few: one kernel moves bodies and walls, and its last block completes it.

To launch what little walls and clocks take by themselves, beside or after, took longer than all that they do.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .clock import completing_function
from .structs import array_structs
from .wall_motion import advance_function

ARRIVE = """
#if defined(__CUDA_ARCH__)
    __shared__ bool last;
    __syncthreads();
    if (threadIdx.x == 0) {
        __threadfence();
        last = atomicInc((unsigned*)arrivals.data, parties - 1) == parties - 1;  // counts from 0 again then
        __threadfence();
    }
    __syncthreads();
    return last;
#else
    arrivals.data[0] = (arrivals.data[0] + 1) % parties;
    return arrivals.data[0] == 0;
#endif
"""
BLOCK_THREAD = """
#if defined(__CUDA_ARCH__)
    return threadIdx.x;
#else
    return 0;
#endif
"""
BLOCK_THREADS = """
#if defined(__CUDA_ARCH__)
    return blockDim.x;
#else
    return 1;
#endif
"""


@wp.func_native(ARRIVE)
def comes_last(arrivals: wp.array(dtype=wp.int32), parties: wp.int32) -> wp.bool:
    """Whether this block is the last of so many to come here, and what all others wrote can be read; all threads of a
    block must call. A CPU's block is one task."""


@wp.func_native(BLOCK_THREAD)
def block_thread() -> wp.int32: ...


@wp.func_native(BLOCK_THREADS)
def block_threads() -> wp.int32: ...


@functools.cache
def ending_functions(scalar, strokes: bool, growth: bool, ends: bool):
    """`move_walls` by as many threads, and `end_step`, which all threads must call when they are done, of so many
    blocks (`parties`). Without `ends` neither does anything: what they do has kernels of its own."""
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    advance, complete = advance_function(scalar, strokes), completing_function(scalar, growth)

    @wp.func
    def move_walls(thread: wp.int32, flags: wp.array2d(dtype=wp.int32), scenes: Scenes, walls: Walls):
        if wp.static(ends):
            if thread < walls.scene.shape[0]:
                advance(scenes, flags, walls, thread)

    @wp.func
    def end_step(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, arrivals: wp.array(dtype=wp.int32), parties: wp.int32
    ):
        if wp.static(ends):
            if comes_last(arrivals, parties):
                for s in range(block_thread(), flags.shape[0], block_threads()):
                    complete(flags, scenes, s)

    return SimpleNamespace(move_walls=move_walls, end_step=end_step)
