"""Contacts between spheres on a GPU: a thread a pair, and sums of each sphere's in a fixed order.

Lists hold every pair at both spheres; a *link* is a pair once. A step looks at those that are `near`: most links of a
list do not touch. What a link gives stands at both entries of its pair, and is added up for each sphere in the order of
the list, by the kernel that moves bodies: forces need no atomic, and bits depend on no order of threads. Planes and
pipes have a kernel of their own, a thread a sphere, which runs beside.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from ..common.types import lowest_bit, types, vector_functions
from .analytic_walls import analytic_wall_functions
from .bond_parallel import BROKEN_IN_TENSION, HYDRATED, UNBONDED, bond_functions
from .contact_law import contact_functions
from .contacts import contact_options
from .linking import BITS, MORE, mark_function
from .pairs import BLOCK, bonded_function, pair_functions
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs, links_struct

WARP = 32
"""Threads of a warp."""


@functools.cache
def pull_functions(scalar):
    """`pull` writes the two rows of an entry; `pulled` adds up those of a sphere: force [N], moment [N m] and lost
    energy [J]."""
    t = types(scalar)
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_int, read_vec4, write_vec4 = rows.read_int, rows.read_vec4, rows.write_vec4

    @wp.func
    def pull(links: Links, k: wp.int32, force: t.vec3, moment: t.vec3, lost: scalar):
        write_vec4(links.pull, 2 * k, t.vec4(force[0], force[1], force[2], moment[0]))
        write_vec4(links.pull, 2 * k + 1, t.vec4(moment[1], moment[2], lost, scalar(0.0)))

    @wp.func
    def pulled(spheres: Spheres, pairs: Pairs, links: Links, i: wp.int32, row: wp.int32, slot: wp.int32):
        """`row` is the scene's first entry, `slot` the sphere's place in `pairs.start`."""
        force = t.vec3()
        moment = t.vec3()
        lost = wp.float64(0.0)
        begin = row + read_int(pairs.start, slot)
        end = row + read_int(pairs.start, slot + 1)
        block = begin
        word = wp.int32(0)
        while block < end and word <= MORE:
            left = wp.int32(0)
            if word == 0:
                left = read_int(spheres.touching, i)
            else:
                left = read_int(links.more, MORE * i + word - 1)
            while left != 0:
                # Four at a time: while one is waited for, the others come.
                k = block + lowest_bit(left)
                left = left & (left - 1)
                a, b = read_vec4(links.pull, 2 * k), read_vec4(links.pull, 2 * k + 1)
                c, d, e, f, g, h = t.vec4(), t.vec4(), t.vec4(), t.vec4(), t.vec4(), t.vec4()
                if left != 0:
                    k = block + lowest_bit(left)
                    left = left & (left - 1)
                    c, d = read_vec4(links.pull, 2 * k), read_vec4(links.pull, 2 * k + 1)
                if left != 0:
                    k = block + lowest_bit(left)
                    left = left & (left - 1)
                    e, f = read_vec4(links.pull, 2 * k), read_vec4(links.pull, 2 * k + 1)
                if left != 0:
                    k = block + lowest_bit(left)
                    left = left & (left - 1)
                    g, h = read_vec4(links.pull, 2 * k), read_vec4(links.pull, 2 * k + 1)
                force = (((force + xyz(a)) + xyz(c)) + xyz(e)) + xyz(g)
                moment = (moment + t.vec3(a[3], b[0], b[1])) + t.vec3(c[3], d[0], d[1])
                moment = (moment + t.vec3(e[3], f[0], f[1])) + t.vec3(g[3], h[0], h[1])
                lost += (wp.float64(b[2]) + wp.float64(d[2])) + (wp.float64(f[2]) + wp.float64(h[2]))
            block += BLOCK
            word += 1
        for k in range(begin + BITS, end):  # no bits tell of these
            a, b = read_vec4(links.pull, 2 * k), read_vec4(links.pull, 2 * k + 1)
            force += xyz(a)
            moment += t.vec3(a[3], b[0], b[1])
            lost += wp.float64(b[2])
        return force, moment, lost

    return pull, pulled


@functools.cache
def warp_functions(scalar, width: int) -> SimpleNamespace:
    """What threads of a warp do together, all of them: `anywhere` (does something hold for any), `from_lane` (a number
    that another has; `energy_from_lane` in double precision), `settle` (what any has read, others may now write)."""
    alone = width == 1
    taken = "return value;" if alone else "return __shfl_sync(0xffffffffu, value, lane);"

    @wp.func_native("return holds;" if alone else "return __any_sync(0xffffffffu, holds);")
    def anywhere(holds: wp.bool) -> wp.bool: ...

    @wp.func_native(taken)
    def from_lane(value: scalar, lane: wp.int32) -> scalar: ...

    @wp.func_native(taken)
    def energy_from_lane(value: wp.float64, lane: wp.int32) -> wp.float64: ...

    @wp.func_native("" if alone else "__syncwarp();")
    def settle(): ...

    return SimpleNamespace(anywhere=anywhere, from_lane=from_lane, energy_from_lane=energy_from_lane, settle=settle)


@functools.cache
def look_function(scalar, law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool):
    """`looks`: whether a link touches or is bonded; lets go of what has parted."""
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
    read_int = row_functions(scalar).read_int
    pull, _ = pull_functions(scalar)
    mark = mark_function(scalar)

    @wp.func
    def part(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, parameters: wp.array(dtype=Parameters), s: wp.int32,
        i: wp.int32, j: wp.int32, k: wp.int32, twin: wp.int32,
    ):  # fmt: skip
        """Clear what a pair remembers; returns the energy that its spring, still loaded, takes with it [J]."""
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
                pairs.bond[k] = 0  # may bond again at the next touch
                pairs.bond[twin] = 0
        return lost

    @wp.func
    def looks(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, links: Links, parameters: wp.array(dtype=Parameters),
        p: wp.int32, s: wp.int32, ends: wp.vec4i, position_i: t.vec4, position_j: t.vec4,
    ) -> wp.bool:  # fmt: skip
        i, j, k, twin = ends[0], ends[1], ends[2], ends[3]
        reach = position_i[3] + position_j[3]
        close = wp.length_sq(xyz(position_j) - xyz(position_i)) < reach * reach
        held_apart = wp.bool(False)
        if wp.static(bonds):
            kind = pairs.bond[k]
            close = close or kind > 0
            if wp.static(subcycling):
                held_apart = kind == HYDRATED  # stepped in rounds of its own
                close = close and not held_apart
        state = read_int(links.touched, p)
        if (close and state != 1) or (not close and state != 0):
            lost = scalar(0.0)
            if not close and state == 1 and not held_apart:
                lost = part(scenes, spheres, pairs, parameters, s, i, j, k, twin)
            after = wp.where(close, 1, 0)
            if lost > scalar(0.0):
                after = 2  # its rows count once more
            else:
                row = scenes.row[s].pairs
                mark(spheres, links, i, k - row - pairs.start[i + s], close)
                mark(spheres, links, j, twin - row - pairs.start[j + s], close)
            links.touched[p] = after
            if not close:
                pull(links, k, t.vec3(), t.vec3(), lost)
                pull(links, twin, t.vec3(), t.vec3(), scalar(0.0))
        return close

    return looks


@functools.cache
def link_functions(scalar, law, history: bool, bonds: bool, healing: bool, dissipation: bool, mixed: bool):
    """`evaluate`: force and moments of a link, its history and bond. Bodies may be `mixed`, of several materials."""
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
    pull, _ = pull_functions(scalar)

    @wp.func
    def evaluate(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, links: Links, parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond), s: wp.int32, ends: wp.vec4i, position_i: t.vec4, position_j: t.vec4,
    ):  # fmt: skip
        i, j, k, twin = ends[0], ends[1], ends[2], ends[3]
        dt = scalar(scenes.clock[s, DT_PREVIOUS])  # the displacement that led here is that of the step before
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
            kind = pairs.bond[k]
            total, bond_moment, lost, outcome = bonded(
                pairs, bond_parameters, scenes.row[s].bonds, k, pair, spin_j - spin_i, total, lost, dt
            )
            if wp.static(healing):
                if kind == UNBONDED:
                    pairs.bond[twin] = pairs.bond[k]
            if outcome < 0:
                pairs.bond[twin] = outcome
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
        pull(links, k, total, pair.arm_i * turn + bond_moment, lost)
        pull(links, twin, -total, pair.arm_j * turn - bond_moment, scalar(0.0))

    return evaluate


@functools.cache
def surface_kernel(scalar, law, analytic: bool, dissipation: bool, wear: bool, width: int):
    """Kernel over spheres, in whole warps of `width` threads (1 on a CPU): force and moment of each by planes and
    pipes, to which meshes add theirs."""
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Walls
    Parameters = law.functions(scalar).Parameters
    surface = analytic_wall_functions(scalar, law, False, dissipation, wear)
    Segment, far_from_walls, on_walls = surface.Segment, surface.far_from_walls, surface.on_walls
    anywhere = warp_functions(scalar, width).anywhere
    t = types(scalar)
    rows = row_functions(scalar)
    read_vec4, write_vec3 = rows.read_vec4, rows.write_vec3

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def surface_contacts(
        # model
        wall_parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        # state, read
        last: wp.int32,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        i = wp.min(wp.tid(), last - 1)
        s = spheres.scene[i]
        here = wp.tid() < last and flags[s, HALTED] == 0
        far = wp.bool(True)
        near = wp.bool(False)
        if wp.static(analytic):
            far = far_from_walls(read_vec4(spheres.position, i), read_vec4(spheres.clear, i))
            near = here and (not far or scenes.row[s].still == 0)
        force = t.vec3()
        moment = t.vec3()
        if anywhere(near):
            force, moment, lost = on_walls(
                i, scenes.row[s], near, far, wp.tid() % width, scalar(scenes.clock[s, DT_PREVIOUS]),
                scenes.clock[s, FORCE_SCALE], wall_parameters, segments, spheres, slots, walls,
            )  # fmt: skip
            if wp.static(dissipation):
                if near:
                    spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost
        if here:
            write_vec3(spheres.force, i, force)
            write_vec3(spheres.moment, i, moment)

    return surface_contacts


@functools.cache
def link_kernel(
    scalar, law, history: bool, bonds: bool, healing: bool, subcycling: bool, dissipation: bool, mixed: bool
):
    """Kernel over links: contacts of those that touch.

    Each of its threads, of which there are `threads`, takes a near link, and one more for so many as there are; then
    links of scenes whose near ones may miss a contact.
    """
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    Parameters = law.functions(scalar).Parameters
    Bond = bond_functions(scalar).Bond
    looks = look_function(scalar, law, history, bonds, healing, subcycling, dissipation)
    evaluate = link_functions(scalar, law, history, bonds, healing, dissipation, mixed)
    read_vec4 = row_functions(scalar).read_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def link_contacts(
        # model
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # state, read
        threads: wp.int32,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        pairs: Pairs,
        links: Links,
    ):
        near = links.near_count[0]
        count = near
        if links.near_count[1] != 0:
            count += links.link.shape[0]
        for q in range(wp.tid(), count, threads):
            p, s = wp.int32(0), wp.int32(0)
            ends = wp.vec4i(-1, -1, -1, -1)
            if q < near:
                ends = links.near[q]
                p, s = links.near_link[q][0], links.near_link[q][1]
            else:
                p = q - near
                s = links.scene[p]
            if (links.outrun[s] != 0) == (q < near) or flags[s, HALTED] != 0:
                continue
            if q >= near:
                link = links.link[p]
                if link[0] < 0:
                    continue
                first, row = scenes.row[s].spheres, scenes.row[s].pairs
                ends = wp.vec4i(first + link[0], first + link[1], row + link[2], row + link[3])
            position_i, position_j = read_vec4(spheres.position, ends[0]), read_vec4(spheres.position, ends[1])
            if looks(scenes, spheres, pairs, links, pair_parameters, p, s, ends, position_i, position_j):
                evaluate(
                    scenes, spheres, pairs, links, pair_parameters, bond_parameters, s, ends, position_i, position_j
                )

    return link_contacts
