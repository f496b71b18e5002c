"""Strain rate and viscosity of mortar beside aggregates.

Strain rates are computed at samples: the cells and the cell edges of the grid. An aggregate may cut a sample. The
aggregate does not deform, so the mortar in the sample deforms more: with the mortar's fraction f of the sample, the
strain rate of the mortar is the strain rate of the sample divided by f. The dissipation in the sample is then mu / f
times the square of the sample's strain rate, where mu is the viscosity of the mortar. The matrix therefore contains mu
/ f instead of mu.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..mps.grid.cells import GridKind, first, grid_parameters_struct, grid_structs, second
from ..mps.grid.forces import relaxed_viscosity_function
from ..mps.grid.other_laws import flow_functions
from ..mps.grid.places import grid_functions
from ..mps.structs import mps_types
from .bodies import body_functions, body_structs

LEAST = wp.constant(0.1)
"""Lower limit of the mortar fraction of a sample; smaller values would only make the equations harder to solve."""


@functools.cache
def strain_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `rates` and `viscosity`, which compute the apparent viscosities of cells and of edges.

    They replace the kernels of `kernels/mps/grid/forces.py` on grids with aggregates. The cells and edges are called
    samples. Both kernels also store in `cut`, for the viscous matrix, the viscosity of each sample divided by the
    mortar fraction of the sample. `rates` runs first. Both run with one task per cell.
    """
    dims, pairs = 3, 3
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    Cover = body_structs(scalar).Cover
    t = mps_types(scalar, dims)
    whole = t.whole
    f, body = grid_functions(scalar, of), body_functions(scalar, of)
    law = flow_functions(scalar, of)
    relaxed_viscosity = relaxed_viscosity_function(scalar, of)

    @wp.func
    def share(g: Grid, cover: Cover, number: wp.int32, sample: wp.int32) -> scalar:
        return wp.max(body.mortar_part(g, cover, number, sample), scalar(LEAST))

    @wp.func
    def rigid(g: Grid, cover: Cover, a: wp.int32, b: wp.int32, c: wp.int32, d: wp.int32) -> wp.bool:
        """Return whether four faces move with the same aggregate."""
        one = cover.owner[a]
        return one != 0 and cover.owner[b] == one and cover.owner[c] == one and cover.owner[d] == one

    @wp.func
    def squared_stretch(g: Grid, mesh: Fields, cover: Cover, c: whole) -> scalar:
        """Return twice the sum of the squared stretch rates of the mortar in a cell [1/s2]."""
        rates = f.stretch(g, mesh, c) / share(g, cover, f.at(g, c), 0)
        return scalar(2.0) * wp.length_sq(rates)

    @wp.func
    def around(g: Grid, mesh: Fields, geometry: Geometry, cover: Cover, c: whole, pair: wp.int32) -> scalar:
        """Return the mean of the squared shear rates of the mortar at a cell's edges [1/s2].

        `pair` is the pair of axes in whose plane the shear is measured; only edges in concrete count.
        """
        sum = scalar(0.0)
        count = scalar(0.0)
        for n in range(4):
            e = f.moved(f.moved(c, first(pair), n % 2), second(pair), n / 2)
            rate, volume = f.shear(g, mesh, geometry, e, pair)
            if volume > scalar(0.0):
                rate = rate / share(g, cover, f.at(g, e), pair + 1)
                sum += rate * rate
                count += scalar(1.0)
        return sum / wp.max(count, scalar(1.0))

    @wp.kernel(enable_backward=False, module="unique")
    def rates(g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, cover: Cover, mesh: Fields, cut: Fields):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        cut.in_cell[number] = scalar(0.0)
        if mesh.liquid[number] == 0 or not f.on_grid(g, c):
            return
        square = squared_stretch(g, mesh, cover, c)
        first_pair = around(g, mesh, geometry, cover, c, 0)
        second_pair = around(g, mesh, geometry, cover, c, 1)
        third = around(g, mesh, geometry, cover, c, 2)
        mesh.strain_without_pair[number] = square + second_pair + third
        mesh.strain_without_pair[number + g.slots] = square + first_pair + third
        mesh.strain_without_pair[number + 2 * g.slots] = square + first_pair + second_pair
        square += first_pair + second_pair + third
        mesh.strain[number] = square
        mesh.in_cell[number] = relaxed_viscosity(
            g, mesh.in_cell[number], law.apparent(g, wp.sqrt(square)), wp.sqrt(square)
        )
        still = wp.bool(True)
        for axis in range(3):
            r = number + axis * g.slots
            s = f.at(g, f.moved(c, axis, 1)) + axis * g.slots
            still = still and rigid(g, cover, number, r, s, s)
        if not still:
            cut.in_cell[number] = mesh.in_cell[number] / share(g, cover, number, 0)

    @wp.kernel(enable_backward=False, module="unique")
    def viscosity(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, cover: Cover, mesh: Fields, cut: Fields
    ):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        for pair in range(pairs):
            place = number + pair * g.slots
            cut.in_corner[place] = scalar(0.0)
            if f.on_grid(g, c):
                rate, volume = f.shear(g, mesh, geometry, c, pair)
                if volume > scalar(0.0):
                    a, b = first(pair), second(pair)
                    rate = rate / share(g, cover, number, pair + 1)
                    sum = scalar(0.0)
                    count = scalar(0.0)
                    for n in range(4):
                        o = f.at(g, f.moved(f.moved(c, a, -(n % 2)), b, -(n / 2)))
                        if mesh.liquid[o] != 0:
                            sum += mesh.strain_without_pair[o + pair * g.slots]
                            count += scalar(1.0)
                    total = wp.sqrt(rate * rate + sum / wp.max(count, scalar(1.0)))
                    mesh.in_corner[place] = relaxed_viscosity(
                        g, mesh.in_corner[place], law.apparent_at_edge(g, total, scalar(0.0)), total
                    )
                    below = f.at(g, f.moved(c, b, -1)) + a * g.slots
                    left = f.at(g, f.moved(c, a, -1)) + b * g.slots
                    if not rigid(g, cover, below, number + a * g.slots, left, number + b * g.slots):
                        cut.in_corner[place] = mesh.in_corner[place] / share(g, cover, number, pair + 1)

    return SimpleNamespace(rates=rates, viscosity=viscosity)
