"""Transfer of velocities from the particles to the faces of the grid, and their extension to faces without particles.

The method is affine particle-in-cell (Jiang et al. 2015), in which each particle carries a velocity and its gradient.
It transfers linear velocity fields without error. `advection.py` transfers velocities from the grid to the particles.
"""

import functools

import warp as wp

from ...common.control import HALTED
from ...common.rows import row_functions
from ..structs import mps_types
from .cells import AIR, FIXED, GHOST, INSIDE, LIQUID, OPEN, SMOOTH, GridKind, grid_parameters_struct, grid_structs, item
from .columns import LANES, column_functions
from .places import grid_functions

LIGHT = wp.constant(0.1)
"""Inertia of a ghost face (an unknown velocity inside a wall), divided by the inertia of a face wholly in concrete."""


@functools.cache
def face_functions(scalar, of: GridKind):
    """Build `kind_of`, which returns the kind of a face, and `needed`, which finds ghost faces.

    A ghost face is a face inside a wall whose velocity is an unknown of the implicit solve.
    """
    dims = of.dimensions
    whole = mps_types(scalar, dims).whole
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    f = grid_functions(scalar, of)

    @wp.func
    def kind_of(g: Grid, mesh: Fields, geometry: Geometry, a: wp.int32, b: wp.int32, r: wp.int32, axis: wp.int32):
        """Return the kind of the face between two cells: AIR, LIQUID, FIXED (side of a wall) or INSIDE (in a wall)."""
        wet = mesh.liquid[a] != 0 or mesh.liquid[b] != 0
        if wp.static(of.cut):
            if geometry.part[r] == scalar(0.0):
                return geometry.shut[r]
            return wp.where(wet, LIQUID, AIR)
        if mesh.solid[a] != OPEN and mesh.solid[b] != OPEN:
            return INSIDE
        if mesh.solid[a] != OPEN or mesh.solid[b] != OPEN:
            return FIXED
        return wp.where(wet, LIQUID, AIR)

    @wp.func
    def needed(g: Grid, mesh: Fields, geometry: Geometry, c: whole, axis: wp.int32) -> wp.bool:
        """Return whether the concrete's deformation depends on the velocity of a face inside a wall.

        The result is true if the wall has friction and there is concrete on either side of the face or at one of its
        edges.
        """
        low = f.at(g, f.moved(c, axis, -1))
        if mesh.solid[f.at(g, c)] == SMOOTH or mesh.solid[low] == SMOOTH:
            return False
        found = mesh.liquid[f.at(g, c)] != 0 or mesh.liquid[low] != 0
        for b in range(dims):
            if b != axis:
                for side in range(2):
                    edge = f.moved(c, b, side)
                    if not found and f.reached(g, edge):
                        found = f.wetness(g, mesh, geometry, edge, axis + b - 1) > scalar(0.0)
        return found

    return kind_of, needed


