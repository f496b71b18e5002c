"""The end of a step on a GPU where spheres are few: the last block of what moves bodies completes it.

To launch what little that takes by itself took longer. Where spheres are many it is a kernel of its own: for blocks to
tell one another what they have done takes more than that.
"""

import functools

import warp as wp

from .clock import completing_function
from .structs import array_structs

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
def ending_function(scalar, growth: bool, half: bool):
    """`end_step`, which all threads of a kernel must call when they are done, of so many blocks (`parties`; 0: the end
    is a kernel of its own, as it always is of half lists)."""
    Scenes = array_structs(scalar).Scenes
    complete = completing_function(scalar, growth)

    @wp.func
    def end_step(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, arrivals: wp.array(dtype=wp.int32), parties: wp.int32
    ):
        if wp.static(not half):
            if parties > 0:
                if comes_last(arrivals, parties):
                    for s in range(block_thread(), flags.shape[0], block_threads()):
                        complete(flags, scenes, s)

    return end_step
