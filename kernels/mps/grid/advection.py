"""Motion of the particles with the velocities of the grid, which are interpolated linearly.

The method is affine particle-in-cell (Jiang et al. 2015), in which each particle also takes over the gradient of the
velocity. `transfer.py` transfers velocities from the particles to the grid.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED, STEPS
from ..structs import mps_types
from .cells import DT, LAST, OPEN, GridKind, grid_parameters_struct, grid_structs, item
from .places import grid_functions

CLEAR = wp.constant(0.02)
"""Minimum distance of particles from a wall that cuts cells, divided by the width of a cell."""


@functools.cache
def sampling_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions that interpolate fields of the grid linearly at a position.

    `carry` interpolates the velocity, and `clearance` interpolates the distance from the nearest wall.
    """
    dims, last = of.dimensions, of.dimensions - 1
    t = mps_types(scalar, dims)
    vec, mat, whole = t.vec, t.mat, t.whole
    Grid = grid_parameters_struct(scalar, dims)
    Geometry = grid_structs(scalar, dims).Geometry
    f = grid_functions(scalar, of)
    corners = 2**dims

    @wp.func
    def corner(g: Grid, base: whole, s: vec, n: wp.int32):
        """Return one corner of a grid cell, with its weight in linear interpolation and the gradient of this weight.

        `base` holds the grid indices of the cell's lowest corner, and `n` is the number of the wanted corner, from 0 to
        2^axes - 1. `s` is the position at which to interpolate, from 0 to 1 along each axis of the cell. The corner is
        returned as its grid indices.
        """
        c = whole()
        part = vec()
        sign = vec()
        bits = n
        for b in range(dims):
            upper = bits % 2
            bits = bits / 2
            c[b] = base[b] + upper
            part[b] = wp.where(upper == 0, scalar(1.0) - s[b], s[b])
            sign[b] = wp.where(upper == 0, scalar(-1.0), scalar(1.0)) / g.width[b]
        weight = scalar(1.0)
        change = sign
        for b in range(dims):
            weight *= part[b]
            for d in range(dims):
                if d != b:
                    change[b] = change[b] * part[d]
        return c, weight, change

    @wp.func
    def sample(
        g: Grid, velocity: wp.array(dtype=scalar), good: wp.array(dtype=wp.int32), x: vec, axis: wp.int32
    ):  # fmt: skip
        """Return a velocity component at a position, its gradient, and the total weight of the faces that contribute.

        The component is interpolated between the faces of the grid. Only faces with a known velocity, which have a
        nonzero entry in `good`, are used. In air, far from the concrete, their total weight is 0.
        """
        base = whole()
        s = vec()
        for b in range(dims):
            half = wp.where(b == axis, scalar(0.0), scalar(0.5))
            along = (x[b] - g.origin[b]) / g.width[b] - half
            base[b] = wp.int32(wp.floor(along))
            if b != last or wp.static(not of.periodic):
                base[b] = wp.clamp(base[b], -1, g.n[b] - wp.where(b == axis, 0, 1))
            s[b] = along - scalar(base[b])
        value = scalar(0.0)
        slope = vec()
        total = scalar(0.0)
        total_slope = vec()
        for n in range(corners):
            c, weight, change = corner(g, base, s, n)
            for b in range(dims):
                if b != last or wp.static(not of.periodic):
                    c[b] = wp.min(c[b], g.n[b])
            r = f.at(g, c) + axis * g.slots
            if good[r] != 0:
                value += weight * velocity[r]
                total += weight
                slope += velocity[r] * change
                total_slope += change
        if total > scalar(0.0):
            value = value / total
        return value, slope - value * total_slope, total

    @wp.func
    def carry(g: Grid, velocity: wp.array(dtype=scalar), good: wp.array(dtype=wp.int32), x: vec):
        """Return the velocity at a position, its gradient, and the total weight of the faces that contribute.

        The velocity is interpolated between the faces of the grid. Only faces with a known velocity, which have a
        nonzero entry in `good`, are used. In air, far from the concrete, their total weight is 0.
        """
        here = vec()
        slopes = mat()
        total = scalar(0.0)
        for axis in range(dims):
            value, slope, total = sample(g, velocity, good, x, axis)
            here[axis] = value
            for b in range(dims):
                slopes[axis, b] = slope[b]
        return here, slopes, total

    @wp.func
    def clearance(g: Grid, geometry: Geometry, x: vec):
        """Return the distance of a position from the nearest wall [m] and the gradient of this distance.

        The distances are stored at points half a cell apart, to resolve walls that are hardly thicker than half a cell.
        """
        base = whole()
        s = vec()
        for b in range(dims):
            along = scalar(2.0) * (x[b] - g.origin[b]) / g.width[b] - scalar(0.5)
            base[b] = wp.clamp(wp.int32(wp.floor(along)), -2, 2 * g.n[b])
            s[b] = along - scalar(base[b])
        value = scalar(0.0)
        slope = vec()
        for n in range(corners):
            half, weight, change = corner(g, base, s, n)
            c = whole()
            which = wp.int32(0)
            for b in range(dims):
                # Divide the index of a half cell by two to get the index of its cell. Integer division would round
                # negative indices upwards. The lowest index is -2, so add 2 before the division and subtract 1
                # afterwards.
                c[b] = (half[b] + 2) / 2 - 1
                which += (half[b] - 2 * c[b]) * (1 << b)
            depth = geometry.depth[f.at(g, c) * corners + which]
            value += weight * depth
            slope += scalar(2.0) * depth * change
        return value, slope

    return SimpleNamespace(carry=carry, clearance=clearance)


