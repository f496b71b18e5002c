"""Viscous forces, pressure and weight on the faces of a grid, and the matrix of the implicit solve for velocities.

The viscous forces result from normal strain rates (stretch) in cells and shear rates at edges. They are derivatives of
a single dissipation function, for any distribution of the viscosity in space. The matrix is therefore symmetric, and
every force on a face has an opposite force on neighbouring faces.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ..structs import mps_types, row_place
from .cells import DT, FORCE, LIQUID, GridKind, first, grid_parameters_struct, grid_structs, item, second
from .levels import system_structs
from .other_laws import flow_functions
from .places import grid_functions
from .structure import with_gain_function

STIFFENING = wp.constant(2.0)
"""Exponent by which the viscosity of unyielded concrete is extrapolated in flows with a free surface.

Let `before` be the viscosity in the previous step, and `now` the viscosity at the present shear rate. The step then
uses the viscosity before * (now / before)^STIFFENING. With the exponent 1 it would use `now`.
"""


@functools.cache
def relaxed_viscosity_function(scalar, of: GridKind):
    """Build `relaxed_viscosity`, which returns a viscosity for the next step from its previous and present values."""
    Grid = grid_parameters_struct(scalar, of.dimensions)
    law = flow_functions(scalar, of)

    @wp.func
    def relaxed_viscosity(g: Grid, before: scalar, now: scalar, rate: scalar) -> scalar:
        """Return the viscosity for a step, from the previous value `before` and the value `now` at the present rate.

        Normally it is the geometric mean of both values. With `now` itself, a plug (unyielded concrete) that ends less
        than a cell from the wall of a pipe would oscillate.

        Flows that may have a free surface also stop and start. In such flows, concrete that yields gets the value
        `now`. In concrete below the yield stress, a step can reduce the shear rate only by the ratio of stress to yield
        stress, so that longer time steps would delay the moment at which concrete comes to rest. The viscosity below
        the yield stress is therefore extrapolated to ``before * (now / before) ** STIFFENING``.
        """
        if before > scalar(0.0):
            if wp.static(not of.periodic):
                if now > before and before * rate < g.yield_stress:
                    ahead = wp.pow(now / before, scalar(STIFFENING))
                    return wp.min(before * ahead, law.unyielded_viscosity(g))
                if now < before:
                    return now
            return wp.sqrt(before * now)
        return now

    return relaxed_viscosity


@functools.cache
def viscosity_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `rates` and `viscosity`, which compute the apparent viscosity of cells and then of edges.

    Both kernels use the magnitude of the whole strain rate tensor. On the staggered grid, shear is defined at edges and
    stretch in cells; a component that is not defined at an edge or in a cell is averaged over the four nearest
    points at which it is defined.
    """
    dims, pairs = of.dimensions, of.pairs
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    whole = mps_types(scalar, dims).whole
    f = grid_functions(scalar, of)
    law = flow_functions(scalar, of)
    relaxed_viscosity = relaxed_viscosity_function(scalar, of)
    with_gain = with_gain_function(scalar, dims)

    @wp.func
    def change(g: Grid, mesh: Fields, c: whole, axis: wp.int32) -> scalar:
        """Return the magnitude of the change of the shear stress over the length of a cell along an axis [Pa].

        The result is a central difference at the corner `c` of a two-dimensional grid. It is averaged over three
        neighbouring corners across this axis, so that oscillations from cell to cell do not amplify themselves.
        """
        sum = scalar(0.0)
        for n in range(3):
            beside = f.moved(c, 1 - axis, n - 1)
            after, before = f.at(g, f.moved(beside, axis, 1)), f.at(g, f.moved(beside, axis, -1))
            sum += wp.where(n == 1, scalar(0.5), scalar(0.25)) * (mesh.stress[after] - mesh.stress[before])
        return scalar(0.5) * wp.abs(sum)

    @wp.func
    def around(g: Grid, mesh: Fields, geometry: Geometry, c: whole, pair: wp.int32) -> scalar:
        """Return the mean of the squared shear rates over those edges of a cell that lie in concrete [1/s2]."""
        sum = scalar(0.0)
        count = scalar(0.0)
        for n in range(4):
            e = f.moved(f.moved(c, first(pair), n % 2), second(pair), n / 2)
            rate, volume = f.shear(g, mesh, geometry, e, pair)
            if volume > scalar(0.0):
                sum += rate * rate
                count += scalar(1.0)
        return sum / wp.max(count, scalar(1.0))

    @wp.kernel(enable_backward=False, module="unique")
    def rates(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, worker: wp.int32, workers: wp.int32
    ):
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        if mesh.liquid[number] == 0 or not f.on_grid(g, c):
            return
        square = scalar(2.0) * wp.length_sq(f.stretch(g, mesh, c))
        if wp.static(of.dimensions == 2):
            mesh.strain_without_pair[number] = square
            square += around(g, mesh, geometry, c, 0)
        else:
            first_pair, second_pair = around(g, mesh, geometry, c, 0), around(g, mesh, geometry, c, 1)
            third = around(g, mesh, geometry, c, 2)
            mesh.strain_without_pair[number] = square + second_pair + third
            mesh.strain_without_pair[number + g.slots] = square + first_pair + third
            mesh.strain_without_pair[number + 2 * g.slots] = square + first_pair + second_pair
            square += first_pair + second_pair + third
        mesh.strain[number] = square
        own = g
        if wp.static(of.thixotropic):
            own = with_gain(g, mesh.gained[number])
        mesh.in_cell[number] = relaxed_viscosity(
            g, mesh.in_cell[number], law.apparent(own, wp.sqrt(square)), wp.sqrt(square)
        )

    @wp.kernel(enable_backward=False, module="unique")
    def viscosity(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, worker: wp.int32, workers: wp.int32
    ):
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for pair in range(pairs):
            place = number + pair * g.slots
            rate, volume = f.shear(g, mesh, geometry, c, pair)
            if volume > scalar(0.0):
                sum = scalar(0.0)
                count = scalar(0.0)
                gained = scalar(0.0)
                for n in range(4):
                    o = f.at(g, f.moved(f.moved(c, first(pair), -(n % 2)), second(pair), -(n / 2)))
                    if mesh.liquid[o] != 0:
                        sum += mesh.strain_without_pair[o + pair * g.slots]
                        if wp.static(of.thixotropic):
                            gained += mesh.gained[o]
                        count += scalar(1.0)
                own = g
                if wp.static(of.thixotropic):
                    own = with_gain(g, gained / wp.max(count, scalar(1.0)))
                total = wp.sqrt(rate * rate + sum / wp.max(count, scalar(1.0)))
                # The correction for the edge of a plug (unyielded concrete) is used in full pipes only. Beside a free
                # surface the stress varies along both axes, and it contains noise from the particles.
                most = scalar(0.0)
                if wp.static(of.periodic and not of.cut):
                    most = wp.max(change(g, mesh, c, 1), change(g, mesh, c, 0))
                mesh.in_corner[place] = relaxed_viscosity(
                    g, mesh.in_corner[place], law.apparent_at_edge(own, total, most), total
                )

    return SimpleNamespace(rates=rates, viscosity=viscosity)


