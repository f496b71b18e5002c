"""Thixotropy on a grid: the yield stress that concrete gained at rest, and how flow breaks this structure down.

While concrete is sheared, the gained yield stress G changes as dG/dt = A - alpha G rate. Here A is the rate of recovery
and alpha the constant of breakdown. Roussel 2006 writes this equation for a state of structure lambda: d lambda/dt =
1/T - alpha lambda rate, with the time of recovery T. With the yield stress tau_0, G is tau_0 lambda and A is tau_0 / T.
The term A is included only with `GridKind.rebuilding`. The slip layer on a wall is sheared by its slip velocity only.
The structure is stored on the grid and not carried with the flow, which makes no difference in a pipe whose state is
the same all along its axis.
"""

import functools

import warp as wp

from ...common.control import HALTED
from .cells import DT, LIQUID, GridKind, grid_parameters_struct, grid_structs, item
from .places import grid_functions


@functools.cache
def with_gain_function(scalar, dimensions: int):
    """Build `with_gain`, which returns a copy of the parameters `Grid` whose yield stress is higher by `gained`."""
    Grid = grid_parameters_struct(scalar, dimensions)

    @wp.func
    def with_gain(g: Grid, gained: scalar):
        own = g
        own.yield_stress = g.yield_stress + gained
        return own

    return with_gain


@functools.cache
def break_kernel(scalar, of: GridKind):
    """Build the kernel that updates the yield stress gained at rest, in each cell and in the slip layer.

    The flow breaks down the structure that has built up at rest. The kernel computes one time step, with one thread per
    cell. This thread also updates the slip layer along the faces of the cell.
    """
    Grid = grid_parameters_struct(scalar, of.dimensions)
    structs = grid_structs(scalar, of.dimensions)
    Fields, Walls = structs.Fields, structs.Walls
    f = grid_functions(scalar, of)

    @wp.func
    def rebuilt(rate: scalar, broken: scalar, dt: scalar) -> scalar:
        """Return the increase of the yield stress [Pa] by structure that builds up in this step.

        Structure builds up at the given `rate` [Pa/s], and a part of it breaks down again within the step. The result
        does not include structure from earlier steps, which the breakdown reduces by the factor exp(-`broken`).
        """
        if broken > scalar(1.0e-3):
            return rate * dt * (scalar(1.0) - wp.exp(-broken)) / broken
        return rate * dt * (scalar(1.0) - scalar(0.5) * broken)

    @wp.kernel(enable_backward=False, module="unique")
    def break_structure(
        g: Grid,
        breakdown: scalar,
        breakdown_strain: scalar,
        rebuild_rate: scalar,
        flags: wp.array(dtype=wp.int32),
        walls: Walls,
        mesh: Fields,
        worker: wp.int32,
        workers: wp.int32,
    ):
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        if not f.on_grid(g, f.cell(g, number)):
            return
        dt = scalar(mesh.clock[DT])
        if mesh.liquid[number] != 0:
            broken = wp.sqrt(mesh.strain[number]) * dt / breakdown_strain
            mesh.gained[number] = mesh.gained[number] * wp.exp(-broken)
            if wp.static(of.rebuilding):
                mesh.gained[number] += rebuilt(rebuild_rate, broken, dt)
        for axis in range(of.dimensions):
            r = number + axis * g.slots
            if mesh.kind[r] == LIQUID and mesh.wall_area[r] > scalar(0.0):
                slipped = wp.abs(mesh.slip[r]) * dt / breakdown
                mesh.layer[r] = mesh.layer[r] * wp.exp(-slipped)
                if wp.static(of.rebuilding):
                    mesh.layer[r] += rebuilt(rebuild_rate, slipped, dt)

    return break_structure