@functools.cache
def advect_kernel(scalar, of: GridKind):
    """Build the kernel that gives particles the velocity of the grid and moves them, with one task per particle.

    A particle moves with the velocity at its position half a step later (midpoint rule).
    """
    dims, last = of.dimensions, of.dimensions - 1
    t = mps_types(scalar, dims)
    vec, mat, whole = t.vec, t.mat, t.whole
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Particles, Fields, Geometry = structs.Particles, structs.Fields, structs.Geometry
    f = grid_functions(scalar, of)
    at_place = sampling_functions(scalar, of)
    carry, clearance = at_place.carry, at_place.clearance

    @wp.func
    def leaves(g: Grid, mesh: Fields, x: vec) -> wp.bool:
        """Return whether a position lies outside the grid, beyond an open side."""
        c = whole()
        outside = wp.bool(False)
        for b in range(dims):
            c[b] = wp.clamp(wp.int32(wp.floor((x[b] - g.origin[b]) / g.width[b])), -1, g.n[b])
            if c[b] < 0 or c[b] >= g.n[b]:
                outside = True
        if outside:
            return mesh.solid[f.at(g, c)] == OPEN
        return False

    @wp.kernel(enable_backward=False, module="unique")
    def advect(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, velocity: wp.array(dtype=scalar),
        good: wp.array(dtype=wp.int32), particles: Particles, event_flags: wp.array(dtype=wp.int32), worker: wp.int32,
        workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        p = item(wp.tid(), worker, workers)
        if particles.mass[p] == scalar(0.0):
            return
        x = particles.position[p]
        dt = scalar(mesh.clock[DT])
        here, slope, total = carry(g, velocity, good, x)
        if wp.static(not of.periodic):
            if total == scalar(0.0):  # A particle alone in the air falls freely.
                here = particles.velocity[p] + dt * g.gravity
        # Estimate the velocity that the grid had in the previous step at the particle's present position. The estimate
        # is the particle's own velocity, plus the velocity gradient times the distance that the particle has moved
        # since that step.
        before = particles.velocity[p]
        before += scalar(mesh.clock[LAST]) * (particles.gradient[p] * before)
        particles.velocity[p] = here
        particles.gradient[p] = slope
        particles.pressure[p] = mesh.pressure[f.cell_of(g, x)]
        moving = vec()
        moving[last] = g.frame
        there, _slope, ahead = carry(g, velocity, good, x + scalar(0.5) * dt * (here - moving))
        if wp.static(not of.periodic):
            if ahead == scalar(0.0):
                there = here
        after = x + dt * (there - moving)
        if wp.static(not of.periodic):
            # Particles move with the mean of the grid's previous and new velocity, so subtract half of the velocity's
            # change.
            after -= scalar(0.5) * dt * (here - before)
            aside, _bent, _known = carry(g, mesh.shift, good, x)
            after += dt * aside
        if wp.static(of.periodic):
            length = scalar(g.n[last]) * g.width[last]
            after[last] = after[last] - length * wp.floor((after[last] - g.origin[last]) / length)
        if wp.static(of.cut):
            # Rounding errors and the curvature of the particle's path may lead a particle into a wall, so push the
            # particle out. Most particles are far from walls, so compute the direction only for particles near walls.
            near = wp.bool(True)
            for _ in range(2):
                if near:
                    gap, _outward = clearance(g, geometry, after)
                    near = gap < scalar(CLEAR) * g.width[0]
                    if near:
                        gap, outward = clearance(g, geometry, after)
                        steep = wp.length(outward)
                        if steep > scalar(0.1):
                            after += wp.min(scalar(CLEAR) * g.width[0] - gap, g.width[0]) / (steep * steep) * outward
        gone = wp.bool(False)
        if wp.static(of.cut and not of.periodic):
            gone = leaves(g, mesh, after)
        if gone and geometry.inlet.shape[0] > 0:
            # The particle has left the grid and enters it again. Choose a pseudo-random position of the inlet, so that
            # particles spread over the inlet.
            turn = wp.uint32(p) * wp.uint32(7919) + wp.uint32(flags[STEPS]) * wp.uint32(104729)
            place = wp.int32(turn % wp.uint32(geometry.inlet.shape[0]))
            particles.velocity[p] = g.inflow
            particles.gradient[p] = mat()
            after = geometry.inlet[place]
        elif gone:
            particles.mass[p] = scalar(0.0)
        else:
            little = scalar(1.0e-3)
            for b in range(dims):
                if b != last or wp.static(not of.periodic):
                    low = g.origin[b] + little * g.width[b]
                    high = g.origin[b] + (scalar(g.n[b]) - little) * g.width[b]
                    after[b] = wp.clamp(after[b], low, high)
        speed = scalar(0.0)
        for b in range(dims):
            speed += wp.abs(here[b])
        if not (speed < scalar(1.0e6)):
            event_flags[1] = 1
        particles.position[p] = after

    return advect