@functools.cache
def particle_functions(scalar, of: GridKind):
    """Build `from_particles` for a CPU and `at_all_faces` for a GPU, which average the velocities of particles.

    The weights of the particles fall linearly to zero at a distance of one cell from the centre of a face.
    """
    dims, last = of.dimensions, of.dimensions - 1
    t = mps_types(scalar, dims)
    whole, vec = t.whole, t.vec
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields = structs.Fields
    f = grid_functions(scalar, of)
    around, block = 2 * 3**last, 3**dims
    columns = column_functions(scalar, dims, of.periodic)
    add_velocity, pair = columns.add_velocity, columns.pair
    read_vec4 = row_functions(scalar).read_vec4

    @wp.func
    def cell_beside(g: Grid, c: whole, n: wp.int32, axis: wp.int32):
        """Return the `n`-th cell around a cell, or around one of its lower faces, and whether this cell is in the grid.

        The face is the lower side of cell `c` along `axis`; an `axis` of -1 stands for the cell itself. Around a cell
        lie three cells along each axis. Around a face lie only two cells along the axis of the face.
        """
        o = whole()
        there = wp.bool(True)
        rest = wp.where(axis >= 0, n / 2, n)
        for b in range(dims):
            if b == axis:
                o[b] = c[b] + n % 2 - 1
            else:
                o[b] = c[b] + rest % 3 - 1
                rest = rest / 3
            if o[b] < 0 or o[b] >= g.n[b]:
                if wp.static(of.periodic):
                    there = there and b == last
                else:
                    there = False
        return o, there

    @wp.func
    def from_particles(g: Grid, mesh: Fields, c: whole, axis: wp.int32, before: scalar) -> scalar:
        """Return the weighted mean velocity of the particles around a face, or `before` if there are none."""
        place = f.face_middle(g, c, axis)
        length = scalar(g.n[last]) * g.width[last]
        sums = pair()
        for n in range(around):
            o, there = cell_beside(g, c, n, axis)
            if there:
                other = f.at(g, o)
                sums = add_velocity(
                    mesh.columns, mesh.place.shape[0] + LANES, mesh.begin[other], mesh.count[other], place, g.width,
                    length, axis, sums,
                )  # fmt: skip
        if sums[0] > scalar(0.0):
            return sums[1] / sums[0]
        return before

    @wp.func
    def at_all_faces(g: Grid, mesh: Fields, c: whole):
        """Return two sums over particles for each lower face of a cell: the weights, and the weighted velocities.

        Every particle is read only once for all faces of the cell, which saves a GPU a third of the time.
        """
        totals = vec()
        sums = vec()
        length = scalar(g.n[last]) * g.width[last]
        middle = f.face_middle(g, c, 0)
        middle[0] = middle[0] + scalar(0.5) * g.width[0]
        for n in range(block):
            o, there = cell_beside(g, c, n, -1)
            if there:
                other = f.at(g, o)
                for k in range(mesh.count[other]):
                    at = mesh.begin[other] + k
                    particle = read_vec4(mesh.sorted_place, at)
                    d = vec()
                    beside = vec()
                    within = vec()
                    for b in range(dims):
                        d[b] = middle[b] - particle[b]
                        if wp.static(of.periodic):
                            if b == last:
                                d[b] = d[b] - length * wp.round(d[b] / length)
                        # A particle's weight is the product of one factor for each axis. Along the axis of a face, its
                        # distance from the face counts; along the others, its distance from the middle of the cell.
                        beside[b] = wp.max(scalar(1.0) - wp.abs(d[b] / g.width[b] - scalar(0.5)), scalar(0.0))
                        within[b] = wp.max(scalar(1.0) - wp.abs(d[b]) / g.width[b], scalar(0.0))
                    for axis in range(dims):
                        weight = particle[3] * beside[axis]
                        for b in range(dims):
                            if b != axis:
                                weight *= within[b]
                        if weight > scalar(0.0):
                            motion = read_vec4(mesh.sorted_motion, dims * at + axis)
                            own = motion[3] - scalar(0.5) * g.width[axis] * motion[axis]
                            for b in range(dims):
                                own += motion[b] * d[b]
                            totals[axis] = totals[axis] + weight
                            sums[axis] = sums[axis] + weight * own
        return totals, sums

    return from_particles, at_all_faces


