"""Operators of the moving particle method: forces, divergence and pressure gradient of a step, without its solves.

Gradient and divergence are exact for linear fields (weighted least squares over the neighbours).

The Laplacian is the sum over pairs of Xu, Li & Jiang 2021 (Eq. 5), with weights that vanish at their reach. The sum is
multiplied by a factor: twice the number of dimensions, divided by the sum of the gradient's weights. This makes the
Laplacian exact for quadratic fields wherever the neighbours are distributed evenly. Each pair uses the mean of both
particles' factors, so that momentum is conserved.
"""

import functools

import warp as wp

from ..common.control import HALTED
from .flow_laws import BINGHAM, law_functions
from .structs import array_structs, flow_struct, mps_functions, mps_types, row_place, span

NEARER, DAMPED = wp.constant(0.45), wp.constant(2.0)
"""Damping of the pressure at walls: a distance from the wall divided by the particle spacing, and a factor.

For particles closer to a wall than NEARER spacings, the diagonal of the pressure equation is multiplied by DAMPED.
Without this damping, the pressure would oscillate from step to step. A pressure increment changes the particle's
velocity, and with it the velocity that is extrapolated behind the wall. Both velocities change the divergence at the
particle itself. Very close to the wall, this response exceeds twice the response that the undamped diagonal describes.
In the initial lattice the outermost particles are half a spacing from the wall, so they are not damped.
"""


