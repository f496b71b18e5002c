"""Sphere-sphere contact forces over a stored neighbour list, and, in the same pass, planes and pipes.

One list serves both devices. In the *half* list (CPU: a thread owns the spheres of a chunk) a pair inside a
chunk stands once and its force is added to both spheres; a pair across two chunks stands at both. In the *full*
list (GPU) every pair stands at both spheres, each thread writes only its own sphere, and no atomic is needed. A
pair is always evaluated in the order of its spheres' permanent numbers, so both copies compute and store the same
bits.

A row of the list is gone through twice: first the distances, which leave a bit for each contact, then the
contacts, one bit after the other. The second loop does nothing but contacts: on a GPU threads of a warp work on
theirs together, on a CPU there is no branch to mispredict. The bits of the first BLOCK entries are kept for the
next step, so that contacts which have parted are known without reading the history of all that never touched.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from ..common.types import SPAN, cpu_flags, lane_functions, types
from .analytic_walls import analytic_wall_functions
from .bond_parallel import bond_functions
from .pairs import ALL_TOUCHED, BLOCK, closeness_function, parting_function, share_function, touching_function
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs


@functools.cache
def contact_parts(scalar, pair_law, wall_law, half: bool, history: bool, bonds: bool, healing: bool,
                  subcycling: bool, dissipation: bool, ways: int, lanes: int):  # fmt: skip
    """Everything that :func:`contact_kernel` calls."""
    structs = array_structs(scalar)
    law = pair_law.functions(scalar)
    analytic = analytic_wall_functions(scalar, wall_law, dissipation)
    rows = row_functions(scalar)
    return SimpleNamespace(
        Scenes=structs.Scenes, Spheres=structs.Spheres, Slots=structs.Slots, Pairs=structs.Pairs, Walls=structs.Walls,
        Parameters=law.Parameters, WallParameters=wall_law.functions(scalar).Parameters,
        Bond=bond_functions(scalar).Bond, Segment=analytic.Segment,
        touching=touching_function(scalar, pair_law, half, history, bonds, healing, dissipation),
        close_entries=closeness_function(scalar, bonds, subcycling, lanes), share=share_function(ways),
        part_entries=parting_function(scalar, pair_law, half, history, healing, subcycling, dissipation),
        far_from_walls=analytic.far_from_walls, on_walls=analytic.on_walls,
        read_int=rows.read_int, read_vec3=rows.read_vec3, read_vec4=rows.read_vec4, write_vec3=rows.write_vec3,
        **vars(lane_functions(scalar, lanes)),
    )  # fmt: skip


def contact_options(half: bool) -> dict:
    """Of the compiler. A GPU's exact division and root are subroutines that take most of a contact's time; those of
    `fast_math` are off by two units in the last place, in single precision only."""
    return {"fast_math": not half, "cpu_compiler_flags": cpu_flags()}


@functools.cache
def contact_kernel(scalar, pair_law, wall_law, half: bool, history: bool, bonds: bool, healing: bool,
                   subcycling: bool, walls_too: bool, dissipation: bool, ways: int = 1, lanes: int = 1):  # fmt: skip
    """Kernel over spheres: contact forces [N] and moments about sphere centres [N m].

    In the half list they are added to what stands there, else they replace it. With `dissipation` it also adds up what
    energy friction, dashpots and breaking bonds take [J]. The launch owns spheres `first` to `last`, chunk `part`.
    Contacts of a sphere are added up in so many `ways`, 1 or 4, to which they fall in turn, and these by pairs: by as
    many `lanes`, threads of a GPU beside one another, or by one, to the same bits.
    """
    t, span = types(scalar), SPAN if half else 1
    f = contact_parts(
        scalar, pair_law, wall_law, half, history, bonds, healing, subcycling, dissipation, ways, lanes
    )  # fmt: skip
    Parameters, WallParameters, Bond, Segment = f.Parameters, f.WallParameters, f.Bond, f.Segment
    Scenes, Spheres, Slots, Pairs, Walls = f.Scenes, f.Spheres, f.Slots, f.Pairs, f.Walls

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(half))
    def contacts(
        # model
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        wall_parameters: wp.array(dtype=WallParameters),
        segments: wp.array(dtype=Segment),
        # chunk
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        # state, read
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        slots: Slots,
        pairs: Pairs,
        walls: Walls,
    ):
        begin_i = first + wp.tid() / lanes * wp.static(span)
        lane = wp.tid() % lanes
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            s = spheres.scene[i]
            if flags[s, HALTED] != 0:
                continue
            base = scenes.row[s].spheres
            dt = scalar(scenes.clock[s, DT_PREVIOUS])  # the displacement that led here is that of the step before
            position_i = f.read_vec4(spheres.position, i)
            velocity_i = f.read_vec4(spheres.velocity, i)
            spin_i = f.read_vec3(spheres.spin, i)
            row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
            force_i = t.vec3()
            moment_i = t.vec3()
            lost_i = wp.float64(0.0)
            begin = scenes.row[s].pairs + pairs.start[i + s]
            end = scenes.row[s].pairs + pairs.start[i + s + 1]
            before = wp.int32(0)
            if wp.static(history or healing):
                before = spheres.touching[i]
            for block in range(begin, end, BLOCK):
                bits = f.close_entries(spheres, pairs, base, position_i, block, wp.min(BLOCK, end - block), lane)
                bits = f.either(bits)
                if lane == 0 and wp.static(history or healing):
                    parted = wp.static(ALL_TOUCHED) & ~bits
                    if block == begin:
                        parted = parted & before
                        if bits != before:
                            spheres.touching[i] = bits
                    lost_i += f.part_entries(
                        spheres, pairs, pair_parameters, row, base, first, last, position_i[3], velocity_i[3], block,
                        end, parted,
                    )  # fmt: skip
                held_force, held_moment, held_lost = t.vec3(), t.vec3(), wp.float64(0.0)
                low_force, low_moment, low_lost = t.vec3(), t.vec3(), wp.float64(0.0)
                for way in range(lane, ways, lanes):
                    force, moment, taken = f.touching(
                        spheres, pairs, pair_parameters, bond_parameters, scenes.row[s].bonds, row, base, first, last,
                        i, block, f.share(bits, way), dt, position_i, velocity_i, spin_i,
                    )  # fmt: skip
                    if wp.static(lanes == ways):
                        force_i += f.total(force)
                        moment_i += f.total(moment)
                        lost_i += f.total_double(taken)
                    else:  # by pairs, as lanes do
                        if way % 2 == 1:
                            force, moment, taken = held_force + force, held_moment + moment, held_lost + taken
                        if way == 1:
                            low_force, low_moment, low_lost = force, moment, taken
                        if way == 3:
                            force_i += low_force + force
                            moment_i += low_moment + moment
                            lost_i += low_lost + taken
                        held_force, held_moment, held_lost = force, moment, taken
            if lane != 0:
                continue
            if wp.static(walls_too):
                far = f.far_from_walls(position_i, f.read_vec4(spheres.clear, i))
                if not far or scenes.row[s].still == 0:
                    wall_force, wall_moment, wall_lost = f.on_walls(
                        i, scenes.row[s], far, part, dt, scenes.clock[s, FORCE_SCALE], wall_parameters, segments,
                        spheres, slots, walls,
                    )  # fmt: skip
                    force_i += wall_force
                    moment_i += wall_moment
                    lost_i += wall_lost
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost_i
            if wp.static(half):
                f.write_vec3(spheres.force, i, f.read_vec3(spheres.force, i) + force_i)
                f.write_vec3(spheres.moment, i, f.read_vec3(spheres.moment, i) + moment_i)
            else:
                f.write_vec3(spheres.force, i, force_i)
                f.write_vec3(spheres.moment, i, moment_i)

    return contacts
