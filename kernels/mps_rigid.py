"""Rigid groups of particles (passively moving solids, Koshizuka, Nobe & Oka 1998): coarse aggregate.

Particles of a grain move as fluid does; then their mean velocity and angular momentum become those of a rigid body.
Places follow from stored offsets, so that a grain keeps its shape for ever.
"""

import functools

import warp as wp

from .mps_types import HALTED, fluid_struct, mps_functions, mps_types
from .types import types


@functools.cache
def rigid_kernels(scalar, dimensions: int):
    """`velocities` before particles advance and `places` after it; a thread a grain."""
    t = mps_types(scalar, dimensions)
    vec3, mat33 = types(scalar).vec3, types(scalar).mat33
    f = mps_functions(scalar, dimensions)
    Flow = fluid_struct(scalar)
    flat = dimensions == 2
    last = dimensions - 1

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

    @wp.kernel(enable_backward=False, module="unique")
    def velocities(
        flow: Flow,
        flags: wp.array(dtype=wp.int32),
        first: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        moved: wp.array(dtype=t.vec),
        spin: wp.array(dtype=vec3),
        step: wp.array(dtype=t.vec),
    ):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        count = scalar(first[g + 1] - first[g])
        centre = t.vec()
        mean = t.vec()
        aside = t.vec()
        for i in range(first[g], first[g + 1]):
            centre += position[i]
            mean += velocity[i]
            aside += moved[i]
        centre = centre / count
        mean = mean / count
        aside = aside / count
        momentum = vec3()
        inertia = mat33()
        for i in range(first[g], first[g + 1]):
            r = raised(position[i] - centre)
            momentum += wp.cross(r, raised(velocity[i] - mean))
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
        for i in range(first[g], first[g + 1]):
            velocity[i] = mean + lowered(wp.cross(turn, raised(position[i] - centre)))
            moved[i] = aside
        spin[g] = turn
        mean[last] = mean[last] - flow.piston_speed
        step[g] = flow.dt * mean + aside

    @wp.kernel(enable_backward=False, module="unique")
    def places(
        flow: Flow,
        flags: wp.array(dtype=wp.int32),
        first: wp.array(dtype=wp.int32),
        offset: wp.array(dtype=t.vec),
        step: wp.array(dtype=t.vec),
        spin: wp.array(dtype=vec3),
        middle: wp.array(dtype=t.vec),
        middle_rounding: wp.array(dtype=t.vec),
        turn: wp.array(dtype=t.mat),
        position: wp.array(dtype=t.vec),
    ):
        if flags[HALTED] != 0:
            return
        g = wp.tid()
        turn[g] = turned(turn[g], flow.dt * spin[g])
        way = step[g] - middle_rounding[g]
        centre = middle[g] + way
        middle_rounding[g] = (centre - middle[g]) - way
        # A grain that would reach into a wall goes back as far as its deepest particle does.
        closest = scalar(0.25) * flow.spacing
        deepest = scalar(0.0)
        lowest = scalar(0.0)
        back = t.vec()
        for i in range(first[g], first[g + 1]):
            target = centre + turn[g] * offset[i]
            out = wp.length(f.across(target)) - (flow.radius - closest)
            if out > deepest:
                deepest = out
                back = f.outward(target)
            lowest = wp.max(lowest, closest - target[last])
        centre = centre - deepest * back
        centre[last] = centre[last] + lowest
        for i in range(first[g], first[g + 1]):
            position[i] = centre + turn[g] * offset[i]
        middle[g] = centre

    return velocities, places
