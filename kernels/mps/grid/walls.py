"""What walls do to the faces along them: their stress, its growth with the velocity, and how concrete slips."""

import functools

import warp as wp

from ...common.control import HALTED
from ..structs import mps_types
from .bingham import bingham_functions
from .cells import (
    AIR,
    FIXED,
    INSIDE,
    LIQUID,
    OPEN,
    SLIVER,
    SMOOTH,
    Kind,
    cells_struct,
    grid_functions,
    grid_structs,
)


@functools.cache
def side_kernel(scalar, of: Kind):
    """Stress of walls that are sides of a pipe's cells on the faces along them."""
    Cells = cells_struct(scalar, 2)
    structs = grid_structs(scalar, 2)
    Mesh, Walls = structs.Mesh, structs.Walls
    f = grid_functions(scalar, of)
    law = bingham_functions(scalar, 2)

    @wp.kernel(enable_backward=False, module="unique")
    def wall_stress(g: Cells, flags: wp.array(dtype=wp.int32), walls: Walls, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for axis in range(2):
            r = number + axis * g.slots
            mesh.rubbed[r] = scalar(0.0)
            mesh.traction[r] = scalar(0.0)
            mesh.growth[r] = scalar(0.0)
            mesh.slip[r] = mesh.velocity[r]
            if mesh.kind[r] == LIQUID:
                for side in range(2):
                    next = f.moved(c, 1 - axis, 2 * side - 1)
                    o = f.at(g, next)
                    if mesh.kind[o + axis * g.slots] == INSIDE:
                        wall = mesh.solid[o]
                        if wall == OPEN:
                            wall = mesh.solid[f.at(g, f.moved(next, axis, -1))]
                        if walls.slip_viscosity[wall] >= scalar(0.0):
                            still = walls.velocity[wall][axis]
                            relative = mesh.velocity[r] - still
                            way = wp.where(relative < scalar(0.0), scalar(-1.0), scalar(1.0))
                            # A wall to the left or below slows what goes along it by a shear of the same sign.
                            turn = way * wp.where(side == 0, scalar(1.0), scalar(-1.0))
                            width = g.width[1 - axis]
                            ring = scalar(1.0)
                            at_wall = f.moved(c, 1 - axis, side)
                            if wp.static(of.axial):
                                if axis == 1:
                                    # More of a ring's area lies on its outer side.
                                    outer = wp.where(side == 1, scalar(1.0), scalar(-1.0))
                                    radius = f.side_weight(g, at_wall)
                                    ring -= outer * width / (scalar(6.0) * radius - outer * scalar(3.0) * width)
                            beyond = f.at(g, f.moved(c, 1 - axis, 1 - side))
                            inner = wp.max(turn * mesh.stress[beyond], scalar(0.0))
                            stress, growth, slip = law.at_wall(
                                g, wp.abs(relative), inner, width, ring, walls.slip_viscosity[wall],
                                walls.slip_yield[wall],
                            )  # fmt: skip
                            mesh.rubbed[r] = g.width[axis] * f.side_weight(g, at_wall)
                            mesh.traction[r] = way * stress
                            mesh.growth[r] = growth
                            mesh.slip[r] = still + way * slip
                            mesh.stress[f.at(g, at_wall)] = turn * stress

    return wall_stress


@functools.cache
def wall_kernel(scalar, of: Kind):
    """Stress of walls that pass through cells on the faces beside them."""
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Mesh, Walls, Geometry = structs.Mesh, structs.Walls, structs.Geometry
    t = mps_types(scalar, dims)
    whole = t.whole
    f = grid_functions(scalar, of)
    law = bingham_functions(scalar, dims)

    @wp.func
    def aside(g: Cells, mesh: Mesh, c: whole, axis: wp.int32, other: wp.int32) -> scalar:
        """Velocity along another axis at the middle of a face, of the faces around that have one."""
        sum = scalar(0.0)
        count = scalar(0.0)
        for n in range(4):
            r = f.at(g, f.moved(f.moved(c, axis, -(n % 2)), other, n / 2)) + other * g.slots
            if mesh.kind[r] == LIQUID:
                sum += mesh.velocity[r]
                count += scalar(1.0)
        return sum / wp.max(count, scalar(1.0))

    @wp.func
    def sheared(mesh: Mesh, cell: wp.int32) -> scalar:
        """Shear stress in a cell [Pa]; none in the air."""
        if mesh.liquid[cell] == 0:
            return scalar(0.0)
        return mesh.in_cell[cell] * wp.sqrt(mesh.strain[cell])

    @wp.func
    def smooth(g: Cells, mesh: Mesh, c: whole, axis: wp.int32) -> wp.bool:
        """Is a face within a wall that nothing rubs on?"""
        return mesh.solid[f.at(g, c)] == SMOOTH or mesh.solid[f.at(g, f.moved(c, axis, -1))] == SMOOTH

    @wp.kernel(enable_backward=False, module="unique")
    def wall_stress(g: Cells, flags: wp.array(dtype=wp.int32), walls: Walls, geometry: Geometry, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for axis in range(dims):
            r = number + axis * g.slots
            mesh.rubbed[r] = scalar(0.0)
            mesh.traction[r] = scalar(0.0)
            mesh.growth[r] = scalar(0.0)
            mesh.slip[r] = mesh.velocity[r]
            wall = geometry.surface[r]
            gap = geometry.gap[r]
            if mesh.kind[r] == LIQUID and walls.slip_viscosity[wall] >= scalar(0.0):
                area = scalar(0.0)  # of wall that the face looks at along the axes
                steep = scalar(0.0)
                inner = scalar(0.0)
                far = scalar(0.0)
                x = f.face_middle(g, c, axis)
                still = f.wall_speed(walls, wall, x, axis)
                relative = mesh.velocity[r] - still
                way = wp.where(relative < scalar(0.0), scalar(-1.0), scalar(1.0))
                for b in range(dims):
                    for side in range(2):
                        next = f.moved(c, b, 2 * side - 1)
                        o = f.at(g, next) + axis * g.slots
                        kind = AIR
                        if b != axis or (next[b] >= 0 and next[b] <= g.n[b]):  # beyond an open side there is no wall
                            kind = mesh.kind[o]
                        # A wall across the face's own way stretches what is before it.
                        hidden = kind != LIQUID and kind != AIR and (b != axis or kind != FIXED)
                        if hidden and not smooth(g, mesh, next, axis):
                            # The wall's normal has this share along the axis.
                            share = wp.clamp((gap - geometry.gap[o]) / g.width[b], scalar(0.0), scalar(1.0))
                            weight = f.cell_weight(g, c)
                            if wp.static(of.axial):
                                if axis == 0:
                                    weight = f.side_weight(g, c)
                                if axis == 1 and b == 0:
                                    weight = f.side_weight(g, f.moved(c, 0, side))
                            area += share * weight * f.block(g) / g.width[b]
                            if share >= steep:
                                # Stress a cell further from the wall: what there is of it, whichever way it acts.
                                steep = share
                                ahead = f.moved(c, b, 1 - 2 * side)
                                inner = scalar(0.5) * (
                                    sheared(mesh, f.at(g, ahead)) + sheared(mesh, f.at(g, f.moved(ahead, axis, -1)))
                                )
                                far = gap + share * g.width[b]
                if area > scalar(0.0):
                    far = wp.max(far, scalar(1.01) * gap)
                    square = relative * relative
                    for b in range(dims):
                        if b != axis:
                            other = aside(g, mesh, c, axis, b) - f.wall_speed(walls, wall, x, b)
                            square += other * other
                    speed = wp.sqrt(square)
                    stress, growth, slip = law.near_wall(
                        g, speed, gap, inner, far, walls.slip_viscosity[wall], walls.slip_yield[wall]
                    )
                    mesh.rubbed[r] = area
                    mesh.traction[r] = way * stress
                    mesh.growth[r] = growth
                    mesh.slip[r] = still + way * slip
                    if speed > scalar(0.0):
                        # Along the velocity stress grows as the law has it, aside as its direction turns.
                        part = relative / speed
                        mesh.traction[r] = part * stress
                        mesh.growth[r] = part * part * growth + (scalar(1.0) - part * part) * stress / speed
                        mesh.slip[r] = still + part * slip

    return wall_stress


@functools.cache
def sliver_kernel(scalar, of: Kind):
    """Velocities of faces of which only the rim is outside a wall, from those beside them; a task a slot."""
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Mesh, Geometry = structs.Mesh, structs.Geometry
    f = grid_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def slivers(g: Cells, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for axis in range(dims):
            r = number + axis * g.slots
            if mesh.kind[r] == SLIVER:
                sum = scalar(0.0)
                count = scalar(0.0)
                for n in range(2 * dims):
                    next = f.moved(c, n / 2, 2 * (n % 2) - 1)
                    o = f.at(g, next) + axis * g.slots
                    if next[n / 2] <= g.n[n / 2] and mesh.kind[o] == LIQUID:
                        # What is open of the face lies at about this distance from the wall.
                        here = scalar(0.5) * geometry.part[r] * g.width[n / 2]
                        share = wp.min(here / geometry.gap[o], scalar(1.0))
                        sum += mesh.slip[o] + share * (mesh.velocity[o] - mesh.slip[o])
                        count += scalar(1.0)
                mesh.velocity[r] = sum / wp.max(count, scalar(1.0))

    return slivers
