"""The regularised Bingham law (Xu, Li & Jiang 2021, Eq. 15), and its means over cells in which the stress varies.

In a pipe, the stress varies linearly from the axis to the wall. The mean velocity of a cell is therefore an integral of
the shear rate over the stress, which has a closed form for this law. Some layers, at a wall or beside a plug, are
thinner than a cell. With the closed form, the velocity is as accurate as the stress even in such layers.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .cells import grid_parameters_struct


@functools.cache
def rate_functions(scalar, dimensions: int) -> SimpleNamespace:
    """Build the functions of the Bingham law: viscosity for a given shear rate, and shear rate for a given stress.

    `apparent` follows the regularised law. `rate_of` replaces the inverse of this law by two straight lines, one below
    and one above the yield stress. `rate_slope` is the derivative of `rate_of`, `rate_integral` its integral over the
    stress, and `double_integral` the integral of `rate_integral`.
    """
    Grid = grid_parameters_struct(scalar, dimensions)

    @wp.func
    def apparent(g: Grid, rate: scalar) -> scalar:
        """Return the apparent viscosity [Pa s] at a shear rate: the shear stress divided by the shear rate."""
        bent = g.regularisation * rate
        if bent > scalar(1.0e-3):
            return g.viscosity + g.yield_stress * (scalar(1.0) - wp.exp(-bent)) / rate
        # Use a series for small rates, because the fraction (1 - exp(-x)) / x loses digits there.
        return g.viscosity + g.yield_stress * g.regularisation * (scalar(1.0) - scalar(0.5) * bent)

    @wp.func
    def unyielded_viscosity(g: Grid) -> scalar:
        """Return the viscosity [Pa s] of concrete whose stress is below the yield stress."""
        return g.viscosity + g.yield_stress * g.regularisation

    @wp.func
    def rate_of(g: Grid, stress: scalar) -> scalar:
        """Return the shear rate [1/s] at a nonnegative stress.

        The flow curve consists of two straight lines that meet at the yield stress.
        """
        return wp.max(stress - g.yield_stress, scalar(0.0)) / g.viscosity + (
            wp.min(stress, g.yield_stress) / unyielded_viscosity(g)
        )

    @wp.func
    def rate_slope(g: Grid, stress: scalar) -> scalar:
        if stress > g.yield_stress:
            return scalar(1.0) / g.viscosity
        return scalar(1.0) / unyielded_viscosity(g)

    @wp.func
    def rate_integral(g: Grid, stress: scalar) -> scalar:
        """Return the integral of the shear rate over the stress, from 0 to a nonnegative stress."""
        over = wp.max(stress - g.yield_stress, scalar(0.0))
        below = wp.min(stress, g.yield_stress)
        return scalar(0.5) * (over * over / g.viscosity + below * below / unyielded_viscosity(g)) + (
            over * g.yield_stress / unyielded_viscosity(g)
        )

    @wp.func
    def double_integral(g: Grid, stress: scalar) -> scalar:
        """Return the integral of `rate_integral` from 0 to `stress`; it has the same sign as `stress`."""
        size = wp.abs(stress)
        over = wp.max(size - g.yield_stress, scalar(0.0))
        below = wp.min(size, g.yield_stress)
        sum = over * over * over / (scalar(6.0) * g.viscosity) + (
            below * below * below / scalar(6.0) + over * g.yield_stress * (g.yield_stress + over) / scalar(2.0)
        ) / unyielded_viscosity(g)
        return wp.sign(stress) * sum

    return SimpleNamespace(
        apparent=apparent,
        unyielded_viscosity=unyielded_viscosity,
        rate_of=rate_of,
        rate_slope=rate_slope,
        rate_integral=rate_integral,
        double_integral=double_integral,
    )


@functools.cache
def bingham_functions(scalar, dimensions: int) -> SimpleNamespace:
    """Build the functions of the Bingham law on a grid.

    - `apparent`: viscosity at a shear rate.
    - `apparent_at_edge`: viscosity at a corner between cells, also if a plug (unyielded concrete) ends within these
      cells.
    - `at_wall`: shear stress that a wall exerts on the cell beside it.
    """
    Grid = grid_parameters_struct(scalar, dimensions)
    f = rate_functions(scalar, dimensions)
    apparent, unyielded_viscosity, rate_of, rate_slope = f.apparent, f.unyielded_viscosity, f.rate_of, f.rate_slope
    rate_integral, double_integral = f.rate_integral, f.double_integral

    @wp.func
    def apparent_at_edge(g: Grid, rate: scalar, change: scalar) -> scalar:
        """Return the viscosity at the corner where two cells meet, corrected if the edge of a plug lies in these cells.

        `rate` is the difference of the cells' mean velocities divided by the distance of the cells' centres [1/s].
        `change` is the amount by which the shear stress changes from one side of a cell to the opposite side [Pa]. If
        the edge of a plug (a region below the yield stress) lies in the cells, `rate` is larger than the shear rate at
        the corner.
        """
        viscosity = apparent(g, rate)
        if rate <= scalar(0.0):
            return viscosity
        # Estimate the shear stress at the corner where the two cells meet. Approximate the relation of shear rate and
        # stress by two straight lines, and assume that no edge of a plug (unyielded concrete) lies inside the cells.
        most = wp.min(
            rate * unyielded_viscosity(g),
            g.yield_stress + g.viscosity * (rate - g.yield_stress / unyielded_viscosity(g)),
        )
        if most + change <= g.yield_stress or most - change >= g.yield_stress or change <= scalar(0.01) * most:
            return viscosity
        low = scalar(0.0)
        high = most
        # Find the corner's stress s by bisection: the mean shear rate about the corner must equal `rate`. In this mean
        # the weight is a hat function, which falls linearly from the corner to zero at the far sides of both cells. The
        # stress changes by d = `change` over each cell, so the mean is (F(s + d) - 2 F(s) + F(s - d)) / d^2, where F is
        # `double_integral`.
        for _ in range(20):
            middle = scalar(0.5) * (low + high)
            mean = (
                double_integral(g, middle + change)
                - scalar(2.0) * double_integral(g, middle)
                + double_integral(g, middle - change)
            )
            if mean < rate * change * change:
                low = middle
            else:
                high = middle
        return viscosity * high / most

    @wp.func
    def beside_wall(g: Grid, stress: scalar, inner: scalar, width: scalar):
        """Return the mean velocity of a cell at a wall minus the velocity at the wall, and its derivative.

        Both are velocities of the concrete along the wall, so slip is not included. The derivative of the difference is
        with respect to `stress`, the shear stress at the wall. Across the cell, the stress changes linearly from this
        value to `inner` at the side opposite the wall.
        """
        # The stress varies linearly across the cell, from `stress` at the wall to `inner`. The difference is `change`.
        # Where the stress is tau, the velocity relative to the wall is u = width / change * (F(stress) - F(tau)). Here
        # F, the function `rate_integral`, is the integral of the shear rate over the stress. The mean of u over the
        # cell contains the integral of F, which is the function `double_integral`.
        change = stress - inner
        if change > scalar(0.05) * stress:
            part = (change * rate_integral(g, stress) - (double_integral(g, stress) - double_integral(g, inner))) / (
                change * change
            )
            return width * part, width / change * (rate_of(g, stress) - scalar(2.0) * part)
        # If the stress hardly varies across the cell, use Simpson's rule, because the closed form loses digits there.
        middle = scalar(0.5) * (stress + inner)
        mean = rate_of(g, stress) / scalar(6.0) + rate_of(g, middle) / scalar(3.0)
        return width * mean, width / scalar(6.0) * (rate_slope(g, stress) + rate_slope(g, middle))

    @wp.func
    def at_wall(
        g: Grid, speed: scalar, inner: scalar, width: scalar, ring: scalar, slip_viscosity: scalar, slip_yield: scalar
    ):  # fmt: skip
        """Return a wall's stress on the cell beside it, its derivative with respect to `speed`, and the slip velocity.

        `speed` is the cell's mean velocity along the wall. This mean velocity is the sum of the slip velocity (Xu, Li &
        Jiang 2021, Eq. 8) and the mean velocity due to shear within the cell; in cells that are rings about an axis,
        the mean velocity due to shear is multiplied by `ring`. Newton's method solves for the stress. It starts above
        the solution, where the function is convex.
        """
        # Start from an upper bound of the wall stress. The stress would be larger if slip alone, or shear alone, had to
        # produce the whole speed. Both of these stresses are therefore upper bounds, the second one after
        # multiplication by a margin. Use the smaller bound.
        sheared = scalar(3.0) * (g.yield_stress + scalar(4.0) * g.viscosity * speed / width)
        stress = wp.min(slip_yield + slip_viscosity * speed, sheared)
        growth = scalar(1.0)
        slip = scalar(0.0)
        least = scalar(0.1) * width / unyielded_viscosity(g)
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

    return SimpleNamespace(
        apparent=apparent, unyielded_viscosity=unyielded_viscosity, apparent_at_edge=apparent_at_edge, at_wall=at_wall
    )
