"""Herschel-Bulkley and modified Bingham laws: closed forms against integrals, limits, and what is refused."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad

from warpcrete.core.errors import SceneError
from warpcrete.theory.laws import BINGHAM, FlowLaw
from warpcrete.theory.pipe import (
    CONCRETES,
    FORMS,
    Concrete,
    Line,
    flow_of_pressure,
    kaplan,
    measured_layer,
    steady,
    velocity,
)
from warpcrete.theory.pipe_table import table
from warpcrete.theory.segregated import Segregated
from warpcrete.theory.suspension import SUSPENSIONS, mortar_of, power_thickening, thickening
from warpcrete.theory.vessels import duct_stress, funnel_time

LAWS = {f"n={n}": {"index": n} for n in (0.3, 0.5, 0.8, 1.3, 1.6, 2.5)} | {
    f"c={c}": {"quadratic": c} for c in (1e-6, 0.5, 20.0)
}
LINE, FLOW = Line(), 1500e-6
SCC = Concrete(density=2350, viscosity=30, yield_stress=40, slip_viscosity=800, slip_yield=20)
OTHERS = {
    "thins": {"flow_index": 0.6}, "thickens": {"flow_index": 1.4}, "squared": {"quadratic_viscosity": 2.0},
    "layer thins": {"slip_flow_index": 0.7}, "layer thickens": {"slip_flow_index": 1.5},
    "layer squared": {"slip_quadratic_viscosity": 900.0},
    "both": {"flow_index": 1.3, "slip_quadratic_viscosity": 500.0},
}  # fmt: skip


@pytest.mark.parametrize("yield_stress", [0.0, 40.0])
@pytest.mark.parametrize("stress", [45.0, 300.0])
@pytest.mark.parametrize("law", LAWS)
def test_mean_velocity_is_the_integral_over_the_stress(law, stress, yield_stress):
    law, radius = FlowLaw(yield_stress, 30.0, **LAWS[law]), 0.05
    for form, power in (("pipe", 2), ("plane", 1)):
        integral, _ = quad(lambda s, p=power: s**p * float(law.rate(s)), yield_stress, stress, epsrel=1e-12, limit=200)
        found = law.mean_velocity(stress, radius, form)
        assert found == pytest.approx(radius * integral / stress ** (power + 1), rel=1e-10)


@pytest.mark.parametrize("index", [0.5, 0.8, 1.3, 1.6])
def test_published_closed_forms_of_the_herschel_bulkley_law(index):
    """In terms of m = 1/n and x = yield stress over wall stress, as textbooks print them."""
    yields, k, stress, radius, m = 40.0, 30.0, 300.0, 0.05, 1 / index
    x, law = yields / stress, FlowLaw(40.0, 30.0, index)
    base = radius * (stress / k) ** m * (1 - x) ** (m + 1)
    pipe = base * ((1 - x) ** 2 / (m + 3) + 2 * x * (1 - x) / (m + 2) + x**2 / (m + 1))
    assert law.mean_velocity(stress, radius, "pipe") == pytest.approx(pipe, rel=1e-13)
    plane = base * ((1 - x) / (m + 2) + x / (m + 1))
    assert law.mean_velocity(stress, radius, "plane") == pytest.approx(plane, rel=1e-13)


@pytest.mark.parametrize("law", LAWS)
def test_rate_is_the_inverse_of_the_stress(law):
    law, rates = FlowLaw(40.0, 30.0, **LAWS[law]), np.array([0.0, 1e-2, 1.0, 1e3])
    assert law.rate(law.stress(rates)) == pytest.approx(rates, rel=1e-7)
    assert law.rate([0.0, 39.0, 40.0]) == pytest.approx([0.0, 0.0, 0.0], abs=0)


def test_both_laws_become_bingham():
    plain = FlowLaw(40.0, 30.0)
    for near in (FlowLaw(40.0, 30.0, 1 + 1e-9), FlowLaw(40.0, 30.0, 1.0, 1e-9)):
        assert near.name != BINGHAM
        for form in ("pipe", "plane"):
            assert near.mean_velocity(300.0, 0.05, form) == pytest.approx(plain.mean_velocity(300.0, 0.05, form))
    assert dataclasses.replace(SCC, flow_index=1, quadratic_viscosity=0) == SCC and SCC.bulk_law.name == BINGHAM


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("thickness", [0.0, 4e-3])
@pytest.mark.parametrize("name", OTHERS)
def test_flow_is_the_integral_of_the_profile(name, thickness, form):
    concrete, line = dataclasses.replace(SCC, **OTHERS[name]), Line(slip_thickness=thickness)
    state = steady(concrete, line, FLOW, form)
    assert state.flow == pytest.approx(FLOW, rel=1e-12)
    assert concrete.layer_law.stress(state.slip_velocity) == pytest.approx(state.wall_stress, rel=1e-12)
    inner = line.radius - thickness
    r = (np.arange(200_000) + 0.5) / 200_000 * inner
    above = velocity(concrete, line, state, r) - state.slip_velocity
    weight = np.ones_like(r) / line.radius if form == "plane" else 2 * r / line.radius**2
    mean = state.slip_velocity + float(np.sum(above * weight)) * inner / len(r)
    assert np.pi * line.radius**2 * mean == pytest.approx(FLOW, rel=1e-8)
    assert flow_of_pressure(concrete, line, state.pressure, form).flow == pytest.approx(FLOW, rel=1e-9)


@pytest.mark.parametrize("name", OTHERS)
def test_profile_obeys_the_law(name):
    concrete = dataclasses.replace(SCC, **OTHERS[name])
    state = steady(concrete, LINE, FLOW)
    r = np.linspace(state.plug_radius, LINE.radius, 7)[1:-1]
    slope = (velocity(concrete, LINE, state, r - 1e-6) - velocity(concrete, LINE, state, r + 1e-6)) / 2e-6
    assert concrete.bulk_law.stress(slope) == pytest.approx(state.wall_stress * r / LINE.radius, rel=1e-6)


def test_a_layer_that_is_not_linear_is_found_from_points_of_a_pipe():
    for name in ("layer thins", "layer thickens", "layer squared", "both"):
        concrete = dataclasses.replace(SCC, **OTHERS[name])
        flows = [0.5e-3, 1e-3, 3e-3, 5e-3]
        pressures = [steady(concrete, LINE, flow).pressure for flow in flows]
        found = measured_layer(concrete, LINE, flows, pressures)
        assert (found.slope, found.offset) == pytest.approx((800.0, 20.0), rel=1e-8)


def test_mortar_of_a_concrete_with_another_law():
    """Mortar between aggregates is sheared faster than the whole, so that the factor depends on the flow index."""
    for name in ("thins", "thickens", "squared"):
        concrete = dataclasses.replace(SCC, **OTHERS[name])
        mortar, rate = mortar_of(concrete, 0.36, 2630.0), 5.0
        factor, yields = thickening(0.36, *SUSPENSIONS["spheres"])
        faster = np.sqrt(factor / 0.64)
        flows = mortar.bulk_law.stress(faster * rate) - mortar.yield_stress
        assert concrete.bulk_law.stress(rate) == pytest.approx(
            yields * mortar.yield_stress + factor * flows / faster, rel=1e-12
        )
        assert mortar.slip_viscosity == concrete.slip_viscosity and mortar.flow_index == concrete.flow_index
    assert power_thickening(7.0, 0.36, 1.0) == 7.0


@pytest.mark.parametrize("name", OTHERS)
def test_even_aggregate_does_not_change_the_flow(name):
    concrete = dataclasses.replace(SCC, **OTHERS[name])
    even = Segregated(concrete, LINE, 0.36, 0.0).steady(FLOW)
    assert even.pressure == pytest.approx(steady(concrete, LINE, FLOW).pressure, rel=1e-10)
    inward = Segregated(concrete, LINE, 0.36, -0.2).steady(FLOW)
    assert inward.wall_stress < even.wall_stress


@pytest.mark.parametrize("law", [{"flow_index": 0.6}, {"flow_index": 1.5}, {"quadratic_viscosity": 3.0}])
def test_slots_and_ducts(law):
    """A slot is a channel between planes; with n near 1, other ducts have the form of Bingham's law."""
    own = FlowLaw(40.0, 30.0, law.get("flow_index", 1.0), law.get("quadratic_viscosity", 0.0))
    stress, radius = duct_stress(np.array([0.1]), np.array([1e6]), 0.02, 30.0, 40.0, **law)
    assert radius[0] == pytest.approx(0.01, rel=1e-6)
    assert own.mean_velocity(stress[0], 0.01, "plane") == pytest.approx(0.1, rel=1e-6)
    near, _ = duct_stress(np.array([0.3]), np.array([0.065]), 0.075, 30.0, 40.0, flow_index=1 + 1e-9)
    plain, _ = duct_stress(np.array([0.3]), np.array([0.065]), 0.075, 30.0, 40.0)
    assert near == pytest.approx(plain, rel=1e-6)
    funnel = (0.0325, 0.2575), (0.15, 0.60), 0.075, 30.0, 20.0, 2300.0
    assert funnel_time(*funnel, **law) != pytest.approx(funnel_time(*funnel), rel=0.05)


def test_what_is_refused():
    for given, text in (
        ({"flow_index": 1.2, "quadratic_viscosity": 1.0}, "flow_index = 1.2: cannot be combined with quadratic_visc"),
        ({"slip_flow_index": 0.8, "slip_quadratic_viscosity": 1.0}, "slip_flow_index = 0.8: cannot be combined"),
        ({"flow_index": 0.0}, "flow_index = 0.0: must be a finite number above 0"),
        ({"quadratic_viscosity": -1.0}, "quadratic_viscosity = -1.0: must be finite and at least 0"),
        ({"slip_flow_index": float("nan")}, "slip_flow_index = nan"),
    ):
        with pytest.raises(SceneError, match=text):
            dataclasses.replace(SCC, **given)
    for name in ("thins", "layer squared"):
        with pytest.raises(SceneError, match="Kaplan's model"):
            kaplan(dataclasses.replace(SCC, **OTHERS[name]), LINE, FLOW)
    assert "kaplan" in table(CONCRETES["no1"], LINE, [FLOW])
    words = table(dataclasses.replace(SCC, **OTHERS["both"]), LINE, [FLOW])
    assert "kaplan" not in words and "flow index 1.3" in words and "quadratic 500" in words
