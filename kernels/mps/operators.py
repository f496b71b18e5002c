"""Operators of the moving particle method: what a step computes from places and velocities, apart from its solves.

Gradient and divergence are exact for linear fields (weighted least squares over the neighbours); the Laplacian is the
pairwise sum of Xu, Li & Jiang 2021 (Eq. 5), with weights that vanish at their reach. Its factor is twice the
dimensions over the sum of the gradient's weights, which makes it exact for quadratics wherever neighbours lie evenly
around; a pair takes the mean of both, so that what one gains the other loses.
"""

import functools

import warp as wp

from ..common.control import HALTED
from .structs import array_structs, flow_struct, mps_functions, mps_types, row_place, span

NEARER, DAMPED = wp.constant(0.45), wp.constant(2.0)
"""Particles nearer to a wall than this part of a spacing, which stand there in the lattice at a half, get this times
their diagonal in the pressure's equation: what their increments give back to their own divergence, from the velocity
that goes on behind the wall, else grows past twice of it, and pressures swing from step to step."""


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
        # Input: parameters of the flow.
        flow: Flow,
        # Input: range of rows of this launch.
        first: wp.int32,
        end: wp.int32,
        # Input: state, which is only read.
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # Output: arrays that are written.
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
        # Input: parameters of the flow.
        flow: Flow,
        # Input: range of rows of this launch.
        first: wp.int32,
        end: wp.int32,
        # Input: state, which is only read.
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # Output: arrays that are written.
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
        # Input: parameters of the flow.
        flow: Flow,
        # Input: range of rows of this launch.
        first: wp.int32,
        end: wp.int32,
        # Input: state, which is only read.
        flags: wp.array(dtype=wp.int32),
        lists: Lists,
        fields: Fields,
        # Input and output: arrays that are read and written.
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
