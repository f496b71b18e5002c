"""Rigid aggregates on the staggered grid of a flow: their shapes and motion, and the faces that move with them.

An aggregate is a sphere or a clump, a rigid body of several spheres that may overlap. `cover.py` finds the parts of the
grid that aggregates cover.

The grid stores one velocity component at each cell face. A face whose centre lies in an aggregate moves with the
aggregate, so its velocity is not an unknown. With the velocity V and the spin w of the aggregate, and the vector d from
its centre to the face, the face's velocity is the component of V + w x d along the face's axis. With P, the matrix that
maps V and w to face velocities, the viscous matrix A of all faces becomes P^T A P. The drag on aggregates follows from
this, without a drag law.

The places at which strain rates are computed are called samples: the cells (for stretching) and the cell edges (for
shear). In comments on array shapes, n is the number of aggregates, and `cells` the number of cells, including a frame
around the grid.

The grid is filled with mortar everywhere, also inside aggregates. An aggregate adds its own mass minus the mass of the
mortar in its place, so its weight in mortar does not depend on how the grid resolves its surface.
"""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from ..mps.grid.cells import DT, VELOCITY_CORRECTION, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import place_functions
from ..mps.structs import mps_types

FULL = wp.constant(1 << 20)
"""Integer that represents the fraction 1, of a face or of a sample (a cell or a cell edge).

Tasks add the fractions that aggregates cover as integers, because a sum of integers does not depend on the order of
additions.
"""

SEARCH_LOOPS, COVER_LOOPS = {"max_unroll": 2}, {"max_unroll": 3}
"""Warp options of two groups of kernels. Kernels with SEARCH_LOOPS search for walls. Kernels with COVER_LOOPS find the
parts of cells that aggregates cover.

Warp unrolls loops of at most `max_unroll` iterations. With Warp's default, 16, these kernels have up to 784 copies of
their innermost function. NVIDIA's compiler takes two minutes for each of them. With these options it takes 1.5 s (11 s
for the parts of cells that clumps cover). If the second option were 2 as well, a CPU would take five times as long to
run these kernels.
"""


class BodyKind(NamedTuple):
    """Properties of aggregates for which kernels are specialised."""

    clumps: bool = False
    """True if aggregates may consist of several spheres; False if each aggregate is one sphere."""
    friction: bool = False
    """True if friction acts where aggregates touch each other or a wall."""

    @property
    def turning(self) -> bool:
        """Return whether forces between neighbours exert torques on aggregates."""
        return self.clumps or self.friction


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
        radius: wp.array(dtype=scalar)  # Radius of the sphere with each aggregate's volume [m], shape (n,).

        # Mass of each aggregate minus the mass of the mortar in its place [kg], and moment of inertia of each aggregate
        # minus the moment of inertia of this mortar [kg m2], each of shape (n,).
        extra_mass: wp.array(dtype=scalar)
        extra_inertia: wp.array(dtype=scalar)
        force: wp.array(dtype=vec3)  # External force on each aggregate, such as weight minus buoyancy [N], shape (n,).
        torque: wp.array(dtype=vec3)  # External torque on each aggregate about its centre [N m], shape (n,).

        # Inverses of each aggregate's diagonal blocks in the reduced viscous matrix, for its velocity and for its spin,
        # each of shape (n,).
        mobility: wp.array(dtype=mat33)
        spin_mobility: wp.array(dtype=mat33)

        # Mean viscous resistance of the faces that move with each aggregate [kg/s], shape (n,): the viscous force on
        # the aggregate per velocity if all other faces are at rest, divided by the number of its faces along an axis.
        resistance: wp.array(dtype=scalar)
        # The following arrays describe clumps; they are empty if each aggregate is a sphere. The number of spheres of
        # all aggregates is m.
        first: wp.array(dtype=wp.int32)  # Index of each aggregate's first sphere, shape (n + 1,).
        body: wp.array(dtype=wp.int32)  # Index of the aggregate to which each sphere belongs, shape (m,).
        size: wp.array(dtype=scalar)  # Radius of each sphere [m], shape (m,).

        # Volume of each sphere, without those parts of overlaps that are counted with other spheres [m3], shape (m,).
        share: wp.array(dtype=scalar)
        # Vector from the centre of the aggregate to the centre of each sphere [m], shape (m,): `offset` along the
        # principal axes of the aggregate, and `arm` along the axes of the grid.
        offset: wp.array(dtype=vec3)
        arm: wp.array(dtype=vec3)
        # Principal moments of inertia of each aggregate, divided by its mass [m2], shape (n,).
        moments: wp.array(dtype=vec3)
        # Inertia tensor of each aggregate minus the inertia tensor of the mortar in its place, along the axes of the
        # grid [kg m2], shape (n,).
        tensor: wp.array(dtype=mat33)
        # Torque that keeps the angular momentum of each aggregate constant while its inertia tensor turns [N m], shape
        # (n,).
        gyration: wp.array(dtype=vec3)

    @wp.struct
    class Cover:
        # Number of aggregates that contain the centre of each face, and 1 + the largest index of these aggregates, each
        # of shape (3 * cells,).
        claims: wp.array(dtype=wp.int32)
        owner: wp.array(dtype=wp.int32)
        # The next two arrays, of shape (3 * cells,), describe each face that moves with no aggregate. `closing` is the
        # number of its adjacent cells in which all other faces move with one and the same aggregate. `closer` is 1 +
        # the largest index of these aggregates, or 0 if there are no such cells.
        closing: wp.array(dtype=wp.int32)
        closer: wp.array(dtype=wp.int32)
        # 1 for cells in narrow gaps between two aggregates, or between an aggregate and a wall, whose faces must not
        # move with an aggregate; 0 for all other cells. The shape is (cells,).
        shared: wp.array(dtype=wp.int32)
        # Three arrays of shape (3 * cells,), with one entry for each face of the grid: the number of aggregates that
        # cover a part of the face; the largest index of these aggregates, plus 1; and the covered fraction of the
        # face's area as an integer, in units of 1 / FULL.
        touches: wp.array(dtype=wp.int32)
        toucher: wp.array(dtype=wp.int32)
        covered: wp.array(dtype=wp.int32)
        # Fraction of each sample that aggregates fill, times FULL, shape (4 * cells,). Cells come first, followed by
        # the edges for shear in the planes of the three pairs of axes.
        solid: wp.array(dtype=wp.int32)
        first: wp.array(dtype=wp.int32)  # Index in `faces` of each aggregate's first face, shape (n + 1,).
        count: wp.array(dtype=wp.int32)  # Number of the grid's faces that move with each aggregate, shape (n,).

        # Number of entries of each aggregate in `faces`, shape (n,).
        touched: wp.array(dtype=wp.int32)
        # Indices of the grid's faces that aggregates cover, sorted by aggregate, shape (entries,). For each aggregate,
        # the faces that move with it come first, followed by the faces that it covers partly.
        faces: wp.array(dtype=wp.int32)
        # Fraction of the area of each face in `faces` that the aggregate covers, shape (entries,). It is 1 for faces
        # that move with the aggregate.
        part: wp.array(dtype=scalar)
        # Vector from the centre of the aggregate to the centre of each face in `faces` [m], shape (entries,).
        lever: wp.array(dtype=vec3)

    return SimpleNamespace(Bodies=Bodies, Cover=Cover)


