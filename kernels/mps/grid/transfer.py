"""Between particles and grid: affine particle-in-cell (Jiang et al. 2015), which keeps linear flows as they are."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED, STEPS
from ..structs import mps_types
from .cells import AIR, BIN, FIXED, GATE, INSIDE, LIQUID, OPEN, cells_struct, grid_functions, grid_structs


@functools.cache
def bin_kernels(scalar, axial: bool, periodic: bool) -> SimpleNamespace:
    """Kernels `clear`, `lift`, `sort`, `order` and `fill`: which particles are in which cell, which cells are full."""
    Cells = cells_struct(scalar)
    structs = grid_structs(scalar)
    Particles, Mesh = structs.Particles, structs.Mesh
    f = grid_functions(scalar, axial, periodic)
    vec = mps_types(scalar, 2).vec

    @wp.kernel(enable_backward=False, module="unique")
    def clear(mesh: Mesh):
        """A task a slot: no particles."""
        mesh.count[wp.tid()] = 0

    @wp.kernel(enable_backward=False, module="unique")
    def lift(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot: a gate's cells open when their time has come."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        if mesh.solid[c] == GATE and scalar(flags[STEPS]) * g.dt >= mesh.opens[c]:
            mesh.solid[c] = OPEN

    @wp.kernel(enable_backward=False, module="unique")
    def sort(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Mesh):
        """A task a particle: into its cell's bin."""
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        c = f.cell_of(g, particles.position[p])
        place = wp.atomic_add(mesh.count, c, 1)
        if place < BIN:
            mesh.bin[c * BIN + place] = p

    @wp.kernel(enable_backward=False, module="unique")
    def order(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot: particles of a cell in the order of their numbers, for equal sums."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        if i < 0 or k < 0 or i >= g.nx or k >= g.nz:
            return
        count = wp.min(mesh.count[c], BIN)
        mesh.count[c] = count
        begin = c * BIN
        for a in range(1, count):
            own = mesh.bin[begin + a]
            b = a
            while b > 0 and mesh.bin[begin + b - 1] > own:
                mesh.bin[begin + b] = mesh.bin[begin + b - 1]
                b -= 1
            mesh.bin[begin + b] = own

    @wp.kernel(enable_backward=False, module="unique")
    def fill(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Mesh):
        """A task a slot: how much of a cell concrete fills, by the particles around its middle.

        A flat surface spreads over two cells; half as steep again, and cut at nothing and all, it holds as much, and
        how particles lie within the concrete does not matter.
        """
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        if i < 0 or k < 0 or i >= g.nx or k >= g.nz:
            return
        part = scalar(0.0)
        crowd = scalar(1.0)
        if mesh.solid[c] == OPEN:
            place = vec(g.left + (scalar(i) + scalar(0.5)) * g.dx, (scalar(k) + scalar(0.5)) * g.dz)
            sum = scalar(0.0)
            room = scalar(0.0)
            for a in range(-1, 2):
                for b in range(-1, 2):
                    o = f.at(g, i + a, k + b)
                    if mesh.solid[o] == OPEN:
                        share = wp.where(a == 0, scalar(0.75), scalar(0.125)) * (
                            wp.where(b == 0, scalar(0.75), scalar(0.125))
                        )
                        room += share * f.cell_volume(g, i + a)
                        if i + a >= 0 and i + a < g.nx and k + b < g.nz:
                            for n in range(mesh.count[o]):
                                p = mesh.bin[o * BIN + n]
                                d = particles.position[p] - place
                                near = (scalar(1.0) - wp.abs(d[0]) / g.dx) * (scalar(1.0) - wp.abs(d[1]) / g.dz)
                                if wp.abs(d[0]) < g.dx and wp.abs(d[1]) < g.dz:
                                    sum += near * particles.mass[p]
            crowd = sum * g.volume / room
            part = wp.clamp(scalar(0.5) + scalar(1.5) * (crowd - scalar(0.5)), scalar(0.0), scalar(1.0))
        mesh.crowd[c] = crowd
        mesh.fill[c] = part
        mesh.liquid[c] = wp.where(part > scalar(0.0), 1, 0)

    return SimpleNamespace(clear=clear, lift=lift, sort=sort, order=order, fill=fill)


@functools.cache
def gather_kernel(scalar, axial: bool, periodic: bool):
    """Kinds and volumes of the faces, and the velocities that particles bring to them; a task a slot."""
    vec = mps_types(scalar, 2).vec
    Cells = cells_struct(scalar)
    structs = grid_structs(scalar)
    Particles, Mesh, Walls = structs.Particles, structs.Mesh, structs.Walls
    f = grid_functions(scalar, axial, periodic)

    @wp.func
    def kind_of(mesh: Mesh, a: wp.int32, b: wp.int32) -> wp.int32:
        """Kind of the face between two cells."""
        if mesh.solid[a] != OPEN and mesh.solid[b] != OPEN:
            return INSIDE
        if mesh.solid[a] != OPEN or mesh.solid[b] != OPEN:
            return FIXED
        if mesh.liquid[a] != 0 or mesh.liquid[b] != 0:
            return LIQUID
        return AIR

    @wp.func
    def brought(
        g: Cells, particles: Particles, mesh: Mesh, i: wp.int32, k: wp.int32, axis: wp.int32, before: scalar
    ) -> scalar:
        """Velocity that particles bring to a face; as `before` where there are none."""
        half = scalar(0.5)
        place = vec(g.left + (scalar(i) + half * scalar(axis)) * g.dx, (scalar(k) + half * scalar(1 - axis)) * g.dz)
        whole = scalar(0.0)
        sum = scalar(0.0)
        for a in range(wp.max(i - 1, 0), wp.min(i + axis, g.nx - 1) + 1):
            for b in range(k - 1, k + 1 + (1 - axis)):
                c = f.at(g, a, b)
                for n in range(mesh.count[c]):
                    p = mesh.bin[c * BIN + n]
                    d = place - particles.position[p]
                    if wp.static(periodic):
                        length = scalar(g.nz) * g.dz
                        d[1] = d[1] - length * wp.round(d[1] / length)
                    across = scalar(1.0) - wp.abs(d[0]) / g.dx
                    along = scalar(1.0) - wp.abs(d[1]) / g.dz
                    if across > scalar(0.0) and along > scalar(0.0):
                        weight = across * along * particles.mass[p]
                        carried = particles.velocity[p] + particles.gradient[p] * d
                        whole += weight
                        sum += weight * carried[axis]
        if whole > scalar(0.0):
            return sum / whole
        return before

    @wp.kernel(enable_backward=False, module="unique")
    def gather(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, walls: Walls, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        if wp.static(periodic):
            if k < 0 or k >= g.nz:
                return
        for axis in range(2):
            r = c + axis * g.slots
            kind = INSIDE
            volume = scalar(0.0)
            if (axis == 0 and i >= 0) or (axis == 1 and k >= 0):
                low = f.at(g, i - 1 + axis, k - axis)
                kind = kind_of(mesh, low, c)
                if kind == FIXED:
                    mesh.velocity[r] = walls.velocity[wp.max(mesh.solid[low], mesh.solid[c])][axis]
                if kind == LIQUID:
                    width = wp.where(axis == 0, g.dx, g.dz)
                    volume = scalar(0.5) * (mesh.fill[low] + mesh.fill[c]) * f.face_area(g, i, axis) * width
                    mesh.velocity[r] = brought(g, particles, mesh, i, k, axis, mesh.velocity[r])
            mesh.kind[r] = kind
            mesh.volume[r] = volume

    return gather


@functools.cache
def extend_kernel(scalar, axial: bool, periodic: bool):
    """Velocities of faces in the air and within walls, from those beside them, for particles there; a task a slot.

    Beside a wall the velocity goes on in a straight line through that at the wall.
    """
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh
    f = grid_functions(scalar, axial, periodic)

    @wp.kernel(enable_backward=False, module="unique")
    def extend(
        g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh, again: wp.int32, before: wp.array(dtype=scalar),
        known_before: wp.array(dtype=wp.int32), after: wp.array(dtype=scalar), known_after: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        for axis in range(2):
            r = c + axis * g.slots
            value = mesh.velocity[r]
            good = wp.where(f.known(mesh.kind[r]), 1, 0)
            if again != 0:
                value = before[r]
                good = known_before[r]
            if good == 0:
                sum = scalar(0.0)
                whole = scalar(0.0)
                for n in range(4):
                    a = i + wp.where(n == 0, 1, 0) - wp.where(n == 1, 1, 0)
                    b = k + wp.where(n == 2, 1, 0) - wp.where(n == 3, 1, 0)
                    if a >= -1 and a <= g.nx and b >= -1 and b <= g.nz:
                        o = f.at(g, a, b) + axis * g.slots
                        if again != 0:
                            if known_before[o] != 0:
                                sum += before[o]
                                whole += scalar(1.0)
                        elif mesh.kind[o] == LIQUID:
                            # The wall is to the left of its right neighbour, and so on.
                            if mesh.kind[r] == INSIDE and ((axis == 1 and n < 2) or (axis == 0 and n > 1)):
                                wall = f.at(g, a, b) + (2 * axis + n % 2) * g.slots
                                sum += scalar(2.0) * mesh.slip[wall] - mesh.velocity[o]
                            else:
                                sum += mesh.velocity[o]
                            whole += scalar(1.0)
                if whole > scalar(0.0):
                    value = sum / whole
                    good = 1
            after[r] = value
            known_after[r] = good

    return extend


@functools.cache
def advect_kernel(scalar, axial: bool, periodic: bool):
    """Particles take the velocity around them and go with that of half a step later; a task a particle."""
    t = mps_types(scalar, 2)
    vec, mat = t.vec, t.mat
    Cells = cells_struct(scalar)
    structs = grid_structs(scalar)
    Particles, Mesh = structs.Particles, structs.Mesh
    f = grid_functions(scalar, axial, periodic)

    @wp.func
    def sample(
        g: Cells, velocity: wp.array(dtype=scalar), good: wp.array(dtype=wp.int32), x: vec, axis: wp.int32
    ):  # fmt: skip
        """A component of the velocity at a place, bilinear between faces, and its slopes."""
        across = (x[0] - g.left) / g.dx - scalar(0.5) * scalar(axis)
        along = x[1] / g.dz - scalar(0.5) * scalar(1 - axis)
        i = wp.clamp(wp.int32(wp.floor(across)), -1, g.nx - axis)
        k = wp.int32(wp.floor(along))
        if wp.static(not periodic):
            k = wp.clamp(k, -1, g.nz - 1)
        s = vec(across - scalar(i), along - scalar(k))
        value = scalar(0.0)
        slope = vec()
        whole = scalar(0.0)
        whole_slope = vec()
        for a in range(2):
            for b in range(2):
                r = f.at(g, wp.min(i + a, g.nx), k + b) + axis * g.slots
                if good[r] != 0:
                    part = vec(wp.where(a == 0, scalar(1.0) - s[0], s[0]), wp.where(b == 0, scalar(1.0) - s[1], s[1]))
                    change = vec(wp.where(a == 0, -part[1], part[1]) / g.dx, wp.where(b == 0, -part[0], part[0]) / g.dz)
                    value += part[0] * part[1] * velocity[r]
                    whole += part[0] * part[1]
                    slope += velocity[r] * change
                    whole_slope += change
        if whole > scalar(0.0):
            value = value / whole
        return value, slope - value * whole_slope, whole

    @wp.func
    def carry(g: Cells, velocity: wp.array(dtype=scalar), good: wp.array(dtype=wp.int32), x: vec):
        u, du, _across = sample(g, velocity, good, x, 0)
        w, dw, whole = sample(g, velocity, good, x, 1)
        return vec(u, w), mat(du[0], du[1], dw[0], dw[1]), whole

    @wp.kernel(enable_backward=False, module="unique")
    def advect(
        g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh, velocity: wp.array(dtype=scalar),
        good: wp.array(dtype=wp.int32), particles: Particles, late: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        x = particles.position[p]
        here, slope, whole = carry(g, velocity, good, x)
        if wp.static(not periodic):
            if whole == scalar(0.0):  # alone in the air
                here = particles.velocity[p] - vec(scalar(0.0), g.gravity * g.dt)
        particles.velocity[p] = here
        particles.gradient[p] = slope
        particles.pressure[p] = mesh.pressure[f.cell_of(g, x)]
        moving = vec(scalar(0.0), g.frame)
        there, _slope, ahead = carry(g, velocity, good, x + scalar(0.5) * g.dt * (here - moving))
        if wp.static(not periodic):
            if ahead == scalar(0.0):
                there = here
        after = x + g.dt * (there - moving)
        if wp.static(not periodic):
            aside, _bent, _known = carry(g, mesh.shift, good, x)
            after += g.dt * aside
        if wp.static(periodic):
            length = scalar(g.nz) * g.dz
            after[1] = after[1] - length * wp.floor(after[1] / length)
        # Rounding and the curvature of a path may lead into a wall.
        if mesh.solid[f.cell_of(g, vec(after[0], x[1]))] != OPEN:
            after[0] = x[0]
        if mesh.solid[f.cell_of(g, after)] != OPEN:
            after[1] = x[1]
        little = scalar(1.0e-3)
        after[0] = wp.clamp(after[0], g.left + little * g.dx, g.left + (scalar(g.nx) - little) * g.dx)
        if wp.static(not periodic):
            after[1] = wp.clamp(after[1], little * g.dz, (scalar(g.nz) - little) * g.dz)
        if not (wp.abs(here[0]) + wp.abs(here[1]) < scalar(1.0e6)):
            late[1] = 1
        particles.position[p] = after

    return advect
