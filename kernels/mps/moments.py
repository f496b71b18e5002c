"""Of every particle, at the start of a step: moments of its neighbours, viscosity, what the wall is to it.

Whether it lies at the free surface and its predicted pressure follow from the same sums.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from .structs import array_structs, flow_struct, mps_functions, mps_types, row_place, span

FREE = wp.constant(0.9)
"""Part of the lattice's sum of weights below which a particle may lie at the free surface."""
BENEATH = {2: 0.2, 3: 0.15}
"""Part of that sum, in spacings, by which its neighbours must lie beneath it on balance. In a lattice's surface they
do by 0.33 and 0.28; under a hole of one particle in the inside, where nothing is free, by 0.17 and 0.08."""


@functools.cache
def rheology_functions(scalar, dimensions: int):
    """`rate_of` shear of a velocity gradient, and `apparent`, the viscosity of the regularised Bingham law there."""
    t = mps_types(scalar, dimensions)
    Flow = flow_struct(scalar)

    @wp.func
    def rate_of(gradient: t.mat) -> scalar:
        rate = scalar(0.0)
        for a in range(wp.static(dimensions)):
            for b in range(wp.static(dimensions)):
                both = gradient[a, b] + gradient[b, a]
                rate += scalar(0.5) * both * both
        return wp.sqrt(rate)

    @wp.func
    def apparent(flow: Flow, rate: scalar):
        """Stress over rate (Xu, Li & Jiang 2021, Eq. 15), and the slope of the stress over the rate [Pa s]."""
        viscosity = flow.viscosity
        bent_rate = flow.regularisation * rate
        fall = wp.exp(-bent_rate)
        if bent_rate > scalar(1.0e-3):
            viscosity += flow.yield_stress * (scalar(1.0) - fall) / rate
        else:
            viscosity += flow.yield_stress * flow.regularisation * (scalar(1.0) - scalar(0.5) * bent_rate)
        return viscosity, flow.viscosity + flow.yield_stress * flow.regularisation * fall

    return SimpleNamespace(rate_of=rate_of, apparent=apparent)


@functools.cache
def moments_function(scalar, dimensions: int, serial: bool):
    """`moments`: sums of weights over the neighbours of a particle, and of what they are to be fitted by."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Lists, Fields = structs.Lists, structs.Fields
    place = row_place(serial)
    last = dimensions - 1

    @wp.struct
    class Moments:
        number: scalar  # sum of the fluid's weights
        whole_number: scalar  # of all weights
        dense: scalar  # sum of density weights, its own included
        fluid: t.mat  # second moments of fluid neighbours
        whole: t.mat  # of all neighbours
        shear: t.mat  # of the fluid's velocity differences with distances
        first: t.vec  # first moments of fluid neighbours
        above: scalar  # first moment of all along the pipe
        slope: t.vec  # of the fluid's pressure differences with distances
        rise: scalar  # sum of those
        wall: scalar  # what the wall would exchange with the particle over its stress
        inside: scalar  # distance from the wall [m]

    @wp.func
    def moments(
        i: wp.int32,
        flow: Flow,
        position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        pressure: wp.array(dtype=scalar),
        lists: Lists,
        fields: Fields,
    ):
        m = Moments()
        shortest = scalar(1.0e-3) * flow.spacing  # as `distance` has it; calling that, CUDA's compiler adds otherwise
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
                    # Velocity behind the wall continues the slope at the wall: what the pair would exchange is the
                    # wall's stress times this.
                    m.wall = m.wall + w / (r * r) * wp.max(m.inside + beyond, scalar(0.0))
        return m

    @wp.func
    def open_above(i: wp.int32, flow: Flow, position: wp.array(dtype=t.vec), lists: Lists) -> wp.int32:
        """1 if no fluid is above a particle, within half a right angle and the widest reach.

        Beneath a hole in the inside, however wide, there is some on its other side.
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
def geometry_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Per particle: sums of weights, moment matrices, weights of the wall, apparent viscosity, predicted pressure.

    Arrays of particles come one by one: with a struct of them CUDA's compiler forms other products in double precision.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Lists, Fields, Matrix, Solve = structs.Lists, structs.Fields, structs.Matrix, structs.NumberSolve
    open_above = moments_function(scalar, dimensions, serial).open_above
    moments = moments_function(scalar, dimensions, serial).moments
    rheology = rheology_functions(scalar, dimensions)
    rate_of, apparent_viscosity = rheology.rate_of, rheology.apparent

    @wp.kernel(enable_backward=False, module="unique")
    def geometry(
        # model
        flow: Flow,
        # chunk
        first: wp.int32,
        end: wp.int32,
        # state, read
        flags: wp.array(dtype=wp.int32),
        particle_position: wp.array(dtype=t.vec),
        particle_velocity: wp.array(dtype=t.vec),
        particle_pressure: wp.array(dtype=scalar),
        lists: Lists,
        # written; of the shift of particles, the residual is the density's error
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
            fields.whole_inverse[i] = f.inverse(m.whole)
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
            # The least-squares line through the neighbours' pressures filters modes that gradients do not see.
            bent = back * m.first
            own = flow.cutoff / flow.spacing  # weight of the particle's own pressure
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
                if i < matrix.bound:
                    # What is sheared between a wall and a grain is the mortar up to the grain's own half spacing.
                    m.inside -= scalar(0.5) * flow.spacing
            fields.viscosity[i] = apparent
            # Velocity from the wall to here over the wall's stress: stress falls in a straight line towards the axis,
            # and the rate of shear with it, from what the tangent gives at the wall to what it is here.
            near_wall = wp.clamp(m.inside, scalar(1.0e-3) * flow.spacing, flow.radius)
            bend = near_wall / flow.radius
            fields.compliance[i] = near_wall * ((scalar(1.0) - bend) / apparent + scalar(0.5) * bend / tangent)

    return geometry
