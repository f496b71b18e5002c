"""Closed forms and estimates of standard tests: slump, spread, L-box, V-funnel.

A long heap rests where the weight of its slope is borne by the plate (Roussel & Coussot 2005), and sooner, by the next
order of shallow theory, as it resists its stretch too (in a plane Dubash, Balmforth, Slim & Cochard 2009; about an axis
here); a tall one where each layer has grown wide enough to bear what is above it (Murata 1984; for cones Schowalter &
Christensen 1998). Murata's concrete yields where the largest shear stress is the yield stress, half of what presses
(Tresca); a Bingham fluid in three dimensions does where the invariant of all stresses is (von Mises), at the root of a
third of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

LAYERS = 4000
"""Into which a cone is cut for the sum over its height."""
SLICES, SLICES_FUNNEL, SPEEDS = 400, 60, 120
"""Into which a box is cut along its length, and a funnel along its height; speeds that are tried for each level."""


def cone_volume(top: float, base: float, height: float) -> float:
    """Of a truncated cone of these radii [m3]."""
    return math.pi * height / 3 * (top * top + top * base + base * base)


def long_heap_spread(volume: float, yield_stress: float, density: float, gravity: float = 9.81) -> float:
    """Diameter of a heap much wider than high [m]: tau = 225 rho g V^2 / (128 pi^2 R^5) (Roussel & Coussot 2005)."""
    return 2 * (225 * density * gravity * volume**2 / (128 * math.pi**2 * yield_stress)) ** 0.2


HEAPS = {"plane": math.pi / 2, "axial": math.sqrt(3) * math.pi / 4}
"""What resists the stretch of a heap that has just stopped, over yield stress and depth: normal stress along the slope
less that across, on top of what weight makes of both, summed over the depth.

Shear takes tau (1 - z / h) at the height z, the stretch what is left of the yield stress, the root of tau^2 - shear^2,
whose mean over the depth is pi / 4 tau: twice that in a plane, where the normal stresses are s and -s; the root of 3 of
it about the axis, where a heap that keeps its shape has s along the radius and around, -2 s upwards, and
3 s^2 + shear^2 = tau^2.
"""


def heap_depth(
    inward: np.ndarray, yield_stress: float, density: float, gravity: float = 9.81, form: str = "axial"
) -> np.ndarray:
    """Depth of a heap at rest at a distance inward from its front [m]: rho g h^2 / 2 = tau (inward + HEAPS h).

    Weight presses outward, the plate holds with tau over the distance, the stretch with HEAPS tau on the section. The
    long heap is that without the last. `form` is "plane" or "axial".
    """
    bears = yield_stress / (density * gravity)
    front = HEAPS[form] * bears
    return front + np.sqrt(front * front + 2 * bears * np.asarray(inward))


def heap_at_rest(
    volume: float, yield_stress: float, density: float, gravity: float = 9.81, form: str = "axial"
) -> tuple[float, float]:
    """Reach from the middle and depth there [m] of a wide heap that resists its stretch, inertia aside.

    `volume` of the whole about an axis [m3], of one half by the metre in a plane [m2]. For heaps wider than high.
    """
    widest = 1.0
    while heap_volume(widest, yield_stress, density, gravity, form) < volume:
        widest *= 2
    reach = root(lambda x: heap_volume(x, yield_stress, density, gravity, form) - volume, 0.0, widest)
    return reach, float(heap_depth(np.array(reach), yield_stress, density, gravity, form))


def heap_volume(reach: float, yield_stress: float, density: float, gravity: float = 9.81, form: str = "axial") -> float:
    """What :func:`heap_at_rest` holds that reaches so far [m3, or m2 of one half in a plane]."""
    place = (np.arange(LAYERS) + 0.5) * reach / LAYERS
    depth = heap_depth(reach - place, yield_stress, density, gravity, form)
    return float(np.sum(depth * (2 * math.pi * place if form == "axial" else 1.0)) * reach / LAYERS)


def viscous_front(volume: float, viscosity: float, density: float, time: float, gravity: float = 9.81) -> float:
    """How far a fluid without yield stress has come on a plate it sticks to [m], long after `volume` [m2] was let go:
    1.411 (g V^3 / (3 nu))^(1/5) t^(1/5) (Huppert 1982), in a plane, to one side.
    """
    return 1.411 * (density * gravity * volume**3 * time / (3 * viscosity)) ** 0.2


def tall_cone_slump(
    top: float, base: float, height: float, yield_stress: float, density: float, gravity: float = 9.81,
    bears: float = math.sqrt(3),
) -> float:  # fmt: skip
    """Fall of the top of a truncated cone [m], each layer of which widens until it bears what is above it.

    A layer bears a pressure of `bears` yield stresses: the root of 3 by von Mises, 2 by Tresca as Murata 1984 has it.
    """
    depth = (np.arange(LAYERS) + 0.5) * height / LAYERS
    radius = top + (base - top) * depth / height
    area = math.pi * radius**2
    load = density * gravity * math.pi * depth / 3 * (top * top + top * radius + radius * radius)
    stays = np.minimum(1.0, bears * yield_stress * area / load)  # of the layer's height
    return float(np.sum(1 - stays) * height / LAYERS)


def box_at_rest(
    volume: float, length: float, width: float, yield_stress: float, density: float, gravity: float = 9.81
) -> tuple[float, float, float]:
    """Depths at both ends of a box whose floor and sides concrete sticks to, and how far it has come [m].

    What comes in at one end without inertia rests where floor and sides bear its slope: h' = tau (b + 2 h) / (rho g b
    h), integrated from the far end, or from the front where it does not come so far (Nguyen, Roussel & Coussot 2006).
    """
    pull = yield_stress / (density * gravity)

    def filled(far: float, reach: float) -> tuple[float, float]:
        """Volume, and depth at the near end."""
        step, depth, sum = reach / SLICES, far, 0.0
        for _ in range(SLICES):
            # In h squared, whose slope is finite at a front.
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


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function that grows is none."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) < 0 else (low, middle)
    return 0.5 * (low + high)


def duct_constants(aspect: float) -> tuple[float, float]:
    """Constants a and b of a rectangular duct of sides in this ratio, 0 to 1, between those of Kozicki, Chou & Tiu
    1966: a and b of a slot are 1/2 and 1.
    """
    ratio = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)
    a, b = (0.5, 0.4132, 0.3212, 0.2440, 0.2178, 0.2121), (1.0, 0.9085, 0.8182, 0.7278, 0.6831, 0.6771)
    return float(np.interp(aspect, ratio, a)), float(np.interp(aspect, ratio, b))


def duct_stress(
    speed: np.ndarray, wide: np.ndarray, deep: float, viscosity: float, yield_stress: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean stress of the walls of a rectangular duct at a mean speed [Pa], and hydraulic radius [m], shape as `wide`.

    2 v / R = tau / mu (1 / (a + b) - q / b + a q^(1 + b/a) / (b (a + b))), q = tau0 / tau: Bingham's law in Kozicki,
    Chou & Tiu's form, which is exact in slots and pipes.
    """
    radius = wide * deep / (2 * (wide + deep))
    a, b = np.array([duct_constants(min(w, deep) / max(w, deep)) for w in wide]).T
    goal = 2 * speed * viscosity / radius
    low, high = np.full_like(radius, yield_stress), 3 * yield_stress + 3 * (a + b) * goal
    for _ in range(60):
        stress = 0.5 * (low + high)
        q = np.minimum(yield_stress / stress, 1.0)
        less = stress * (1 / (a + b) - q / b + a / (b * (a + b)) * q ** (1 + b / a)) < goal
        low, high = np.where(less, stress, low), np.where(less, high, stress)
    return 0.5 * (low + high), radius


