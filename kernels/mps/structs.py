"""Types, parameters, arrays and small functions that the kernels of the moving particle method share.

The same source serves two and three dimensions. The last coordinate runs along the pipe, the others across it.
Positions are relative to the moving piston, velocities are relative to the pipe at rest.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import SPAN, types

# Error codes stored in `flags[FAILED]`: the solve that did not converge, or a lost particle.
VISCOSITY = 1
PRESSURE = 2
DENSITY = 3
LOST = 4  # Error code: the state of a particle is not a number, or the particle is far outside the flow.


@functools.cache
def mps_types(scalar, dimensions: int) -> SimpleNamespace:
    """Return the types of one precision in two or three dimensions.

    They are the vector `vec`, the matrix `mat` and the integer vector `whole`.
    """
    double = scalar is wp.float64
    if dimensions == 2:
        vec, mat = (wp.vec2d, wp.mat22d) if double else (wp.vec2f, wp.mat22f)
        return SimpleNamespace(vec=vec, mat=mat, whole=wp.vec2i)
    vec, mat = (wp.vec3d, wp.mat33d) if double else (wp.vec3f, wp.mat33f)
    return SimpleNamespace(vec=vec, mat=mat, whole=wp.vec3i)


@functools.cache
def flow_struct(scalar):
    """Build the struct of a flow's parameters, in one precision."""

    @wp.struct
    class FlowConstants:
        count: wp.int32  # Number of fluid particles.
        spacing: scalar  # Initial particle spacing l0 [m].
        cutoff: scalar  # Reach of the weights of gradient, divergence and Laplacian [m].
        wide: scalar  # Reach of the density weights [m].
        lattice_number: scalar  # Sum of the weights of a particle's neighbours inside a regular lattice.
        lattice_density: scalar  # Sum of the density weights around a particle inside a regular lattice.
        radius: scalar  # Radius of the pipe, or half the width of the channel [m].
        loss_limit: scalar  # Position along the pipe beyond which a particle counts as lost [m].
        piston_speed: scalar  # Speed of the piston [m/s].
        gravity: scalar  # Gravitational acceleration along the pipe, positive if opposite to the flow [m/s2].
        dt: scalar  # Time step [s].
        density: scalar  # Reference density of the pressure equation [kg/m3].
        viscosity: scalar  # Plastic viscosity of the Bingham law [Pa s], or consistency k of another law [Pa s^n].
        flow_index: scalar  # Flow index n; 1 except for the Herschel-Bulkley law.
        quadratic_viscosity: scalar  # Coefficient c of the modified Bingham law [Pa s2]; 0 for other laws.
        yield_stress: scalar  # Yield stress of the concrete [Pa].
        regularisation: scalar  # Regularisation time beta of the flow law [s].
        slip_viscosity: scalar  # Viscous constant eta_L of the slip layer [Pa s/m].
        slip_yield: scalar  # Yield stress tau_L0 of the slip layer [Pa].
        slip_index: scalar  # Flow index n of the slip layer's law.
        slip_quadratic: scalar  # Coefficient of the squared slip velocity [Pa s2/m2].

        # Fraction of the density error (relative excess of a particle's density sum) that one step removes.
        correction: scalar
        skin: scalar  # Distance by which neighbour lists extend beyond the reach of the weights (skin) [m].

    return FlowConstants


