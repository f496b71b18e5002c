"""Types, numbers, arrays and small functions that the kernels of the moving particle method share.

One source serves two and three dimensions. The last coordinate runs along the pipe, the others across it; places are
counted from the piston, velocities are those of the room.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import SPAN, types

# What failed, as `flags[FAILED]` of `common.control` has it.
VISCOSITY = 1
PRESSURE = 2
DENSITY = 3
LOST = 4  # a particle is not a number, or far outside


@functools.cache
def mps_types(scalar, dimensions: int) -> SimpleNamespace:
    """`vec` and `mat` of one precision in two or three dimensions, and `whole` numbers as many."""
    double = scalar is wp.float64
    if dimensions == 2:
        vec, mat = (wp.vec2d, wp.mat22d) if double else (wp.vec2f, wp.mat22f)
        return SimpleNamespace(vec=vec, mat=mat, whole=wp.vec2i)
    vec, mat = (wp.vec3d, wp.mat33d) if double else (wp.vec3f, wp.mat33f)
    return SimpleNamespace(vec=vec, mat=mat, whole=wp.vec3i)


@functools.cache
def flow_struct(scalar):
    """Numbers of a flow."""

    @wp.struct
    class Flow:
        count: wp.int32  # fluid particles
        spacing: scalar  # l0 [m]
        cutoff: scalar  # reach of gradient, divergence and Laplacian [m]
        wide: scalar  # reach of the density [m]
        lattice_number: scalar  # sum of weights inside the lattice
        lattice_density: scalar  # sum of density weights inside the lattice
        radius: scalar  # of the pipe, or half the channel's width [m]
        highest: scalar  # place along the pipe beyond which a particle is lost [m]
        piston_speed: scalar  # [m/s]
        gravity: scalar  # along the pipe, against the flow [m/s2]
        dt: scalar  # [s]
        density: scalar  # reference of the pressure's equation [kg/m3]
        viscosity: scalar  # plastic [Pa s]
        yield_stress: scalar  # [Pa]
        regularisation: scalar  # beta [s]
        slip_viscosity: scalar  # eta_L [Pa s/m]
        slip_yield: scalar  # tau_L0 [Pa]
        correction: scalar  # part of the density's error that a step takes away
        skin: scalar  # of the lists [m]

    return Flow


@functools.cache
def array_structs(scalar, dimensions: int) -> SimpleNamespace:
    """Structs `Particles`, `Lists`, `Fields`, `Grains`, `Coarse`, `Matrix`, and `Solve` of vectors and of numbers."""
    t = mps_types(scalar, dimensions)
    vec3, mat33 = types(scalar).vec3, types(scalar).mat33

    @wp.struct
    class Particles:
        position: wp.array(dtype=t.vec)  # from the piston's middle [m], shape (n,) as the rest
        rounding: wp.array(dtype=t.vec)  # what rounding took from the position so far [m]
        velocity: wp.array(dtype=t.vec)  # in the room [m/s]
        pressure: wp.array(dtype=scalar)  # [Pa]
        density: wp.array(dtype=scalar)  # of two phases [kg/m3]; one phase has no rows
        group: wp.array(dtype=wp.int32)  # grain of coarse aggregate, -1 for mortar; one phase has no rows

    @wp.struct
    class Lists:
        near_capacity: wp.int32  # entries that there is room for in a row
        far_capacity: wp.int32
        wall_capacity: wp.int32
        near_count: wp.array(dtype=wp.int32)  # entries in a row, shape (n,)
        near: wp.array(dtype=wp.int32)  # fluid particles within the operators' reach, shape (n * near_capacity,)
        far_count: wp.array(dtype=wp.int32)
        far: wp.array(dtype=wp.int32)  # those that only the density sees, shape (n * far_capacity,)
        wall_count: wp.array(dtype=wp.int32)
        wall: wp.array(dtype=wp.int32)  # particles of the walls, shape (n * wall_capacity,)
        wall_position: wp.array(dtype=t.vec)  # of those [m], shape (wall particles,)

    @wp.struct
    class Fields:
        pair_weight: wp.array(dtype=scalar)  # of an entry of `near`, over the distance squared [1/m2]
        fluid_inverse: wp.array(dtype=t.mat)  # of the moment matrix of fluid neighbours [1/m2], shape (n,) as the rest
        whole_inverse: wp.array(dtype=t.mat)  # of that of all neighbours [1/m2]
        inverse_number: wp.array(dtype=scalar)  # factor of the Laplacian
        wall_weight: wp.array(dtype=scalar)  # area of wall that a particle stands for over its volume, unscaled [1/m]
        wall_scale: wp.array(dtype=wp.float64)  # factor that makes all these areas that of the wall, shape (1,)
        viscosity: wp.array(dtype=scalar)  # apparent [Pa s]
        compliance: wp.array(dtype=scalar)  # velocity from wall to particle over the wall's stress [m/s/Pa]
        predicted: wp.array(dtype=scalar)  # filtered pressure of the step before [Pa]
        traction: wp.array(dtype=scalar)  # the wall's stress [Pa]
        increment: wp.array(dtype=scalar)  # of the pressure in this step [Pa]
        potential: wp.array(dtype=scalar)  # whose slope moves particles off crowds [m2]
        moved: wp.array(dtype=t.vec)  # displacement of this step besides that by velocity [m]
        built: wp.array(dtype=t.vec)  # position when the lists were built [m]
        late: wp.array(dtype=wp.int32)  # 1 if a particle outgrew the lists, 1 if one is lost, shape (2,)

    @wp.struct
    class Grains:
        first: wp.array(dtype=wp.int32)  # particle of each grain, and the end of the last, shape (grains + 1,)
        offset: wp.array(dtype=t.vec)  # of its particles from its middle at the start [m], shape (grain particles,)
        middle: wp.array(dtype=t.vec)  # [m], shape (grains,) as the rest
        middle_rounding: wp.array(dtype=t.vec)  # what rounding took from it so far [m]
        centre: wp.array(dtype=t.vec)  # mean place of its particles in this step [m]
        inverse_inertia: wp.array(dtype=mat33)  # about that, of particles of mass one [1/m2]
        mobility: wp.array(dtype=scalar)  # velocity over force by the matrix's diagonal alone, a preconditioner
        spin_mobility: wp.array(dtype=mat33)  # spin over moment likewise
        step: wp.array(dtype=t.vec)  # displacement of this step [m]
        spin: wp.array(dtype=vec3)  # [rad/s]
        turn: wp.array(dtype=t.mat)  # rotation since the start

    @wp.struct
    class Coarse:
        count: wp.int32  # cubes that particles are gathered in
        wide: wp.int32  # of them across the pipe, 3 at least
        of: wp.array(dtype=wp.int32)  # cube of each particle, shape (n,)
        first: wp.array(dtype=wp.int32)  # place of its particles in `member`, and their end, shape (count + 1,)
        member: wp.array(dtype=wp.int32)  # particles by cubes, shape (n,)
        neighbour: wp.array(dtype=wp.int32)  # cubes around each, -1: none, shape (3^d * count,)
        coefficient: wp.array(dtype=scalar)  # with those; in the middle one over the diagonal, shape (3^d * count,)
        diagonal: wp.array(dtype=scalar)  # shape (count,)
        pair: wp.array(dtype=scalar)  # of each particle with the cubes around, shape (3^d * n,), of a GPU alone

    @wp.struct
    class Matrix:
        near_capacity: wp.int32  # as that of the lists, and so the next two
        near_count: wp.array(dtype=wp.int32)
        near: wp.array(dtype=wp.int32)
        coefficient: wp.array(dtype=scalar)  # of an entry of `near`
        diagonal: wp.array(dtype=scalar)  # shape (n,) as the rest
        drag: wp.array(dtype=scalar)  # resistance of the wall to motion along it [kg/m3/s]
        free: wp.array(dtype=wp.int32)  # 1 at the free surface, whose pressure is none
        position: wp.array(dtype=t.vec)  # as that of the particles [m]
        bound: wp.int32  # rows of grains' particles, which come before those of mortar
        grains: Grains
        coarse: Coarse

    def solve_struct(value):
        @wp.struct
        class Solve:
            residual: wp.array(dtype=value)  # shape (n,)
            direction: wp.array(dtype=value)  # shape (n,); of a GPU (2n,): two in turn
            product: wp.array(dtype=value)  # of the matrix and the direction, shape (n,)
            preconditioned: wp.array(dtype=value)  # residual over the diagonal, shape (n,); of a GPU alone
            load: wp.array(dtype=value)  # residual of each cube of the coarse grid, shape (cubes,)
            lift: wp.array(dtype=value)  # its solution, two in turn, shape (2 cubes,)
            change: wp.array(dtype=value)  # of that, shape (cubes,)
            inner: wp.array(dtype=wp.float64)  # product of load and solution of each cube, shape (cubes,)
            partial: wp.array(dtype=wp.float64)  # sums of each block or thread: three kinds, one after the other
            least: wp.array(dtype=wp.float64)  # norm of the residual that is small enough, shape (1,)
            outcome: wp.array(dtype=wp.float64)  # iterations, norms of the residual before and after, shape (OUTCOME,)
            history: wp.array(dtype=wp.float64)  # norm of the residual after each iteration

        return Solve

    return SimpleNamespace(
        Particles=Particles, Lists=Lists, Fields=Fields, Matrix=Matrix, Grains=Grains, Coarse=Coarse,
        VectorSolve=solve_struct(t.vec), NumberSolve=solve_struct(scalar),
    )  # fmt: skip


@functools.cache
def mps_functions(scalar, dimensions: int) -> SimpleNamespace:
    """Weights and geometry of one precision in two or three dimensions."""
    t = mps_types(scalar, dimensions)
    Flow = flow_struct(scalar)
    last = dimensions - 1

    @wp.func
    def across(x: t.vec) -> t.vec:
        """The part of a vector that is not along the pipe."""
        x[last] = scalar(0.0)
        return x

    @wp.func
    def outward(x: t.vec) -> t.vec:
        """Unit vector from the axis to a place."""
        part = across(x)
        size = wp.length(part)
        if size > scalar(0.0):
            return part / size
        return t.vec()

    @wp.func
    def beyond_room(flow: Flow, x: t.vec) -> scalar:
        """How far a place is beyond where particles may be, a quarter of a spacing from the wall."""
        return wp.length(across(x)) - (flow.radius - scalar(0.25) * flow.spacing)

    @wp.func
    def distance(flow: Flow, d: t.vec) -> scalar:
        """Length of a vector between particles, never so small that a weight means nothing."""
        return wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)

    @wp.func
    def weight(r: scalar, reach: scalar) -> scalar:
        """Koshizuka & Oka's weight (Xu, Li & Jiang 2021, Eq. 2)."""
        return reach / r - scalar(1.0)

    @wp.func
    def density_weight(r: scalar, reach: scalar) -> scalar:
        """Wendland's quintic: its sum hardly depends on how particles at the same density are arranged."""
        if r >= reach:
            return scalar(0.0)
        q = r / reach
        a = scalar(1.0) - q
        a = a * a
        return a * a * (scalar(4.0) * q + scalar(1.0))

    @wp.func
    def slope_of_pair(pair_weight: scalar, d: t.vec, difference: scalar) -> t.vec:
        """What a neighbour at `d` brings to the corrected gradient: times its distance squared, the Laplacian's weight
        is the gradient's."""
        return (pair_weight * wp.length_sq(d) * difference) * d

    @wp.func
    def inverse(m: t.mat) -> t.mat:
        """Of a moment matrix; where too few neighbours fix it, that of its mean."""
        mean = wp.trace(m) / scalar(dimensions)
        whole = mean
        for _ in range(wp.static(dimensions - 1)):
            whole *= mean
        if wp.determinant(m) > scalar(1.0e-3) * whole:
            return wp.inverse(m)
        if mean > scalar(0.0):
            return wp.identity(n=wp.static(dimensions), dtype=scalar) / mean
        return t.mat()

    return SimpleNamespace(
        across=across, outward=outward, beyond_room=beyond_room, distance=distance, weight=weight,
        density_weight=density_weight, slope_of_pair=slope_of_pair, inverse=inverse,
    )  # fmt: skip


def row_place(serial: bool):
    """Function of (row, entry, rows, capacity): where an entry of a row of a list lies.

    A CPU walks a row, so its entries are neighbours; threads of a GPU walk many rows abreast, so those are.
    """
    return place_by_row if serial else place_by_entry


@wp.func
def place_by_row(row: wp.int32, entry: wp.int32, rows: wp.int32, capacity: wp.int32) -> wp.int32:
    return row * capacity + entry


@wp.func
def place_by_entry(row: wp.int32, entry: wp.int32, rows: wp.int32, capacity: wp.int32) -> wp.int32:
    return entry * rows + row


def span(serial: bool) -> int:
    """Rows that a task takes: many on a CPU, where a task costs, one on a GPU."""
    return SPAN if serial else 1