@functools.cache
def gather_kernel(scalar, serial: bool, of: GridKind):
    """Build the kernel that determines the kind and volume of each face, and its velocity from nearby particles."""
    dims, last = of.dimensions, of.dimensions - 1
    vec = mps_types(scalar, dims).vec
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry, Walls = structs.Fields, structs.Geometry, structs.Walls
    f = grid_functions(scalar, of)
    kind_of, needed = face_functions(scalar, of)
    from_particles, at_all_faces = particle_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def gather(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, walls: Walls, mesh: Fields, worker: wp.int32,
        workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        if wp.static(of.periodic):
            if c[last] < 0 or c[last] >= g.n[last]:
                return
        totals = vec()
        sums = vec()
        if wp.static(not serial):
            totals, sums = at_all_faces(g, mesh, c)
        for axis in range(dims):
            r = number + axis * g.slots
            kind = INSIDE
            volume = scalar(0.0)
            if c[axis] >= 0:
                low = f.at(g, f.moved(c, axis, -1))
                kind = kind_of(g, mesh, geometry, low, number, r, axis)
                if wp.static(of.cut):
                    if kind == INSIDE and needed(g, mesh, geometry, c, axis):
                        kind = GHOST
                        volume = scalar(LIGHT) * f.face_area(g, c, axis) * g.width[axis]
                if kind == FIXED:
                    if wp.static(of.cut):
                        wall = geometry.surface[r]
                        mesh.velocity[r] = f.wall_speed(walls, wall, f.face_middle(g, c, axis), axis)
                    else:
                        mesh.velocity[r] = walls.velocity[wp.max(mesh.solid[low], mesh.solid[number])][axis]
                if kind == LIQUID:
                    wet = scalar(0.5) * (mesh.fill[low] + mesh.fill[number])
                    volume = wet * f.open_area(g, geometry, c, axis) * g.width[axis]
                if f.is_unknown(kind):
                    if wp.static(serial):
                        mesh.velocity[r] = from_particles(g, mesh, c, axis, mesh.velocity[r])
                    elif totals[axis] > scalar(0.0):
                        mesh.velocity[r] = sums[axis] / totals[axis]
            mesh.kind[r] = kind
            mesh.volume[r] = volume

    return gather


@functools.cache
def extend_kernel(scalar, of: GridKind):
    """Build the kernel that extends velocities to faces in the air and inside walls, from the faces beside them.

    The velocity of a particle near a free surface or a wall is interpolated from faces on both sides, so faces in the
    air and inside walls need velocities, too.

    - If walls are sides of cells, the velocity is extrapolated linearly into the wall from its values at the wall and
      at the face beside it.
    - If walls cut cells, the velocities of ghost faces inside walls are unknowns of the solve instead.

    The kernel runs with one task per cell and extends the velocities by one cell per launch.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    whole = mps_types(scalar, dims).whole
    f = grid_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def extend(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, again: wp.int32, final: wp.int32,
        before: wp.array(dtype=scalar), known_before: wp.array(dtype=wp.int32), after: wp.array(dtype=scalar),
        known_after: wp.array(dtype=wp.int32), worker: wp.int32, workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        stride = whole()
        stride[0] = 1
        for b in range(1, dims):
            stride[b] = stride[b - 1] * (g.n[b - 1] + 2)
        for axis in range(dims):
            r = number + axis * g.slots
            value = mesh.velocity[r]
            good = wp.where(f.has_velocity(mesh.kind[r]), 1, 0)
            if again != 0:
                value = before[r]
                good = known_before[r]
            if good == 0:
                sum = scalar(0.0)
                count = scalar(0.0)
                for n in range(2 * dims):
                    along = n / 2
                    by = 1 - 2 * (n % 2)
                    if c[along] + by >= -1 and c[along] + by <= g.n[along]:
                        o = r + by * stride[along]
                        if wp.static(of.periodic):
                            o = f.at(g, f.moved(c, along, by)) + axis * g.slots
                        if again != 0:
                            if known_before[o] != 0:
                                sum += before[o]
                                count += scalar(1.0)
                        elif mesh.kind[o] == LIQUID:
                            beside = mesh.velocity[o]
                            # Extrapolate the velocity linearly into the wall. Leave out faces at the lower end of the
                            # grid, which have a cell on one side only.
                            if mesh.kind[r] == INSIDE and c[axis] >= 0 and along != axis and wp.static(not of.cut):
                                beside = scalar(2.0) * mesh.slip[o] - beside
                            sum += beside
                            count += scalar(1.0)
                if count > scalar(0.0):
                    value = sum / count
                    good = 1
            after[r] = value
            known_after[r] = good
            if final != 0 and good != 0 and mesh.kind[r] == AIR:
                # Store the extended velocity of this face in the air, because concrete may reach the face before a
                # particle is near enough to determine its velocity.
                mesh.velocity[r] = value

    return extend
