"""A barrier for threads that replay their own chunks of a step on the CPU.

Warp runs a CPU kernel on the thread that launches it, and lets Python's other threads run meanwhile. Each thread
replays a graph of its own; at the barriers, which are kernels too, all wait for the last.
"""

import warp as wp

MEET = """
    int* state = &gate.data[0];
    int round = __atomic_load_n(state + 1, __ATOMIC_ACQUIRE);
    if (__atomic_add_fetch(state, 1, __ATOMIC_ACQ_REL) == parties) {
        __atomic_store_n(state, 0, __ATOMIC_RELAXED);
        __atomic_store_n(state + 1, round + 1, __ATOMIC_RELEASE);
    } else {
        while (__atomic_load_n(state + 1, __ATOMIC_ACQUIRE) == round) {
#if defined(__x86_64__)
            __builtin_ia32_pause();
#endif
        }
    }
"""


@wp.func_native(MEET)
def meet(gate: wp.array(dtype=wp.int32), parties: wp.int32): ...


@wp.kernel(enable_backward=False)
def barrier(gate: wp.array(dtype=wp.int32), parties: wp.int32):
    """One thread: wait until `parties` threads are here. `gate` holds how many are, and the round."""
    meet(gate, parties)
