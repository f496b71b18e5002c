"""Operators of the moving particle method: what a step computes from places and velocities, apart from its solves.

Gradient and divergence are exact for linear fields (weighted least squares over the neighbours); the Laplacian is the
pairwise sum of Xu, Li & Jiang 2021 (Eq. 5), with weights that vanish at their reach. Its factor is twice the
dimensions over the sum of the gradient's weights, which makes it exact for quadratics wherever neighbours lie evenly
around; a pair takes the mean of both, so that what one gains the other loses.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from .structs import array_structs, flow_struct, mps_functions, mps_types, row_place, span

FREE = wp.constant(0.9)
"""Part of the lattice's sum of weights below which a particle may lie at the free surface."""
NEARER, DAMPED = wp.constant(0.45), wp.constant(2.0)
"""Particles nearer to a wall than this part of a spacing, which stand there in the lattice at a half, get this times
their diagonal in the pressure's equation: what their increments give back to their own divergence, from the velocity
that goes on behind the wall, else grows past twice of it, and pressures swing from step to step."""
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


@functools.cache
def wall_law_function(scalar, dimensions: int):
    """`wall_force`: a force less that of the slip layer, the layer's resistance to more speed, the wall's stress."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)

    @wp.func
    def wall_force(flow: Flow, x: t.vec, v: t.vec, area: scalar, compliance: scalar, force: t.vec):
        """`area` is that of the wall over the particle's volume [1/m]; Xu, Li & Jiang 2021, Eq. 8."""
        resist = scalar(0.0)
        stress = scalar(0.0)
        # The wall's stress follows from the velocity at the wall, not from the particle's own.
        n = f.outward(x)
        along = v - wp.dot(n, v) * n
        speed = wp.length(along)
        if speed <= flow.slip_yield * compliance:
            resist = area / compliance  # the layer does not slip
            stress = speed / compliance
        else:
            damp = scalar(1.0) / (scalar(1.0) + flow.slip_viscosity * compliance)
            resist = area * flow.slip_viscosity * damp
            stress = damp * (flow.slip_yield + flow.slip_viscosity * speed)
            force -= (area * flow.slip_yield * damp / speed) * along
        force -= resist * along
        return force, resist, stress

    return wall_force


