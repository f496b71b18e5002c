"""The regularised Bingham law (Xu, Li & Jiang 2021, Eq. 15), and its means over cells in which the stress varies.

Where stress changes in a straight line, as it does across a pipe, velocities that are means over cells follow from
integrals of the law. So a wall layer or the edge of a plug thinner than a cell are as exact as the stress is.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .cells import cells_struct


@functools.cache
def rate_functions(scalar, dimensions: int) -> SimpleNamespace:
    """`apparent` viscosity of a rate; `rate_of` a stress, in straight lines, its `rate_slope`, its integral `once` and
    `twice`."""
    Cells = cells_struct(scalar, dimensions)

    @wp.func
    def apparent(g: Cells, rate: scalar) -> scalar:
        """Stress over rate [Pa s]."""
        bent = g.regularisation * rate
        if bent > scalar(1.0e-3):
            return g.viscosity + g.yield_stress * (scalar(1.0) - wp.exp(-bent)) / rate
        return g.viscosity + g.yield_stress * g.regularisation * (scalar(1.0) - scalar(0.5) * bent)

    @wp.func
    def unyielded(g: Cells) -> scalar:
        """Viscosity below the yield stress [Pa s]."""
        return g.viscosity + g.yield_stress * g.regularisation

    @wp.func
    def rate_of(g: Cells, stress: scalar) -> scalar:
        """Rate of shear at a stress of 0 or more, in two straight lines."""
        return wp.max(stress - g.yield_stress, scalar(0.0)) / g.viscosity + (
            wp.min(stress, g.yield_stress) / unyielded(g)
        )

    @wp.func
    def rate_slope(g: Cells, stress: scalar) -> scalar:
        if stress > g.yield_stress:
            return scalar(1.0) / g.viscosity
        return scalar(1.0) / unyielded(g)

    @wp.func
    def once(g: Cells, stress: scalar) -> scalar:
        """Integral of that rate from no stress on."""
        over = wp.max(stress - g.yield_stress, scalar(0.0))
        below = wp.min(stress, g.yield_stress)
        return scalar(0.5) * (over * over / g.viscosity + below * below / unyielded(g)) + (
            over * g.yield_stress / unyielded(g)
        )

    @wp.func
    def twice(g: Cells, stress: scalar) -> scalar:
        """Integral of the integral, of either sign as the stress."""
        size = wp.abs(stress)
        over = wp.max(size - g.yield_stress, scalar(0.0))
        below = wp.min(size, g.yield_stress)
        sum = over * over * over / (scalar(6.0) * g.viscosity) + (
            below * below * below / scalar(6.0) + over * g.yield_stress * (g.yield_stress + over) / scalar(2.0)
        ) / unyielded(g)
        return wp.sign(stress) * sum

    return SimpleNamespace(
        apparent=apparent, unyielded=unyielded, rate_of=rate_of, rate_slope=rate_slope, once=once, twice=twice
    )


@functools.cache
def bingham_functions(scalar, dimensions: int) -> SimpleNamespace:
    """`apparent` viscosity of a rate, `apparent_at_edge` where a plug may end, and `at_wall`."""
    Cells = cells_struct(scalar, dimensions)
    f = rate_functions(scalar, dimensions)
    apparent, unyielded, rate_of, rate_slope, once, twice = (
        f.apparent, f.unyielded, f.rate_of, f.rate_slope, f.once, f.twice,
    )  # fmt: skip

    @wp.func
    def apparent_at_edge(g: Cells, rate: scalar, change: scalar) -> scalar:
        """Viscosity at a corner, for the `rate` between the means of two cells over which stress changes by `change`.

        Where the plug ends within them that rate, a mean itself, is more than the rate at the corner.
        """
        viscosity = apparent(g, rate)
        # Where there is no edge, the stress of the two lines that are integrated.
        most = wp.min(rate * unyielded(g), g.yield_stress + g.viscosity * (rate - g.yield_stress / unyielded(g)))
        if most + change <= g.yield_stress or most - change >= g.yield_stress or change <= scalar(0.01) * most:
            return viscosity
        low = scalar(0.0)
        high = most
        for _ in range(20):
            middle = scalar(0.5) * (low + high)
            mean = twice(g, middle + change) - scalar(2.0) * twice(g, middle) + twice(g, middle - change)
            if mean < rate * change * change:
                low = middle
            else:
                high = middle
        return viscosity * high / most

    @wp.func
    def beside_wall(g: Cells, stress: scalar, inner: scalar, width: scalar):
        """Mean velocity of a cell beside a wall over that at the wall, and its growth with the wall's `stress`.

        Stress falls in a straight line to `inner` on the cell's other side.
        """
        change = stress - inner
        if change > scalar(0.05) * stress:
            part = (change * once(g, stress) - (twice(g, stress) - twice(g, inner))) / (change * change)
            return width * part, width / change * (rate_of(g, stress) - scalar(2.0) * part)
        middle = scalar(0.5) * (stress + inner)
        mean = rate_of(g, stress) / scalar(6.0) + rate_of(g, middle) / scalar(3.0)
        return width * mean, width / scalar(6.0) * (rate_slope(g, stress) + rate_slope(g, middle))

    @wp.func
    def at_wall(
        g: Cells, speed: scalar, inner: scalar, width: scalar, ring: scalar, slip_viscosity: scalar, slip_yield: scalar
    ):  # fmt: skip
        """Stress of a wall on the cell beside it, whose mean `speed` along it this is, its growth with that, and the
        slip velocity (Xu, Li & Jiang 2021, Eq. 8); `ring` is by how much a ring's mean is less than a plane's.

        Newton's steps come from above, where what is solved is convex.
        """
        sheared = scalar(3.0) * (g.yield_stress + scalar(4.0) * g.viscosity * speed / width)
        stress = wp.min(slip_yield + slip_viscosity * speed, sheared)
        growth = scalar(1.0)
        slip = scalar(0.0)
        least = scalar(0.1) * width / unyielded(g)
        for _ in range(40):
            slip = wp.max(stress - slip_yield, scalar(0.0)) / slip_viscosity
            within, grows = beside_wall(g, stress, wp.min(inner, stress), width)
            growth = wp.max(ring * grows, least)
            if stress > slip_yield:
                growth += scalar(1.0) / slip_viscosity
            step = (slip + ring * within - speed) / growth
            stress = wp.max(stress - step, scalar(0.0))
            if wp.abs(step) <= scalar(1.0e-6) * stress:
                break
        return stress, scalar(1.0) / growth, slip

    return SimpleNamespace(apparent=apparent, unyielded=unyielded, apparent_at_edge=apparent_at_edge, at_wall=at_wall)
