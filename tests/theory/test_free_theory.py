"""Closed forms of slump, spread, heaps, funnels and boxes."""

import math

import numpy as np
import pytest

from warpcrete.theory.vessels import (
    HEAPS,
    box_at_rest,
    box_slope,
    box_yield_stress,
    cone_volume,
    duct_stress,
    funnel_time,
    heap_at_rest,
    heap_depth,
    long_heap_spread,
    tall_cone_slump,
    viscous_front,
)


def test_a_long_heap_holds_the_volume_under_its_parabola():
    """h^2 = 2 tau (R - r) / (rho g), turned about the axis."""
    volume, tau, rho = 5.5e-3, 50.0, 2300.0
    radius = long_heap_spread(volume, tau, rho) / 2
    r = (np.arange(200000) + 0.5) * radius / 200000
    height = np.sqrt(2 * tau * (radius - r) / (rho * 9.81))
    assert np.sum(2 * np.pi * r * height) * radius / 200000 == pytest.approx(volume, rel=1e-5)


def test_a_tall_cylinder_slumps_as_murata_has_it():
    """s / H = 1 - 2 t (1 - ln 2 t), t = tau / (rho g H) (Pashias et al. 1996), and not at all above half the weight."""
    for t in (0.05, 0.2, 0.4):
        found = tall_cone_slump(0.1, 0.1, 0.3, t * 2000 * 9.81 * 0.3, 2000.0, bears=2)
        assert found / 0.3 == pytest.approx(1 - 2 * t * (1 - math.log(2 * t)), abs=1e-6)
    assert tall_cone_slump(0.1, 0.1, 0.3, 0.51 * 2000 * 9.81 * 0.3, 2000.0, bears=2) == 0


@pytest.mark.parametrize("form", ["plane", "axial"])
def test_a_heap_is_borne_by_the_plate_and_by_its_stretch(form):
    """The slope of its depth, from its weight, what the plate bears, and what resists the stretch, by differences."""
    tau, rho, g = 50.0, 2300.0, 9.81
    inward = np.linspace(0.0, 0.3, 100001)
    depth = heap_depth(inward, tau, rho, g, form)
    stretch = {"plane": 2.0, "axial": math.sqrt(3)}[form] * math.pi / 4 * tau
    change = np.gradient(0.5 * rho * g * depth**2 - stretch * depth, inward)
    assert change[1:-1] == pytest.approx(np.full(len(inward) - 2, tau), rel=1e-6)
    assert depth[0] == pytest.approx(2 * HEAPS[form] * tau / (rho * g))


def test_a_heap_holds_its_volume_and_becomes_the_long_one():
    volume, rho = cone_volume(0.05, 0.1, 0.3), 2300.0
    reach, depth = heap_at_rest(volume, 50.0, rho)
    r = (np.arange(200000) + 0.5) * reach / 200000
    assert np.sum(2 * np.pi * r * heap_depth(reach - r, 50.0, rho)) * reach / 200000 == pytest.approx(volume, rel=1e-5)
    assert (2 * reach, depth) == pytest.approx((0.5621, 0.0384), rel=2e-3)
    flat, _ = heap_at_rest(0.01, 50.0, 2000.0, form="plane")
    x = (np.arange(200000) + 0.5) * flat / 200000
    assert np.mean(heap_depth(flat - x, 50.0, 2000.0, form="plane")) * flat == pytest.approx(0.01, rel=1e-5)
    off = [2 * heap_at_rest(volume, tau, rho)[0] / long_heap_spread(volume, tau, rho) - 1 for tau in (50.0, 5.0, 0.05)]
    assert np.all(np.array(off) < 0) and np.all(np.diff(off) > 0) and abs(off[2]) < 2e-3


def test_a_viscous_front_is_that_of_huppert_s_similar_shape():
    """h = V / x_N (1 - y^2)^(1/3) over its mean runs as its slope drives it: rho g h^3 / (3 mu) dh/dx, at y = 0.5."""
    volume, viscosity, rho, g, y, little = 0.01, 10.0, 2000.0, 9.81, 0.5, 1e-4
    shape = lambda s: (1 - s * s) ** (1 / 3)  # noqa: E731
    mean = float(np.mean(shape((np.arange(400000) + 0.5) / 400000)))
    front = viscous_front(volume, viscosity, rho, 4.0)
    speed = (viscous_front(volume, viscosity, rho, 4.0 + little) - front) / little
    depth = volume / front / mean * shape(y)
    slope = volume / front / mean * (shape(y + little) - shape(y - little)) / (2 * little * front)
    # Every place goes at y times the front's speed, and that is its mean over the depth.
    assert -rho * g * depth**2 * slope / (3 * viscosity) == pytest.approx(y * speed, rel=2e-3)


def test_ducts_between_the_known_ones():
    """A slot and a square: Newton's resistance, and Bingham's in the slot."""
    wide = np.array([1.0])
    newton, radius = duct_stress(np.array([0.1]), wide, 1.0, 20.0, 0.0)
    assert newton / radius == pytest.approx(28.454 * 20 * 0.1, rel=1e-4)  # of a square of 1 m (Shah & London 1978)
    stress, radius = duct_stress(np.array([0.1]), np.array([1e6]), 0.02, 20.0, 50.0)
    q = 50.0 / stress
    assert 0.01 * stress / (3 * 20.0) * (1 - 1.5 * q + 0.5 * q**3) == pytest.approx(0.1, rel=1e-7)


