"""Closed-form solutions and estimates for standard tests: slump, spread, L-box, LCPC box, V-funnel.

A long heap comes to rest where the yield stress on the plate balances the outward pressure of its slope (Roussel &
Coussot 2005). The next order of shallow-layer theory adds the heap's resistance to stretching, which stops the heap
earlier (Dubash, Balmforth, Slim & Cochard 2009 in a plane; here also about an axis). A tall heap rests where each layer
has grown wide enough to bear the weight above it (Murata 1984; for cones Schowalter & Christensen 1998).

In Murata's theory, concrete yields where the largest shear stress, half of the vertical pressure, reaches the yield
stress (Tresca). A Bingham fluid in three dimensions yields where the second invariant of the stress does (von Mises),
which means that the vertical pressure divided by the square root of 3 reaches the yield stress.
"""

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np

from .laws import BINGHAM, FlowLaw

LAYERS = 4000
"""Number of slices for numerical integration, into which a cone is divided along its height or a heap along its
radius."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)
"""Nodes from -1 to 1 and weights of Gauss-Legendre integration."""
SLICES, SLICES_FUNNEL, SPEEDS = 400, 60, 120
"""Numbers that determine the accuracy of numerical solutions. SLICES is the number of slices of a box along its length,
and SLICES_FUNNEL the number of slices of a funnel along its height. For each height of the concrete in the funnel, the
outlet speed is interpolated between SPEEDS values."""


def cone_volume(top: float, base: float, height: float) -> float:
    """Return the volume [m3] of a truncated cone with radii `top` and `base` and a `height` [m]."""
    return math.pi * height / 3 * (top * top + top * base + base * base)


def long_heap_spread(volume: float, yield_stress: float, density: float, gravity: float = 9.81) -> float:
    """Return the diameter [m] of a heap at rest that is much wider than high (Roussel & Coussot 2005).

    The radius R follows from tau = 225 rho g V^2 / (128 pi^2 R^5), with the yield stress tau, the density rho, gravity
    g, and the volume V of the heap.
    """
    return 2 * (225 * density * gravity * volume**2 / (128 * math.pi**2 * yield_stress)) ** 0.2


HEAPS = {"plane": math.pi / 2, "axial": math.sqrt(3) * math.pi / 4}
"""Resistance of a heap to stretching, divided by yield stress tau and depth h, for the forms "plane" and "axial".

The resistance is the normal stress along the slope minus the normal stress across it, without the part that the weight
causes, integrated over the depth. At height z, shear uses tau (1 - z / h) of the yield stress. The remaining part,
sqrt(tau^2 - shear^2), resists stretching. The mean of this part over the depth is (pi / 4) tau.

