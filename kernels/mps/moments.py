"""Evaluation of every particle's neighbourhood at the start of a step.

Weighted sums over the neighbours yield moment matrices, apparent viscosity, wall terms and the predicted pressure, and
show whether a particle belongs to the free surface.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from .flow_laws import BINGHAM, law_functions
from .structs import array_structs, flow_struct, mps_functions, mps_types, row_place, span

FREE = wp.constant(0.9)
"""Limit for the sum of the weights of a particle's neighbours, divided by this sum in a regular lattice. A particle
with a smaller sum may be at the free surface."""
BENEATH = {2: 0.2, 3: 0.15}
"""Minimum mean depth of the neighbours below a particle at the free surface, by number of dimensions.

The mean depth is minus the first moment of the neighbours' weights along the pipe. It is divided by the spacing and by
the sum of weights of a full lattice. A particle in the surface of a lattice has a mean depth of 0.33 in two dimensions
and 0.28 in three. If the fluid has a hole as large as one particle, a particle below the hole has a mean depth of 0.17
in two dimensions and 0.08 in three. Such a hole is no free surface.
"""


@functools.cache
def rheology_functions(scalar, dimensions: int, law: str):
    """Build the functions of the regularised flow law, which is Bingham's or another one of `flow_laws`.

    `rate_of` returns the shear rate of a velocity gradient [1/s], and `apparent` returns the viscosity at a shear rate.
    """
    t = mps_types(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    h = law_functions(scalar, law)

    @wp.func
    def rate_of(gradient: t.mat) -> scalar:
        rate = scalar(0.0)
        for a in range(wp.static(dimensions)):
            for b in range(wp.static(dimensions)):
                both = gradient[a, b] + gradient[b, a]
                rate += scalar(0.5) * both * both
        return wp.sqrt(rate)

    @wp.func
    def apparent(flow: FlowConstants, rate: scalar):
        """Return the apparent viscosity and the derivative of the stress with respect to the rate, both in [Pa s].

        Bingham's law is Eq. 15 of Xu, Li & Jiang 2021.
        """
        viscosity = flow.viscosity
        tangent = flow.viscosity
        if wp.static(law != BINGHAM):
            slow = scalar(1.0) / flow.regularisation
            viscosity = h.viscosity(flow.viscosity, flow.flow_index, flow.quadratic_viscosity, rate, slow)
            tangent = h.tangent(flow.viscosity, flow.flow_index, flow.quadratic_viscosity, rate, slow)
        bent_rate = flow.regularisation * rate
        fall = wp.exp(-bent_rate)
        if bent_rate > scalar(1.0e-3):
            viscosity += flow.yield_stress * (scalar(1.0) - fall) / rate
        else:
            # Use a series for small rates, because the fraction (1 - exp(-x)) / x loses digits there.
            viscosity += flow.yield_stress * flow.regularisation * (scalar(1.0) - scalar(0.5) * bent_rate)
        return viscosity, tangent + flow.yield_stress * flow.regularisation * fall

    return SimpleNamespace(rate_of=rate_of, apparent=apparent)


@functools.cache
def moments_function(scalar, dimensions: int, serial: bool):
    """Build `moments`, the weighted sums over a particle's neighbours, and `open_above`, a test for the free surface.

    Least-squares fits of velocity, pressure and their gradients are computed from these sums.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Lists, Fields = structs.Lists, structs.Fields
    place = row_place(serial)
    last = dimensions - 1

    @wp.struct
    class Moments:
        number: scalar  # Sum of the weights of the fluid neighbours.
        whole_number: scalar  # Sum of the weights of all neighbours, walls included.
        dense: scalar  # Sum of the density weights, the particle's own weight included.
        fluid: t.mat  # Weighted sum of x x^T over the fluid neighbours, where x is the relative position.
        whole: t.mat  # Weighted sum of x x^T over all neighbours, walls included, where x is the relative position.
        shear: t.mat  # Weighted sum of (velocity difference) x (relative position)^T over the fluid neighbours.
        first: t.vec  # Weighted sum of the relative positions of the fluid neighbours.
        above: scalar  # Weighted sum over all neighbours, walls included, of the relative position along the pipe.
        slope: t.vec  # Weighted sum of (pressure difference) x (relative position) over the fluid neighbours.
        rise: scalar  # Weighted sum of the pressure differences from the particle to its fluid neighbours.

        # Viscous force per volume that the wall particles exert, divided by the wall stress and by the factor that
        # calibrates the Laplacian [1/m].
        wall: scalar
        inside: scalar  # Distance of the particle from the wall [m].

    @wp.func
    def moments(
        i: wp.int32,
        flow: FlowConstants,
        position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        pressure: wp.array(dtype=scalar),
        lists: Lists,
        fields: Fields,
    ):
        m = Moments()
        # The code of the function `distance` is repeated below, because a call would make CUDA's compiler sum in a
        # different order and thus change the last bits of the results.
        shortest = scalar(1.0e-3) * flow.spacing
        x = position[i]
        v = velocity[i]
        p = pressure[i]
        m.dense = scalar(1.0)
        for k in range(lists.near_count[i]):
            at = place(i, k, flow.count, lists.near_capacity)
            j = lists.near[at]
            d = position[j] - x
            r = wp.max(wp.length(d), shortest)
            m.dense = m.dense + f.density_weight(r, flow.wide)
            if r < flow.cutoff:
                w = f.weight(r, flow.cutoff)
                m.number = m.number + w
                m.fluid = m.fluid + wp.outer(w * d, d)
                m.shear = m.shear + wp.outer(w * (velocity[j] - v), d)
                m.first = m.first + w * d
                dp = pressure[j] - p
                m.rise = m.rise + w * dp
                m.slope = m.slope + (w * dp) * d
                fields.pair_weight[at] = w / (r * r)
            else:
                fields.pair_weight[at] = scalar(0.0)
        for k in range(lists.far_count[i]):
            j = lists.far[place(i, k, flow.count, lists.far_capacity)]
            m.dense = m.dense + f.density_weight(wp.length(position[j] - x), flow.wide)
        m.whole_number = m.number
        m.whole = m.fluid
        m.above = m.first[last]
        m.inside = flow.radius - wp.length(f.across(x))
        for k in range(lists.wall_count[i]):
            y = lists.wall_position[lists.wall[place(i, k, flow.count, lists.wall_capacity)]]
            d = y - x
            r = wp.max(wp.length(d), shortest)
            m.dense = m.dense + f.density_weight(r, flow.wide)
            if r < flow.cutoff:
                w = f.weight(r, flow.cutoff)
                m.whole_number = m.whole_number + w
                m.whole = m.whole + wp.outer(w * d, d)
                m.above = m.above + w * d[last]
                beyond = wp.length(f.across(y)) - flow.radius
                if beyond > scalar(0.0) and y[last] > scalar(0.0):
                    # Behind the wall, the velocity profile is extrapolated with its slope at the wall. The viscous
                    # force per volume due to a wall particle is then proportional to the wall stress. `m.wall` is the
                    # sum of the factors of proportionality.
                    m.wall = m.wall + w / (r * r) * wp.max(m.inside + beyond, scalar(0.0))
        return m

    @wp.func
    def open_above(i: wp.int32, flow: FlowConstants, position: wp.array(dtype=t.vec), lists: Lists) -> wp.int32:
        """Return 1 if no fluid neighbour lies within 45 degrees of the upward direction of a particle, else 0.

        This tells a free surface from a hole inside the fluid: a particle below a hole has fluid above it, on the other
        side of the hole.
        """
        x = position[i]
        for k in range(lists.near_count[i]):
            d = position[lists.near[place(i, k, flow.count, lists.near_capacity)]] - x
            if d[last] > scalar(0.7) * wp.length(d):
                return wp.int32(0)
        for k in range(lists.far_count[i]):
            d = position[lists.far[place(i, k, flow.count, lists.far_capacity)]] - x
            if d[last] > scalar(0.7) * wp.length(d):
                return wp.int32(0)
        return wp.int32(1)

    return SimpleNamespace(Moments=Moments, moments=moments, open_above=open_above)


