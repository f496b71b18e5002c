"""Operators of the moving particle method: what a step computes from places and velocities, apart from its solves.

Gradient and divergence are exact for linear fields (weighted least squares over the neighbours); the Laplacian is the
pairwise sum of Xu, Li & Jiang 2021 (Eq. 5), with weights that vanish at their reach. Its factor is twice the
dimensions over the sum of the gradient's weights, which makes it exact for quadratics wherever neighbours lie evenly
around; a pair takes the mean of both, so that what one gains the other loses.
"""

import functools

import warp as wp

from .mps_types import HALTED, fluid_struct, mps_functions, mps_types, row_place, span

FREE = wp.constant(0.9)
"""Share of the lattice's sum of weights below which a particle may lie at the free surface."""
BENEATH = {2: 0.2, 3: 0.15}
"""Share of that sum, in spacings, by which its neighbours must lie beneath it on balance. In a lattice's surface they
do by 0.33 and 0.28; under a hole of one particle in the inside, where nothing is free, by 0.17 and 0.08."""


@functools.cache
def geometry_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Per particle: sums of weights, moment matrices, weights of the wall, apparent viscosity, predicted pressure."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = fluid_struct(scalar)
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def geometry(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        far_capacity: wp.int32,
        wall_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        far_count: wp.array(dtype=wp.int32),
        far: wp.array(dtype=wp.int32),
        wall_count: wp.array(dtype=wp.int32),
        wall: wp.array(dtype=wp.int32),
        group: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        wall_position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        pressure: wp.array(dtype=scalar),
        pair_weight: wp.array(dtype=scalar),
        fluid_inverse: wp.array(dtype=t.mat),
        whole_inverse: wp.array(dtype=t.mat),
        inverse_number: wp.array(dtype=scalar),
        free: wp.array(dtype=wp.int32),
        crowding: wp.array(dtype=scalar),
        wall_weight: wp.array(dtype=scalar),
        viscosity: wp.array(dtype=scalar),
        compliance: wp.array(dtype=scalar),
        predicted: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            v = velocity[i]
            p = pressure[i]
            shortest = scalar(1.0e-3) * flow.spacing
            number = scalar(0.0)
            dense = scalar(1.0)
            moment = t.mat()
            shear = t.mat()
            first_moment = t.vec()
            slope = t.vec()
            rise = scalar(0.0)
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                j = near[at]
                d = position[j] - x
                r = wp.max(wp.length(d), shortest)
                dense += f.density_weight(r, flow.wide)
                if r < flow.cutoff:
                    w = f.weight(r, flow.cutoff)
                    number += w
                    moment += wp.outer(w * d, d)
                    shear += wp.outer(w * (velocity[j] - v), d)
                    first_moment += w * d
                    dp = pressure[j] - p
                    rise += w * dp
                    slope += (w * dp) * d
                    pair_weight[at] = w / (r * r)
                else:
                    pair_weight[at] = scalar(0.0)
            for k in range(far_count[i]):
                j = far[place(i, k, flow.count, far_capacity)]
                dense += f.density_weight(wp.length(position[j] - x), flow.wide)

            sums = number
            above = first_moment[last]
            whole = moment
            s = flow.radius - wp.length(f.across(x))
            drag = scalar(0.0)
            for k in range(wall_count[i]):
                y = wall_position[wall[place(i, k, flow.count, wall_capacity)]]
                d = y - x
                r = wp.max(wp.length(d), shortest)
                dense += f.density_weight(r, flow.wide)
                if r < flow.cutoff:
                    w = f.weight(r, flow.cutoff)
                    number += w
                    whole += wp.outer(w * d, d)
                    above += w * d[last]
                    beyond = wp.length(f.across(y)) - flow.radius
                    if beyond > scalar(0.0) and y[last] > scalar(0.0):
                        # Velocity behind the wall continues the slope at the wall: what the pair would exchange
                        # is the wall's stress times this.
                        drag += w / (r * r) * wp.max(s + beyond, scalar(0.0))
            back = f.inverse(moment)
            fluid_inverse[i] = back
            whole_inverse[i] = f.inverse(whole)

            full = wp.max(number, scalar(FREE) * flow.lattice_number)
            inverse_number[i] = scalar(dimensions) / full
            wall_weight[i] = scalar(wp.static(2.0 * dimensions)) / full * drag

            surface = wp.int32(0)
            beneath = scalar(wp.static(BENEATH[dimensions])) * flow.lattice_number * flow.spacing
            if number < scalar(FREE) * flow.lattice_number and above < -beneath:
                surface = wp.int32(1)
            free[i] = surface
            excess = dense / flow.lattice_density - scalar(1.0)
            crowding[i] = flow.correction * wp.clamp(excess, scalar(-0.01), scalar(0.01))
            # The least-squares line through the neighbours' pressures filters modes that gradients do not see.
            bent = back * first_moment
            own = flow.cutoff / flow.spacing  # weight of the particle's own pressure
            weight = own + sums - wp.dot(first_moment, bent)
            forward = scalar(0.0)
            if weight > scalar(0.1) * own:
                forward = (rise - wp.dot(bent, slope)) / weight
            if surface == 1:
                predicted[i] = scalar(0.0)
                crowding[i] = scalar(0.0)
            else:
                predicted[i] = p + forward

            gradient = shear * back
            rate = scalar(0.0)
            for a in range(wp.static(dimensions)):
                for b in range(wp.static(dimensions)):
                    both = gradient[a, b] + gradient[b, a]
                    rate += scalar(0.5) * both * both
            rate = wp.sqrt(rate)
            apparent = flow.viscosity
            bent_rate = flow.regularisation * rate
            fall = wp.exp(-bent_rate)
            if bent_rate > scalar(1.0e-3):
                apparent += flow.yield_stress * (scalar(1.0) - fall) / rate
            else:
                apparent += flow.yield_stress * flow.regularisation * (scalar(1.0) - scalar(0.5) * bent_rate)
            tangent = flow.viscosity + flow.yield_stress * flow.regularisation * fall
            if wp.static(two_phase):
                if group[i] >= 0:
                    apparent = flow.aggregate_viscosity
                    tangent = apparent
            viscosity[i] = apparent
            # Velocity from the wall to here over the wall's stress: stress falls in a straight line towards the axis,
            # and the rate of shear with it, from what the tangent gives at the wall to what it is here.
            near_wall = wp.clamp(s, scalar(1.0e-3) * flow.spacing, flow.radius)
            bend = near_wall / flow.radius
            compliance[i] = near_wall * ((scalar(1.0) - bend) / apparent + scalar(0.5) * bend / tangent)

    return geometry


@functools.cache
def momentum_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Forces at the known velocities, and the matrix of their implicit change: viscosity and the slip layer."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = fluid_struct(scalar)
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def momentum(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        density: wp.array(dtype=scalar),
        position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        pair_weight: wp.array(dtype=scalar),
        inverse_number: wp.array(dtype=scalar),
        fluid_inverse: wp.array(dtype=t.mat),
        wall_weight: wp.array(dtype=scalar),
        wall_scale: wp.array(dtype=wp.float64),
        viscosity: wp.array(dtype=scalar),
        compliance: wp.array(dtype=scalar),
        predicted: wp.array(dtype=scalar),
        pair_coefficient: wp.array(dtype=scalar),
        diagonal: wp.array(dtype=scalar),
        drag: wp.array(dtype=scalar),
        traction: wp.array(dtype=scalar),
        residual: wp.array(dtype=t.vec),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            v = velocity[i]
            mu = viscosity[i]
            p = predicted[i]
            rho = flow.density
            if wp.static(two_phase):
                rho = density[i]
            total = scalar(0.0)
            force = t.vec()
            slope = t.vec()
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                weight = pair_weight[at]
                j = near[at]
                other = viscosity[j]
                laplacian = weight * (inverse_number[i] + inverse_number[j])
                c = laplacian * scalar(2.0) * mu * other / (mu + other)
                pair_coefficient[at] = c
                total += c
                force += c * (velocity[j] - v)
                d = position[j] - x
                # Times r squared, the Laplacian's weight is the gradient's.
                slope += (weight * wp.length_sq(d) * (predicted[j] - p)) * d
            force -= fluid_inverse[i] * slope
            force[last] = force[last] - rho * flow.gravity

            resist = scalar(0.0)
            stress = scalar(0.0)
            if wall_weight[i] > scalar(0.0):
                # The wall's stress follows from the velocity at the wall, not from the particle's own.
                n = f.outward(x)
                along = v - wp.dot(n, v) * n
                speed = wp.length(along)
                share = wall_weight[i] * scalar(wall_scale[0])
                if speed <= flow.slip_yield * compliance[i]:
                    resist = share / compliance[i]  # the layer does not slip
                    stress = speed / compliance[i]
                else:
                    damp = scalar(1.0) / (scalar(1.0) + flow.slip_viscosity * compliance[i])
                    resist = share * flow.slip_viscosity * damp
                    stress = damp * (flow.slip_yield + flow.slip_viscosity * speed)
                    force -= (share * flow.slip_yield * damp / speed) * along
                force -= resist * along
            drag[i] = resist
            traction[i] = stress
            diagonal[i] = rho / flow.dt + total
            residual[i] = force

    return momentum


@functools.cache
def divergence_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Divergence of the velocities, as right-hand side and matrix of the pressure's increment."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = fluid_struct(scalar)
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def divergence(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        wall_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        wall_count: wp.array(dtype=wp.int32),
        wall: wp.array(dtype=wp.int32),
        density: wp.array(dtype=scalar),
        free: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        wall_position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        pair_weight: wp.array(dtype=scalar),
        inverse_number: wp.array(dtype=scalar),
        whole_inverse: wp.array(dtype=t.mat),
        pair_coefficient: wp.array(dtype=scalar),
        diagonal: wp.array(dtype=scalar),
        residual: wp.array(dtype=scalar),
        increment: wp.array(dtype=scalar),
        potential: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            v = velocity[i]
            increment[i] = scalar(0.0)
            potential[i] = scalar(0.0)
            total = scalar(0.0)
            change = t.mat()
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                weight = pair_weight[at]
                j = near[at]
                c = weight * (inverse_number[i] + inverse_number[j])
                if wp.static(two_phase):
                    c *= scalar(2.0) * flow.density / (density[i] + density[j])
                pair_coefficient[at] = c
                total += c
                d = position[j] - x
                change += wp.outer((weight * wp.length_sq(d)) * (velocity[j] - v), d)
            beneath = wp.max(x[last], scalar(0.5) * flow.spacing)
            inside = wp.max(flow.radius - wp.length(f.across(x)), scalar(0.5) * flow.spacing)
            n = f.outward(x)
            for k in range(wall_count[i]):
                y = wall_position[wall[place(i, k, flow.count, wall_capacity)]]
                d = y - x
                r = wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)
                if r < flow.cutoff:
                    # Behind a wall the velocity towards it goes on in a straight line through its value there.
                    jump = t.vec()
                    beyond = wp.length(f.across(y)) - flow.radius
                    if beyond > scalar(0.0):
                        jump -= (wp.dot(v, n) * (inside + beyond) / inside) * n
                    if y[last] < scalar(0.0):
                        jump[last] = jump[last] - (v[last] - flow.piston_speed) * (beneath - y[last]) / beneath
                    change += wp.outer(f.weight(r, flow.cutoff) * jump, d)
            sum_of_slopes = wp.trace(change * whole_inverse[i])
            diagonal[i] = total
            residual[i] = -flow.density / flow.dt * sum_of_slopes
            if free[i] != 0:
                residual[i] = scalar(0.0)

    return divergence


@functools.cache
def gradient_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """End of the projection: velocities without divergence, and their pressure."""
    t = mps_types(scalar, dimensions)
    Flow = fluid_struct(scalar)
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def project(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        density: wp.array(dtype=scalar),
        position: wp.array(dtype=t.vec),
        pair_weight: wp.array(dtype=scalar),
        fluid_inverse: wp.array(dtype=t.mat),
        predicted: wp.array(dtype=scalar),
        increment: wp.array(dtype=scalar),
        velocity: wp.array(dtype=t.vec),
        pressure: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            p = increment[i]
            rho = flow.density
            if wp.static(two_phase):
                rho = density[i]
            slope = t.vec()
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                j = near[at]
                d = position[j] - x
                slope += (pair_weight[at] * wp.length_sq(d) * (increment[j] - p)) * d
            velocity[i] = velocity[i] - (flow.dt / rho) * (fluid_inverse[i] * slope)
            pressure[i] = predicted[i] + p

    return project