@functools.cache
def friction_function(scalar, of: GridKind):
    """Build `wall_friction`, a function for the friction of a wall that passes between a cell face and the next one.

    The next face follows along the axis `b`. The function returns three values:

    - the friction force against the velocity of the face,
    - the derivative of this force with respect to that velocity,
    - the coefficient of the next face's velocity in the matrix row of the face.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    Fields = grid_structs(scalar, dims).Fields
    whole = mps_types(scalar, dims).whole
    f = grid_functions(scalar, of)

    @wp.func
    def wall_friction(g: Grid, mesh: Fields, c: whole, axis: wp.int32, b: wp.int32, side: wp.int32):
        force = scalar(0.0)
        traction_slope = scalar(0.0)
        coefficient = scalar(0.0)
        lower = f.moved(c, b, side - 1)
        around = b == wp.static(dims - 1 if of.periodic else -1)
        if around or (lower[b] >= -1 and lower[b] < g.n[b]):
            k = (axis * dims + b) * g.slots + f.at(g, lower)
            wall_stiffness = mesh.wall_stiffness[k]
            if wall_stiffness > scalar(0.0):
                share = wp.where(side == 0, mesh.wall_weight[k], scalar(1.0) - mesh.wall_weight[k])
                force = share * mesh.wall_force[k]
                traction_slope = share * share * wall_stiffness
                coefficient = -share * (scalar(1.0) - share) * wall_stiffness
        return force, traction_slope, coefficient

    return wall_friction


@functools.cache
def store_coefficient_function(scalar, serial: bool, of: GridKind):
    """Build `store_coefficient`, which adds the coefficient of a neighbouring face to a row of the matrix.

    If the velocity of the neighbouring face is known, the function adds nothing. It returns the number of coefficients
    in the row.
    """
    Fields = grid_structs(scalar, of.dimensions).Fields
    Matrix = system_structs(scalar).Matrix
    f = grid_functions(scalar, of)
    entry = row_place(serial)

    @wp.func
    def store_coefficient(
        mesh: Fields, matrix: Matrix, r: wp.int32, count: wp.int32, near: wp.int32, c: scalar
    ) -> wp.int32:
        if not f.is_unknown(mesh.kind[near]):
            return count
        place = entry(r, count, matrix.rows, matrix.near_capacity)
        matrix.near[place] = near
        matrix.coefficient[place] = c
        return count + 1

    return store_coefficient


@functools.cache
def momentum_kernel(scalar, serial: bool, of: GridKind):
    """Build the kernel that sets up the implicit solve for the velocities of the faces, with one task per cell.

    The forces on each face at the velocities before the solve are stored as the residual with which the solve starts.
    The matrix has a row for each face. It contains the forces that act implicitly: inertia, viscosity and the friction
    of walls. Pressure, weight and driving force act explicitly, so they are part of the residual only.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    systems = system_structs(scalar)
    Matrix, Solve = systems.Matrix, systems.Solve
    f = grid_functions(scalar, of)
    store_coefficient = store_coefficient_function(scalar, serial, of)
    wall_friction = friction_function(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def momentum(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, matrix: Matrix, viscous: Solve,
        worker: wp.int32, workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        within = f.on_grid(g, c)
        if wp.static(not of.cut):
            if within:
                edge_rate, edge_volume = f.shear(g, mesh, geometry, c, 0)
                if edge_volume > scalar(0.0):
                    # Store the mean of the edge's previous and present shear stress. It is used only for viscosity and
                    # wall stress in the next step. With the present stress alone, the flow would oscillate.
                    mesh.stress[number] = scalar(0.5) * (mesh.stress[number] + edge_rate * mesh.in_corner[number])
        for axis in range(dims):
            r = number + axis * g.slots
            count = wp.int32(0)
            diagonal = scalar(0.0)
            force = scalar(0.0)
            kind = mesh.kind[r]
            # Ghost faces inside a wall at the grid's boundary lie one cell outside the grid.
            is_unknown = (within or wp.static(of.cut)) and f.is_unknown(kind)
            if is_unknown:
                volume = mesh.volume[r]
                mesh.start[r] = mesh.velocity[r]
                low = f.at(g, f.moved(c, axis, -1))
                diagonal = g.density * volume / scalar(mesh.clock[DT])
                if kind == LIQUID:
                    force = f.open_area(g, geometry, c, axis) * (mesh.pressure[low] - mesh.pressure[number])
                    force += volume * g.density * g.gravity[axis]
                    if wp.static(of.periodic):
                        if axis == wp.static(of.dimensions - 1):
                            force += volume * scalar(mesh.drive[FORCE])
                for b in range(dims):
                    for side in range(2):
                        way = wp.where(side == 0, scalar(1.0), scalar(-1.0))
                        next = f.at(g, f.moved(c, b, 2 * side - 1)) + axis * g.slots
                        other = scalar(0.0)
                        if wp.static(of.cut):
                            slowed, grows, coupled = wall_friction(g, mesh, c, axis, b, side)
                            force -= slowed
                            diagonal += grows
                            other = coupled
                        if b == axis:
                            # Along its own axis, a face lies between two cells. Add the force on the face due to the
                            # viscous normal stress in the cell on this `side`, 2 mu times its normal strain rate.
                            along = g.width[axis]
                            cell = f.moved(c, axis, side - 1)
                            o = f.at(g, cell)
                            if mesh.liquid[o] != 0:
                                both = scalar(2.0) * mesh.fill[o] * f.cell_volume(g, cell) * mesh.in_cell[o]
                                if wp.static(of.cut):
                                    both *= geometry.room[o]
                                rates = f.stretch(g, mesh, cell)
                                own = scalar(0.0)
                                if f.has_velocity(mesh.kind[next]):
                                    force -= both * way * rates[axis] / along
                                    own = both / (along * along)
                                    other += own
                                if wp.static(of.axial):
                                    if axis == 0:
                                        half = scalar(0.5) / f.cell_weight(g, cell)
                                        if not f.has_velocity(mesh.kind[next]):
                                            half = scalar(2.0) * half
                                        else:
                                            other -= both * half * half
                                        force -= both * rates[2] * half
                                        own += both * half * half
                                diagonal += own
                        elif wp.static(not of.cut) or f.reached(g, f.moved(c, b, side)):
                            # Along axis b, a face has an edge on either side. Add the force due to the shear at the
                            # edge on this `side`.
                            across = g.width[b]
                            edge = f.moved(c, b, side)
                            pair = axis + b - 1
                            rate, wet = f.shear(g, mesh, geometry, edge, pair)
                            if wet > scalar(0.0):
                                e = f.at(g, edge)
                                both = wet * mesh.in_corner[e + pair * g.slots]
                                force -= both * way * rate / across
                                own = both / (across * across)
                                diagonal += own
                                other += own
                                cross = way * both / (across * g.width[axis])
                                other_axis = b * g.slots
                                count = store_coefficient(mesh, matrix, r, count, e + other_axis, -cross)
                                behind = f.at(g, f.moved(edge, axis, -1)) + other_axis
                                count = store_coefficient(mesh, matrix, r, count, behind, cross)
                        if other != scalar(0.0):
                            count = store_coefficient(mesh, matrix, r, count, next, other)
                if wp.static(not of.cut):
                    area = scalar(0.5) * (mesh.fill[low] + mesh.fill[number]) * mesh.wall_area[r]
                    force -= area * mesh.traction[r]
                    diagonal += area * mesh.traction_slope[r]
            matrix.free[r] = wp.where(is_unknown, 0, 1)
            matrix.near_count[r] = count
            matrix.diagonal[r] = diagonal
            viscous.residual[r] = force

    return momentum
