"""Kernel that calls the functions of a contact law along prescribed motions of two bodies, to test the law itself."""

import functools

import warp as wp

from ..common.types import types
from .contact_law import contact_functions


@functools.cache
def law_trial_kernel(scalar, law):
    """Return a kernel that evaluates a contact law along a prescribed path, for two spheres and for a sphere at a wall.

    All array arguments except `parameters` have the shape (2, steps). Thread 0 evaluates the contact of two spheres,
    and thread 1 the contact of a sphere with a wall. A path is given by the gap between the surfaces [m], the speed at
    which the gap opens [m/s], and the speed at which body b slides along body a [m/s]. Body b also rolls at this speed.
    If `keep` is 0, each step begins with a zero history.
    """
    t = types(scalar)
    f = contact_functions(scalar)
    sphere_touch, wall_touch = f.sphere_touch, f.wall_touch
    functions, rolls = law.functions(scalar), law.rolls
    Parameters, force, stiffness, energy = functions.Parameters, functions.force, functions.stiffness, functions.energy
    moment, moment_energy = (functions.moment, functions.moment_energy) if rolls else (None, None)

    @wp.kernel(module="unique", enable_backward=False)
    def march(
        parameters: wp.array(dtype=Parameters), keep: wp.int32, dt: scalar, radius: scalar, mass: scalar,
        gaps: wp.array2d(dtype=scalar),
        openings: wp.array2d(dtype=scalar), slidings: wp.array2d(dtype=scalar), forces: wp.array2d(dtype=t.vec3),
        histories: wp.array2d(dtype=t.vec3), losses: wp.array2d(dtype=scalar), stiffnesses: wp.array2d(dtype=t.vec4),
        energies: wp.array2d(dtype=scalar), moments: wp.array2d(dtype=t.vec3), turnings: wp.array2d(dtype=t.vec3),
    ):  # fmt: skip
        i = wp.tid()
        zero = scalar(0.0)
        p = parameters[0]
        n = t.vec3(scalar(0.6), zero, scalar(0.8))
        along = t.vec3(zero, scalar(1.0), zero)
        history = t.vec3()
        rolling = t.vec3()
        for k in range(gaps.shape[1]):
            velocity = openings[i, k] * n + slidings[i, k] * along
            touch = sphere_touch(n, gaps[i, k], velocity, zero, radius, radius, mass, mass)
            if i == 1:
                touch = wall_touch(n, gaps[i, k], velocity, zero, radius, mass)
            if keep == 0:
                history = t.vec3()
            on_a, after, lost = force(p, touch, history, dt)
            forces[i, k] = on_a
            histories[i, k] = after
            losses[i, k] = lost
            stiffnesses[i, k] = stiffness(p, touch)
            energies[i, k] = energy(p, touch, after)
            history = histories[i, k]
            if wp.static(rolls):
                turning = slidings[i, k] / radius * wp.cross(n, along)
                torque, twisted, slipped = moment(p, touch, turning, rolling, dt)
                moments[i, k] = torque
                turnings[i, k] = twisted
                losses[i, k] += slipped
                energies[i, k] += moment_energy(p, touch, twisted)
                rolling = turnings[i, k]

    return march
