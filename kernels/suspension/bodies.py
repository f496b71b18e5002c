"""Rigid aggregates on the staggered grid of a flow: faces that move with them, and the mortar fraction of samples.

The grid stores one velocity component at each cell face. A face whose centre lies in an aggregate moves with the
aggregate, so its velocity is not an unknown. With the velocity V and the spin w of the aggregate, and the vector d from
its centre to the face, the face's velocity is the component of V + w x d along the face's axis. With P, the matrix that
maps V and w to face velocities, the viscous matrix A of all faces becomes P^T A P. The drag on aggregates follows from
this, without a drag law.

Strain rates belong to samples. A sample is a cell (for stretching) or a cell edge (for shear). In comments on array
shapes, n is the number of aggregates, and `slots` the number of cells, including a frame around the grid.

The grid is filled with mortar everywhere, also inside aggregates. An aggregate adds the difference between its own mass
and that of the mortar in its place, so its weight in mortar does not depend on how the grid resolves its surface.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from ..mps.grid.cells import DT, LIQUID, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import place_functions
from ..mps.structs import mps_types

FULL = wp.constant(1 << 20)
"""Integer that represents the fraction 1 of a sample or of a face.

Tasks add the fractions of aggregates as integers, because a sum of integers does not depend on the order of additions.
"""


@functools.cache
def body_structs(scalar) -> SimpleNamespace:
    """Build the structs `Bodies`, the state of the aggregates, and `Cover`, the parts of the grid that they cover."""
    vec3, mat33, quat = types(scalar).vec3, types(scalar).mat33, types(scalar).quat

    @wp.struct
    class Bodies:
        centre: wp.array(dtype=vec3)  # Centre of each aggregate [m], shape (n,).
        velocity: wp.array(dtype=vec3)  # Velocity of each aggregate's centre [m/s], shape (n,).
        spin: wp.array(dtype=vec3)  # Angular velocity of each aggregate [rad/s], shape (n,).
        turn: wp.array(dtype=quat)  # Orientation of each aggregate, shape (n,).
        radius: wp.array(dtype=scalar)  # Radius of each aggregate, which is a sphere [m], shape (n,).
        # Mass of each aggregate minus that of an equal volume of mortar [kg], and moment of inertia of each aggregate
        # minus that of this mortar [kg m2], each of shape (n,).
        extra_mass: wp.array(dtype=scalar)
        extra_inertia: wp.array(dtype=scalar)
        force: wp.array(dtype=vec3)  # External force on each aggregate, such as weight minus buoyancy [N], shape (n,).
        torque: wp.array(dtype=vec3)  # External torque on each aggregate about its centre [N m], shape (n,).
        # Inverses of each aggregate's diagonal blocks in the reduced viscous matrix, for its velocity and for its spin,
        # each of shape (n,).
        mobility: wp.array(dtype=mat33)
        spin_mobility: wp.array(dtype=mat33)

    @wp.struct
    class Cover:
        # Number of aggregates that contain the centre of each face, and 1 + the largest index of these aggregates, each
        # of shape (3 slots,).
        claims: wp.array(dtype=wp.int32)
        owner: wp.array(dtype=wp.int32)
        # The next two arrays, of shape (3 slots,), describe each face that moves with no aggregate. `closing` is the
        # number of its adjacent cells in which all other faces move with aggregates, all of a cell with the same one.
        # `closer` is the largest index of these aggregates plus 1, or 0 if there are none.
        closing: wp.array(dtype=wp.int32)
        closer: wp.array(dtype=wp.int32)
        # 1 for cells in narrow gaps between two aggregates, or between an aggregate and a wall, whose faces must not
        # move with an aggregate; 0 for all other cells. The shape is (slots,).
        shared: wp.array(dtype=wp.int32)
        # Three arrays of shape (3 slots,), with one entry for each face of the grid: the number of aggregates that
        # cover a part of the face; the largest index of these aggregates, plus 1; and the covered fraction of the
        # face's area as an integer, in units of 1 / FULL.
        touches: wp.array(dtype=wp.int32)
        toucher: wp.array(dtype=wp.int32)
        covered: wp.array(dtype=wp.int32)
        # Fraction of each sample that aggregates fill, times FULL, shape (4 slots,). Cells come first, followed by the
        # edges for shear in the planes of the three pairs of axes.
        solid: wp.array(dtype=wp.int32)
        first: wp.array(dtype=wp.int32)  # Index in `faces` of each aggregate's first face, shape (n + 1,).
        count: wp.array(dtype=wp.int32)  # Number of the grid's faces that move with each aggregate, shape (n,).
        # Number of entries of each aggregate in `faces`, shape (n,).
        touched: wp.array(dtype=wp.int32)
        # Indices of the grid's faces that aggregates cover, sorted by aggregate. For each aggregate, the faces that
        # move with it come first, followed by the faces that it covers partly.
        faces: wp.array(dtype=wp.int32)
        # Fraction of the area of each face in `faces` that the aggregate covers. It is 1 for faces that move with the
        # aggregate.
        part: wp.array(dtype=scalar)
        # Vector from the centre of the aggregate to the centre of each face in `faces` [m].
        lever: wp.array(dtype=vec3)

    return SimpleNamespace(Bodies=Bodies, Cover=Cover)


@functools.cache
def body_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions for an aggregate on the grid, such as its face velocities and the mortar fraction of samples."""
    t = mps_types(scalar, 3)
    vec, whole = t.vec, t.whole
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    places = place_functions(scalar, of)

    @wp.func
    def nearest_image(g: Grid, d: vec) -> vec:
        """Return the vector `d` from one point to another.

        In a periodic pipe, return the vector to the nearest copy of the other point.
        """
        if wp.static(of.periodic):
            length = scalar(g.n[2]) * g.width[2]
            d[2] = d[2] - length * wp.round(d[2] / length)
        return d

    @wp.func
    def lever(g: Grid, bodies: Bodies, b: wp.int32, r: wp.int32) -> vec:
        """Return the vector from the centre of an aggregate to the centre of a face [m]."""
        axis = r / g.slots
        return nearest_image(g, places.face_middle(g, places.cell(g, r - axis * g.slots), axis) - bodies.centre[b])

    @wp.func
    def carried(velocity: vec, spin: vec, d: vec, axis: wp.int32) -> scalar:
        """Return the component along `axis` of the velocity of a point of a rigid body.

        `d` is the vector from the body's centre to the point.
        """
        return (velocity + wp.cross(spin, d))[axis]

    @wp.func
    def box(g: Grid, bodies: Bodies, b: wp.int32):
        """Return the lowest and the highest indices along each axis of the cells that an aggregate may touch."""
        low = whole()
        high = whole()
        for axis in range(3):
            x = (bodies.centre[b][axis] - g.origin[axis]) / g.width[axis]
            reach = bodies.radius[b] / g.width[axis]
            low[axis] = wp.int32(wp.floor(x - reach)) - 1
            high[axis] = wp.int32(wp.floor(x + reach)) + 1
            if axis < 2 or wp.static(not of.periodic):
                low[axis] = wp.max(low[axis], 0)
                high[axis] = wp.min(high[axis], g.n[axis])
        return low, high

    @wp.func
    def sample_middle(g: Grid, c: whole, sample: wp.int32) -> vec:
        """Return the midpoint of cell `c` if `sample` is 0, or of its lowest edge for the pair of axes `sample` - 1."""
        x = vec()
        for axis in range(3):
            on_edge = (sample == 1 and axis < 2) or (sample == 2 and axis != 1) or (sample == 3 and axis > 0)
            x[axis] = g.origin[axis] + (scalar(c[axis]) + wp.where(on_edge, scalar(0.0), scalar(0.5))) * g.width[axis]
        return x

    @wp.func
    def solid_part(g: Grid, bodies: Bodies, b: wp.int32, middle: vec) -> scalar:
        """Return the fraction of a cell-sized box about `middle` that lies in an aggregate.

        The box is divided into 27 smaller boxes. In each of them, a plane approximates the surface of the aggregate.
        """
        d = middle - bodies.centre[b]
        radius = bodies.radius[b]
        half = scalar(0.5) * wp.length(g.width)
        away = wp.length(d) - radius
        if away > half:
            return scalar(0.0)
        if away < -half:
            return scalar(1.0)
        sum = scalar(0.0)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    x = d + wp.cw_mul(vec(scalar(i - 1), scalar(j - 1), scalar(k - 1)), g.width) / scalar(3.0)
                    size = wp.max(wp.length(x), scalar(1.0e-6) * radius)
                    # Length of a smaller box, a third of the cell-sized box along each axis, measured along the normal
                    # of the aggregate's surface.
                    extent = wp.dot(wp.abs(x), g.width) / (size * scalar(3.0))
                    sum += wp.clamp(scalar(0.5) - (size - radius) / extent, scalar(0.0), scalar(1.0))
        return sum / scalar(27.0)

    @wp.func
    def covered_part(g: Grid, bodies: Bodies, b: wp.int32, middle: vec, axis: wp.int32) -> scalar:
        """Return the fraction of a face's area that lies in an aggregate; `middle` is the face's centre.

        The face is divided into 9 rectangles. In each of them, a line approximates the outline of the aggregate.
        """
        d = middle - bodies.centre[b]
        radius = bodies.radius[b]
        if wp.abs(wp.length(d) - radius) > wp.length(g.width):
            return wp.where(wp.length(d) < radius, scalar(1.0), scalar(0.0))
        one, two = (axis + 1) % 3, (axis + 2) % 3
        sum = scalar(0.0)
        for i in range(3):
            for j in range(3):
                x = d
                x[one] = x[one] + scalar(i - 1) * g.width[one] / scalar(3.0)
                x[two] = x[two] + scalar(j - 1) * g.width[two] / scalar(3.0)
                size = wp.max(wp.length(x), scalar(1.0e-6) * radius)
                extent = (wp.abs(x[one]) * g.width[one] + wp.abs(x[two]) * g.width[two]) / (size * scalar(3.0))
                extent = wp.max(extent, scalar(1.0e-3) * g.width[one])
                sum += wp.clamp(scalar(0.5) - (size - radius) / extent, scalar(0.0), scalar(1.0))
        return sum / scalar(9.0)

    @wp.func
    def mortar_part(g: Grid, cover: Cover, number: wp.int32, sample: wp.int32) -> scalar:
        """Return the mortar fraction of a sample; `sample` is 0 for a cell and 1 + the pair of axes for an edge."""
        filled = scalar(cover.solid[number + sample * g.slots]) / scalar(FULL)
        return wp.max(scalar(1.0) - filled, scalar(0.0))

    return SimpleNamespace(
        lever=lever, carried=carried, box=box, sample_middle=sample_middle, solid_part=solid_part,
        covered_part=covered_part, mortar_part=mortar_part, nearest_image=nearest_image,
    )  # fmt: skip


