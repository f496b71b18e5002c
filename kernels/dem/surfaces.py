"""Contacts of spheres with planes and pipes on a GPU, with one or a few threads for each sphere.

Most spheres touch no wall. Contacts with planes and pipes have a kernel of their own, which runs concurrently with the
kernel of `links.py`.
"""

import functools

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from .analytic_walls import analytic_wall_functions
from .contacts import contact_options
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs
from .warps import warp_functions


@functools.cache
def surface_kernel(scalar, law, dissipation: bool, wear: bool, width: int) -> wp.Kernel:
    """Return the kernel over spheres that computes the force and moment of all planes and pipes on each sphere.

    Each sphere has 2^`lane_bits` threads, and the launch consists of whole warps of `width` threads (1 on a CPU). The
    kernel stores one force and one moment for each sphere. Another kernel adds the forces of triangle meshes, and the
    kernel that moves bodies reads and clears the sums.
    """
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Walls
    Parameters = law.functions(scalar).Parameters
    surface = analytic_wall_functions(scalar, law, False, dissipation, wear, width)
    Segment, far_from_walls, on_walls = surface.Segment, surface.far_from_walls, surface.on_walls
    any_in_warp = warp_functions(scalar, width).any_in_warp
    rows = row_functions(scalar)
    read_vec4, write_vec3 = rows.read_vec4, rows.write_vec3

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def surface_contacts(
        # The next arguments are arrays of the model, which are constant during a run.
        wall_parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        count: wp.int32,
        lane_bits: wp.int32,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        place = wp.tid() >> lane_bits
        i = wp.min(place, count - 1)
        s = spheres.scene[i]
        here = place < count and flags[s, HALTED] == 0
        far = far_from_walls(read_vec4(spheres.position, i), read_vec4(spheres.clear, i))
        near = here and (not far or scenes.row[s].walls_fixed == 0)
        if any_in_warp(near):
            force, moment, lost = on_walls(
                i, scenes.row[s], near, far, wp.tid() % width, 1 << lane_bits, scalar(scenes.clock[s, DT_PREVIOUS]),
                scenes.clock[s, FORCE_SCALE], wall_parameters, segments, spheres, slots, walls,
            )  # fmt: skip
            if near and wp.tid() & ((1 << lane_bits) - 1) == 0:
                if wp.static(dissipation):
                    spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost
                write_vec3(spheres.force, i, force)
                write_vec3(spheres.moment, i, moment)

    return surface_contacts
