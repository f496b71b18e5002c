"""Aggregates that leave the simulated box through an open side, such as the outlet of a funnel.

The grid contains mortar everywhere, also inside aggregates, so an aggregate adds only its own mass minus the mass of an
equal volume of mortar. Beyond an open side there is no mortar. The part of an aggregate that has left therefore adds
its full mass and weight. An aggregate that has left entirely is placed far away from the box, where it stays at rest.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..mps.grid.cells import grid_parameters_struct
from ..mps.structs import mps_types
from .bodies import BodyKind, body_structs, shape_functions
from .pairs import pair_struct

PARKED = wp.constant(1.0e3)
"""Smallest magnitude of one coordinate of an aggregate that has left the simulated box [m]. Such aggregates are placed
far away from the box."""


@functools.cache
def leaving_kernels(scalar, kind: BodyKind) -> SimpleNamespace:
    """Build the kernels `weigh` and `park`, each with one task per aggregate.

    `opens` has bit number 2 axis + 1 set if the upper side of the simulated box along this axis is open, and bit number
    2 axis if the lower side is open. `excess` is the density of the aggregates minus the density of the mortar [kg/m3].
    """
    vec = mps_types(scalar, 3).vec
    Grid = grid_parameters_struct(scalar, 3)
    Bodies = body_structs(scalar).Bodies
    Pairs, shape = pair_struct(scalar), shape_functions(scalar, kind)

    @wp.func
    def beyond(g: Grid, bodies: Bodies, s: wp.int32, side: wp.int32) -> scalar:
        """Return how far a sphere reaches beyond a side of the box [m], at most its diameter."""
        axis = side / 2
        inside = shape.centre(bodies, s)[axis] - g.origin[axis]
        if side % 2 == 1:
            inside = scalar(g.n[axis]) * g.width[axis] - inside
        return wp.clamp(shape.radius(bodies, s) - inside, scalar(0.0), scalar(2.0) * shape.radius(bodies, s))

    @wp.func
    def outside(g: Grid, bodies: Bodies, b: wp.int32, side: wp.int32) -> wp.bool:
        """Return whether an aggregate lies entirely beyond a side of the box."""
        gone = wp.bool(True)
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            gone = gone and beyond(g, bodies, s, side) == scalar(2.0) * shape.radius(bodies, s)
        return gone

    @wp.kernel(enable_backward=False, module="unique")
    def weigh(
        g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, pairs: Pairs, opens: wp.int32, excess: scalar
    ):  # fmt: skip
        """Compute the mass and weight that each aggregate has in addition to the mortar in its place.

        Also delete the list of neighbours of each aggregate that has left the box entirely.
        """
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        radius = bodies.radius[b]
        volume = scalar(4.0 / 3.0 * wp.pi) * radius * radius * radius
        left = scalar(0.0)
        gone = wp.bool(False)
        for side in range(6):
            if (opens >> side) % 2 == 1:
                gone = gone or outside(g, bodies, b, side)
                for s in range(shape.first(bodies, b), shape.end(bodies, b)):
                    size = shape.radius(bodies, s)
                    h = beyond(g, bodies, s, side)
                    cap = scalar(wp.pi / 3.0) * h * h * (scalar(3.0) * size - h)
                    if wp.static(kind.clumps):
                        cap *= bodies.share[s] / (scalar(4.0 / 3.0 * wp.pi) * size * size * size)
                    left += cap
        left = wp.where(gone, volume, wp.min(left, volume))
        extra = excess * volume + g.density * left
        bodies.extra_mass[b] = extra
        if wp.static(kind.clumps):
            bodies.tensor[b] = shape.tensor(bodies, b)
        else:
            bodies.extra_inertia[b] = scalar(0.4) * extra * radius * radius
        bodies.force[b] = extra * g.gravity
        if gone:
            bodies.force[b] = vec()
            for s in range(shape.first(bodies, b), shape.end(bodies, b)):
                pairs.count[s] = 0
                pairs.smallest_gap[s] = scalar(1.0e30)

    @wp.kernel(enable_backward=False, module="unique")
    def park(g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, opens: wp.int32):
        """Move aggregates that have left the box entirely far away, at a distance from each other, and stop them."""
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        for side in range(6):
            if (opens >> side) % 2 == 1 and outside(g, bodies, b, side):
                axis = side / 2
                x = bodies.centre[b]
                x[axis] = wp.where(side % 2 == 0, scalar(-1.0), scalar(1.0)) * (scalar(PARKED) + scalar(b))
                bodies.centre[b] = x
                bodies.velocity[b] = vec()
                bodies.spin[b] = vec()

    return SimpleNamespace(weigh=weigh, park=park)
