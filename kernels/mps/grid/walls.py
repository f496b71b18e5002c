"""Kernels for the friction of walls: shear stress, its derivative with respect to velocity, and slip velocity."""

import functools

import warp as wp

from ...common.control import HALTED
from ..flow_laws import BINGHAM, law_functions
from ..structs import mps_types
from .cells import INSIDE, LIQUID, OPEN, GridKind, grid_parameters_struct, grid_structs, item
from .other_laws import flow_functions
from .places import grid_functions
from .structure import with_gain_function

SLOW = wp.constant(1.0e-6)
"""Slip velocity below which the viscous stress of a nonlinear slip layer is smoothed to be nearly linear [m/s]."""
STICKY = wp.constant(20.0)
"""Stiffness of a slip layer to which concrete sticks, divided by the shear stiffness of a cell of concrete. It limits
the stiffness of all slip layers, because sticking without any slip would need an infinite stiffness."""


@functools.cache
def side_kernel(scalar, of: GridKind):
    """Build the kernel that computes the shear stress of a pipe's walls on the faces beside and parallel to them.

    The walls of a pipe coincide with sides of cells. The kernel runs with one task per cell.
    """
    Grid = grid_parameters_struct(scalar, 2)
    structs = grid_structs(scalar, 2)
    Fields, Walls = structs.Fields, structs.Walls
    f = grid_functions(scalar, of)
    law = flow_functions(scalar, of)
    with_gain = with_gain_function(scalar, 2)

    @wp.kernel(enable_backward=False, module="unique")
    def wall_stress(
        g: Grid, flags: wp.array(dtype=wp.int32), walls: Walls, mesh: Fields, worker: wp.int32, workers: wp.int32
    ):
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for axis in range(2):
            r = number + axis * g.slots
            mesh.wall_area[r] = scalar(0.0)
            mesh.traction[r] = scalar(0.0)
            mesh.traction_slope[r] = scalar(0.0)
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
                            # If the wall is to the left of the face or below it, the shear stress has the sign of
                            # `relative`, the velocity of the concrete relative to the wall. If the wall is to the right
                            # or above, the stress has the opposite sign.
                            turn = way * wp.where(side == 0, scalar(1.0), scalar(-1.0))
                            width = g.width[1 - axis]
                            ring = scalar(1.0)
                            at_wall = f.moved(c, 1 - axis, side)
                            if wp.static(of.axial):
                                if axis == 1:
                                    # Cells are rings about the axis. A ring has more of its volume on the outer side,
                                    # which changes the mean velocity of the cell.
                                    outer = wp.where(side == 1, scalar(1.0), scalar(-1.0))
                                    radius = f.side_weight(g, at_wall)
                                    ring -= outer * width / (scalar(6.0) * radius - outer * scalar(3.0) * width)
                            beyond = f.at(g, f.moved(c, 1 - axis, 1 - side))
                            inner = wp.max(turn * mesh.stress[beyond], scalar(0.0))
                            own = g
                            slip_yield = walls.slip_yield[wall]
                            if wp.static(of.thixotropic):
                                own = with_gain(g, mesh.gained[number])
                                slip_yield += mesh.layer[r]
                            if wp.static(of.plain):
                                stress, traction_slope, slip = law.at_wall(
                                    own, wp.abs(relative), inner, width, ring, walls.slip_viscosity[wall], slip_yield
                                )
                            else:
                                stress, traction_slope, slip = law.at_wall(
                                    own, wp.abs(relative), inner, width, ring, walls.slip_viscosity[wall], slip_yield,
                                    walls.slip_index[wall], walls.slip_quadratic[wall],
                                )  # fmt: skip
                            mesh.wall_area[r] = g.width[axis] * f.side_weight(g, at_wall)
                            mesh.traction[r] = way * stress
                            mesh.traction_slope[r] = traction_slope
                            mesh.slip[r] = still + way * slip
                            mesh.stress[f.at(g, at_wall)] = turn * stress

    return wall_stress


