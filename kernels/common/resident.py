"""Barrier for all blocks of one GPU kernel.

The GPU must have room to run all these blocks at the same time, because they wait for each other.
"""

import warp as wp

GATHER = """
    WP_TILE_SYNC();
#if defined(__CUDA_ARCH__)
    if (parties > 1) {
        if (threadIdx.x == 0) {
            // When all blocks have arrived, the highest bit flips and all lower bits are 0 again.
            unsigned* here = reinterpret_cast<unsigned*>(gate.data);
            __threadfence();
            const unsigned before = atomicAdd(here, blockIdx.x == 0 ? 0x80000000u - (parties - 1) : 1u);
            while (((before ^ *reinterpret_cast<volatile unsigned*>(here)) & 0x80000000u) == 0) {}
            __threadfence();
        }
        WP_TILE_SYNC();
    }
#endif
"""


@wp.func_native(GATHER)
def gather(gate: wp.array(dtype=wp.int32), parties: wp.int32):
    """Wait until all `parties` blocks of the kernel have called this function; on a CPU there is only one block."""
