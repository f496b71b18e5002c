"""Kernels that sort particles into cells, and the kernel that opens a gate."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ...common.rows import row_functions
from ...common.types import types
from .cells import NOW, GridKind, grid_parameters_struct, grid_structs, item
from .columns import LANES, column_functions
from .places import grid_functions


@functools.cache
def bin_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels that sort particles into cells: `clear`, `tally`, `allot`, `sort`, `order` and `copy` (GPU).

    A step launches them in this order. All cells share one list of particles, in which each cell reserves as many
    entries as it has particles. The order in which cells reserve their entries differs from run to run, but results do
    not depend on it.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Particles, Fields = structs.Particles, structs.Fields
    f = grid_functions(scalar, of)
    store = column_functions(scalar, dims).store
    vec4, write_vec4 = types(scalar).vec4, row_functions(scalar).write_vec4

    @wp.kernel(enable_backward=False, module="unique")
    def clear(mesh: Fields):
        """Set the particle counts of all cells to zero, with one task per cell."""
        mesh.count[wp.tid()] = 0
        if wp.tid() == 0:
            mesh.reserved_places[0] = 0

    @wp.kernel(enable_backward=False, module="unique")
    def tally(g: Grid, flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Fields):
        """Find the cell of each particle and count the particles of each cell, with one task per particle."""
        if flags[HALTED] != 0:
            return
        p = wp.tid()
        c = wp.int32(-1)
        if particles.mass[p] > scalar(0.0):
            c = f.cell_of(g, particles.position[p])
            mesh.place[p] = wp.atomic_add(mesh.count, c, 1)
        mesh.cell_of_particle[p] = c

    @wp.kernel(enable_backward=False, module="unique")
    def allot(flags: wp.array(dtype=wp.int32), mesh: Fields):
        """Reserve a range of `sorted_particles` for the particles of each cell, with one task per cell."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        if mesh.count[c] > 0:
            mesh.begin[c] = wp.atomic_add(mesh.reserved_places, 0, mesh.count[c])

    @wp.kernel(enable_backward=False, module="unique")
    def sort(flags: wp.array(dtype=wp.int32), mesh: Fields, worker: wp.int32, workers: wp.int32):
        """Write the number of each particle into the range of `sorted_particles` that is reserved for its cell.

        The kernel runs with one task per particle.
        """
        if flags[HALTED] != 0:
            return
        p = item(wp.tid(), worker, workers)
        c = mesh.cell_of_particle[p]
        if c >= 0:
            mesh.sorted_particles[mesh.begin[c] + mesh.place[p]] = p

    @wp.kernel(enable_backward=False, module="unique")
    def order(flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Fields, worker: wp.int32, workers: wp.int32):
        """Sort the particles of each cell by their numbers, so that sums are reproducible, with one task per cell.

        On a CPU, copy the particles into columns in this order (`columns.py`), because many cells and faces read them.
        """
        if flags[HALTED] != 0:
            return
        c = item(wp.tid(), worker, workers)
        begin = mesh.begin[c]
        for a in range(1, mesh.count[c]):
            own = mesh.sorted_particles[begin + a]
            b = a
            while b > 0 and mesh.sorted_particles[begin + b - 1] > own:
                mesh.sorted_particles[begin + b] = mesh.sorted_particles[begin + b - 1]
                b -= 1
            mesh.sorted_particles[begin + b] = own
        if wp.static(serial):
            for k in range(begin, begin + mesh.count[c]):
                store(particles, mesh.sorted_particles[k], mesh.columns, k, mesh.place.shape[0] + LANES)

    @wp.kernel(enable_backward=False, module="unique")
    def copy(flags: wp.array(dtype=wp.int32), particles: Particles, mesh: Fields):
        """Copy the particles in sorted order, because many cells and faces read them.

        The kernel runs on a GPU only, with one task per particle. Neighbouring tasks thus write neighbouring entries.
        """
        k = wp.tid()
        if flags[HALTED] != 0 or k >= mesh.reserved_places[0]:
            return
        p = mesh.sorted_particles[k]
        x, velocity, gradient = particles.position[p], particles.velocity[p], particles.gradient[p]
        place = vec4()
        place[3] = particles.mass[p]
        for axis in range(dims):
            place[axis] = x[axis]
            motion = vec4()
            motion[3] = velocity[axis]
            for b in range(dims):
                motion[b] = gradient[axis, b]
            write_vec4(mesh.sorted_motion, dims * k + axis, motion)
        write_vec4(mesh.sorted_place, k, place)

    return SimpleNamespace(clear=clear, tally=tally, allot=allot, sort=sort, order=order, copy=copy)


@functools.cache
def lift_kernel(scalar, of: GridKind):
    """Build the kernel that opens a gate, cell by cell at given times, with one task per cell.

    In each cell whose opening time has come, the geometry is replaced by `after`, the geometry without the gate.
    """
    dims, places, quarters = of.dimensions, 2**of.dimensions, 4 * of.pairs
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry

    @wp.kernel(enable_backward=False, module="unique")
    def lift(
        slots: wp.int32, flags: wp.array(dtype=wp.int32), after: Geometry, solid_after: wp.array(dtype=wp.int32),
        geometry: Geometry, mesh: Fields, worker: wp.int32, workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        c = item(wp.tid(), worker, workers)
        if scalar(mesh.clock[NOW]) >= geometry.opens[c]:
            mesh.solid[c] = solid_after[c]
            for k in range(places):
                geometry.depth[c * places + k] = after.depth[c * places + k]
            for k in range(quarters):
                geometry.quarter_fraction[c * quarters + k] = after.quarter_fraction[c * quarters + k]
            geometry.room[c] = after.room[c]
            geometry.weighted_volume[c] = after.weighted_volume[c]
            for axis in range(dims):
                r = c + axis * slots
                geometry.gap[r] = after.gap[r]
                geometry.part[r] = after.part[r]
                geometry.shut[r] = after.shut[r]
                geometry.surface[r] = after.surface[r]

    return lift
