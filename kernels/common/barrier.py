"""A barrier for CPU threads, each of which computes a part of a simulation step.

Warp runs a CPU kernel on the thread that launches it and lets Python's other threads run meanwhile. Each thread
therefore replays a separate recorded sequence of launches (launch graph). The barrier is a kernel in these graphs:
every thread waits in it until the last thread has arrived.

A waiting thread first spins for some microseconds, which is enough while every thread has a core to itself. Then it
sleeps (with a futex on Linux). This frees its core for a thread whose own core is busy with another process.
"""

import warp as wp

GATE = 3
"""Length of a barrier's integer array. The three elements are the number of threads that have arrived, the number of
times that all threads have passed the barrier, and the number of sleeping threads."""
SPINS = 2000
"""Number of times a waiting thread checks the barrier before it sleeps; all these checks take about 30 microseconds."""

MEET = """
    int* here = &gate.data[0];
    int* rounds = &gate.data[1];
    int* asleep = &gate.data[2];
#if defined(__linux__) && (defined(__x86_64__) || defined(__aarch64__))
#define WARPCRETE_FUTEX
    // Name the symbol explicitly, because a function declared here would become a member of Warp's namespace.
    extern long warpcrete_syscall(long, ...) __asm__("syscall");
#if defined(__x86_64__)
    const long number = 202;
#else
    const long number = 98;
#endif
    const auto futex = [](int* word, int operation, int value) {
        warpcrete_syscall(number, word, operation, value, (void*)0, (void*)0, 0);
    };
#endif
    const int round = __atomic_load_n(rounds, __ATOMIC_ACQUIRE);
    if (__atomic_add_fetch(here, 1, __ATOMIC_ACQ_REL) == parties) {
        __atomic_store_n(here, 0, __ATOMIC_RELAXED);
        __atomic_store_n(rounds, round + 1, __ATOMIC_SEQ_CST);
#if defined(WARPCRETE_FUTEX)
        if (__atomic_load_n(asleep, __ATOMIC_SEQ_CST) > 0)
            futex(rounds, 129, 0x7fffffff);  // FUTEX_WAKE_PRIVATE: wake all sleeping threads.
#endif
    } else {
        int spins = 0;
        while (__atomic_load_n(rounds, __ATOMIC_ACQUIRE) == round) {
#if defined(__x86_64__)
            __builtin_ia32_pause();
#endif
#if defined(WARPCRETE_FUTEX)
            if (++spins >= SPINS) {
                // The last thread to arrive sees that this thread is about to sleep, or this thread sees the new round.
                __atomic_add_fetch(asleep, 1, __ATOMIC_SEQ_CST);
                while (__atomic_load_n(rounds, __ATOMIC_SEQ_CST) == round)
                    futex(rounds, 128, round);  // FUTEX_WAIT_PRIVATE: sleep unless the round has changed.
                __atomic_sub_fetch(asleep, 1, __ATOMIC_SEQ_CST);
            }
#endif
        }
    }
""".replace("SPINS", str(SPINS))


@wp.func_native(MEET)
def meet(gate: wp.array(dtype=wp.int32), parties: wp.int32): ...


@wp.kernel(enable_backward=False)
def barrier(gate: wp.array(dtype=wp.int32), parties: wp.int32):
    """Wait at the barrier until `parties` threads have each launched this kernel with a single task."""
    meet(gate, parties)
