"""Sphere-sphere contact forces over a stored neighbour list, on a CPU.

In the *half* list of a CPU, where a thread owns the spheres of a chunk, a pair inside a chunk stands once and its force
is added to both spheres; a pair across two chunks stands at both. (The list of a GPU holds all pairs at both spheres:
see `links`.) A pair is always evaluated in the order of its spheres' permanent numbers, so both copies compute and
store the same bits.

A row of the list is gone through twice: first the distances, which leave a bit for each contact, then the
contacts, one bit after the other. The second loop does nothing but contacts: there is no branch to mispredict. The bits
of the first BLOCK entries are kept for the next step, so that contacts which have parted are known without reading the
history of all that never touched.
"""

import functools

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from ..common.types import SPAN, cpu_flags, types
from .bond_parallel import bond_functions
from .pairs import ALL_TOUCHED, BLOCK, closeness_function, parting_function, touching_function
from .structs import DT_PREVIOUS, array_structs


def contact_options(half: bool) -> dict:
    """Of the compiler. A GPU's exact division and root are subroutines that take most of a contact's time; those of
    `fast_math` are off by two units in the last place, in single precision only."""
    return {"fast_math": not half, "cpu_compiler_flags": cpu_flags()}


@functools.cache
def contact_kernel(scalar, law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool):
    """Kernel over spheres of a half list: adds contact forces [N] and moments about sphere centres [N m].

    With `dissipation` it also adds up what energy friction, dashpots and breaking bonds take [J]. The launch owns
    spheres `first` to `last`.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Parameters = law.functions(scalar).Parameters
    Bond = bond_functions(scalar).Bond
    touching = touching_function(scalar, law, history, bonds, healing, dissipation)
    close_entries = closeness_function(scalar, bonds, subcycling)
    part_entries = parting_function(scalar, law, history, healing, subcycling, dissipation)
    rows = row_functions(scalar)
    read_vec3, read_vec4, write_vec3 = rows.read_vec3, rows.read_vec4, rows.write_vec3

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(True))
    def contacts(
        # model
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # chunk
        first: wp.int32,
        last: wp.int32,
        # state, read
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        pairs: Pairs,
    ):
        begin_i = first + wp.tid() * SPAN
        for i in range(begin_i, wp.min(begin_i + SPAN, last)):
            s = spheres.scene[i]
            if flags[s, HALTED] != 0:
                continue
            base = scenes.row[s].spheres
            dt = scalar(scenes.clock[s, DT_PREVIOUS])  # the displacement that led here is that of the step before
            position_i = read_vec4(spheres.position, i)
            velocity_i = read_vec4(spheres.velocity, i)
            spin_i = read_vec3(spheres.spin, i)
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
                bits = close_entries(spheres, pairs, base, position_i, block, wp.min(BLOCK, end - block))
                if wp.static(history or healing):
                    parted = wp.static(ALL_TOUCHED) & ~bits
                    if block == begin:
                        parted = parted & before
                        if bits != before:
                            spheres.touching[i] = bits
                    lost_i += part_entries(
                        spheres, pairs, pair_parameters, row, base, first, last, position_i[3], velocity_i[3], block,
                        end, parted,
                    )  # fmt: skip
                force, moment, taken = touching(
                    spheres, pairs, pair_parameters, bond_parameters, scenes.row[s].bonds, row, base, first, last, i,
                    block, bits, dt, position_i, velocity_i, spin_i,
                )  # fmt: skip
                force_i += force
                moment_i += moment
                lost_i += taken
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost_i
            write_vec3(spheres.force, i, read_vec3(spheres.force, i) + force_i)
            write_vec3(spheres.moment, i, read_vec3(spheres.moment, i) + moment_i)

    return contacts
