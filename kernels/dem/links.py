"""Contact forces between spheres on a GPU: one thread per pair, and sums for each sphere in a fixed order.

Neighbour lists contain every pair at both spheres; a *link* represents both list entries, so each pair has one link.
A step evaluates only the near links (see :mod:`near`), because most links of a list do not touch. The kernel that moves
bodies adds up the results of each sphere's links in the order of its list. Forces therefore need no atomic operations,
and results do not depend on the order in which threads run. :mod:`surfaces` handles planes and pipes.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from ..common.types import lowest_bit, types, vector_functions
from .bond_parallel import BROKEN_IN_TENSION, HYDRATED, UNBONDED, bond_functions, kind_of
from .contact_law import contact_functions
from .contacts import contact_options
from .linking import EXTRA_MASKS, MASKED_ENTRIES, mark_function
from .pairs import BLOCK, bonded_function, pair_functions
from .structs import APART, DT_PREVIOUS, PARTED, STIFF, TOUCHING, array_structs, links_struct


def result_rows(bonds: bool, rolls: bool, dissipation: bool) -> int:
    """Return the number of rows of `links.result` in which each pair of spheres stores its result.

    Two rows hold a force and a contact moment, which suffice for both spheres because the forces on them are opposite.
    With bonds, rolling resistance or a sum of the lost energy, each sphere needs two rows of its own: one for its force
    and energy, one for its moment.
    """
    return 4 if bonds or rolls or dissipation else 2


@functools.cache
def result_functions(scalar, count: int):
    """Return functions that store the results of a link in `count` rows, and that add up the results for a sphere.

    A link is a listed pair of spheres.

    - `store_result` writes the rows of a link.
    - `store_loss` writes the energy loss of a link whose spheres have just separated.
    - `sum_of_links` returns the sums over the links of a sphere: force [N], moment [N m] and lost energy [J].
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack
    rows = row_functions(scalar)
    read_int, read_vec4, write_vec4 = rows.read_int, rows.read_vec4, rows.write_vec4
    apart = count > 2

    @wp.func
    def store_result(
        links: Links, p: wp.int32, force: t.vec3, arm_i: scalar, turn: t.vec3, arm_j: scalar, own: t.vec3, lost: scalar
    ):
        if wp.static(apart):
            write_vec4(links.result, count * p, pack(force, lost))
            write_vec4(links.result, count * p + 1, pack(arm_i * turn + own, scalar(0.0)))
            write_vec4(links.result, count * p + 2, pack(-force, scalar(0.0)))
            write_vec4(links.result, count * p + 3, pack(arm_j * turn - own, scalar(0.0)))
        else:
            write_vec4(links.result, count * p, pack(force, arm_i))
            write_vec4(links.result, count * p + 1, pack(turn, arm_j))

    @wp.func
    def store_loss(links: Links, p: wp.int32, lost: scalar):
        store_result(links, p, t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), t.vec3(), lost)

    @wp.func
    def row_of(first: wp.int32, end: wp.int32):
        """Return the index in `links.result` at which the result of a link for one of its two spheres begins.

        `first` is the index of the scene's first link. `end` is the number p of the link in the scene if the sphere is
        the one with the lower permanent number, and -1 - p if it is the other sphere.
        """
        if wp.static(apart):
            return count * (first + wp.where(end >= 0, end, -1 - end)) + wp.where(end >= 0, 0, 2)
        return count * (first + wp.where(end >= 0, end, -1 - end))

    @wp.func
    def force_on_end(end: wp.int32, force: t.vec4):
        """Return the force of a link (pair of spheres) on one of its spheres [N].

        `end` is nonnegative for the sphere with the lower permanent number, and negative for the other sphere.
        """
        if wp.static(apart):
            return xyz(force)
        return wp.where(end >= 0, xyz(force), -xyz(force))

    @wp.func
    def moment_on_end(end: wp.int32, force: t.vec4, turn: t.vec4):
        """Return the moment of a link (pair of spheres) about the centre of one of its spheres [N m].

        `end` is nonnegative for the sphere with the lower permanent number, and negative for the other sphere.
        """
        if wp.static(apart):
            return xyz(turn)
        return wp.where(end >= 0, force[3], turn[3]) * xyz(turn)

    @wp.func
    def sum_of_links(spheres: Spheres, pairs: Pairs, links: Links, i: wp.int32, row: wp.int32, slot: wp.int32):
        """Add up force, moment and lost energy over the links of sphere i, in the order of its neighbour list.

        `row` is the index of the scene's first list entry. `pairs.start[slot]` is the index of the first list entry of
        sphere i, counted from `row`.
        """
        force = t.vec3()
        moment = t.vec3()
        lost = wp.float64(0.0)
        begin = row + read_int(pairs.start, slot)
        end = row + read_int(pairs.start, slot + 1)
        block = begin
        word = wp.int32(0)
        while block < end and word <= EXTRA_MASKS:
            left = wp.int32(0)
            if word == 0:
                left = read_int(spheres.touching, i)
            else:
                left = read_int(links.later_touching, EXTRA_MASKS * i + word - 1)
            while left != 0:
                # Each pass of this loop loads the results of up to four links at once, so that their memory latencies
                # overlap.
                q = read_int(links.end, block + lowest_bit(left))
                left = left & (left - 1)
                u, v, w = wp.int32(0), wp.int32(0), wp.int32(0)
                found = wp.int32(1)
                if left != 0:
                    u = read_int(links.end, block + lowest_bit(left))
                    left = left & (left - 1)
                    found = 2
                if left != 0:
                    v = read_int(links.end, block + lowest_bit(left))
                    left = left & (left - 1)
                    found = 3
                if left != 0:
                    w = read_int(links.end, block + lowest_bit(left))
                    left = left & (left - 1)
                    found = 4
                r = row_of(row / 2, q)
                a, b = read_vec4(links.result, r), read_vec4(links.result, r + 1)
                c, d, e, f, g, h = t.vec4(), t.vec4(), t.vec4(), t.vec4(), t.vec4(), t.vec4()
                if found > 1:
                    r = row_of(row / 2, u)
                    c, d = read_vec4(links.result, r), read_vec4(links.result, r + 1)
                if found > 2:
                    r = row_of(row / 2, v)
                    e, f = read_vec4(links.result, r), read_vec4(links.result, r + 1)
                if found > 3:
                    r = row_of(row / 2, w)
                    g, h = read_vec4(links.result, r), read_vec4(links.result, r + 1)
                # Add the results of a sphere's links (contacts with other spheres) strictly one after the other, so
                # that their rounding is always the same. A link whose spheres have just separated adds zeros, which do
                # not change this rounding.
                force = (((force + force_on_end(q, a)) + force_on_end(u, c)) + force_on_end(v, e)) + force_on_end(w, g)
                moment = (moment + moment_on_end(q, a, b)) + moment_on_end(u, c, d)
                moment = (moment + moment_on_end(v, e, f)) + moment_on_end(w, g, h)
                if wp.static(apart):
                    lost = (((lost + wp.float64(a[3])) + wp.float64(c[3])) + wp.float64(e[3])) + wp.float64(g[3])
            block += BLOCK
            word += 1
        # The list entries after the first MASKED_ENTRIES have no bits that mark touching pairs, so add the results of
        # all these entries. Pairs that do not touch have a result of zero.
        for entry in range(begin + MASKED_ENTRIES, end):
            q = read_int(links.end, entry)
            r = row_of(row / 2, q)
            a, b = read_vec4(links.result, r), read_vec4(links.result, r + 1)
            force += force_on_end(q, a)
            moment += moment_on_end(q, a, b)
            if wp.static(apart):
                lost += wp.float64(a[3])
        return force, moment, lost

    return SimpleNamespace(store_result=store_result, store_loss=store_loss, sum_of_links=sum_of_links)


