"""Rigid groups of particles, which are the grains of coarse aggregate.

The viscous solve admits only rigid motions of a grain. For each grain, the unknowns of the solve are a velocity and a
spin, and the loads are a resultant force and a moment. The pressure then accelerates the grain's particles as if they
were fluid. Afterwards the particles get the rigid motion that has the same momentum and angular momentum (passively
moving solids, Koshizuka, Nobe & Oka 1998). Their positions follow from stored offsets, so that a grain never changes
its shape.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from .structs import array_structs, flow_struct, mps_functions, mps_types


@functools.cache
def rotation_functions(scalar, dimensions: int):
    """Build functions for rotations in two or three dimensions.

    `to_3d` converts a vector to three dimensions, and `from_3d` converts it back. `rotated` applies a further small
    rotation to a rotation matrix.
    """
    t = mps_types(scalar, dimensions)
    vec3 = types(scalar).vec3
    flat = dimensions == 2

    @wp.func
    def to_3d(v: t.vec) -> vec3:
        """Return a vector in three dimensions; the two axes of a plane become x and z."""
        if wp.static(flat):
            return vec3(v[0], scalar(0.0), v[1])
        else:
            return vec3(v[0], v[1], v[wp.static(dimensions - 1)])

    @wp.func
    def from_3d(v: vec3) -> t.vec:
        if wp.static(flat):
            return t.vec(v[0], v[2])
        else:
            return t.vec(v)

    @wp.func
    def rotated(m: t.mat, angle: vec3) -> t.mat:
        """Return rotation matrix `m` followed by a small rotation, which is given as a rotation vector [rad]."""
        size = wp.length(angle)
        if size == scalar(0.0):
            return m
        if wp.static(flat):
            # The rotation in a plane is about y and turns z towards x.
            s, c = wp.sin(angle[1]), wp.cos(angle[1])
            after = t.mat(c, s, -s, c) * m
            long = wp.sqrt(after[0, 0] * after[0, 0] + after[1, 0] * after[1, 0])
            c, s = after[0, 0] / long, after[0, 1] / long
            return t.mat(c, s, -s, c)
        else:
            after = wp.quat_to_matrix(wp.quat_from_axis_angle(angle / size, size)) * m
            # Make the rows of the rotation matrix orthonormal again, because rounding errors accumulate.
            x = wp.normalize(vec3(after[0, 0], after[0, 1], after[0, 2]))
            y = vec3(after[1, 0], after[1, 1], after[1, 2])
            y = wp.normalize(y - wp.dot(x, y) * x)
            return wp.matrix_from_rows(x, y, wp.cross(x, y))

    return SimpleNamespace(to_3d=to_3d, from_3d=from_3d, rotated=rotated)


@functools.cache
def body_functions(scalar, dimensions: int) -> SimpleNamespace:
    """Build functions that treat a grain as a rigid body.

    `lever_inertia` is the inertia of one particle of unit mass about a centre, and `inverted` inverts an inertia.
    `resultant` sums vectors, such as forces, over a grain's particles, and `moment` sums their moments about a centre.
    `spun` is the velocity of a particle due to the grain's spin.
    """
    t = mps_types(scalar, dimensions)
    vec3, mat33 = types(scalar).vec3, types(scalar).mat33
    rotation = rotation_functions(scalar, dimensions)
    to_3d, from_3d = rotation.to_3d, rotation.from_3d
    flat = dimensions == 2

    @wp.func
    def lever_inertia(lever: t.vec) -> mat33:
        r = to_3d(lever)
        return wp.length_sq(r) * wp.identity(n=3, dtype=scalar) - wp.outer(r, r)

    @wp.func
    def inverted(inertia: mat33) -> mat33:
        """Return the inverse of an inertia matrix; in two dimensions, only the entry for rotation about y is set."""
        inverse = mat33()
        if wp.static(flat):
            if inertia[1, 1] > scalar(0.0):
                inverse[1, 1] = scalar(1.0) / inertia[1, 1]
        else:
            size = wp.trace(inertia) / scalar(3.0)
            if size > scalar(0.0):
                # Particles on a straight line have no inertia and no angular momentum about that line. A small added
                # inertia makes the matrix invertible, and the spin about the line stays zero.
                if wp.determinant(inertia) < scalar(1.0e-3) * size * size * size:
                    inertia += scalar(1.0e-4) * size * wp.identity(n=3, dtype=scalar)
                inverse = wp.inverse(inertia)
        return inverse

    @wp.func
    def resultant(borne: wp.array(dtype=t.vec), begin: wp.int32, end: wp.int32) -> t.vec:
        sum = t.vec()
        for i in range(begin, end):
            sum += borne[i]
        return sum

    @wp.func
    def moment(
        borne: wp.array(dtype=t.vec), mean: t.vec, place: wp.array(dtype=t.vec), centre: t.vec, begin: wp.int32,
        end: wp.int32,
    ) -> vec3:  # fmt: skip
        """Return the sum of the moments about `centre` of the vectors `borne`, one vector for each particle of a grain.

        `place` contains the positions of the particles, and `centre` is the mean of these positions. A constant vector
        has no moment about this centre, so `mean` may be subtracted from all vectors to reduce rounding errors.
        """
        sum = vec3()
        for i in range(begin, end):
            sum += wp.cross(to_3d(place[i] - centre), to_3d(borne[i] - mean))
        return sum

    @wp.func
    def spun(spin: vec3, lever: t.vec) -> t.vec:
        return from_3d(wp.cross(spin, to_3d(lever)))

    return SimpleNamespace(
        lever_inertia=lever_inertia, inverted=inverted, resultant=resultant, moment=moment, spun=spun
    )


@functools.cache
def bodies_kernel(scalar, dimensions: int):
    """Build the kernel that computes centre, inverse inertia and mobilities of each grain for the viscous solve.

    It runs with one thread per grain. The mobilities of a grain are its velocity per force and its spin per moment.
    They are computed from the diagonal of the solve's matrix only, because they serve as a preconditioner.
    """
    mat33 = types(scalar).mat33
    body = body_functions(scalar, dimensions)
    structs = array_structs(scalar, dimensions)
    Particles, Matrix, Grains = structs.Particles, structs.Matrix, structs.Grains

    @wp.kernel(enable_backward=False, module="unique")
    def bodies(flags: wp.array(dtype=wp.int32), particles: Particles, matrix: Matrix, grains: Grains):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        begin, end = grains.first[g], grains.first[g + 1]
        centre = body.resultant(particles.position, begin, end) / scalar(end - begin)
        inertia = mat33()
        resistance = scalar(0.0)
        spin_resistance = mat33()
        for i in range(begin, end):
            lever = body.lever_inertia(particles.position[i] - centre)
            own = matrix.diagonal[i] + matrix.drag[i]
            inertia += lever
            resistance += own
            spin_resistance += own * lever
        grains.centre[g] = centre
        grains.inverse_inertia[g] = body.inverted(inertia)
        grains.mobility[g] = scalar(1.0) / resistance
        grains.spin_mobility[g] = body.inverted(spin_resistance)

    return bodies


@functools.cache
def share_function(scalar, dimensions: int):
    """Build `share`, which applies the preconditioner to the residual of one rigid grain.

    Only the resultant force and moment of the residual matter. The function writes the preconditioned residual of the
    grain's particles. It returns two numbers: the inner product of residual and preconditioned residual, and the
    squared norm of the residual's projection onto rigid motions.
    """
    t = mps_types(scalar, dimensions)
    body = body_functions(scalar, dimensions)
    Grains = array_structs(scalar, dimensions).Grains

    @wp.func
    def share(
        g: wp.int32,
        grains: Grains,
        position: wp.array(dtype=t.vec),
        residual: wp.array(dtype=t.vec),
        preconditioned: wp.array(dtype=t.vec),
    ):
        begin, end = grains.first[g], grains.first[g + 1]
        centre = grains.centre[g]
        force = body.resultant(residual, begin, end)
        moment = body.moment(residual, t.vec(), position, centre, begin, end)
        mean = grains.mobility[g] * force
        spin = grains.spin_mobility[g] * moment
        for i in range(begin, end):
            preconditioned[i] = mean + body.spun(spin, position[i] - centre)
        inner = wp.dot(force, mean) + wp.dot(moment, spin)
        square = wp.length_sq(force) / scalar(end - begin) + wp.dot(moment, grains.inverse_inertia[g] * moment)
        return wp.float64(inner), wp.float64(square)

    return share


@functools.cache
def velocities_kernel(scalar, dimensions: int):
    """Build the kernel that replaces the velocities of each grain's particles by a rigid motion.

    The rigid motion has the mean velocity and the angular momentum of these particles. The kernel runs before the
    particles advance, with one thread per grain.
    """
    body = body_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Fields, Grains = structs.Particles, structs.Fields, structs.Grains
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def velocities(
        flow: FlowConstants, flags: wp.array(dtype=wp.int32), particles: Particles, fields: Fields, grains: Grains
    ):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        begin, end = grains.first[g], grains.first[g + 1]
        count = scalar(end - begin)
        centre = grains.centre[g]
        mean = body.resultant(particles.velocity, begin, end) / count
        aside = body.resultant(fields.extra_displacement, begin, end) / count
        spin = grains.inverse_inertia[g] * body.moment(particles.velocity, mean, particles.position, centre, begin, end)
        for i in range(begin, end):
            particles.velocity[i] = mean + body.spun(spin, particles.position[i] - centre)
            fields.extra_displacement[i] = aside
        grains.spin[g] = spin
        mean[last] = mean[last] - flow.piston_speed
        grains.step[g] = flow.dt * mean + aside

    return velocities


@functools.cache
def places_kernel(scalar, dimensions: int):
    """Build the kernel that moves and rotates each grain after the particles have advanced (one thread per grain)."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    rotated = rotation_functions(scalar, dimensions).rotated
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Grains = structs.Particles, structs.Grains
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def places(flow: FlowConstants, flags: wp.array(dtype=wp.int32), particles: Particles, grains: Grains):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        grains.turn[g] = rotated(grains.turn[g], flow.dt * grains.spin[g])
        step = grains.step[g] - grains.middle_rounding[g]
        centre = grains.middle[g] + step
        grains.middle_rounding[g] = (centre - grains.middle[g]) - step
        # A grain that would penetrate a wall is moved back by the depth of its deepest particle.
        deepest = scalar(0.0)
        lowest = scalar(0.0)
        back = t.vec()
        for i in range(grains.first[g], grains.first[g + 1]):
            target = centre + grains.turn[g] * grains.offset[i]
            out = f.beyond_room(flow, target)
            if out > deepest:
                deepest = out
                back = f.outward(target)
            lowest = wp.max(lowest, scalar(0.25) * flow.spacing - target[last])
        centre = centre - deepest * back
        centre[last] = centre[last] + lowest
        for i in range(grains.first[g], grains.first[g + 1]):
            particles.position[i] = centre + grains.turn[g] * grains.offset[i]
        grains.middle[g] = centre

    return places
