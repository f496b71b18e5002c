"""Kernels that sort particles into cells, and the kernel that opens a gate."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from .cells import NOW, Kind, cells_struct, grid_functions, grid_structs


@functools.cache
def bin_kernels(scalar, of: Kind) -> SimpleNamespace:
    """Build the kernels `clear`, `tally`, `allot`, `sort` and `order`, which sort particles into cells in this order.

    All cells share one list, in which each cell reserves as many places as it has particles. The order of the cells in
    the list differs from run to run, but results do not depend on it.
    """
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Particles, Mesh = structs.Particles, structs.Mesh
    f = grid_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def clear(mesh: Mesh):
        """Set the particle counts of all cells to zero, with one task per cell."""
        mesh.count[wp.tid()] = 0
        if wp.tid() == 0:
            mesh.listed[0] = 0

    @wp.kernel(enable_backward=False, module="unique")
    def tally(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Mesh):
        """Find the cell of each particle and count the particles of each cell, with one task per particle."""
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
        """Reserve places in the list for the particles of each cell, with one task per cell."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        if mesh.count[c] > 0:
            mesh.begin[c] = wp.atomic_add(mesh.listed, 0, mesh.count[c])

    @wp.kernel(enable_backward=False, module="unique")
    def sort(flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """Write each particle into the list at the places of its cell, with one task per particle."""
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        c = mesh.home[p]
        if c >= 0:
            mesh.bin[mesh.begin[c] + mesh.place[p]] = p

    @wp.kernel(enable_backward=False, module="unique")
    def order(flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """Sort the particles of each cell by their numbers, so that sums are reproducible, with one task per cell."""
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
    """Build the kernel that opens a gate when its time has come, with one task per cell.

    It replaces the geometry of the cells at the gate by `after`, the geometry without the gate.
    """
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
