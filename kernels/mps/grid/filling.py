"""How full cells are, by the particles around their middles."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ..structs import mps_types
from .cells import OPEN, Kind, cells_struct, grid_functions, grid_structs

WET = wp.constant(0.02)
"""Part of a cell that is concrete's from which on it flows there: if less did, surfaces at rest on the cells' sides
would stir (1 mm/s in a fluid of 10 Pa s)."""


@functools.cache
def level_functions(scalar, of: Kind) -> SimpleNamespace:
    """What a crowd says of a cell: `level` and `lies`, `film` which of both; what counts `behind` a cell's side."""
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    Mesh = grid_structs(scalar, dims).Mesh
    f = grid_functions(scalar, of)
    t = mps_types(scalar, dims)
    vec, whole = t.vec, t.whole
    corners = 2**dims

    @wp.func
    def level(crowd: scalar) -> scalar:
        """How high a flat surface stands in a cell whose middle has such a crowd around it; 0 and 1 are its faces."""
        if crowd < scalar(0.5):
            return wp.sqrt(scalar(2.0) * crowd) - scalar(0.5)
        return scalar(1.5) - wp.sqrt(wp.max(scalar(2.0) * (scalar(1.0) - crowd), scalar(0.0)))

    @wp.func
    def lies(crowd: scalar) -> scalar:
        """The same of concrete that lies on a wall: what is below the middle counts in full."""
        return wp.where(crowd < scalar(0.5), crowd, level(crowd))

    @wp.func
    def film(mesh: Mesh, g: Cells, c: whole) -> wp.bool:
        """Is there a wall on one side of a cell, no particle on the other, and no deep concrete beside it?"""
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
    def behind(g: Cells, mesh: Mesh, c: whole, d: vec) -> scalar:
        """What cells that are wall have of a particle of this cell: it counts here, or what lies on a wall would weigh
        half."""
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
def fill_kernel(scalar, of: Kind):
    """How much of each cell concrete fills; a task a slot.

    By the particles around its middle: of a flat surface along the grid it is as high as that, and how particles lie
    within the concrete does not matter.
    """
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Particles, Mesh, Geometry = structs.Particles, structs.Mesh, structs.Geometry
    f = grid_functions(scalar, of)
    t = mps_types(scalar, dims)
    vec, whole = t.vec, t.whole
    around = 3**dims
    say = level_functions(scalar, of)
    level, lies, film, behind = say.level, say.lies, say.film, say.behind

    @wp.kernel(enable_backward=False, module="unique")
    def fill(g: Cells, flags: wp.array(dtype=wp.int32), particles: Particles, geometry: Geometry, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        if not f.in_grid(g, c):
            return
        part = scalar(0.0)
        crowd = scalar(1.0)
        if mesh.solid[number] == OPEN:
            place = vec()
            for b in range(dims):
                place[b] = g.origin[b] + (scalar(c[b]) + scalar(0.5)) * g.width[b]
            sum = scalar(0.0)
            for n in range(around):
                o = whole()
                rest = n
                for b in range(dims):
                    o[b] = c[b] + rest % 3 - 1
                    rest = rest / 3
                if f.in_grid(g, o):
                    other = f.at(g, o)
                    for k in range(mesh.count[other]):
                        p = mesh.bin[mesh.begin[other] + k]
                        d = particles.position[p] - place
                        near = scalar(1.0)
                        for b in range(dims):
                            near *= wp.max(scalar(1.0) - wp.abs(d[b]) / g.width[b], scalar(0.0))
                        if n == wp.static(around // 2):
                            near += behind(g, mesh, c, d)
                        sum += near * particles.mass[p]
            crowd = sum * g.volume / geometry.hold[number]
            part = wp.clamp(wp.where(film(mesh, g, c), lies(crowd), level(crowd)), scalar(0.0), scalar(1.0))
        mesh.crowd[number] = crowd
        mesh.fill[number] = part
        mesh.liquid[number] = wp.where(part > scalar(WET), 1, 0)

    return fill