def test_a_straight_funnel_empties_as_a_duct_does():
    """Weight over resistance is the same at any level: the speed is one, but for inertia."""
    time = funnel_time((0.03, 0.03), (0.0, 0.6), 0.06, 500.0, 0.0, 2300.0)
    speed = 2300 * 9.81 * 0.06**2 / (28.454 * 500.0)
    assert time == pytest.approx(0.6 / speed, rel=2e-4)
    assert math.isinf(funnel_time((0.03, 0.03), (0.0, 0.6), 0.06, 20.0, 500.0, 2300.0))


def test_a_slip_layer_adds_its_velocity_to_that_of_a_duct():
    """The wall stress of sticking concrete at 0.1 m/s also drives the layer: both velocities add up."""
    wide, layer = np.array([0.065]), (700.0, 20.0)
    stress, radius = duct_stress(np.array([0.1]), wide, 0.075, 40.0, 30.0)
    faster = 0.1 + (stress - layer[1]) / layer[0]
    again, same = duct_stress(faster, wide, 0.075, 40.0, 30.0, layer)
    assert again == pytest.approx(stress, rel=1e-9) and same == radius
    plug, _ = duct_stress(np.array([0.01]), wide, 0.075, 40.0, 300.0, layer)
    assert plug == pytest.approx(20 + 7.0, rel=1e-9)
    sticks = funnel_time((0.0325, 0.2575), (0.15, 0.6), 0.075, 50.0, 30.0, 2300.0)
    stiff = funnel_time((0.0325, 0.2575), (0.15, 0.6), 0.075, 50.0, 30.0, 2300.0, layer=(1e12, 0.0))
    slips = funnel_time((0.0325, 0.2575), (0.15, 0.6), 0.075, 50.0, 30.0, 2300.0, layer=(900.0, 10.0))
    assert stiff == pytest.approx(sticks, rel=1e-6) and 0.1 * sticks < slips < 0.25 * sticks


def test_a_funnel_of_a_thin_fluid_empties_as_torricelli_has_it():
    """The jet has the speed sqrt(2 g h) of the height h above the outlet, in a tapered funnel."""
    narrow, brim, throat, whole = 0.03, 0.25, 0.15, 0.6
    time = funnel_time((narrow, brim), (throat, whole), 0.06, 1e-6, 0.0, 2300.0)
    step = whole / 60  # The estimate sums over slices and takes the height at the top of each.
    top = step * np.arange(1 + round(throat / step), 61)
    wide = narrow + (brim - narrow) * (top - 0.5 * step - throat) / (whole - throat)
    assert time == pytest.approx(np.sum(wide / narrow * step / np.sqrt(2 * 9.81 * top)), rel=5e-3)


@pytest.mark.parametrize(("tau", "reaches"), [(50.0, True), (300.0, False)])
def test_a_box_at_rest_holds_the_volume_and_bears_its_slope(tau, reaches):
    near, far, reach = box_at_rest(0.012, 0.7, 0.2, tau, 2300.0)
    assert (far > 0) == reaches and (reach == 0.7) == reaches
    x = np.linspace(0, reach, 20001)
    depth = np.empty_like(x)
    depth[-1] = max(far, 1e-6)
    for n in range(len(x) - 1, 0, -1):
        slope = tau * (0.2 + 2 * depth[n]) / (2300 * 9.81 * 0.2 * depth[n])
        depth[n - 1] = depth[n] + min(slope * (x[1] - x[0]), 1e-3)
    assert depth[0] == pytest.approx(near, rel=5e-4)
    assert np.trapezoid(depth, x) * 0.2 == pytest.approx(0.012, rel=1e-3)


@pytest.mark.parametrize("tau", [20.0, 100.0, 400.0])
def test_a_long_box_tells_its_yield_stress(tau):
    """L = h0 / A + b / (2 A) ln(b / (b + 2 h0)) with A = 2 tau / (rho g b), as Roussel (2007) prints it."""
    volume, width, rho, g = 0.006, 0.2, 2300.0, 9.81
    near, _, reach = box_at_rest(volume, 1.2, width, tau, rho)
    a = 2 * tau / (rho * g * width)
    assert near / a + width / (2 * a) * math.log(width / (width + 2 * near)) == pytest.approx(reach, rel=1e-4)
    assert width / a * box_slope(near, width)[1] == pytest.approx(volume, rel=1e-4)
    assert box_yield_stress(reach, volume, width, rho) == pytest.approx(tau, rel=1e-4)
    # In a wide box only the floor holds the concrete: tau = rho g h0^2 / (2 L), and h0 is 3/2 of the mean depth.
    wide, mean = 1e3, volume / (width * reach)
    found = box_yield_stress(reach, mean * wide * reach, wide, rho)
    assert found == pytest.approx(rho * g * (1.5 * mean) ** 2 / (2 * reach), rel=1e-3)
