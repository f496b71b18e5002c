"""Thixotropy on a grid: the yield stress that concrete gained at rest, and how flow breaks this structure down.

The gained yield stress G decays as dG/dt = -alpha G rate while concrete is sheared (Roussel 2006); the recovery during
shear is neglected. The slip layer on a wall is sheared by its slip velocity only. The structure is stored on the grid
and not carried with the flow, which makes no difference in a pipe whose state is the same all along its axis.
"""

import functools

import warp as wp

from ...common.control import HALTED
from .cells import DT, LIQUID, Kind, cells_struct, grid_functions, grid_structs


@functools.cache
def grown_function(scalar, dimensions: int):
    """Build `grown`, which returns a copy of the grid's parameters with the yield stress raised by `gained`."""
    Cells = cells_struct(scalar, dimensions)

    @wp.func
    def grown(g: Cells, gained: scalar):
        own = g
        own.yield_stress = g.yield_stress + gained
        return own

    return grown


@functools.cache
def break_kernel(scalar, of: Kind):
    """Build the kernel that breaks down the structure of each cell, and of the slip layer along its faces, in a step.

    It runs with one thread per cell.
    """
    Cells = cells_struct(scalar, of.dimensions)
    structs = grid_structs(scalar, of.dimensions)
    Mesh, Walls = structs.Mesh, structs.Walls
    f = grid_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def break_structure(
        g: Cells, breakdown: scalar, breakdown_strain: scalar, flags: wp.array(dtype=wp.int32), walls: Walls, mesh: Mesh
    ):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        if not f.on_grid(g, f.cell(g, number)):
            return
        dt = scalar(mesh.clock[DT])
        if mesh.liquid[number] != 0:
            mesh.gained[number] = mesh.gained[number] * wp.exp(-wp.sqrt(mesh.strain[number]) * dt / breakdown_strain)
        for axis in range(of.dimensions):
            r = number + axis * g.slots
            if mesh.kind[r] == LIQUID and mesh.rubbed[r] > scalar(0.0):
                mesh.layer[r] = mesh.layer[r] * wp.exp(-wp.abs(mesh.slip[r]) * dt / breakdown)

    return break_structure
