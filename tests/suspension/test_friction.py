"""Friction between aggregates in a mortar, and between aggregates and walls."""

import numpy as np
import pytest

from warpcrete.mps.grid.geometry import ROUGH
from warpcrete.mps.grid.layout import Motion
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.suspension.balance import step_with_balance
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow
from warpcrete.verification.suspensions_friction import FLOOR, LEVER, PRESS, TOUCHING, WIDTH, motion, pushed
from warpcrete.verification.suspensions_many import suspension

pytestmark = pytest.mark.thorough


def test_friction_turns_a_sphere_the_other_way(device):
    """A sphere that is pushed along a floor rolls; without friction, the mortar at the floor turns it backwards."""
    assert motion(pushed(0.0, 0.2 * PRESS, 0.0, device, "float64", steps=4))[1] < 0
    assert motion(pushed(0.3, 0.2 * PRESS, 0.0, device, "float64", steps=4))[1] > 0


def test_a_moving_wall_drags_a_sphere_along(device):
    """A sphere that is pressed onto a moving floor moves and turns with it, because both touch without sliding."""
    sphere = Aggregates(np.array([[0.0, 0.0, FLOOR + RADIUS + TOUCHING]]), np.array([RADIUS]), DENSITY)
    found = []
    for friction in (0.0, 0.5):
        flow = mortar_flow(
            (16, 12, 12), WIDTH, sphere, device, "float64", friction=friction, time_step=0.02, speed=1e-3,
            walls=[(lambda x: x[:, 2] - FLOOR, ROUGH + 1)], motions=(Motion((1e-3, 0.0, 0.0)),),
        )  # fmt: skip
        flow.aggregates.bodies.force.assign(np.array([[0.0, 0.0, -PRESS]]))
        flow.take(15)
        velocity, spin = motion(flow)
        found.append(abs(1e-3 - (velocity - spin * LEVER)))
    assert found[1] < 0.02e-3 < found[0]


def crowd(device, precision="float64", **given):
    return suspension(0.35, 0, device, precision, wide=4, long=4, rate=1.0, strain=0.05, extra_density=400.0,
                      friction=0.5, **given)  # fmt: skip


def test_power_and_momentum_are_balanced_with_friction(device):
    flow, gripped = crowd(device, coupled=1e-9), 0
    for _ in range(4):
        balance = step_with_balance(flow)
        gripped += int((flow.aggregates.pairs.grip.numpy() > 0).sum())
        assert abs(balance.error) < 1e-7
        assert abs(balance.momentum - balance.impulse) < 1e-7 * balance.impulse_scale
    assert gripped > 0


def test_friction_resumes_with_the_same_bits(device):
    flow = crowd(device, "float32")
    flow.take(3)
    kept = flow.state_dict()
    assert len(kept["arrays"]["aggregate_last_force"]) == kept["arrays"]["aggregate_last_count"].sum() > 0
    again = crowd(device, "float32")
    again.load_state_dict(kept)
    for each in (flow, again):
        each.take(2)
    for name in ("centre", "velocity", "spin", "turn"):
        first, second = (getattr(each.aggregates.bodies, name).numpy() for each in (flow, again))
        assert np.array_equal(first, second)