@functools.cache
def geometry_kernel(scalar, dimensions: int, serial: bool, two_phase: bool, law: str = BINGHAM):
    """Build the kernel that evaluates each particle's neighbourhood at the start of a step.

    It computes moment matrices, wall weights, apparent viscosity, predicted pressure and the error of the density, and
    marks particles at the free surface. The particle arrays are passed one by one: if they come in a struct, CUDA's
    compiler combines products differently in double precision, which changes the last bits of results.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Lists, Fields, Matrix, Solve = structs.Lists, structs.Fields, structs.Matrix, structs.NumberSolve
    open_above = moments_function(scalar, dimensions, serial).open_above
    moments = moments_function(scalar, dimensions, serial).moments
    rheology = rheology_functions(scalar, dimensions, law)
    rate_of, apparent_viscosity = rheology.rate_of, rheology.apparent

    @wp.kernel(enable_backward=False, module="unique")
    def geometry(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        # The next arguments are the range of particles that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments hold the state of the flow, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        particle_position: wp.array(dtype=t.vec),
        particle_velocity: wp.array(dtype=t.vec),
        particle_pressure: wp.array(dtype=scalar),
        lists: Lists,
        # The next arguments are arrays that this kernel writes. It stores the fraction of the density error that a step
        # removes as the residual of `shifting`, the solve that moves particles out of crowded regions.
        fields: Fields,
        matrix: Matrix,
        shifting: Solve,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            m = moments(i, flow, particle_position, particle_velocity, particle_pressure, lists, fields)
            back = f.inverse(m.fluid)
            fields.fluid_inverse[i] = back
            fields.all_inverse[i] = f.inverse(m.whole)
            full = wp.max(m.whole_number, scalar(FREE) * flow.lattice_number)
            fields.inverse_number[i] = scalar(dimensions) / full
            fields.wall_weight[i] = scalar(wp.static(2.0 * dimensions)) / full * m.wall

            surface = wp.int32(0)
            beneath = scalar(wp.static(BENEATH[dimensions])) * flow.lattice_number * flow.spacing
            if m.whole_number < scalar(FREE) * flow.lattice_number and m.above < -beneath:
                surface = open_above(i, flow, particle_position, lists)
            matrix.free[i] = surface
            excess = m.dense / flow.lattice_density - scalar(1.0)
            shifting.residual[i] = flow.correction * wp.clamp(excess, scalar(-0.01), scalar(0.01))
            # Predict the pressure by a least-squares fit of a linear function to the neighbours' pressures. The fit
            # filters out checkerboard patterns, whose gradient is zero for the gradient operator. The gradient is
            # eliminated from the normal equations, which leaves one equation for the change of the particle's own
            # pressure (Schur complement).
            bent = back * m.first
            # Weight with which the particle's own pressure enters the least-squares fit.
            own = flow.cutoff / flow.spacing
            weight = own + m.number - wp.dot(m.first, bent)
            forward = scalar(0.0)
            if weight > scalar(0.1) * own:
                forward = (m.rise - wp.dot(bent, m.slope)) / weight
            if surface == 1:
                fields.predicted[i] = scalar(0.0)
                shifting.residual[i] = scalar(0.0)
            else:
                fields.predicted[i] = particle_pressure[i] + forward

            apparent, tangent = apparent_viscosity(flow, rate_of(m.shear * back))
            if wp.static(two_phase):
                if i < matrix.grain_rows:
                    # Use the distance between the wall and the surface of a grain, because only the mortar in between
                    # is sheared. The surface of a grain lies half a spacing outside the centre of its particle.
                    m.inside -= scalar(0.5) * flow.spacing
            fields.viscosity[i] = apparent
            # The compliance is the velocity difference between wall and particle, divided by the wall stress tau. The
            # distance of the particle from the wall is `near_wall`, and `bend` is this distance divided by the pipe's
            # radius. The stress falls linearly from tau at the wall to 0 at the axis, so it is tau (1 - bend) at the
            # particle. The particle's shear rate is this stress divided by the apparent viscosity. The wall's shear
            # rate is higher by tau bend / tangent, with the tangent viscosity. The velocity difference is the mean of
            # both rates times the distance.
            near_wall = wp.clamp(m.inside, scalar(1.0e-3) * flow.spacing, flow.radius)
            bend = near_wall / flow.radius
            fields.compliance[i] = near_wall * ((scalar(1.0) - bend) / apparent + scalar(0.5) * bend / tangent)

    return geometry
