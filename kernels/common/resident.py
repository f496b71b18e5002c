"""Blocks of a GPU's kernel that stay, and wait for one another. There must be room for all of them at once."""

import warp as wp

GATHER = """
    WP_TILE_SYNC();
#if defined(__CUDA_ARCH__)
    if (parties > 1) {
        if (threadIdx.x == 0) {
            // The highest bit turns when all are here, and those below are 0 again.
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
    """All threads of a kernel's blocks, `parties` of them, wait here for the last. A CPU has one block."""
