"""Kernels that choose the near links of a GPU: the pairs close enough to touch within a few steps.

Near links form a second, shorter neighbour list of pairs (links). The main list holds all pairs within a skin that
lasts for a hundred steps or more, and most of these pairs do not touch. Near links are the pairs whose gap is below a
fraction NEAR of the skin. They stay valid for a correspondingly shorter time, and a step evaluates only them. The
device chooses them anew at a fixed interval (`NEAR_LINK_INTERVAL` in `warpcrete/dem/engine`), without the host. If a
sphere moves too far before the next choice, its scene evaluates all links until then. No contact is missed, and the
results are the same either way.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import row_functions
from ..common.types import vector_functions
from .structs import APART, SINCE_BUILD, array_structs, links_struct

NEAR = 0.25
"""Largest gap between two spheres that are chosen as a near pair, as a fraction of the skin, which is the largest gap
in the neighbour list."""
CHOICE_BLOCK = 256
"""Number of threads in a block of the kernel that chooses near links; its launches consist of whole blocks."""
TAKE_PLACES = """
#if defined(__CUDA_ARCH__)
    __shared__ int before[32], begin;
    const int lane = threadIdx.x & 31, warp = threadIdx.x >> 5;
    const unsigned wanting = __ballot_sync(0xffffffffu, wants);
    if (lane == 0) before[warp] = __popc(wanting);
    __syncthreads();
    if (threadIdx.x == 0) {
        int sum = 0;
        for (unsigned w = 0; w < (blockDim.x >> 5); ++w) {
            const int own = before[w];
            before[w] = sum;
            sum += own;
        }
        begin = sum > 0 ? atomicAdd(count.data, sum) : 0;
    }
    __syncthreads();
    return wants ? begin + before[warp] + __popc(wanting & ((1u << lane) - 1)) : -1;
#else
    return wants ? count.data[0]++ : -1;
#endif
"""


@wp.func_native(TAKE_PLACES)
def take_place(count: wp.array(dtype=wp.int32), wants: wp.bool) -> wp.int32:
    """Return a free index in the list of near links if `wants` is true, else -1.

    All threads of a block must call this function together, with one atomic addition per block. Blocks run in any
    order, so the order of the list differs from run to run.
    """


@functools.cache
def near_kernels(scalar) -> SimpleNamespace:
    """Return the kernels that select near links, which are listed pairs of spheres that may touch within a few steps.

    The kernel `record_positions` runs first and stores the current positions of the spheres. It must be launched with
    at least two threads, and with no fewer threads than there are spheres or scenes. The kernel `choose_near` follows.
    It runs with one thread per listed pair, in whole blocks.
    """
    structs = array_structs(scalar)
    Scenes, Spheres = structs.Scenes, structs.Spheres
    Links = links_struct(scalar)
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_vec4, write_vec4 = rows.read_vec4, rows.write_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def record_positions(scenes: Scenes, spheres: Spheres, links: Links):
        i = wp.tid()
        if i < spheres.position.shape[0]:
            write_vec4(links.near_position, i, read_vec4(spheres.position, i))
        if i < scenes.row.shape[0]:
            links.near_time[i] = scenes.clock[i, SINCE_BUILD]
            links.near_list_exceeded[i] = 0
        if i < 2:
            links.near_count[i] = 0

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def choose_near(scenes: Scenes, spheres: Spheres, links: Links):
        p = wp.tid()
        near = wp.bool(False)
        link = wp.vec4i(-1, -1, -1, -1)
        s = wp.int32(0)
        if p < links.link.shape[0]:
            link = links.link[p]
            s = links.scene[p]
        first = scenes.row[s].spheres
        row = scenes.row[s].pairs
        if link[0] >= 0:
            a, b = read_vec4(spheres.position, first + link[0]), read_vec4(spheres.position, first + link[1])
            reach = a[3] + b[3] + scalar(wp.static(NEAR)) * scenes.row[s].skin
            near = wp.length_sq(xyz(b) - xyz(a)) < reach * reach
            # Also put a pair into the list of near links if it touched in the last step or is bonded, even if its
            # spheres are far apart now. The next step must evaluate such a pair to notice that its contact has ended.
            near = near or links.state[p] != APART
        place = take_place(links.near_count, near)
        if near:
            links.near[place] = wp.vec4i(first + link[0], first + link[1], row + link[2], p)

    return SimpleNamespace(record_positions=record_positions, choose_near=choose_near)
