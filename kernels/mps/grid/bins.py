"""Which particles are in which cell, and what a gate has opened."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from .cells import NOW, Kind, cells_struct, grid_functions, grid_structs


@functools.cache
def bin_kernels(scalar, of: Kind) -> SimpleNamespace:
    """Kernels `clear`, `tally`, `allot`, `sort` and `order`: which particles are in which cell.

    A cell takes as much of one list as it has particles; where its part begins is as it happens, and matters nothing.
    """
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Particles, Mesh = structs.Particles, structs.Mesh
    f = grid_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def clear(mesh: Mesh):
        """A task a slot: no particles."""
        mesh.count[wp.tid()] = 0
        if wp.tid() == 0:
            mesh.listed[0] = 0

    @wp.kernel(enable_backward=False, module="unique")
    def tally(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Mesh):
        """A task a particle: its cell, and how many are there already."""
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        c = wp.int32(-1)
        if particles.mass[p] > scalar(0.0):
            c = f.cell_of(g, particles.position[p])
            mesh.place[p] = wp.atomic_add(mesh.count, c, 1)
        mesh.home[p] = c

    @wp.kernel(enable_backward=False, module="unique")
    def allot(flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot: where the cell's particles begin."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        if mesh.count[c] > 0:
            mesh.begin[c] = wp.atomic_add(mesh.listed, 0, mesh.count[c])

    @wp.kernel(enable_backward=False, module="unique")
    def sort(flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a particle: into its cell's part of the list."""
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        c = mesh.home[p]
        if c >= 0:
            mesh.bin[mesh.begin[c] + mesh.place[p]] = p

    @wp.kernel(enable_backward=False, module="unique")
    def order(flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot: particles of a cell in the order of their numbers, for equal sums."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        begin = mesh.begin[c]
        for a in range(1, mesh.count[c]):
            own = mesh.bin[begin + a]
            b = a
            while b > 0 and mesh.bin[begin + b - 1] > own:
                mesh.bin[begin + b] = mesh.bin[begin + b - 1]
                b -= 1
            mesh.bin[begin + b] = own

    return SimpleNamespace(clear=clear, tally=tally, allot=allot, sort=sort, order=order)


@functools.cache
def lift_kernel(scalar, of: Kind):
    """What a gate shuts opens when its time has come; a task a slot. `after` is the geometry without the gate."""
    dims, places, quarters = of.dimensions, 2**of.dimensions, 4 * of.pairs
    structs = grid_structs(scalar, dims)
    Mesh, Geometry = structs.Mesh, structs.Geometry

    @wp.kernel(enable_backward=False, module="unique")
    def lift(
        slots: wp.int32, flags: wp.array(dtype=wp.int32), after: Geometry, solid_after: wp.array(dtype=wp.int32),
        geometry: Geometry, mesh: Mesh,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        if scalar(mesh.clock[NOW]) >= geometry.opens[c]:
            mesh.solid[c] = solid_after[c]
            for k in range(places):
                geometry.depth[c * places + k] = after.depth[c * places + k]
            for k in range(quarters):
                geometry.nook[c * quarters + k] = after.nook[c * quarters + k]
            geometry.room[c] = after.room[c]
            geometry.hold[c] = after.hold[c]
            for axis in range(dims):
                r = c + axis * slots
                geometry.gap[r] = after.gap[r]
                geometry.part[r] = after.part[r]
                geometry.shut[r] = after.shut[r]
                geometry.surface[r] = after.surface[r]

    return lift