@functools.cache
def shape_functions(scalar, kind: BodyKind) -> SimpleNamespace:
    """Build functions that return properties of an aggregate's spheres, such as centre, radius and velocity.

    If each aggregate is one sphere, a sphere has the same index as its aggregate.
    """
    t = types(scalar)
    vec, mat33, quat = t.vec3, t.mat33, t.quat
    Bodies = body_structs(scalar).Bodies

    @wp.func
    def first(bodies: Bodies, b: wp.int32) -> wp.int32:
        """Return the index of an aggregate's first sphere."""
        if wp.static(kind.clumps):
            return bodies.first[b]
        return b

    @wp.func
    def end(bodies: Bodies, b: wp.int32) -> wp.int32:
        """Return 1 + the index of an aggregate's last sphere."""
        if wp.static(kind.clumps):
            return bodies.first[b + 1]
        return b + 1

    @wp.func
    def body(bodies: Bodies, s: wp.int32) -> wp.int32:
        """Return the index of the aggregate to which a sphere belongs."""
        if wp.static(kind.clumps):
            return bodies.body[s]
        return s

    @wp.func
    def radius(bodies: Bodies, s: wp.int32) -> scalar:
        """Return the radius of a sphere [m]."""
        if wp.static(kind.clumps):
            return bodies.size[s]
        return bodies.radius[s]

    @wp.func
    def centre(bodies: Bodies, s: wp.int32) -> vec:
        """Return the centre of a sphere [m]."""
        if wp.static(kind.clumps):
            return bodies.centre[bodies.body[s]] + bodies.arm[s]
        return bodies.centre[s]

    @wp.func
    def velocity(
        bodies: Bodies, linear: wp.array(dtype=vec), angular: wp.array(dtype=vec), start: wp.int32, s: wp.int32
    ) -> vec:
        """Return the velocity of a sphere's centre, from velocities and spins of aggregates.

        The velocities and spins begin at the index `start` of `linear` and `angular`.
        """
        if wp.static(kind.clumps):
            b = bodies.body[s]
            return linear[start + b] + wp.cross(angular[start + b], bodies.arm[s])
        return linear[start + s]

    @wp.func
    def nearest(bodies: Bodies, b: wp.int32, d: vec):
        """Return the vector from a sphere's centre to a point, and the radius of the sphere.

        Among the spheres of an aggregate, the function chooses the sphere whose surface is nearest to the point, or the
        sphere in which the point lies deepest. `d` is the vector from the aggregate's centre to the point.
        """
        x = d
        size = bodies.radius[b]
        if wp.static(kind.clumps):
            least = scalar(1.0e30)
            for s in range(bodies.first[b], bodies.first[b + 1]):
                to = d - bodies.arm[s]
                gap = wp.length(to) - bodies.size[s]
                if gap < least:
                    least = gap
                    x = to
                    size = bodies.size[s]
        return x, size

    @wp.func
    def exposed(bodies: Bodies, s: wp.int32, n: vec) -> wp.bool:
        """Return whether the point of a sphere's surface in the direction `n` is on the surface of the aggregate.

        Otherwise the point lies within another sphere of the aggregate.
        """
        free = wp.bool(True)
        if wp.static(kind.clumps):
            b = bodies.body[s]
            point = bodies.arm[s] + bodies.size[s] * n
            for o in range(bodies.first[b], bodies.first[b + 1]):
                if o != s and wp.length(point - bodies.arm[o]) < bodies.size[o]:
                    free = False
        return free

    @wp.func
    def tensor(bodies: Bodies, b: wp.int32) -> mat33:
        """Return an aggregate's inertia tensor minus the inertia tensor of the mortar in its place [kg m2].

        The components are along the axes of the grid.
        """
        turn = wp.quat_to_matrix(quat(bodies.turn[b]))
        return turn * wp.diag(bodies.extra_mass[b] * bodies.moments[b]) * wp.transpose(turn)

    if kind.clumps:

        @wp.func
        def inertia(bodies: Bodies, b: wp.int32):
            return bodies.tensor[b]
    else:

        @wp.func
        def inertia(bodies: Bodies, b: wp.int32):
            return bodies.extra_inertia[b]

    return SimpleNamespace(
        first=first, end=end, body=body, radius=radius, centre=centre, velocity=velocity, nearest=nearest,
        exposed=exposed, tensor=tensor, inertia=inertia,
    )  # fmt: skip