@functools.cache
def contact_update_function(
    scalar, law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool
):
    """Return the function `update_contact`, which checks if the two spheres of a link touch.

    A link is a listed pair of spheres. The function clears the contact history when a contact has ended. The class
    `Features` in `warpcrete/dem/engine/model.py` explains the flags.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    functions = law.functions(scalar)
    Parameters, contact_energy = functions.Parameters, functions.energy
    rolls = law.rolls
    moment_energy = functions.moment_energy if rolls else None
    sphere_touch = contact_functions(scalar).sphere_touch
    xyz = vector_functions(scalar).xyz
    store_loss = result_functions(scalar, result_rows(bonds, rolls, dissipation)).store_loss
    mark_touching = mark_function(scalar)

    @wp.func
    def clear_parted(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, parameters: wp.array(dtype=Parameters), s: wp.int32,
        i: wp.int32, j: wp.int32, k: wp.int32, twin: wp.int32,
    ):  # fmt: skip
        """Clear the history of a pair that has separated, and return the elastic energy left in its springs [J]."""
        lost = scalar(0.0)
        if wp.static(history):
            if wp.static(dissipation):
                loaded = wp.length_sq(pairs.history[k]) > scalar(0.0)
                if wp.static(rolls):
                    loaded = loaded or wp.length_sq(pairs.rolling[k]) > scalar(0.0)
                if loaded:
                    touch = sphere_touch(
                        t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), spheres.position[i][3], spheres.position[j][3],
                        spheres.velocity[i][3], spheres.velocity[j][3],
                    )  # fmt: skip
                    row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
                    lost = contact_energy(parameters[row + spheres.material[j]], touch, xyz(pairs.history[k]))
                    if wp.static(rolls):
                        lost += moment_energy(parameters[row + spheres.material[j]], touch, pairs.rolling[k])
            pairs.history[k] = t.vec4()
            if wp.static(rolls):
                pairs.rolling[k] = t.vec3()
        if wp.static(healing):
            if pairs.bond[k] < 0:
                pairs.bond[k] = 0  # Reset the broken bond, so that the pair may bond again when its spheres next touch.
                pairs.load[k] = t.vec8()
                pairs.bond[twin] = 0
        return lost

    @wp.func
    def update_contact(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, links: Links, parameters: wp.array(dtype=Parameters),
        s: wp.int32, ends: wp.vec4i, position_i: t.vec4, position_j: t.vec4, state: wp.int32, kind: wp.int32,
    ) -> wp.bool:  # fmt: skip
        """Return True if the spheres of a link (listed pair) touch or are bonded, and update the link's state.

        `state` is the previous value in `links.state`; the new value is stored only if it differs. `kind` is the kind
        of the bond between the spheres.
        """
        i, j, k, p = ends[0], ends[1], ends[2], ends[3]
        reach = position_i[3] + position_j[3]
        close = wp.length_sq(xyz(position_j) - xyz(position_i)) < reach * reach
        held_apart = wp.bool(False)
        if wp.static(bonds):
            close = close or kind > 0
            if wp.static(subcycling):
                # Skip a pair with a stiff bond: its forces are computed separately, in several rounds per step
                # (sub-cycling).
                held_apart = kind == HYDRATED
                close = close and not held_apart
        after = wp.where(close, TOUCHING, APART)
        if held_apart:
            # The contact history of a pair is cleared when its state changes to APART. A stiff bond may break, and its
            # spheres separate, between two checks by this kernel. If the state were APART while the bond holds, the
            # next check would see no change and keep the old history.
            after = STIFF
        if state != after:
            lost = scalar(0.0)
            row = scenes.row[s].pairs
            twin = row + links.link[p][3]
            if after == APART and state != PARTED:
                lost = clear_parted(scenes, spheres, pairs, parameters, s, i, j, k, twin)
            if lost > scalar(0.0):
                after = PARTED  # Keep the link in the sums for one more step, so that its lost energy is counted.
            else:
                mark_touching(spheres, links, i, k - row - pairs.start[i + s], close)
                mark_touching(spheres, links, j, twin - row - pairs.start[j + s], close)
            links.state[p] = after
            if not close:
                store_loss(links, p, lost)
        return close

    return update_contact


@functools.cache
def link_functions(scalar, law, history: bool, bonds: bool, healing: bool, dissipation: bool, mixed: bool):
    """Return the function `evaluate`, which computes the force and the moments between the two spheres of a link.

    A link is a pair of spheres in a neighbour list. The function also updates the contact history and the bond. `mixed`
    is True if the spheres have several materials. The class `Features` in `warpcrete/dem/engine/model.py` explains the
    flags.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    functions = law.functions(scalar)
    Parameters, contact_force = functions.Parameters, functions.force
    rolls = law.rolls
    contact_moment = functions.moment if rolls else None
    Bond = bond_functions(scalar).Bond
    pair_touch = pair_functions(scalar).pair_touch
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack
    bonded = bonded_function(scalar, healing, dissipation)
    rows = row_functions(scalar)
    read_int, read_vec3, read_vec4 = rows.read_int, rows.read_vec3, rows.read_vec4
    write_vec3, write_vec4 = rows.write_vec3, rows.write_vec4
    store_result = result_functions(scalar, result_rows(bonds, rolls, dissipation)).store_result

    @wp.func
    def evaluate(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, links: Links, parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond), s: wp.int32, ends: wp.vec4i, position_i: t.vec4, position_j: t.vec4,
    ):  # fmt: skip
        i, j, k, p = ends[0], ends[1], ends[2], ends[3]
        # Here dt is the previous time step, because the displacement of that step led to the current overlap.
        dt = scalar(scenes.clock[s, DT_PREVIOUS])
        spin_i, spin_j = xyz(read_vec4(spheres.spin, i)), xyz(read_vec4(spheres.spin, j))
        material = read_int(spheres.material, i)
        law_row = scenes.row[s].laws + material * scenes.row[s].materials
        if wp.static(mixed):
            material = read_int(spheres.material, j)
        law_row += material
        old_history = t.vec3()
        if wp.static(history):
            old_history = xyz(read_vec4(pairs.history, k))
        pair = pair_touch(
            position_i, read_vec4(spheres.velocity, i), spin_i, position_j, read_vec4(spheres.velocity, j), spin_j,
            scalar(1.0), dt,
        )  # fmt: skip
        total, new_history, lost = contact_force(parameters[law_row], pair.touch, old_history, dt)
        if wp.static(history):
            write_vec4(pairs.history, k, pack(new_history, scalar(0.0)))
        bond_moment = t.vec3()
        if wp.static(bonds):
            before = pairs.bond[k]
            total, bond_moment, lost, outcome = bonded(
                pairs, bond_parameters, scenes.row[s].bonds, scenes.row[s].loads, k, pair, spin_j - spin_i, total,
                lost, dt,
            )  # fmt: skip
            if wp.static(healing):
                if before == UNBONDED:
                    pairs.bond[scenes.row[s].pairs + links.link[p][3]] = pairs.bond[k]
            if outcome < 0:
                pairs.bond[scenes.row[s].pairs + links.link[p][3]] = outcome
                if outcome == BROKEN_IN_TENSION:
                    wp.atomic_add(spheres.broken, i, wp.vec2i(1, 0))
                else:
                    wp.atomic_add(spheres.broken, i, wp.vec2i(0, 1))
        if wp.static(rolls):
            held_back, new_rolling, lost_rolling = contact_moment(
                parameters[law_row], pair.touch, spin_j - spin_i,
                read_vec3(pairs.rolling, k), dt,
            )  # fmt: skip
            write_vec3(pairs.rolling, k, new_rolling)
            bond_moment = bond_moment + held_back
            lost += lost_rolling
        turn = wp.cross(pair.touch.normal, total)
        store_result(links, p, total, pair.arm_i, turn, pair.arm_j, bond_moment, lost)

    return evaluate


