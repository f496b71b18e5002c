"""Aggregates that enter a pipe through the plane at its start, and the weight of aggregates in a full pipe.

The plane is a wall that moves with the mean velocity of the flow. Behind it, a straight extension of the pipe holds the
aggregates that have not entered yet. They move with the velocity of the plane, like a plug. An aggregate becomes free
when it has entered entirely. Until then, its velocity is prescribed, so the coupled solve must not change it.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from ..mps.grid.cells import LIQUID, NOW, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import place_functions
from .bodies import BodyKind, body_structs, shape_functions
from .leaving import PARKED
from .pairs import pair_struct


@functools.cache
def entrance_struct(scalar):
    """Build the struct `Entrance`, which describes the plane of entry and the aggregates behind it."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Entrance:
        start: wp.array(dtype=vec3)  # Centre of each aggregate at the time 0 [m], shape (n,).

        # Time at which each aggregate begins to enter the simulated box [s], shape (n,). Until then it is kept far
        # away.
        appears: wp.array(dtype=wp.float64)
        # Time at which each aggregate has entered the pipe entirely and becomes free to move [s], shape (n,).
        enters: wp.array(dtype=wp.float64)
        velocity: vec3  # Velocity of the plane through which aggregates enter the pipe [m/s].
        gravity: vec3  # Gravitational acceleration in the coordinates of the grid [m/s2].

    return Entrance


@functools.cache
def entering_kernels(scalar, of: GridKind, kind: BodyKind) -> SimpleNamespace:
    """Build the kernels for aggregates that enter, each with one task per aggregate unless stated otherwise.

    - `guide` sets position and velocity of the aggregates that are not free yet.
    - `relax` marks cells that a wall cuts and whose faces all move with aggregates, with one task per cell. In a pipe
      that is oblique to the grid, errors of the geometry cause a net inflow into such a cell that no motion of the
      aggregate along the wall can make zero. The kernel `release` of `cover.py` makes the velocities of the marked
      cells' faces unknowns again.
    - `ignore` deletes the lists of neighbours of aggregates that are not free yet, because they need no forces.
    - `fix` deletes the mobility of these aggregates, so that solves do not change their velocities. The inverse blocks
      of the preconditioner are zero, so these aggregates contribute neither to search directions nor to norms.
    - `weigh` sets the weight of each aggregate minus its buoyancy. The mortar beyond the open end of the pipe would
      bear the part of an aggregate that has left, so this part has no weight.
    """
    vec3 = types(scalar).vec3
    Grid, fields = grid_parameters_struct(scalar, 3), grid_structs(scalar, 3)
    Fields, Geometry, Cover = fields.Fields, fields.Geometry, body_structs(scalar).Cover
    places, shape = place_functions(scalar, of), shape_functions(scalar, kind)
    Bodies, Pairs, Entrance = body_structs(scalar).Bodies, pair_struct(scalar), entrance_struct(scalar)

    @wp.kernel(enable_backward=False, module="unique")
    def guide(flags: wp.array(dtype=wp.int32), mesh: Fields, entrance: Entrance, bodies: Bodies):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        now = mesh.clock[NOW]
        if now < entrance.enters[b]:
            x = entrance.start[b] + scalar(now) * entrance.velocity
            if now < entrance.appears[b]:
                x = vec3(-scalar(PARKED) - scalar(b), scalar(0.0), scalar(0.0))
            bodies.centre[b] = x
            bodies.velocity[b] = entrance.velocity
            bodies.spin[b] = vec3()

    @wp.kernel(enable_backward=False, module="unique")
    def relax(g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, cover: Cover):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        if mesh.liquid[number] == 0:
            return
        c = places.cell(g, number)
        cut = wp.bool(False)
        known = wp.bool(True)
        for axis in range(3):
            for side in range(2):
                r = places.at(g, places.moved(c, axis, side)) + axis * g.slots
                if mesh.kind[r] == LIQUID:
                    cut = cut or geometry.part[r] < scalar(1.0)
                    known = known and cover.owner[r] != 0
        if cut and known:
            cover.shared[number] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def ignore(flags: wp.array(dtype=wp.int32), mesh: Fields, entrance: Entrance, bodies: Bodies, pairs: Pairs):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        if mesh.clock[NOW] < entrance.enters[b]:
            for s in range(shape.first(bodies, b), shape.end(bodies, b)):
                pairs.count[s] = 0
                pairs.smallest_gap[s] = scalar(1.0e30)

    @wp.kernel(enable_backward=False, module="unique")
    def fix(flags: wp.array(dtype=wp.int32), mesh: Fields, entrance: Entrance, bodies: Bodies):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        if mesh.clock[NOW] < entrance.enters[b]:
            bodies.mobility[b] = scalar(0.0) * wp.identity(n=3, dtype=scalar)
            bodies.spin_mobility[b] = scalar(0.0) * wp.identity(n=3, dtype=scalar)

    @wp.kernel(enable_backward=False, module="unique")
    def weigh(g: Grid, flags: wp.array(dtype=wp.int32), entrance: Entrance, bodies: Bodies, excess: scalar):
        """Set the force on each aggregate; `excess` is the density of aggregates minus that of mortar [kg/m3].

        The volume of an aggregate that has left the box follows from `extra_mass`, which is the mass of the aggregate
        minus the mass of the mortar in its place: `excess` times the volume of the aggregate, plus the density of the
        mortar times the volume that has left the box.
        """
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        radius = bodies.radius[b]
        volume = scalar(4.0 / 3.0 * wp.pi) * radius * radius * radius
        left = (bodies.extra_mass[b] - excess * volume) / g.density
        bodies.force[b] = excess * wp.max(volume - left, scalar(0.0)) * entrance.gravity

    return SimpleNamespace(guide=guide, relax=relax, ignore=ignore, fix=fix, weigh=weigh)