In a plane the normal stresses are s and -s, which doubles this mean. About an axis, a heap that keeps its shape has the
stress s along the radius and around it, and -2 s upwards, with 3 s^2 + shear^2 = tau^2. The mean is therefore
multiplied by sqrt(3).
"""


def heap_depth(
    inward: np.ndarray, yield_stress: float, density: float, gravity: float = 9.81, form: str = "axial"
) -> np.ndarray:
    """Return the depth [m] of a heap at rest at the distances `inward` [m] behind the heap's front.

    The depth h follows from rho g h^2 / 2 = tau (inward + HEAPS h), with the density rho, the gravity g and the yield
    stress tau. The left side is the outward pressure of the weight over the depth. The plate resists this pressure with
    tau along the distance `inward`, and the stretched section resists it with HEAPS tau h. The formula for a long heap
    (:func:`long_heap_spread`) lacks the last term. `form` is "plane" or "axial".
    """
    bears = yield_stress / (density * gravity)
    front = HEAPS[form] * bears
    return front + np.sqrt(front * front + 2 * bears * np.asarray(inward))


def heap_at_rest(
    volume: float, yield_stress: float, density: float, gravity: float = 9.81, form: str = "axial"
) -> tuple[float, float]:
    """Return the radius or half-width [m] and the central depth [m] of a heap of concrete that has come to rest.

    The closed form leaves out inertia and holds for heaps wider than high. The yield stress resists both shear and
    stretching. `volume` is the volume of the whole heap about an axis [m3], or in a plane the volume of one half per
    metre of depth [m2].
    """
    widest = 1.0
    while heap_volume(widest, yield_stress, density, gravity, form) < volume:
        widest *= 2
    reach = root(lambda x: heap_volume(x, yield_stress, density, gravity, form) - volume, 0.0, widest)
    return reach, float(heap_depth(np.array(reach), yield_stress, density, gravity, form))


def heap_volume(reach: float, yield_stress: float, density: float, gravity: float = 9.81, form: str = "axial") -> float:
    """Return the volume of a heap at rest whose radius or half-width is `reach` [m].

    If `form` is "axial", the result is the volume of the whole heap [m3]. If `form` is "plane", the result is the
    volume of one half of the heap per metre of depth [m2].
    """
    place = (np.arange(LAYERS) + 0.5) * reach / LAYERS
    depth = heap_depth(reach - place, yield_stress, density, gravity, form)
    return float(np.sum(depth * (2 * math.pi * place if form == "axial" else 1.0)) * reach / LAYERS)


def viscous_front(volume: float, viscosity: float, density: float, time: float, gravity: float = 9.81) -> float:
    """Return how far a viscous fluid without yield stress has spread on a plate to one side [m] (Huppert 1982).

    There is no slip between fluid and plate. The solution for long times in a plane is 1.411 (g V^3 / (3 nu))^(1/5)
    t^(1/5). Here g is gravity, nu the kinematic viscosity, and t the `time` since the release [s]. V is the `volume`
    released to this side per metre of depth [m2].
    """
    return 1.411 * (density * gravity * volume**3 * time / (3 * viscosity)) ** 0.2


def tall_cone_slump(
    top: float, base: float, height: float, yield_stress: float, density: float, gravity: float = 9.81,
    bears: float = math.sqrt(3),
) -> float:  # fmt: skip
    """Return the slump [m] of a truncated cone, in which each layer widens until it bears the weight above it.

    `top` and `base` are the radii of the cone [m]. `bears` is the vertical pressure that a layer bears, divided by the
    yield stress: the square root of 3 by von Mises, or 2 by Tresca as in Murata (1984).
    """
    depth = (np.arange(LAYERS) + 0.5) * height / LAYERS
    radius = top + (base - top) * depth / height
    area = math.pi * radius**2
    load = density * gravity * math.pi * depth / 3 * (top * top + top * radius + radius * radius)
    # Fraction of its initial height that each layer of the cone keeps at rest.
    stays = np.minimum(1.0, bears * yield_stress * area / load)
    return float(np.sum(1 - stays) * height / LAYERS)


def box_at_rest(
    volume: float, length: float, width: float, yield_stress: float, density: float, gravity: float = 9.81
) -> tuple[float, float, float]:
    """Return the depths of resting concrete at the near and far end of a box and the length that it covers [m].

    The concrete enters at one end without inertia and sticks to floor and sides. It comes to rest when the stresses on
    floor and sides balance the slope h' of its depth h: h' = tau (b + 2 h) / (rho g b h) (Nguyen, Roussel & Coussot
    2006). Here tau is the yield stress, b the width of the box, rho the density and g gravity. The equation is
    integrated from the far end, or from the front if the concrete does not reach the far end.
    """
    pull = yield_stress / (density * gravity)

    def filled(far: float, reach: float) -> tuple[float, float]:
        """Return the volume [m3] of concrete at rest in the box, and its depth at the near end, the inlet [m].

        `far` is the depth of the concrete at its far end [m], and `reach` is the distance between both ends [m].
        """
        step, depth, sum = reach / SLICES, far, 0.0
        for _ in range(SLICES):
            # Integrate the square of the depth, because the slope of the depth itself is infinite at a front, where the
            # depth is zero.
            middle = math.sqrt(depth * depth + pull * step * (width + 2 * depth) / width)
            after = math.sqrt(depth * depth + 2 * pull * step * (width + 2 * middle) / width)
            sum += 0.5 * (depth + after) * step * width
            depth = after
        return sum, depth

    if yield_stress == 0:
        return volume / (length * width), volume / (length * width), length
    if filled(0.0, length)[0] >= volume:
        reach = root(lambda x: filled(0.0, x)[0] - volume, 0.0, length)
        return filled(0.0, reach)[1], 0.0, reach
    far = root(lambda h: filled(h, length)[0] - volume, 0.0, volume / (length * width))
    return filled(far, length)[1], far, length


def box_slope(near: float, width: float) -> tuple[float, float]:
    """Return two integrals over the depth of concrete at rest in a long box, from 0 at its front to `near` [m].

    The integrals solve the equation of :func:`box_at_rest` (Roussel 2007). Let tau be the yield stress, rho the
    density, g the gravity, b the box's `width` [m], and A = 2 tau / (rho g b). The first integral [m] is A times the
    length that the concrete covers. The second integral [m2] is A / b times the volume of the concrete.
    """
    bent = 0.5 * width * math.log1p(2 * near / width)
    return near - bent, 0.5 * near * near - 0.5 * width * (near - bent)


def box_yield_stress(reach: float, volume: float, width: float, density: float, gravity: float = 9.81) -> float:
    """Return the yield stress [Pa] of concrete that came to rest in a long box before it reached the far end.

    The concrete covers a length of `reach` [m]; its `volume` is in m3. The function inverts :func:`box_at_rest`. The
    concrete sticks to floor and sides (Roussel 2007).
    """
    mean = volume / (width * reach)

    def too_deep(near: float) -> float:
        reach_a, volume_a = box_slope(near, width)
        return volume_a / reach_a - mean

    # The mean depth is between a half and two thirds of the depth at the near end. The depth at the near end is
    # therefore between 1.5 and 2 times the mean depth.
    near = root(too_deep, 1.5 * mean, 2 * mean)
    return 0.5 * density * gravity * width * box_slope(near, width)[0] / reach


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the zero of an increasing function between `low` and `high`, found by bisection."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) < 0 else (low, middle)
    return 0.5 * (low + high)


@functools.lru_cache(maxsize=4096)
def duct_constants(aspect: float) -> tuple[float, float]:
    """Return the constants a and b of a rectangular duct in the formula of Kozicki, Chou & Tiu (1966).

    The constants depend only on the shape; :func:`duct_stress` states the formula. `aspect` is the short side divided
    by the long side, 0 to 1. Values between the tabulated ratios are interpolated. A slot, the gap between two parallel
    plates, has a = 1/2 and b = 1.
    """
    ratio = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)
    a, b = (0.5, 0.4132, 0.3212, 0.2440, 0.2178, 0.2121), (1.0, 0.9085, 0.8182, 0.7278, 0.6831, 0.6771)
    return float(np.interp(aspect, ratio, a)), float(np.interp(aspect, ratio, b))


def duct_stress(
    speed: np.ndarray, wide: np.ndarray, deep: float, viscosity: float, yield_stress: float,
    layer: Sequence[float] | None = None, flow_index: float = 1.0, quadratic_viscosity: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the mean wall stress [Pa] of rectangular ducts at mean speeds [m/s], and their hydraulic radii [m].

    `speed` and the sides `wide` [m] are arrays of one shape; `deep` [m] is the other side of all ducts. `layer`
    describes a slip layer at the walls, whose slip velocity is added: its viscosity divided by its thickness [Pa s/m],
    its yield stress [Pa], and, for laws other than Bingham's, its flow index and its quadratic coefficient.

    The formula of Kozicki, Chou & Tiu is exact for round pipes and for the gap between two parallel plates. Let v be
    the mean speed, R the hydraulic radius, tau the wall stress, g(s) the shear rate at a stress s, and a and b two
    constants of the cross-section. The formula states that 2 v / R is tau^(-b/a) / a times the integral of s^(b/a - 1)
    g(s) ds up to tau. For Bingham's law with the yield stress tau0 and the plastic viscosity mu, this is tau / mu (1 /
    (a + b) - q / b + a q^(1 + b/a) / (b (a + b))), with q = tau0 / tau.
    """
    law = FlowLaw(yield_stress, viscosity, flow_index, quadratic_viscosity)
    radius = wide * deep / (2 * (wide + deep))
    a, b = np.array([duct_constants(min(w, deep) / max(w, deep)) for w in wide]).T
    goal, slip = 2 * speed / radius, None if layer is None else FlowLaw(layer[1], layer[0], *layer[2:])
    least = yield_stress if slip is None else min(yield_stress, slip.yield_stress)
    low, high = np.full_like(radius, least), 3 * law.stress((b + a / flow_index) * goal)
    while np.any(_duct_rate(high, a, b, law) < goal):
        high *= 2
    for _ in range(60):
        stress = 0.5 * (low + high)
        less = _duct_rate(stress, a, b, law) < goal - (0.0 if slip is None else 2 * slip.rate(stress) / radius)
        low, high = np.where(less, stress, low), np.where(less, high, stress)
    return 0.5 * (low + high), radius