@functools.cache
def body_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions for an aggregate on the grid, such as its face velocities and the mortar fraction of a cell."""
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
    def sample_middle(g: Grid, c: whole, sample: wp.int32) -> vec:
        """Return the midpoint of a sample: of cell `c` (`sample` 0), or of its edge for pair of axes `sample` - 1."""
        x = vec()
        for axis in range(3):
            on_edge = (sample == 1 and axis < 2) or (sample == 2 and axis != 1) or (sample == 3 and axis > 0)
            x[axis] = g.origin[axis] + (scalar(c[axis]) + wp.where(on_edge, scalar(0.0), scalar(0.5))) * g.width[axis]
        return x

    @wp.func
    def mortar_part(g: Grid, cover: Cover, number: wp.int32, sample: wp.int32) -> scalar:
        """Return the mortar fraction of a cell (`sample` 0), or of its edge for pair of axes `sample` - 1."""
        filled = scalar(cover.solid[number + sample * g.slots]) / scalar(FULL)
        return wp.max(scalar(1.0) - filled, scalar(0.0))

    return SimpleNamespace(
        lever=lever, carried=carried, sample_middle=sample_middle, mortar_part=mortar_part, nearest_image=nearest_image
    )


@functools.cache
def motion_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `carry`, `move` and `hasten`, with one task per aggregate.

    - `carry` sets the velocities of the faces that move with an aggregate.
    - `move` moves and turns the aggregate by one time step.
    - `hasten` adds the correction that keeps the mean velocity along a periodic pipe constant to the velocity of the
      aggregate.
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

    @wp.kernel(enable_backward=False, module="unique")
    def hasten(flags: wp.array(dtype=wp.int32), mesh: Fields, bodies: Bodies):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        velocity = bodies.velocity[b]
        velocity[2] = velocity[2] + scalar(mesh.drive[VELOCITY_CORRECTION])
        bodies.velocity[b] = velocity

    return SimpleNamespace(carry=carry, move=move, hasten=hasten)


@functools.cache
def pose_kernel(scalar):
    """Build the kernel that turns the spheres and the inertia of each clump with its orientation.

    The kernel runs with one task per aggregate.
    """
    vec, quat = types(scalar).vec3, types(scalar).quat
    Bodies, shape = body_structs(scalar).Bodies, shape_functions(scalar, BodyKind(clumps=True))

    @wp.kernel(enable_backward=False, module="unique")
    def pose(flags: wp.array(dtype=wp.int32), bodies: Bodies):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            bodies.arm[s] = wp.quat_rotate(quat(bodies.turn[b]), vec(bodies.offset[s]))
        tensor = shape.tensor(bodies, b)
        bodies.tensor[b] = tensor
        bodies.gyration[b] = -wp.cross(bodies.spin[b], tensor * bodies.spin[b])

    return pose