@functools.cache
def momentum_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Forces at the known velocities, and the matrix of their implicit change: viscosity and the slip layer."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    Matrix, Solve = structs.Matrix, structs.VectorSolve
    wall_force = wall_law_function(scalar, dimensions)
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def momentum(
        # model
        flow: Flow,
        # chunk
        first: wp.int32,
        end: wp.int32,
        # state, read
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # written
        fields: Fields,
        matrix: Matrix,
        viscous: Solve,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = particles.position[i]
            v = particles.velocity[i]
            mu = fields.viscosity[i]
            p = fields.predicted[i]
            rho = flow.density
            if wp.static(two_phase):
                rho = particles.density[i]
            total = scalar(0.0)
            force = t.vec()
            slope = t.vec()
            for k in range(lists.near_count[i]):
                at = place(i, k, flow.count, lists.near_capacity)
                weight = fields.pair_weight[at]
                j = lists.near[at]
                other = fields.viscosity[j]
                laplacian = weight * (fields.inverse_number[i] + fields.inverse_number[j])
                c = laplacian * scalar(2.0) * mu * other / (mu + other)
                if wp.static(two_phase):
                    # Half of a pair's distance is rigid where one of both is of a grain. What lies between two grains
                    # counts as mortar; within one nothing is sheared.
                    if i < matrix.bound:
                        if j >= matrix.bound:
                            c = laplacian * scalar(2.0) * other
                        elif particles.group[i] == particles.group[j]:
                            c = scalar(0.0)
                        else:
                            c *= scalar(2.0)
                    elif j < matrix.bound:
                        c = laplacian * scalar(2.0) * mu
                matrix.coefficient[at] = c
                total += c
                force += c * (particles.velocity[j] - v)
                slope += f.slope_of_pair(weight, particles.position[j] - x, fields.predicted[j] - p)
            force -= fields.fluid_inverse[i] * slope
            force[last] = force[last] - rho * flow.gravity

            resist = scalar(0.0)
            stress = scalar(0.0)
            if fields.wall_weight[i] > scalar(0.0):
                area = fields.wall_weight[i] * scalar(fields.wall_scale[0])
                force, resist, stress = wall_force(flow, x, v, area, fields.compliance[i], force)
            matrix.drag[i] = resist
            fields.traction[i] = stress
            matrix.diagonal[i] = rho / flow.dt + total
            viscous.residual[i] = force

    return momentum


@functools.cache
def divergence_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Divergence of the velocities, as right-hand side and matrix of the pressure's increment."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    Matrix, Solve = structs.Matrix, structs.NumberSolve
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def divergence(
        # model
        flow: Flow,
        # chunk
        first: wp.int32,
        end: wp.int32,
        # state, read
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # written
        fields: Fields,
        matrix: Matrix,
        projection: Solve,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = particles.position[i]
            v = particles.velocity[i]
            fields.increment[i] = scalar(0.0)
            fields.potential[i] = scalar(0.0)
            total = scalar(0.0)
            change = t.mat()
            for k in range(lists.near_count[i]):
                at = place(i, k, flow.count, lists.near_capacity)
                weight = fields.pair_weight[at]
                j = lists.near[at]
                c = weight * (fields.inverse_number[i] + fields.inverse_number[j])
                if wp.static(two_phase):
                    c *= scalar(2.0) * flow.density / (particles.density[i] + particles.density[j])
                matrix.coefficient[at] = c
                total += c
                d = particles.position[j] - x
                change += wp.outer((weight * wp.length_sq(d)) * (particles.velocity[j] - v), d)
            beneath = wp.max(x[last], scalar(0.5) * flow.spacing)
            inside = wp.max(flow.radius - wp.length(f.across(x)), scalar(0.5) * flow.spacing)
            n = f.outward(x)
            for k in range(lists.wall_count[i]):
                y = lists.wall_position[lists.wall[place(i, k, flow.count, lists.wall_capacity)]]
                d = y - x
                r = f.distance(flow, d)
                if r < flow.cutoff:
                    # Behind a wall the velocity towards it goes on in a straight line through its value there.
                    jump = t.vec()
                    beyond = wp.length(f.across(y)) - flow.radius
                    if beyond > scalar(0.0):
                        jump -= (wp.dot(v, n) * (inside + beyond) / inside) * n
                    if y[last] < scalar(0.0):
                        jump[last] = jump[last] - (v[last] - flow.piston_speed) * (beneath - y[last]) / beneath
                    change += wp.outer(f.weight(r, flow.cutoff) * jump, d)
            sum_of_slopes = wp.trace(change * fields.whole_inverse[i])
            if flow.radius - wp.length(f.across(x)) < scalar(NEARER) * flow.spacing:
                total *= scalar(DAMPED)
            matrix.diagonal[i] = total
            projection.residual[i] = -flow.density / flow.dt * sum_of_slopes
            if matrix.free[i] != 0:
                projection.residual[i] = scalar(0.0)

    return divergence


@functools.cache
def gradient_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """End of the projection: velocities without divergence, and their pressure."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def project(
        # model
        flow: Flow,
        # chunk
        first: wp.int32,
        end: wp.int32,
        # state, read
        flags: wp.array(dtype=wp.int32),
        lists: Lists,
        fields: Fields,
        # read and written
        particles: Particles,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = particles.position[i]
            p = fields.increment[i]
            rho = flow.density
            if wp.static(two_phase):
                rho = particles.density[i]
            slope = t.vec()
            for k in range(lists.near_count[i]):
                at = place(i, k, flow.count, lists.near_capacity)
                j = lists.near[at]
                slope += f.slope_of_pair(fields.pair_weight[at], particles.position[j] - x, fields.increment[j] - p)
            gradient = fields.fluid_inverse[i] * slope
            particles.velocity[i] = particles.velocity[i] - (flow.dt / rho) * gradient
            particles.pressure[i] = fields.predicted[i] + p

    return project