def _duct_rate(stress: np.ndarray, a: np.ndarray, b: np.ndarray, law: FlowLaw) -> np.ndarray:
    """Return 2 v / R for a duct [1/s], with the mean speed v and the hydraulic radius R, at a mean wall `stress` [Pa].

    The function :func:`duct_stress` states the formula and its constants `a` and `b`.
    """
    if law.name == BINGHAM:
        q = np.minimum(law.yield_stress / stress, 1.0)
        return stress * (1 / (a + b) - q / b + a / (b * (a + b)) * q ** (1 + b / a)) / law.viscosity
    # Substitute stress = yield stress + (wall stress - yield stress) x^3, with x from 0 to 1. The integrand as a
    # function of x is smooth even at the yield stress, where the shear rate may have an infinite slope.
    x = 0.5 * (NODES + 1)
    over = np.maximum(stress - law.yield_stress, 0.0)[:, None]
    at = law.yield_stress + over * x**3
    relative = (at / stress[:, None]) ** (b / a - 1)[:, None]
    sum = np.sum(relative * law.rate(at) * over * 1.5 * x**2 * WEIGHTS, axis=1)
    return sum / (a * stress)


def funnel_time(
    half_widths: tuple[float, float], heights: tuple[float, float], depth: float, viscosity: float, yield_stress: float,
    density: float, gravity: float = 9.81, layer: Sequence[float] | None = None, flow_index: float = 1.0,
    quadratic_viscosity: float = 0.0,
) -> float:  # fmt: skip
    """Estimate the time in which a V-funnel empties [s]; infinite if the yield stress holds the concrete back.

    The funnel is modelled as a stack of slices, each with the friction of a duct, and a jet with inertia at the outlet.
    Stretching of the concrete in the taper is neglected. `half_widths` holds the half widths at the outlet and at the
    brim [m]. `heights` holds the heights of the straight outlet and of the whole funnel [m]. `layer` is a slip layer on
    all walls, as in :func:`duct_stress`; without it, concrete sticks to them. The result is the time until the surface
    of the concrete reaches the straight outlet. The concrete that is still in
    the outlet then falls out, although in the model the friction of its slices would stop it.
    """
    narrow, brim = half_widths
    throat, whole = heights
    place = (np.arange(SLICES_FUNNEL) + 0.5) * whole / SLICES_FUNNEL
    wide = 2 * np.where(place < throat, narrow, narrow + (brim - narrow) * (place - throat) / (whole - throat))
    step, outlet = whole / SLICES_FUNNEL, 2 * narrow * depth
    area = wide * depth
    speeds = np.geomspace(1e-6, math.sqrt(2 * gravity * whole), SPEEDS)
    # For each outlet speed and each height of the concrete's surface in the funnel, compute the pressure of the weight
    # above the outlet, minus the losses by friction and inertia [Pa]. The outlet speed is the one for which the
    # difference is zero.
    left = []
    for speed in speeds:
        stress, radius = duct_stress(
            speed * outlet / area, wide, depth, viscosity, yield_stress, layer, flow_index, quadratic_viscosity
        )
        used = np.cumsum(stress / radius) * step + 0.5 * density * speed**2
        left.append(density * gravity * step * np.arange(1, SLICES_FUNNEL + 1) - used)
    time = 0.0
    for level in range(int(SLICES_FUNNEL * throat / whole), SLICES_FUNNEL):
        surplus = np.array([row[level] for row in left])
        if surplus[0] <= 0:
            return math.inf
        speed = float(np.interp(0.0, -surplus, speeds))
        time += area[level] * step / (outlet * speed)
    return time