@functools.cache
def wall_law_function(scalar, dimensions: int, slip_law: str):
    """Build `wall_force`, which computes the force of the slip layer between the wall and a particle beside it."""
    if slip_law != BINGHAM:
        return other_wall_law_function(scalar, dimensions, slip_law)
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)

    @wp.func
    def wall_force(flow: FlowConstants, x: t.vec, v: t.vec, area: scalar, compliance: scalar, force: t.vec):
        """Return `force` plus the force of the slip layer, the layer's resistance, and the wall's stress [Pa].

        The slip law is Eq. 8 of Xu, Li & Jiang 2021. Forces are per volume [N/m3]. `area` is the wall's area divided by
        the particle's volume [1/m]. `compliance` is the velocity difference due to shear between particle and wall,
        divided by the wall's stress [m/s/Pa]. The resistance is the derivative of the layer's braking force with
        respect to the particle's velocity [kg/m3/s].
        """
        resist = scalar(0.0)
        stress = scalar(0.0)
        # The concrete between wall and particle is sheared. The slip velocity is therefore the particle's velocity
        # minus `compliance` times the stress.
        n = f.outward(x)
        along = v - wp.dot(n, v) * n
        speed = wp.length(along)
        if speed <= flow.slip_yield * compliance:
            # The slip layer sticks, because the stress in it is below the yield stress of the layer.
            resist = area / compliance
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
def other_wall_law_function(scalar, dimensions: int, slip_law: str):
    """Build `wall_force` for a slip layer whose stress above the yield stress is not linear in the slip velocity."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    layer = law_functions(scalar, slip_law)

    @wp.func
    def wall_force(flow: FlowConstants, x: t.vec, v: t.vec, area: scalar, compliance: scalar, force: t.vec):
        """Return `force` plus the slip layer's force, the slip layer's resistance, and the wall stress [Pa].

        Arguments and results are the same as in :func:`wall_law_function`. Slip velocity and shear must add up to the
        particle's speed. Newton's method, kept between two bounds, finds the stress for which they do.
        """
        n = f.outward(x)
        along = v - wp.dot(n, v) * n
        speed = wp.length(along)
        stress = speed / compliance  # Stress if the slip layer sticks, so that the whole speed is due to shear.
        eased = compliance
        if stress > flow.slip_yield:
            low = flow.slip_yield
            high = wp.min(stress, low + layer.stress(flow.slip_viscosity, flow.slip_index, flow.slip_quadratic, speed))
            stress = high
            for _ in range(40):
                over = stress - flow.slip_yield
                slip = layer.rate(flow.slip_viscosity, flow.slip_index, flow.slip_quadratic, over)
                eased = compliance + layer.slope(flow.slip_viscosity, flow.slip_index, flow.slip_quadratic, over, slip)
                value = slip + compliance * stress - speed
                if value > scalar(0.0):
                    high = stress
                else:
                    low = stress
                next = stress - value / eased
                if next <= low or next >= high:
                    next = scalar(0.5) * (low + high)
                step = next - stress
                stress = next
                if wp.abs(step) <= scalar(1.0e-6) * stress:
                    break
        if speed > scalar(0.0):
            force -= (area * stress / speed) * along
        return force, area / eased, stress

    return wall_force


@functools.cache
def momentum_kernel(scalar, dimensions: int, serial: bool, two_phase: bool, slip_law: str = BINGHAM):
    """Build the kernel that sets up the implicit solve for the velocities.

    The forces per volume at the velocities before the solve are stored as the residual with which the solve starts. The
    matrix contains the forces that act implicitly: inertia, viscosity and the slip layer's resistance. The pressure
    gradient and gravity act explicitly, so they are part of the residual only.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    Matrix, Solve = structs.Matrix, structs.VectorSolve
    wall_force = wall_law_function(scalar, dimensions, slip_law)
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def momentum(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        # The next arguments are the range of particles that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments hold the state of the flow, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # The next arguments are arrays that this kernel writes.
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
                    # Between a particle of a rigid grain and a particle of mortar, only half of the distance is mortar
                    # that can be sheared, which doubles the coefficient `c`. The coefficient is also doubled between
                    # particles of two different grains. Within one grain nothing is sheared, so the coefficient is
                    # zero.
                    if i < matrix.grain_rows:
                        if j >= matrix.grain_rows:
                            c = laplacian * scalar(2.0) * other
                        elif particles.group[i] == particles.group[j]:
                            c = scalar(0.0)
                        else:
                            c *= scalar(2.0)
                    elif j < matrix.grain_rows:
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
    """Build the kernel that sets up the equations of the pressure increment.

    The right-hand side is -density / dt times the divergence of the velocities, where `density` is the reference
    density. The matrix is minus the Laplacian. In two-phase flows, the coefficient of a pair is multiplied by the
    reference density and divided by the mean density of the pair.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    Matrix, Solve = structs.Matrix, structs.NumberSolve
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def divergence(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        # The next arguments are the range of particles that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments hold the state of the flow, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # The next arguments are arrays that this kernel writes.
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
                    # Extrapolate the normal velocity linearly to the wall particle, so that at the wall it equals the
                    # wall's velocity.
                    jump = t.vec()
                    beyond = wp.length(f.across(y)) - flow.radius
                    if beyond > scalar(0.0):
                        jump -= (wp.dot(v, n) * (inside + beyond) / inside) * n
                    if y[last] < scalar(0.0):
                        jump[last] = jump[last] - (v[last] - flow.piston_speed) * (beneath - y[last]) / beneath
                    change += wp.outer(f.weight(r, flow.cutoff) * jump, d)
            sum_of_slopes = wp.trace(change * fields.all_inverse[i])
            if flow.radius - wp.length(f.across(x)) < scalar(NEARER) * flow.spacing:
                total *= scalar(DAMPED)
            matrix.diagonal[i] = total
            projection.residual[i] = -flow.density / flow.dt * sum_of_slopes
            if matrix.free[i] != 0:
                projection.residual[i] = scalar(0.0)

    return divergence


@functools.cache
def gradient_kernel(scalar, dimensions: int, serial: bool, two_phase: bool):
    """Build the kernel that subtracts the pressure increment's gradient from the velocities, and updates the pressure.

    This last stage of the projection makes the velocities divergence-free.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def project(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        # The next arguments are the range of particles that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments hold the state of the flow, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        lists: Lists,
        fields: Fields,
        # The next arguments are arrays that this kernel reads and writes.
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