@functools.cache
def array_structs(scalar, dimensions: int) -> SimpleNamespace:
    """Build the structs of arrays that the kernels share, for one precision and two or three dimensions.

    They are `Particles`, `Lists` (neighbour lists), `Fields`, `Grains` (rigid coarse aggregate), `Coarse` (coarse grid
    of the solves), `Matrix`, and the working arrays of a solve for vectors (`VectorSolve`) or scalars (`NumberSolve`).
    In the shapes of arrays, n is the number of fluid particles and d the number of dimensions.
    """
    t = mps_types(scalar, dimensions)
    vec3, mat33 = types(scalar).vec3, types(scalar).mat33

    @wp.struct
    class Particles:
        position: wp.array(dtype=t.vec)  # Particle position relative to the piston's centre [m], shape (n,).

        # Rounding error of each particle's position, corrected in the next step [m], shape (n,).
        rounding: wp.array(dtype=t.vec)
        velocity: wp.array(dtype=t.vec)  # Particle velocity relative to the pipe [m/s], shape (n,).
        pressure: wp.array(dtype=scalar)  # Pressure at each particle [Pa], shape (n,).
        density: wp.array(dtype=scalar)  # Density of each particle in two-phase flows [kg/m3], shape (n,); else empty.
        group: wp.array(dtype=wp.int32)  # Grain of each particle, -1 for mortar, shape (n,); empty without grains.

    @wp.struct
    class Lists:
        near_capacity: wp.int32  # Maximum number of a particle's entries in the neighbour list `near`.
        far_capacity: wp.int32  # Maximum number of a particle's entries in the neighbour list `far`.
        wall_capacity: wp.int32  # Maximum number of a particle's entries in the neighbour list `wall`.
        near_count: wp.array(dtype=wp.int32)  # Number of each particle's entries in `near`, shape (n,).

        # Numbers of the fluid particles near each particle, within the reach of the operators, shape (n *
        # near_capacity,).
        near: wp.array(dtype=wp.int32)
        far_count: wp.array(dtype=wp.int32)  # Number of each particle's entries in `far`, shape (n,).

        # Numbers of the fluid particles that are beyond the reach of the operators from each particle, but within the
        # reach of the density weights, shape (n * far_capacity,).
        far: wp.array(dtype=wp.int32)
        wall_count: wp.array(dtype=wp.int32)  # Number of each particle's entries in `wall`, shape (n,).

        # Numbers of the wall particles near each fluid particle, shape (n * wall_capacity,).
        wall: wp.array(dtype=wp.int32)
        wall_position: wp.array(dtype=t.vec)  # Positions of all wall particles [m], shape (wall particles,).

    @wp.struct
    class Fields:
        # Weight of each pair in the neighbour list `near`, divided by its squared distance [1/m2], shape (n *
        # near_capacity,).
        pair_weight: wp.array(dtype=scalar)
        # Inverse of each particle's moment matrix of its fluid neighbours [1/m2], shape (n,).
        fluid_inverse: wp.array(dtype=t.mat)
        # Inverse of each particle's moment matrix of all neighbours, walls included [1/m2], shape (n,).
        all_inverse: wp.array(dtype=t.mat)
        # Factor that calibrates the Laplacian: number of dimensions divided by the sum of the weights of a particle's
        # neighbours, shape (n,).
        inverse_number: wp.array(dtype=scalar)
        # Area of the wall that each particle represents, divided by the particle's volume, before multiplication by
        # `wall_scale` [1/m], shape (n,).
        wall_weight: wp.array(dtype=scalar)
        # Factor by which all wall areas in `wall_weight` are multiplied, so that they add up to the area of wetted
        # wall, shape (1,).
        wall_scale: wp.array(dtype=wp.float64)
        viscosity: wp.array(dtype=scalar)  # Apparent viscosity at each particle [Pa s], shape (n,).

        # Velocity difference due to shear between particle and wall, divided by the wall stress [m/s/Pa], shape (n,).
        compliance: wp.array(dtype=scalar)
        predicted: wp.array(dtype=scalar)  # Filtered pressure of the previous step [Pa], shape (n,).
        traction: wp.array(dtype=scalar)  # Shear stress of the wall beside each particle [Pa], shape (n,).
        increment: wp.array(dtype=scalar)  # Change of each particle's pressure in this step [Pa], shape (n,).

        # Potential whose negative gradient moves particles out of crowded regions [m2], shape (n,).
        potential: wp.array(dtype=scalar)
        # Displacement of each particle in this step in addition to velocity times step [m], shape (n,). It moves the
        # particle out of a crowded region, down the gradient of `potential`, and away from particles too close to it.
        extra_displacement: wp.array(dtype=t.vec)
        # Position of each particle when the neighbour lists were built [m], shape (n,).
        position_at_build: wp.array(dtype=t.vec)
        # Two flags, shape (2,): index 0 is 1 if the neighbour lists are stale, index 1 is 1 if a particle is lost.
        event_flags: wp.array(dtype=wp.int32)

    @wp.struct
    class Grains:
        # Index of each grain's first particle, followed by the number of particles in all grains, shape (grains + 1,).
        first: wp.array(dtype=wp.int32)
        offset: wp.array(dtype=t.vec)  # Initial vector from its grain's centre to each particle of a grain [m].
        middle: wp.array(dtype=t.vec)  # Position of each grain's centre [m], shape (grains,).
        middle_rounding: wp.array(dtype=t.vec)  # Rounding error of each grain's position [m], shape (grains,).
        centre: wp.array(dtype=t.vec)  # Mean position of a grain's particles in this step [m], shape (grains,).

        # Inverse inertia of each grain about `centre` if each of its particles has unit mass [1/m2], shape (grains,).
        inverse_inertia: wp.array(dtype=mat33)
        # Velocity of each grain per unit force, computed from the diagonal of the matrix, as a preconditioner, shape
        # (grains,).
        mobility: wp.array(dtype=scalar)
        # Spin of each grain per unit moment, computed from the diagonal of the matrix, as a preconditioner, shape
        # (grains,).
        spin_mobility: wp.array(dtype=mat33)
        step: wp.array(dtype=t.vec)  # Displacement of each grain in this step [m], shape (grains,).
        spin: wp.array(dtype=vec3)  # Angular velocity of each grain [rad/s], shape (grains,).
        turn: wp.array(dtype=t.mat)  # Rotation of each grain since the start, shape (grains,).

    @wp.struct
    class Coarse:
        count: wp.int32  # Number of cubes of the coarse grid.
        wide: wp.int32  # Number of cubes of the coarse grid across the pipe, along each axis; at least 3.
        of: wp.array(dtype=wp.int32)  # Index of the cube of the coarse grid in which each particle lies, shape (n,).

        # Index in `member` of the first particle of each cube of the coarse grid, followed by the number of particles,
        # shape (count + 1,).
        first: wp.array(dtype=wp.int32)
        member: wp.array(dtype=wp.int32)  # Numbers of the particles, sorted by cube of the coarse grid, shape (n,).

        # Indices of the cubes around each cube of the coarse grid, -1 where there is none, shape (3^d * count,).
        neighbour: wp.array(dtype=wp.int32)
        # Coefficients of the coarse matrix between each cube of the coarse grid and the 3^d cubes centred on it, shape
        # (3^d * count,). The entry between a cube and itself holds 1 over the diagonal of the coarse matrix instead.
        coefficient: wp.array(dtype=scalar)
        diagonal: wp.array(dtype=scalar)  # Diagonal of the coarse matrix, shape (count,).

        # Sum of a particle's matrix coefficients with all particles of one cube of the coarse grid. Each particle has
        # 3^d sums: one for its own cube and one for each adjacent cube. Shape (3^d * n,); GPU only.
        pair: wp.array(dtype=scalar)

    @wp.struct
    class Matrix:
        near_capacity: wp.int32  # Maximum number of off-diagonal entries in a row of the matrix.
        near_count: wp.array(dtype=wp.int32)  # Number of off-diagonal entries in each row of the matrix, shape (n,).
        near: wp.array(dtype=wp.int32)  # Column of each off-diagonal entry of the matrix, shape (n * near_capacity,).

        # Value of each off-diagonal entry of the matrix times -1, shape (n * near_capacity,).
        coefficient: wp.array(dtype=scalar)
        diagonal: wp.array(dtype=scalar)  # Diagonal of the matrix without the resistance of walls, shape (n,).
        drag: wp.array(dtype=scalar)  # Wall's braking force per volume and per velocity [kg/m3/s], shape (n,).

        # 1 for a matrix row whose unknown is held at 0, such as the pressure of a particle at the free surface; else 0.
        # Shape (n,).
        free: wp.array(dtype=wp.int32)
        position: wp.array(dtype=t.vec)  # Positions of the particles [m], shape (n,).
        grain_rows: wp.int32  # Number of matrix rows of particles in rigid grains; they precede the mortar's rows.
        grains: Grains
        coarse: Coarse

    def solve_struct(value):
        @wp.struct
        class Solve:
            residual: wp.array(dtype=value)  # Residual of the linear equations, shape (n,).

            # Search direction, shape (n,); on a GPU the old and the new direction, shape (2n,).
            direction: wp.array(dtype=value)
            product: wp.array(dtype=value)  # Product of the matrix and the search direction, shape (n,).
            preconditioned: wp.array(dtype=value)  # Residual divided by the matrix's diagonal, shape (n,); GPU only.
            load: wp.array(dtype=value)  # Sum of the residual in each cube of the coarse grid, shape (cubes,).
            lift: wp.array(dtype=value)  # Solution on the coarse grid in two alternating buffers, shape (2 cubes,).

            # Difference between the last two iterates of the solution on the coarse grid, shape (cubes,).
            change: wp.array(dtype=value)
            # Product of the summed residual `load` and the solution in each cube of the coarse grid, shape (cubes,).
            inner: wp.array(dtype=wp.float64)
            partial: wp.array(dtype=wp.float64)  # Partial sums of each block or chunk, for up to three totals.
            stop_norm: wp.array(dtype=wp.float64)  # Residual norm at which the solve stops, shape (1,).

            # Number of iterations, and norm of the residual at the start and at the end of the solve, shape (OUTCOME,).
            outcome: wp.array(dtype=wp.float64)
            history: wp.array(dtype=wp.float64)  # Residual norm after each iteration, up to the array's length.

        return Solve

    return SimpleNamespace(
        Particles=Particles, Lists=Lists, Fields=Fields, Matrix=Matrix, Grains=Grains, Coarse=Coarse,
        VectorSolve=solve_struct(t.vec), NumberSolve=solve_struct(scalar),
    )  # fmt: skip


