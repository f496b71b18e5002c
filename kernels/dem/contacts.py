"""Contact forces between spheres over a stored neighbour list, on a CPU.

A CPU uses *half* lists: each thread owns a contiguous range of spheres, called a chunk. A pair inside a chunk has one
list entry, and its force is added to both spheres. A pair across two chunks has an entry at both spheres. (GPU lists
contain every pair at both spheres; see `links`.) A pair is always evaluated in the order of its spheres' permanent
numbers, so both copies compute and store the same bits.

The kernel processes the list of each sphere in blocks of BLOCK entries, in two passes. The first pass computes
distances and sets one bit for each contact. The second pass copies the data of these contacts into vector lanes (see
`lanes`), and evaluates the lanes whenever they are full. The bits of a sphere's first block are kept for the next step.
With these bits, the next step finds the contacts that have ended without reading the history of other pairs.
"""

import functools

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from ..common.types import SPAN, cpu_flags, lowest_bit, types, vector_functions
from .bond_parallel import bond_functions
from .lanes import LANES, evaluate_function, gather_function, layout, scatter_function
from .pairs import ALL_TOUCHED, BLOCK, closeness_function, parting_function
from .structs import DT_PREVIOUS, array_structs


def contact_options(half: bool) -> dict:
    """Return the compiler options of a contact kernel.

    On a GPU, exact division and square root are subroutines that take most of a contact's time. `fast_math` replaces
    them in single precision by faster operations with errors of up to two units in the last place.
    """
    return {"fast_math": not half, "cpu_compiler_flags": cpu_flags()}


@functools.cache
def contact_kernel(
    scalar, law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool, mixed: bool
) -> wp.Kernel:
    """Return the CPU kernel that adds contact forces [N] and moments about sphere centres [N m] to the spheres.

    The neighbour lists are half lists, which contain most pairs once. With `dissipation` the kernel also adds up the
    energy that friction, dashpots and breaking bonds dissipate [J]. A launch processes the spheres from `first` to
    `last`, which belong to one CPU thread. The class `Features` in `warpcrete/dem/engine/model.py` explains the flags.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Parameters = law.functions(scalar).Parameters
    Bond = bond_functions(scalar).Bond
    close_entries = closeness_function(scalar, bonds, subcycling)
    part_entries = parting_function(scalar, law, history, healing, subcycling, dissipation)
    gather = gather_function(scalar, law, history, bonds, healing, mixed)
    evaluate = evaluate_function(scalar, law, history, bonds, dissipation, mixed)
    scatter = scatter_function(scalar, law, history, bonds, dissipation)
    places = layout(law.rolls, history, bonds)
    numbers, integers = places.size, places.integer_size
    rows = row_functions(scalar)
    read_vec4, xyz = rows.read_vec4, vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(True))
    def contacts(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # The next arguments are the range of spheres that this launch processes.
        first: wp.int32,
        last: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        spheres: Spheres,
        pairs: Pairs,
    ):
        columns = wp.zeros(shape=(numbers,), dtype=scalar)
        ints = wp.zeros(shape=(integers,), dtype=wp.int32)
        count = wp.int32(0)  # Number of vector lanes that hold a contact.
        used_row = wp.int32(0)
        used_dt = scalar(0.0)
        i = first + wp.tid() * SPAN - 1
        end_i = wp.min(i + 1 + SPAN, last)
        s = wp.int32(-1)
        row, material, base = wp.int32(0), wp.int32(0), wp.int32(0)
        begin, block, end, bits = wp.int32(0), wp.int32(0), wp.int32(0), wp.int32(0)
        dt = scalar(0.0)
        position_i, velocity_i, spin_i = t.vec4(), t.vec4(), t.vec3()
        # A single loop runs over all contacts, blocks of list entries and spheres. Nested loops would contain several
        # calls of the long function `evaluate`; in a single loop it is compiled once.
        going = wp.bool(True)
        while going:
            full = wp.bool(False)
            if bits != 0:
                k = block + lowest_bit(bits)
                bits = bits & (bits - 1)
                gather(
                    spheres, pairs, bond_parameters, scenes.row[s].bonds, scenes.row[s].loads, row, base, i, k,
                    position_i, velocity_i, spin_i, columns, ints, count,
                )  # fmt: skip
                used_row = row + material
                used_dt = dt
                count = count + 1
                full = count == LANES
            else:
                block = block + BLOCK
                if wp.static(dissipation):
                    # Evaluate the collected contacts after each block of list entries. A sphere's energy losses are
                    # then always added up in the same order: block by block.
                    full = block < end
                if block >= end:
                    i = i + 1
                    begin = 0
                    block = 0
                    end = 0
                    going = i < end_i
                    full = not going
                    if going:
                        full = spheres.scene[i] != s
                        s = spheres.scene[i]
                        if flags[s, HALTED] == 0:
                            base = scenes.row[s].spheres
                            material = spheres.material[i]
                            row = scenes.row[s].laws + material * scenes.row[s].materials
                            # Here dt is the previous time step, because the displacement of that step led to the
                            # current overlap.
                            dt = scalar(scenes.clock[s, DT_PREVIOUS])
                            position_i = read_vec4(spheres.position, i)
                            velocity_i = read_vec4(spheres.velocity, i)
                            spin_i = xyz(read_vec4(spheres.spin, i))
                            begin = scenes.row[s].pairs + pairs.start[i + s]
                            end = scenes.row[s].pairs + pairs.start[i + s + 1]
                            block = begin
                if block < end:
                    bits, held = close_entries(spheres, pairs, base, position_i, block, wp.min(BLOCK, end - block))
                    if wp.static(history or healing):
                        # The bit mask `held` marks pairs of spheres with a stiff bond. These pairs count as touching,
                        # even if their spheres are apart. If the spheres are apart when the bond breaks, the pair
                        # changes from touching to apart, and the kernel clears the pair's contact history.
                        parted = wp.static(ALL_TOUCHED) & ~(bits | held)
                        if block == begin:
                            before = spheres.touching[i]
                            parted = parted & before
                            if (bits | held) != before:
                                spheres.touching[i] = bits | held
                        lost = part_entries(
                            spheres, pairs, pair_parameters, row, base, first, last, position_i[3], velocity_i[3],
                            block, end, parted,
                        )  # fmt: skip
                        if wp.static(dissipation):
                            if lost != wp.float64(0.0):
                                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost
            if full and count > 0:
                evaluate(columns, ints, pair_parameters, used_row, used_dt)
                scatter(spheres, pairs, first, last, columns, ints, count)
                count = 0

    return contacts
