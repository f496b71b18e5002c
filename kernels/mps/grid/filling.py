"""Fill fractions of cells, computed from the density of particles around the cells' centres."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ...common.rows import row_functions
from ..structs import mps_types
from .cells import OPEN, GridKind, grid_parameters_struct, grid_structs, item
from .columns import LANES, column_functions
from .places import grid_functions

WET = wp.constant(0.02)
"""Fill fraction of a cell above which its concrete can flow. With a smaller value, concrete at rest would start to move
if its free surface coincides with the sides of cells (at 1 mm/s in a test with a viscosity of 10 Pa s)."""


@functools.cache
def level_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions that convert the particle density at a cell's centre to the cell's fill fraction.

    `level` and `lies` return the fill fraction: `level` for a cell at a free surface, and `lies` for a thin film of
    concrete on a wall. `film` returns whether a cell contains such a film. `behind` corrects the particle density
    beside walls.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    Fields = grid_structs(scalar, dims).Fields
    f = grid_functions(scalar, of)
    t = mps_types(scalar, dims)
    vec, whole = t.vec, t.whole
    corners = 2**dims

    @wp.func
    def level(particle_density: scalar) -> scalar:
        """Return the height of a flat free surface in a cell, from 0 at the bottom to 1 at the top.

        The height follows from `particle_density`, the weighted density of particles at the cell's centre, divided by
        that in full cells. The weight of a particle falls linearly with its distance from the centre, and is zero at a
        distance of one cell.
        """
        # Measure the height h of the surface from the cell's bottom, in cell heights. With a linear weight of the
        # particles, a surface below the cell's centre (h < 1/2) gives a density of (h + 1/2)^2 / 2, and a surface above
        # the centre gives 1 - (3/2 - h)^2 / 2. Solve for h.
        if particle_density < scalar(0.5):
            return wp.sqrt(scalar(2.0) * particle_density) - scalar(0.5)
        return scalar(1.5) - wp.sqrt(wp.max(scalar(2.0) * (scalar(1.0) - particle_density), scalar(0.0)))

    @wp.func
    def lies(particle_density: scalar) -> scalar:
        """Return the height of a free surface in a cell if the concrete lies on a wall.

        The height runs from 0 at the wall to 1 at the opposite side of the cell. `particle_density` is the density of
        particles at the cell's centre, divided by that in full cells. If it is below 1/2, the height equals this
        density; otherwise the function `level` returns the height.
        """
        return wp.where(particle_density < scalar(0.5), particle_density, level(particle_density))

    @wp.func
    def film(mesh: Fields, g: Grid, c: whole) -> wp.bool:
        """Return whether the concrete in a cell is a thin film on a wall.

        This is so if there is a wall on one side of the cell, no particle in the cell on the opposite side, and no
        neighbouring cell with more than twice as many particles.
        """
        own = mesh.count[f.at(g, c)]
        found = wp.bool(False)
        for n in range(2 * dims):
            o = f.at(g, f.moved(c, n / 2, 2 * (n % 2) - 1))
            if mesh.solid[o] > OPEN:
                other = f.at(g, f.moved(c, n / 2, 1 - 2 * (n % 2)))
                found = found or (mesh.solid[other] == OPEN and mesh.count[other] == 0)
        for n in range(2 * dims):
            found = found and mesh.count[f.at(g, f.moved(c, n / 2, 2 * (n % 2) - 1))] <= 2 * own
        return found

    @wp.func
    def behind(g: Grid, mesh: Fields, c: whole, d: vec) -> scalar:
        """Return the part of a particle's weight that falls on neighbouring wall cells.

        The weight of a particle is distributed over the cells around it. No concrete is in wall cells, so the caller
        adds the part of wall cells to the particle's own cell. Otherwise concrete that lies on a wall would count only
        half. `d` is the vector from the cell's centre to the particle.
        """
        sum = scalar(0.0)
        for n in range(1, corners):
            o = c
            part = scalar(1.0)
            bits = n
            for b in range(dims):
                away = wp.abs(d[b]) / g.width[b]
                if bits % 2 == 1:
                    o[b] = o[b] + wp.where(d[b] > scalar(0.0), 1, -1)
                    part *= away
                else:
                    part *= scalar(1.0) - away
                bits = bits / 2
            if mesh.solid[f.at(g, o)] != OPEN:
                sum += part
        return sum

    return SimpleNamespace(level=level, lies=lies, film=film, behind=behind)


@functools.cache
def fill_kernel(scalar, serial: bool, of: GridKind):
    """Build the kernel that computes the fill fraction of each cell, with one task per cell.

    The fill fraction follows from the density of particles around the cell's centre. This fill fraction is exact for a
    flat free surface parallel to the cells' sides, and does not depend on how the particles inside the concrete are
    arranged.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    f = grid_functions(scalar, of)
    t = mps_types(scalar, dims)
    vec, whole = t.vec, t.whole
    around = 3**dims
    say = level_functions(scalar, of)
    level, lies, film, behind = say.level, say.lies, say.film, say.behind
    add_mass, read_vec4 = column_functions(scalar, dims).add_mass, row_functions(scalar).read_vec4

    # The index `n` of a cell in the block around a given cell counts from 0, fastest along the first axis. Cell 0 has
    # the lowest position along every axis, and the middle index (4 in 2D, 13 in 3D) belongs to the given cell itself.
    @wp.func
    def neighbour(g: Grid, number: wp.int32, n: wp.int32) -> wp.int32:
        """Return the number of cell `n` in the block of 3^axes cells around the cell with the given number."""
        found = number + n % 3 - 1 + (n / 3 % 3 - 1) * (g.n[0] + 2)
        if wp.static(dims == 3):
            found += (n / 9 - 1) * (g.n[0] + 2) * (g.n[1] + 2)
        return found

    @wp.func
    def add_cell(g: Grid, mesh: Fields, c: whole, place: vec, other: wp.int32, own: wp.bool, sum: scalar) -> scalar:
        """Add the weighted masses of the particles of the cell `other` to `sum`.

        The weights fall linearly to zero at a distance of one cell from `place`, the centre of the cell `c`. The masses
        are relative to the mean mass. If both cells are the same, `own` is true.
        """
        if wp.static(serial):
            if not own:
                stride = mesh.place.shape[0] + LANES
                return add_mass(mesh.columns, stride, mesh.begin[other], mesh.count[other], place, g.width, sum)
        for k in range(mesh.count[other]):
            at = mesh.begin[other] + k
            d = vec()
            mass = scalar(0.0)
            if wp.static(serial):
                for b in range(dims):
                    d[b] = mesh.columns[(1 + b) * (mesh.place.shape[0] + LANES) + at] - place[b]
                mass = mesh.columns[at]
            else:
                particle = read_vec4(mesh.sorted_place, at)
                for b in range(dims):
                    d[b] = particle[b] - place[b]
                mass = particle[3]
            near = scalar(1.0)
            for b in range(dims):
                near *= wp.max(scalar(1.0) - wp.abs(d[b]) / g.width[b], scalar(0.0))
            if own:
                near += behind(g, mesh, c, d)
            sum += near * mass
        return sum

    @wp.kernel(enable_backward=False, module="unique")
    def fill(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, worker: wp.int32, workers: wp.int32
    ):
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        if not f.in_grid(g, c):
            return
        part = scalar(0.0)
        particle_density = scalar(1.0)
        if mesh.solid[number] == OPEN:
            particle_density = scalar(0.0)
            place = vec()
            for b in range(dims):
                place[b] = g.origin[b] + (scalar(c[b]) + scalar(0.5)) * g.width[b]
            sum = scalar(0.0)
            # No particle is in the frame around the grid, so every cell of the grid has neighbours on all sides.
            for n in range(around):
                other = neighbour(g, number, n)
                if mesh.count[other] > 0:
                    sum = add_cell(g, mesh, c, place, other, other == number, sum)
            if sum > scalar(0.0):
                particle_density = sum * g.volume / geometry.weighted_volume[number]
                height = level(particle_density)
                if film(mesh, g, c):
                    height = lies(particle_density)
                part = wp.clamp(height, scalar(0.0), scalar(1.0))
        mesh.particle_density[number] = particle_density
        mesh.fill[number] = part
        mesh.liquid[number] = wp.where(part > scalar(WET), 1, 0)

    return fill
