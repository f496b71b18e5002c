"""Functions on a grid for flow laws other than Bingham's, and for slip layers that are not linear.

The functions have the same names and meanings as the functions in the module `bingham`. The viscous part of each law
comes from the module `flow_laws`.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..flow_laws import law_functions
from .bingham import bingham_functions
from .cells import GridKind, grid_parameters_struct

MARGIN = wp.constant(4.0)
"""Factor by which an estimate of the wall stress is multiplied to obtain an upper bound for the search of this
stress."""


@functools.cache
def rate_functions(scalar, dimensions: int, law: str) -> SimpleNamespace:
    """Build functions of a flow law: viscosity as a function of the shear rate, and rate as a function of the stress.

    `apparent` returns the apparent viscosity of the regularised law. `sums` replaces the law below the yield stress by
    a straight line. For a stress of at least zero, it returns the shear rate, and the first and the second integral of
    the rate over the stress from 0.
    """
    Grid = grid_parameters_struct(scalar, dimensions)
    h = law_functions(scalar, law)

    @wp.func
    def apparent(g: Grid, rate: scalar) -> scalar:
        """Return the apparent viscosity [Pa s] at a shear rate: the shear stress divided by the shear rate."""
        flowing = h.viscosity(g.viscosity, g.flow_index, g.quadratic_viscosity, rate, scalar(1.0) / g.regularisation)
        bent = g.regularisation * rate
        if bent > scalar(1.0e-3):
            return flowing + g.yield_stress * (scalar(1.0) - wp.exp(-bent)) / rate
        # Use a series for small rates, because the fraction (1 - exp(-x)) / x loses digits there.
        return flowing + g.yield_stress * g.regularisation * (scalar(1.0) - scalar(0.5) * bent)

    @wp.func
    def unyielded_viscosity(g: Grid) -> scalar:
        """Return the viscosity [Pa s] of concrete whose stress is below the yield stress."""
        return g.yield_stress * g.regularisation + h.viscosity(
            g.viscosity, g.flow_index, g.quadratic_viscosity, scalar(0.0), scalar(1.0) / g.regularisation
        )

    @wp.func
    def sums(g: Grid, stiff: scalar, stress: scalar):
        """Return the shear rate at a `stress` of at least zero, and the first and second integral of the rate.

        Both integrals run over the stress from 0 to `stress`. `stiff` is the viscosity of concrete below the yield
        stress [Pa s].
        """
        over = wp.max(stress - g.yield_stress, scalar(0.0))
        below = wp.min(stress, g.yield_stress)
        rate = h.rate(g.viscosity, g.flow_index, g.quadratic_viscosity, over)
        one = h.integral(g.viscosity, g.flow_index, g.quadratic_viscosity, over, rate)
        two = h.double_integral(g.viscosity, g.flow_index, g.quadratic_viscosity, over, rate)
        one += (scalar(0.5) * below * below + over * g.yield_stress) / stiff
        two += (
            below * below * below / scalar(6.0) + over * g.yield_stress * (g.yield_stress + over) / scalar(2.0)
        ) / stiff
        return rate + below / stiff, one, two

    @wp.func
    def slope(g: Grid, stiff: scalar, stress: scalar) -> scalar:
        """Return the derivative of the shear rate with respect to the stress, for a stress of at least zero."""
        over = stress - g.yield_stress
        if over > scalar(0.0):
            rate = h.rate(g.viscosity, g.flow_index, g.quadratic_viscosity, over)
            return h.slope(g.viscosity, g.flow_index, g.quadratic_viscosity, over, rate)
        return scalar(1.0) / stiff

    return SimpleNamespace(h=h, apparent=apparent, unyielded_viscosity=unyielded_viscosity, sums=sums, slope=slope)


@functools.cache
def edge_function(scalar, dimensions: int, law: str):
    """Build the function `apparent_at_edge`, which returns the apparent viscosity at a corner between two cells.

    The shear rate varies within these cells. The difference of the cells' mean velocities, divided by the distance of
    the cells' centres, is therefore a mean of the rate over both cells, in which the weight of a point falls linearly
    with its distance from the corner. If the stress varies linearly, this mean is (F(s + d) - 2 F(s) + F(s - d)) / d^2.
    Here F is the second integral of the rate over the stress, s is the stress at the corner, and d is the change of the
    stress across one cell. `apparent_at_edge` solves this equation for s.
    """
    Grid = grid_parameters_struct(scalar, dimensions)
    f = rate_functions(scalar, dimensions, law)
    h, apparent, unyielded_viscosity, sums = f.h, f.apparent, f.unyielded_viscosity, f.sums

    @wp.func
    def apparent_at_edge(g: Grid, rate: scalar, change: scalar) -> scalar:
        """Return the apparent viscosity at a corner where two cells meet [Pa s].

        `rate` is the mean of the shear rate over both cells [1/s]. `change` is the amount by which the shear stress
        changes from one side of a cell to the opposite side [Pa].
        """
        viscosity = apparent(g, rate)
        if rate <= scalar(0.0):
            return viscosity
        stiff = unyielded_viscosity(g)
        sheared = rate - g.yield_stress / stiff
        over = h.stress(g.viscosity, g.flow_index, g.quadratic_viscosity, wp.max(sheared, scalar(0.0)))
        # Estimate the stress at the cells' common corner as if the rate hardly varied in these cells.
        plain = g.yield_stress + over
        if sheared <= scalar(0.0):
            plain = rate * stiff
            if plain + change <= g.yield_stress:
                return viscosity
        if change <= scalar(0.01) * plain:
            return viscosity
        if over >= change:
            # Let s be the shear stress at the corner where the two cells meet. From one side of a cell to the other,
            # the stress changes by `change`. The mean rate over both cells is nearly the rate at the stress s plus
            # change^2 / 12 times the second derivative of the rate with respect to the stress. Therefore s is lower
            # than the estimate by change^2 / 12 times `bend`, which is the second derivative divided by the first.
            bend = h.bend(g.viscosity, g.flow_index, g.quadratic_viscosity, over, sheared)
            return viscosity * (scalar(1.0) - change * change * bend / (scalar(12.0) * plain))
        # In this case, the two cells that meet at the corner contain the edge of a plug (unyielded concrete) or the
        # middle of the pipe. Find the shear stress s at the corner for which the mean shear rate over both cells equals
        # `rate`, by Newton's method between two bounds.
        low = scalar(0.0)
        high = plain + change
        s = plain
        goal = rate * change * change
        for _ in range(12):
            rate_above, one_above, two_above = sums(g, stiff, s + change)
            rate_here, one_here, two_here = sums(g, stiff, s)
            rate_below, one_below, two_below = sums(g, stiff, wp.abs(s - change))
            value = two_above - scalar(2.0) * two_here + wp.sign(s - change) * two_below - goal
            if value < scalar(0.0):
                low = s
            else:
                high = s
            growth = one_above - scalar(2.0) * one_here + one_below
            next = s - value / wp.max(growth, scalar(1.0e-30))
            if next <= low or next >= high:
                next = scalar(0.5) * (low + high)
            step = next - s
            s = next
            if wp.abs(step) <= scalar(1.0e-4) * s:
                break
        return viscosity * s / plain

    return apparent_at_edge


@functools.cache
def wall_function(scalar, dimensions: int, law: str, slip_law: str):
    """Build `at_wall`, which computes the stress of a wall on the cell beside it from the cell's mean velocity."""
    Grid = grid_parameters_struct(scalar, dimensions)
    f = rate_functions(scalar, dimensions, law)
    h, apparent, unyielded_viscosity, sums, slope = f.h, f.apparent, f.unyielded_viscosity, f.sums, f.slope
    layer = law_functions(scalar, slip_law)

    @wp.func
    def beside_wall(g: Grid, stiff: scalar, stress: scalar, inner: scalar, width: scalar):
        """Return the cell's mean velocity relative to the concrete at the wall, and the derivative of this velocity.

        The derivative is taken with respect to `stress`, the stress at the wall. Within the cell, the stress falls
        linearly from this value to `inner` on the side opposite the wall.
        """
        change = stress - inner
        rate, one, two = sums(g, stiff, stress)
        if change > scalar(0.05) * stress:
            rate_inner, one_inner, two_inner = sums(g, stiff, inner)
            part = (change * one - (two - two_inner)) / (change * change)
            return width * part, width / change * (rate - scalar(2.0) * part)
        # If the stress hardly varies across the cell, use Simpson's rule, because the closed form loses digits there.
        middle = scalar(0.5) * (stress + inner)
        rate_middle, one_middle, two_middle = sums(g, stiff, middle)
        mean = rate / scalar(6.0) + rate_middle / scalar(3.0)
        return width * mean, width / scalar(6.0) * (slope(g, stiff, stress) + slope(g, stiff, middle))

    @wp.func
    def at_wall(
        g: Grid, speed: scalar, inner: scalar, width: scalar, ring: scalar, slip_viscosity: scalar, slip_yield: scalar,
        slip_index: scalar, slip_quadratic: scalar,
    ):  # fmt: skip
        """Return a wall's stress on a cell, this stress's derivative with respect to `speed`, and the slip velocity.

        The cell lies at the wall, and `speed` is its mean velocity along the wall. This velocity is the sum of the slip
        velocity and of the mean velocity due to shear within the cell. If the cell is a ring about an axis, the mean
        velocity due to shear is multiplied by `ring`. Newton's method is kept between two bounds, because the velocity
        is not a convex function of the stress.
        """
        stiff = unyielded_viscosity(g)
        # The speed is the sum of slip and shear. The stress would be larger if the whole speed were slip, and also if
        # the whole speed were shear. Both of these stresses are therefore upper bounds, the second one after
        # multiplication by MARGIN. Use the smaller bound.
        steepest = (scalar(2.0) + scalar(1.0) / g.flow_index) * speed / width
        sheared = scalar(MARGIN) * (
            g.yield_stress + h.stress(g.viscosity, g.flow_index, g.quadratic_viscosity, steepest)
        )
        high = wp.min(slip_yield + layer.stress(slip_viscosity, slip_index, slip_quadratic, speed), sheared)
        low = scalar(0.0)
        stress = high
        growth = scalar(1.0)
        slip = scalar(0.0)
        # Newton's method divides by the derivative of the speed with respect to the stress. The largest apparent
        # viscosity in the cell gives a lower limit for this derivative. In shear-thickening concrete, the apparent
        # viscosity is largest at the largest shear rate; in all other concrete, it is largest at the smallest shear
        # rate.
        least = scalar(0.1) * width / wp.max(stiff, apparent(g, steepest))
        for _ in range(40):
            over = wp.max(stress - slip_yield, scalar(0.0))
            slip = layer.rate(slip_viscosity, slip_index, slip_quadratic, over)
            within, grows = beside_wall(g, stiff, stress, wp.min(inner, stress), width)
            growth = wp.max(ring * grows, least)
            if over > scalar(0.0):
                growth += layer.slope(slip_viscosity, slip_index, slip_quadratic, over, slip)
            value = slip + ring * within - speed
            if value > scalar(0.0):
                high = stress
            elif stress >= high:
                low = stress
                high = scalar(MARGIN) * stress
            else:
                low = stress
            next = stress - value / growth
            if next <= low or next >= high:
                next = scalar(0.5) * (low + high)
            step = stress - next
            stress = next
            if wp.abs(step) <= scalar(1.0e-6) * stress:
                break
        return stress, scalar(1.0) / growth, slip

    return at_wall


@functools.cache
def flow_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build the functions of the flow laws of bulk and slip layer, which :func:`bingham_functions` describes.

    If the laws are not both Bingham's (`of.plain` is false), the function `at_wall` has two more arguments: the flow
    index and the quadratic coefficient of the slip layer.
    """
    if of.plain:
        return bingham_functions(scalar, of.dimensions)
    f = rate_functions(scalar, of.dimensions, of.law)
    return SimpleNamespace(
        apparent=f.apparent, unyielded_viscosity=f.unyielded_viscosity,
        apparent_at_edge=edge_function(scalar, of.dimensions, of.law),
        at_wall=wall_function(scalar, of.dimensions, of.law, of.slip_law),
    )  # fmt: skip
