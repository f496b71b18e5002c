"""Rigid groups of particles (passively moving solids, Koshizuka, Nobe & Oka 1998): coarse aggregate.

Particles of a grain move as fluid does; then their mean velocity and angular momentum become those of a rigid body.
Places follow from stored offsets, so that a grain keeps its shape for ever.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from .structs import array_structs, flow_struct, mps_functions, mps_types


@functools.cache
def rotation_functions(scalar, dimensions: int):
    """`raised` to three dimensions, `lowered` back, and `turned`, a rotation that is turned further."""
    t = mps_types(scalar, dimensions)
    vec3 = types(scalar).vec3
    flat = dimensions == 2

    @wp.func
    def raised(v: t.vec) -> vec3:
        """A vector in three dimensions; a plane's is x and z."""
        if wp.static(flat):
            return vec3(v[0], scalar(0.0), v[1])
        else:
            return vec3(v[0], v[1], v[wp.static(dimensions - 1)])

    @wp.func
    def lowered(v: vec3) -> t.vec:
        if wp.static(flat):
            return t.vec(v[0], v[2])
        else:
            return t.vec(v)

    @wp.func
    def turned(m: t.mat, angle: vec3) -> t.mat:
        """A rotation, turned further by a small angle."""
        size = wp.length(angle)
        if size == scalar(0.0):
            return m
        if wp.static(flat):
            # About y: z turns towards x.
            s, c = wp.sin(angle[1]), wp.cos(angle[1])
            after = t.mat(c, s, -s, c) * m
            long = wp.sqrt(after[0, 0] * after[0, 0] + after[1, 0] * after[1, 0])
            c, s = after[0, 0] / long, after[0, 1] / long
            return t.mat(c, s, -s, c)
        else:
            after = wp.quat_to_matrix(wp.quat_from_axis_angle(angle / size, size)) * m
            # Rows at right angles and of length one, whatever rounding did.
            x = wp.normalize(vec3(after[0, 0], after[0, 1], after[0, 2]))
            y = vec3(after[1, 0], after[1, 1], after[1, 2])
            y = wp.normalize(y - wp.dot(x, y) * x)
            return wp.matrix_from_rows(x, y, wp.cross(x, y))

    return SimpleNamespace(raised=raised, lowered=lowered, turned=turned)


@functools.cache
def velocities_kernel(scalar, dimensions: int):
    """Before particles advance: mean velocity and angular momentum of each grain, a thread a grain."""
    t = mps_types(scalar, dimensions)
    vec3, mat33 = types(scalar).vec3, types(scalar).mat33
    rotation = rotation_functions(scalar, dimensions)
    raised, lowered = rotation.raised, rotation.lowered
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Fields, Grains = structs.Particles, structs.Fields, structs.Grains
    flat = dimensions == 2
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def velocities(flow: Flow, flags: wp.array(dtype=wp.int32), particles: Particles, fields: Fields, grains: Grains):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        begin = grains.first[g]
        end = grains.first[g + 1]
        count = scalar(end - begin)
        centre = t.vec()
        mean = t.vec()
        aside = t.vec()
        for i in range(begin, end):
            centre += particles.position[i]
            mean += particles.velocity[i]
            aside += fields.moved[i]
        centre = centre / count
        mean = mean / count
        aside = aside / count
        momentum = vec3()
        inertia = mat33()
        for i in range(begin, end):
            r = raised(particles.position[i] - centre)
            momentum += wp.cross(r, raised(particles.velocity[i] - mean))
            inertia += wp.length_sq(r) * wp.identity(n=3, dtype=scalar) - wp.outer(r, r)
        turn = vec3()
        if wp.static(flat):
            if inertia[1, 1] > scalar(0.0):
                turn = vec3(scalar(0.0), momentum[1] / inertia[1, 1], scalar(0.0))
        else:
            size = wp.trace(inertia) / scalar(3.0)
            if size > scalar(0.0):
                # Particles in a row have no inertia about it, and no momentum: a little makes that spin nothing.
                if wp.determinant(inertia) < scalar(1.0e-3) * size * size * size:
                    inertia += scalar(1.0e-4) * size * wp.identity(n=3, dtype=scalar)
                turn = wp.inverse(inertia) * momentum
        for i in range(begin, end):
            particles.velocity[i] = mean + lowered(wp.cross(turn, raised(particles.position[i] - centre)))
            fields.moved[i] = aside
        grains.spin[g] = turn
        mean[last] = mean[last] - flow.piston_speed
        grains.step[g] = flow.dt * mean + aside

    return velocities


@functools.cache
def places_kernel(scalar, dimensions: int):
    """After particles advance: each grain at its new place, turned, a thread a grain."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    turned = rotation_functions(scalar, dimensions).turned
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Grains = structs.Particles, structs.Grains
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def places(flow: Flow, flags: wp.array(dtype=wp.int32), particles: Particles, grains: Grains):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        grains.turn[g] = turned(grains.turn[g], flow.dt * grains.spin[g])
        step = grains.step[g] - grains.middle_rounding[g]
        centre = grains.middle[g] + step
        grains.middle_rounding[g] = (centre - grains.middle[g]) - step
        # A grain that would reach into a wall goes back as far as its deepest particle does.
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