@functools.cache
def link_kernel(
    scalar, law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool, mixed: bool
) -> wp.Kernel:
    """Return the kernel that computes the contact forces of all links (pairs of spheres) that touch.

    The launch has `threads` threads. In the first pass they share the near links, which are the pairs close enough to
    touch within a few steps. This pass skips scenes whose near links may lack a contact. In the second pass the threads
    share all links of the skipped scenes. The class `Features` in `warpcrete/dem/engine/model.py` explains the flags.
    """
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    Parameters = law.functions(scalar).Parameters
    Bond = bond_functions(scalar).Bond
    update_contact = contact_update_function(scalar, law, history, bonds, healing, subcycling, dissipation)
    evaluate = link_functions(scalar, law, history, bonds, healing, dissipation, mixed)
    read_int, read_vec4 = row_functions(scalar).read_int, row_functions(scalar).read_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def link_contacts(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        threads: wp.int32,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        spheres: Spheres,
        pairs: Pairs,
        links: Links,
    ):
        near = links.near_count[0]
        count = near
        if links.near_count[1] != 0:
            count += links.link.shape[0]
        for q in range(wp.tid(), count, threads):
            ends = wp.vec4i(0, 0, 0, 0)
            if q < near:
                ends = links.near[q]
            else:
                p = q - near
                link = links.link[p]
                if link[0] < 0:
                    continue
                first, row = scenes.row[links.scene[p]].spheres, scenes.row[links.scene[p]].pairs
                ends = wp.vec4i(first + link[0], first + link[1], row + link[2], p)
            s = spheres.scene[ends[0]]
            # Issue all reads from memory before the branch that decides whether they are needed, so that their
            # latencies overlap.
            position_i, position_j = read_vec4(spheres.position, ends[0]), read_vec4(spheres.position, ends[1])
            state, kind = read_int(links.state, ends[3]), wp.int32(0)
            if wp.static(bonds):
                kind = kind_of(read_int(pairs.bond, ends[2]))
            if (links.near_list_exceeded[s] != 0) == (q < near) or flags[s, HALTED] != 0:
                continue
            if update_contact(
                scenes, spheres, pairs, links, pair_parameters, s, ends, position_i, position_j, state, kind
            ):  # fmt: skip
                evaluate(
                    scenes, spheres, pairs, links, pair_parameters, bond_parameters, s, ends, position_i, position_j
                )

    return link_contacts