@functools.cache
def mps_functions(scalar, dimensions: int) -> SimpleNamespace:
    """Build the weight functions and geometric functions of one precision in two or three dimensions."""
    t = mps_types(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    last = dimensions - 1

    @wp.func
    def across(x: t.vec) -> t.vec:
        """Return the part of a vector that is perpendicular to the pipe's axis."""
        x[last] = scalar(0.0)
        return x

    @wp.func
    def outward(x: t.vec) -> t.vec:
        """Return the unit vector from the pipe's axis towards `x`, or zero on the axis."""
        part = across(x)
        size = wp.length(part)
        if size > scalar(0.0):
            return part / size
        return t.vec()

    @wp.func
    def beyond_room(flow: FlowConstants, x: t.vec) -> scalar:
        """Return how far `x` lies outside the space for particles [m].

        This space ends a quarter of a spacing before the wall.
        """
        return wp.length(across(x)) - (flow.radius - scalar(0.25) * flow.spacing)

    @wp.func
    def distance(flow: FlowConstants, d: t.vec) -> scalar:
        """Return the length of a vector between particles [m], limited from below so that weights stay finite."""
        return wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)

    @wp.func
    def weight(r: scalar, reach: scalar) -> scalar:
        """Return the weight of Koshizuka & Oka at the distance `r`, ``reach / r - 1`` (Xu, Li & Jiang 2021, Eq. 2)."""
        return reach / r - scalar(1.0)

    @wp.func
    def density_weight(r: scalar, reach: scalar) -> scalar:
        """Return Wendland's quintic weight.

        At equal density, the sum of these weights over the particles around a point hardly depends on how the particles
        are arranged.
        """
        if r >= reach:
            return scalar(0.0)
        q = r / reach
        a = scalar(1.0) - q
        a = a * a
        return a * a * (scalar(4.0) * q + scalar(1.0))

    @wp.func
    def slope_of_pair(pair_weight: scalar, d: t.vec, difference: scalar) -> t.vec:
        """Return the contribution of a neighbouring particle to the corrected gradient.

        `d` is the vector to the neighbour, and `difference` is the neighbour's value of the field minus the particle's
        own. `pair_weight` is the weight of the pair in the Laplacian. It equals the weight in the gradient divided by
        the squared distance.
        """
        return (pair_weight * wp.length_sq(d) * difference) * d

    @wp.func
    def inverse(m: t.mat) -> t.mat:
        """Return the inverse of a moment matrix.

        If a particle has too few neighbours, the matrix is nearly singular. The result is then the inverse of a
        multiple of the identity matrix that has the same trace.
        """
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
    """Return the function that computes where an entry of a neighbour list is stored in the flat array of all entries.

    Its arguments are (row, entry, rows, capacity), and each particle has one row. On a CPU (`serial`), the entries of a
    row are contiguous, because a CPU reads one row after the other. On a GPU, neighbouring threads read entries with
    the same number in neighbouring rows, so these entries are contiguous instead.
    """
    return place_by_row if serial else place_by_entry


@wp.func
def place_by_row(row: wp.int32, entry: wp.int32, rows: wp.int32, capacity: wp.int32) -> wp.int32:
    return row * capacity + entry


@wp.func
def place_by_entry(row: wp.int32, entry: wp.int32, rows: wp.int32, capacity: wp.int32) -> wp.int32:
    return entry * rows + row


def span(serial: bool) -> int:
    """Return the number of particles per task: many on a CPU, where every task has a cost, and one on a GPU."""
    return SPAN if serial else 1