@functools.cache
def cover_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels that find the faces and samples that aggregates cover.

    - `clear` deletes the results of the previous step, with one task per sample.
    - `claim` marks covered faces and adds up the fractions of samples that aggregates fill, with one task per
      aggregate.
    - `collect` lists the faces of each aggregate, with one task per aggregate. It runs after the kernels of
      `release_kernels`.
    """
    whole = mps_types(scalar, 3).whole
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Fields = grid_structs(scalar, 3).Fields
    places, f = place_functions(scalar, of), body_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def clear(g: Grid, cover: Cover):
        k = wp.tid()
        cover.solid[k] = 0
        if k < 3 * g.slots:
            cover.owner[k] = 0
            cover.claims[k] = 0
            cover.touches[k] = 0
            cover.closing[k] = 0
            cover.closer[k] = 0
            cover.toucher[k] = 0
            cover.covered[k] = 0

    @wp.kernel(enable_backward=False, module="unique")
    def claim(g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, mesh: Fields, cover: Cover):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        low, high = f.box(g, bodies, b)
        for k in range(low[2], high[2] + 1):
            for j in range(low[1], high[1] + 1):
                for i in range(low[0], high[0] + 1):
                    c = whole(i, j, k)
                    number = places.at(g, c)
                    for axis in range(3):
                        middle = places.face_middle(g, c, axis)
                        r = number + axis * g.slots
                        if mesh.kind[r] == LIQUID:
                            if wp.length(middle - bodies.centre[b]) < bodies.radius[b]:
                                wp.atomic_add(cover.claims, r, 1)
                                wp.atomic_max(cover.owner, r, b + 1)
                            area = wp.int32(f.covered_part(g, bodies, b, middle, axis) * scalar(FULL))
                            if area > 0:
                                wp.atomic_add(cover.touches, r, 1)
                                wp.atomic_max(cover.toucher, r, b + 1)
                                wp.atomic_add(cover.covered, r, area)
                    for sample in range(4):
                        part = f.solid_part(g, bodies, b, f.sample_middle(g, c, sample))
                        if part > scalar(0.0):
                            wp.atomic_add(cover.solid, number + sample * g.slots, wp.int32(part * scalar(FULL)))

    @wp.kernel(enable_backward=False, module="unique")
    def collect(g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, cover: Cover):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        count = wp.int32(0)
        low, high = f.box(g, bodies, b)
        # List the faces axis by axis, in the order in which arrays of faces store them.
        for axis in range(3):
            for k in range(low[2], high[2] + 1):
                for j in range(low[1], high[1] + 1):
                    for i in range(low[0], high[0] + 1):
                        r = places.at(g, whole(i, j, k)) + axis * g.slots
                        if cover.owner[r] == b + 1:
                            cover.faces[cover.first[b] + count] = r
                            cover.part[cover.first[b] + count] = scalar(1.0)
                            cover.lever[cover.first[b] + count] = f.lever(g, bodies, b, r)
                            count += 1
        cover.count[b] = count
        for axis in range(3):
            for k in range(low[2], high[2] + 1):
                for j in range(low[1], high[1] + 1):
                    for i in range(low[0], high[0] + 1):
                        r = places.at(g, whole(i, j, k)) + axis * g.slots
                        # If two aggregates cover parts of a face, list the face for neither of them.
                        if cover.claims[r] == 0 and cover.touches[r] == 1 and cover.toucher[r] == b + 1:
                            cover.faces[cover.first[b] + count] = r
                            cover.part[cover.first[b] + count] = scalar(cover.covered[r]) / scalar(FULL)
                            cover.lever[cover.first[b] + count] = f.lever(g, bodies, b, r)
                            count += 1
        cover.touched[b] = count

    return SimpleNamespace(clear=clear, claim=claim, collect=collect)


@functools.cache
def release_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels that decide which faces in narrow gaps between aggregates and walls move with an aggregate.

    They are launched in the order `close`, `shut`, `share`, `release`. `shut` runs with one task per face, the others
    with one task per cell.
    """
    Grid = grid_parameters_struct(scalar, 3)
    Cover = body_structs(scalar).Cover
    Fields = grid_structs(scalar, 3).Fields
    places = place_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def close(g: Grid, flags: wp.array(dtype=wp.int32), mesh: Fields, cover: Cover):
        """Find cells of which all faces but one move with the same aggregate, and mark the remaining face.

        Mortar is incompressible, so the remaining face has the aggregate's velocity anyway. The result is stored in
        `closing` and `closer`, because other tasks of this kernel still read `claims` and `owner`.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        if mesh.liquid[number] == 0:
            return
        c = places.cell(g, number)
        owner = wp.int32(0)
        left = wp.int32(-1)
        free = wp.int32(0)
        for axis in range(3):
            for side in range(2):
                r = places.at(g, places.moved(c, axis, side)) + axis * g.slots
                own = cover.owner[r]
                if own == 0 or mesh.kind[r] != LIQUID:
                    free += 1
                    left = r
                elif owner == 0 or own == owner:
                    owner = own
                else:
                    free += 2
        if free == 1 and owner != 0 and mesh.kind[left] == LIQUID:
            wp.atomic_add(cover.closing, left, 1)
            wp.atomic_max(cover.closer, left, owner)

    @wp.kernel(enable_backward=False, module="unique")
    def shut(g: Grid, flags: wp.array(dtype=wp.int32), cover: Cover):
        """Let the faces that `close` has marked move with their aggregate."""
        if flags[HALTED] != 0:
            return
        r = wp.tid()
        if cover.closing[r] > 0:
            cover.claims[r] = cover.claims[r] + cover.closing[r]
            cover.owner[r] = cover.closer[r]

    @wp.kernel(enable_backward=False, module="unique")
    def share(g: Grid, flags: wp.array(dtype=wp.int32), mesh: Fields, cover: Cover):
        """Find the cells that would prevent two aggregates, or an aggregate and a wall, from moving apart.

        In such a cell, two faces move with different aggregates, or the centre of a face lies in two aggregates, or
        each face moves with an aggregate or belongs to a wall.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = places.cell(g, number)
        found = wp.int32(0)
        shared = wp.int32(0)
        free = wp.int32(0)
        closed = wp.int32(0)
        if mesh.liquid[number] != 0:
            for axis in range(3):
                for side in range(2):
                    r = places.at(g, places.moved(c, axis, side)) + axis * g.slots
                    own = cover.owner[r]
                    if own != 0:
                        if cover.claims[r] > 1 or (found != 0 and own != found):
                            shared = 1
                        found = own
                    elif mesh.kind[r] == LIQUID:
                        free += 1
                    else:
                        closed += 1
            if found != 0 and free == 0 and closed > 0:
                shared = 1
        cover.shared[number] = shared

    @wp.kernel(enable_backward=False, module="unique")
    def release(g: Grid, flags: wp.array(dtype=wp.int32), cover: Cover):
        """Release the faces of the cells that `share` has found: their velocities become unknowns again.

        If all faces of a cell moved with two aggregates, mortar could neither enter nor leave the cell, and the
        aggregates would stick together.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = places.cell(g, number)
        for axis in range(3):
            r = number + axis * g.slots
            if cover.owner[r] != 0:
                if cover.shared[number] != 0 or cover.shared[places.at(g, places.moved(c, axis, -1))] != 0:
                    cover.owner[r] = 0

    return SimpleNamespace(close=close, shut=shut, share=share, release=release)


@functools.cache
def motion_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `carry` and `move`, with one task per aggregate.

    `carry` sets the velocities of the faces that move with an aggregate. `move` moves and turns the aggregate by one
    time step.
    """
    vec, quat = mps_types(scalar, 3).vec, types(scalar).quat
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Fields = grid_structs(scalar, 3).Fields
    f = body_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def carry(g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, cover: Cover, mesh: Fields):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        for k in range(cover.count[b]):
            place = cover.first[b] + k
            r = cover.faces[place]
            mesh.velocity[r] = f.carried(bodies.velocity[b], bodies.spin[b], cover.lever[place], r / g.slots)

    @wp.kernel(enable_backward=False, module="unique")
    def move(g: Grid, flags: wp.array(dtype=wp.int32), mesh: Fields, bodies: Bodies):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        x = bodies.centre[b] + dt * (bodies.velocity[b] - vec(scalar(0.0), scalar(0.0), g.frame))
        if wp.static(of.periodic):
            length = scalar(g.n[2]) * g.width[2]
            x[2] = x[2] - length * wp.floor((x[2] - g.origin[2]) / length)
        bodies.centre[b] = x
        angle = dt * bodies.spin[b]
        size = wp.length(angle)
        if size > scalar(0.0):
            bodies.turn[b] = wp.normalize(wp.mul(wp.quat_from_axis_angle(angle / size, size), quat(bodies.turn[b])))

    return SimpleNamespace(carry=carry, move=move)