@functools.cache
def wall_kernel(scalar, of: GridKind):
    """Build the kernel that computes the friction of walls which pass through cells (cut cells).

    The friction follows from the concrete's velocity at the wall. This velocity is interpolated between a face in the
    concrete and the next face, which lies inside the wall. The kernel runs with one task per cell.
    """
    dims, last = of.dimensions, of.dimensions - 1
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Walls, Geometry = structs.Fields, structs.Walls, structs.Geometry
    whole = mps_types(scalar, dims).whole
    f = grid_functions(scalar, of)
    layer = law_functions(scalar, of.slip_law)

    @wp.func
    def aside(g: Grid, mesh: Fields, c: whole, axis: wp.int32, other: wp.int32) -> scalar:
        """Return the velocity component along the axis `other` at the centre of a face that is perpendicular to `axis`.

        The grid does not store this component at the face. The result is its mean over the surrounding faces with
        concrete.
        """
        sum = scalar(0.0)
        count = scalar(0.0)
        for n in range(4):
            beside = f.moved(f.moved(c, axis, -(n % 2)), other, n / 2)
            if beside[other] <= g.n[other]:
                r = f.at(g, beside) + other * g.slots
                if mesh.kind[r] == LIQUID:
                    sum += mesh.velocity[r]
                    count += scalar(1.0)
        return sum / wp.max(count, scalar(1.0))

    @wp.func
    def weight(g: Grid, c: whole, axis: wp.int32, b: wp.int32) -> scalar:
        """Return the distance of a point from the axis of symmetry [m], or 1 without such an axis.

        The point lies halfway between a face and the next face along axis `b`.
        """
        if axis == b:
            return f.cell_weight(g, c)
        if axis == 0:
            return f.side_weight(g, c)
        return f.side_weight(g, f.moved(c, 0, 1))

    @wp.func
    def larger_viscosity(mesh: Fields, a: wp.int32, b: wp.int32) -> scalar:
        """Return the larger apparent viscosity of two cells [Pa s]; cells without concrete count as 0."""
        most = scalar(0.0)
        if mesh.liquid[a] != 0:
            most = mesh.in_cell[a]
        if mesh.liquid[b] != 0:
            most = wp.max(most, mesh.in_cell[b])
        return most

    @wp.kernel(enable_backward=False, module="unique")
    def wall_stress(
        g: Grid, flags: wp.array(dtype=wp.int32), walls: Walls, geometry: Geometry, mesh: Fields,
        worker: wp.int32, workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        for axis in range(dims):
            for b in range(dims):
                k = (axis * dims + b) * g.slots + number
                mesh.wall_stiffness[k] = scalar(0.0)
                upper = f.moved(c, b, 1)
                there = c[axis] >= 0 and c[axis] <= g.n[axis] and upper[b] <= g.n[b]
                if wp.static(of.periodic):
                    there = there and c[last] >= 0 and c[last] < g.n[last]
                if there:
                    r, o = number + axis * g.slots, f.at(g, upper) + axis * g.slots
                    if f.is_unknown(mesh.kind[r]) and f.is_unknown(mesh.kind[o]):
                        near = geometry.gap[r]
                        far = geometry.gap[o]
                        if (near > scalar(0.0)) != (far > scalar(0.0)):
                            out = c
                            if far > scalar(0.0):
                                out = upper
                            own = f.at(g, out)
                            low = f.at(g, f.moved(out, axis, -1))
                            wall = geometry.surface[own + axis * g.slots]
                            if walls.slip_viscosity[wall] >= scalar(0.0):
                                # `share` is the derivative of the distance from the wall along axis b. It equals the
                                # component of the wall's unit normal along this axis.
                                share = wp.min(wp.abs(near - far) / g.width[b], scalar(1.0))
                                area = share * weight(g, c, axis, b) * f.block(g) / g.width[b]
                                area *= scalar(0.5) * (mesh.fill[own] + mesh.fill[low])
                                on = wp.abs(near) / (wp.abs(near) + wp.abs(far))
                                x = f.face_middle(g, c, axis)
                                x[b] = x[b] + on * g.width[b]
                                still = f.wall_speed(walls, wall, x, axis)
                                relative = (scalar(1.0) - on) * mesh.velocity[r] + on * mesh.velocity[o] - still
                                square = relative * relative
                                for d in range(dims):
                                    if d != axis:
                                        other = aside(g, mesh, out, axis, d) - f.wall_speed(walls, wall, x, d)
                                        square += other * other
                                speed = wp.sqrt(square)
                                stiff = scalar(STICKY) * larger_viscosity(mesh, own, low) / g.width[b]
                                hold = walls.slip_yield[wall] / wp.max(speed, scalar(1.0e-12))
                                if wp.static(of.slip_law == BINGHAM):
                                    hold += walls.slip_viscosity[wall]
                                else:
                                    hold += layer.viscosity(
                                        walls.slip_viscosity[wall], walls.slip_index[wall], walls.slip_quadratic[wall],
                                        speed, scalar(SLOW),
                                    )  # fmt: skip
                                if hold > stiff:
                                    # Concrete that sticks to a wall would need an infinite stiffness. Use the stiffness
                                    # of a film whose thickness is 1 / STICKY of a cell. Where the velocity rises
                                    # linearly from the wall, a film makes the stress too small, as if the wall were
                                    # further away. The velocity is therefore taken at a point that is further inside
                                    # the concrete, by half the thickness of the film.
                                    hold = stiff
                                    spring = scalar(0.5) * g.width[b] / scalar(STICKY)
                                    spring = wp.min(spring, scalar(0.5) * wp.max(near, far))
                                    on += wp.where(near > far, -spring, spring) / (wp.abs(near) + wp.abs(far))
                                    relative = (scalar(1.0) - on) * mesh.velocity[r] + on * mesh.velocity[o] - still
                                mesh.wall_weight[k] = on
                                mesh.wall_stiffness[k] = area * hold
                                mesh.wall_force[k] = area * hold * relative

    return wall_stress
