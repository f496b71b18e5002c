"""Viscous part h(g) of the flow laws tau = tau_0 + h(g), with the stress tau and the yield stress tau_0.

In the bulk g is the shear rate, and in a slip layer g is the slip velocity. The constants of the laws are k, n and c:

- Bingham: h = k g.
- Herschel-Bulkley: h = k g^n.
- Modified Bingham: h = k g + c g^2 (Yahia & Khayat 2001).

Kernels are specialised for the law; k, n and c are run-time arguments.
"""

import functools
from types import SimpleNamespace

import warp as wp

BINGHAM, HERSCHEL_BULKLEY, MODIFIED_BINGHAM = "bingham", "herschel-bulkley", "modified-bingham"
"""Names of the flow laws, as in `warpcrete.theory.laws`."""


@functools.cache
def law_functions(scalar, law: str) -> SimpleNamespace:
    """Build the functions that compute the viscous stress h of a flow law.

    The viscous stress is the stress minus the yield stress. Each function takes the constants k, n and c of the law's
    formula. Three functions take a shear rate:

    - `stress` returns h.
    - `viscosity` returns h divided by the rate. Below the rate `slow`, h is smoothed so that the result stays finite
      and above 0.
    - `tangent` returns the derivative of the smoothed h with respect to the rate.

    The other functions take a viscous stress, `over`. All of them except `rate` also take the shear rate at this
    stress:

    - `rate` returns the shear rate.
    - `slope` returns the derivative of the rate with respect to the stress.
    - `bend` returns the second derivative of the rate divided by its first derivative.
    - `integral` and `double_integral` return the first and the second integral of the rate from 0.
    """
    return {BINGHAM: linear_law, HERSCHEL_BULKLEY: power_law, MODIFIED_BINGHAM: quadratic_law}[law](scalar)


@functools.cache
def linear_law(scalar) -> SimpleNamespace:
    """Build the functions of the linear law h = k g, as listed in :func:`law_functions`.

    Here h is the viscous stress, k the plastic viscosity, and g the shear rate.
    """

    @wp.func
    def stress(k: scalar, n: scalar, c: scalar, g: scalar) -> scalar:
        return k * g

    @wp.func
    def viscosity(k: scalar, n: scalar, c: scalar, g: scalar, slow: scalar) -> scalar:
        return k

    @wp.func
    def tangent(k: scalar, n: scalar, c: scalar, g: scalar, slow: scalar) -> scalar:
        return k

    @wp.func
    def rate(k: scalar, n: scalar, c: scalar, over: scalar) -> scalar:
        return over / k

    @wp.func
    def slope(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return scalar(1.0) / k

    @wp.func
    def bend(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return scalar(0.0)

    @wp.func
    def integral(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return scalar(0.5) * over * g

    @wp.func
    def double_integral(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return over * over * g / scalar(6.0)

    return SimpleNamespace(
        stress=stress, viscosity=viscosity, tangent=tangent, rate=rate, slope=slope, bend=bend, integral=integral,
        double_integral=double_integral,
    )  # fmt: skip


@functools.cache
def power_law(scalar) -> SimpleNamespace:
    """Build the functions of the power law h = k g^n, as listed in :func:`law_functions`.

    Here h is the viscous stress, g the shear rate, k the consistency, and n the flow index.
    """

    @wp.func
    def stress(k: scalar, n: scalar, c: scalar, g: scalar) -> scalar:
        return k * wp.pow(g, n)

    @wp.func
    def viscosity(k: scalar, n: scalar, c: scalar, g: scalar, slow: scalar) -> scalar:
        return k * wp.pow(g * g + slow * slow, scalar(0.5) * (n - scalar(1.0)))

    @wp.func
    def tangent(k: scalar, n: scalar, c: scalar, g: scalar, slow: scalar) -> scalar:
        square = g * g + slow * slow
        bent = scalar(1.0) + (n - scalar(1.0)) * g * g / square
        return k * wp.pow(square, scalar(0.5) * (n - scalar(1.0))) * bent

    @wp.func
    def rate(k: scalar, n: scalar, c: scalar, over: scalar) -> scalar:
        return wp.pow(over / k, scalar(1.0) / n)

    @wp.func
    def slope(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        if over > scalar(0.0):
            return g / (n * over)
        return scalar(0.0)

    @wp.func
    def bend(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return (scalar(1.0) / n - scalar(1.0)) / over

    @wp.func
    def integral(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return over * g * n / (n + scalar(1.0))

    @wp.func
    def double_integral(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return over * over * g * n * n / ((n + scalar(1.0)) * (scalar(2.0) * n + scalar(1.0)))

    return SimpleNamespace(
        stress=stress, viscosity=viscosity, tangent=tangent, rate=rate, slope=slope, bend=bend, integral=integral,
        double_integral=double_integral,
    )  # fmt: skip


@functools.cache
def quadratic_law(scalar) -> SimpleNamespace:
    """Build the functions of the quadratic law h = k g + c g^2.

    Here h is the viscous stress, g the shear rate, and k and c are constants. With h as variable of integration, dh =
    (k + 2 c g) dg. The integrals of g over the stress are therefore polynomials of g.
    """

    @wp.func
    def stress(k: scalar, n: scalar, c: scalar, g: scalar) -> scalar:
        return g * (k + c * g)

    @wp.func
    def viscosity(k: scalar, n: scalar, c: scalar, g: scalar, slow: scalar) -> scalar:
        return k + c * g

    @wp.func
    def tangent(k: scalar, n: scalar, c: scalar, g: scalar, slow: scalar) -> scalar:
        return k + scalar(2.0) * c * g

    @wp.func
    def rate(k: scalar, n: scalar, c: scalar, over: scalar) -> scalar:
        # The usual form of the quadratic equation's root loses digits, because it subtracts nearly equal numbers. This
        # equivalent form adds them.
        return scalar(2.0) * over / (k + wp.sqrt(k * k + scalar(4.0) * c * over))

    @wp.func
    def slope(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return scalar(1.0) / (k + scalar(2.0) * c * g)

    @wp.func
    def bend(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        rises = k + scalar(2.0) * c * g
        return -scalar(2.0) * c / (rises * rises)

    @wp.func
    def integral(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        return g * g * (scalar(0.5) * k + scalar(2.0 / 3.0) * c * g)

    @wp.func
    def double_integral(k: scalar, n: scalar, c: scalar, over: scalar, g: scalar) -> scalar:
        a = c * g
        return g * g * g * (k * k / scalar(6.0) + scalar(5.0 / 12.0) * k * a + scalar(4.0 / 15.0) * a * a)

    return SimpleNamespace(
        stress=stress, viscosity=viscosity, tangent=tangent, rate=rate, slope=slope, bend=bend, integral=integral,
        double_integral=double_integral,
    )  # fmt: skip
