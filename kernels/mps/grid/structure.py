"""Structure that concrete gained at rest, on a grid: what it adds to yield stresses, and how flow breaks it.

Roussel 2006: stress gained G falls as dG/dt = -alpha G rate while concrete is sheared; what it wins again meanwhile is
left out. The layer on a wall is sheared by its slip alone. Structure lies on the grid: in a pipe that is the same all
along, what goes with the flow changes nothing.
"""

import functools

import warp as wp

from ...common.control import HALTED
from .cells import DT, LIQUID, Kind, cells_struct, grid_functions, grid_structs


@functools.cache
def grown_function(scalar, dimensions: int):
    """`grown`: numbers of a grid whose concrete bears more."""
    Cells = cells_struct(scalar, dimensions)

    @wp.func
    def grown(g: Cells, gained: scalar):
        own = g
        own.yield_stress = g.yield_stress + gained
        return own

    return grown


@functools.cache
def break_kernel(scalar, of: Kind):
    """One thread a cell: what a step leaves of the structure there, and in the layer along its faces."""
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
