"""Contacts of spheres with planes and pipes on a GPU: a few threads a sphere, of which most look at none.

Where spheres are many they have a kernel of their own, which runs beside that of `links`. Where they are few, one
kernel has both, in different blocks: a fork and a join of what is launched take some microseconds of a step.
"""

import functools

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from .analytic_walls import analytic_wall_functions
from .bond_parallel import bond_functions
from .contacts import contact_options
from .links import link_function
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs, links_struct
from .warps import warp_functions


@functools.cache
def surface_function(scalar, law, dissipation: bool, wear: bool, width: int):
    """`meet_walls`: force and moment of a sphere by planes and pipes, where it meets some, by a `thread`; each of so
    many spheres has 2^`lane_bits` of them. All threads of a warp of `width` (1 on a CPU) must call. Meshes add theirs;
    what moves bodies takes them away."""
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Walls
    Parameters = law.functions(scalar).Parameters
    surface = analytic_wall_functions(scalar, law, False, dissipation, wear, width)
    Segment, far_from_walls, on_walls = surface.Segment, surface.far_from_walls, surface.on_walls
    anywhere = warp_functions(scalar, width).anywhere
    rows = row_functions(scalar)
    read_vec4, write_vec3 = rows.read_vec4, rows.write_vec3

    @wp.func
    def meet_walls(
        thread: wp.int32, count: wp.int32, lane_bits: wp.int32, wall_parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment), flags: wp.array2d(dtype=wp.int32), scenes: Scenes, spheres: Spheres,
        slots: Slots, walls: Walls,
    ):  # fmt: skip
        place = thread >> lane_bits
        i = wp.min(place, count - 1)
        s = spheres.scene[i]
        here = place < count and flags[s, HALTED] == 0
        far = far_from_walls(read_vec4(spheres.position, i), read_vec4(spheres.clear, i))
        near = here and (not far or scenes.row[s].still == 0)
        if anywhere(near):
            force, moment, lost = on_walls(
                i, scenes.row[s], near, far, thread % width, 1 << lane_bits, scalar(scenes.clock[s, DT_PREVIOUS]),
                scenes.clock[s, FORCE_SCALE], wall_parameters, segments, spheres, slots, walls,
            )  # fmt: skip
            if near and thread & ((1 << lane_bits) - 1) == 0:
                if wp.static(dissipation):
                    spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost
                write_vec3(spheres.force, i, force)
                write_vec3(spheres.moment, i, moment)

    return meet_walls


@functools.cache
def surface_kernel(scalar, law, dissipation: bool, wear: bool, width: int):
    """Kernel over threads, in whole warps: see :func:`surface_function`."""
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Walls
    Parameters = law.functions(scalar).Parameters
    Segment = analytic_wall_functions(scalar, law, False, dissipation, wear, width).Segment
    meet_walls = surface_function(scalar, law, dissipation, wear, width)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def surface_contacts(
        # model
        wall_parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        # state, read
        count: wp.int32,
        lane_bits: wp.int32,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        meet_walls(wp.tid(), count, lane_bits, wall_parameters, segments, flags, scenes, spheres, slots, walls)

    return surface_contacts


@functools.cache
def meeting_kernel(
    scalar, law, wall_law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool, mixed: bool,
    wear: bool, width: int,
):  # fmt: skip
    """Kernel over so many threads for the planes and pipes of spheres, `wall_threads` in whole blocks, and then so many
    `threads` for links: see :func:`surface_function` and :func:`links.link_function`."""
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Pairs, Walls = (
        structs.Scenes, structs.Spheres, structs.Slots, structs.Pairs, structs.Walls
    )  # fmt: skip
    Links = links_struct(scalar)
    Parameters, Bond = law.functions(scalar).Parameters, bond_functions(scalar).Bond
    WallParameters = wall_law.functions(scalar).Parameters
    Segment = analytic_wall_functions(scalar, wall_law, False, dissipation, wear, width).Segment
    meet_walls = surface_function(scalar, wall_law, dissipation, wear, width)
    meet_spheres = link_function(scalar, law, history, bonds, healing, subcycling, dissipation, mixed)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def all_contacts(
        # model
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        wall_parameters: wp.array(dtype=WallParameters),
        segments: wp.array(dtype=Segment),
        # state, read
        wall_threads: wp.int32,
        count: wp.int32,
        lane_bits: wp.int32,
        threads: wp.int32,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        slots: Slots,
        pairs: Pairs,
        links: Links,
        walls: Walls,
    ):
        thread = wp.tid()
        if thread < wall_threads:
            meet_walls(thread, count, lane_bits, wall_parameters, segments, flags, scenes, spheres, slots, walls)
        else:
            meet_spheres(
                thread - wall_threads, threads, pair_parameters, bond_parameters, flags, scenes, spheres, pairs, links
            )

    return all_contacts