def funnel_time(
    half_widths: tuple[float, float], heights: tuple[float, float], depth: float, viscosity: float, yield_stress: float,
    density: float, gravity: float = 9.81,
) -> float:  # fmt: skip
    """Time in which a funnel empties [s]: its slices as ducts one below the other, and the jet's inertia; infinite if
    the yield stress holds it.

    `half_widths` at the outlet and at the brim, `heights` of the straight outlet and of the whole [m]. An estimate:
    stretch in the taper is left out, and the last of it, which the slices would hold, is told of its fall from above.
    """
    narrow, brim = half_widths
    throat, whole = heights
    place = (np.arange(SLICES_FUNNEL) + 0.5) * whole / SLICES_FUNNEL
    wide = 2 * np.where(place < throat, narrow, narrow + (brim - narrow) * (place - throat) / (whole - throat))
    step, outlet = whole / SLICES_FUNNEL, 2 * narrow * depth
    area = wide * depth
    speeds = np.geomspace(1e-6, math.sqrt(2 * gravity * whole), SPEEDS)
    # What is left of the weight above the outlet, for each speed there and each level of the concrete.
    left = []
    for speed in speeds:
        stress, radius = duct_stress(speed * outlet / area, wide, depth, viscosity, yield_stress)
        taken = np.cumsum(stress / radius) * step + 0.5 * density * speed**2
        left.append(density * gravity * step * np.arange(1, SLICES_FUNNEL + 1) - taken)
    time = 0.0
    for level in range(int(SLICES_FUNNEL * throat / whole), SLICES_FUNNEL):
        surplus = np.array([row[level] for row in left])
        if surplus[0] <= 0:
            return math.inf
        speed = float(np.interp(0.0, -surplus, speeds))
        time += area[level] * step / (outlet * speed)
    return time
