"""Which particles are in which cell, and what a gate has opened."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED, STEPS
from .cells import BIN, Kind, cells_struct, grid_functions, grid_structs


@functools.cache
def bin_kernels(scalar, of: Kind) -> SimpleNamespace:
    """Kernels `clear`, `sort` and `order`: which particles are in which cell."""
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Particles, Mesh = structs.Particles, structs.Mesh
    f = grid_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def clear(mesh: Mesh):
        """A task a slot: no particles."""
        mesh.count[wp.tid()] = 0

    @wp.kernel(enable_backward=False, module="unique")
    def sort(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Mesh):
        """A task a particle: into its cell's bin."""
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        if particles.mass[p] == scalar(0.0):
            return
        c = f.cell_of(g, particles.position[p])
        place = wp.atomic_add(mesh.count, c, 1)
        if place < BIN:
            mesh.bin[c * BIN + place] = p

    @wp.kernel(enable_backward=False, module="unique")
    def order(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot: particles of a cell in the order of their numbers, for equal sums."""
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        if not f.in_grid(g, f.cell(g, number)):
            return
        count = wp.min(mesh.count[number], BIN)
        mesh.count[number] = count
        begin = number * BIN
        for a in range(1, count):
            own = mesh.bin[begin + a]
            b = a
            while b > 0 and mesh.bin[begin + b - 1] > own:
                mesh.bin[begin + b] = mesh.bin[begin + b - 1]
                b -= 1
            mesh.bin[begin + b] = own

    return SimpleNamespace(clear=clear, sort=sort, order=order)


@functools.cache
def lift_kernel(scalar, of: Kind):
    """What a gate shuts opens when its time has come; a task a slot. `after` is the geometry without the gate."""
    dims, places, quarters = of.dimensions, 2**of.dimensions, 4 * of.pairs
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Mesh, Geometry = structs.Mesh, structs.Geometry

    @wp.kernel(enable_backward=False, module="unique")
    def lift(
        g: Cells, flags: wp.array(dtype=wp.int32), after: Geometry, solid_after: wp.array(dtype=wp.int32),
        geometry: Geometry, mesh: Mesh,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        if scalar(flags[STEPS]) * g.dt >= geometry.opens[c]:
            mesh.solid[c] = solid_after[c]
            for k in range(places):
                geometry.depth[c * places + k] = after.depth[c * places + k]
            for k in range(quarters):
                geometry.nook[c * quarters + k] = after.nook[c * quarters + k]
            geometry.room[c] = after.room[c]
            geometry.hold[c] = after.hold[c]
            for axis in range(dims):
                r = c + axis * g.slots
                geometry.gap[r] = after.gap[r]
                geometry.part[r] = after.part[r]
                geometry.shut[r] = after.shut[r]
                geometry.surface[r] = after.surface[r]

    return lift
