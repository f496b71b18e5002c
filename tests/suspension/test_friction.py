"""Friction between aggregates in a mortar, and between aggregates and walls."""

import numpy as np
import pytest

from warpcrete.mps.grid.geometry import ROUGH
from warpcrete.mps.grid.layout import Motion
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.suspension.balance import step_with_balance
from warpcrete.suspension.solve import Tolerances
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow
from warpcrete.verification.suspensions_many import suspension

pytestmark = pytest.mark.thorough
WIDTH, STEP = RADIUS / 2, 0.02
FLOOR = -6 * WIDTH
TOUCHING = 0.00997 * RADIUS
"""Gap to the floor at which a sphere touches it."""
PRESS = 0.02
"""Force that presses the sphere onto the floor [N]."""
LEVER = 1.005 * RADIUS
"""Distance of the centre from the point at which friction acts: half of the gap beyond the surface [m]."""


def pushed(device, friction, force, torque=0.0, steps=20):
    """Push a sphere along the floor, and return its flow afterwards."""
    sphere = Aggregates(np.array([[0.0, 0.0, FLOOR + RADIUS + TOUCHING]]), np.array([RADIUS]), DENSITY)
    flow = mortar_flow((16, 12, 12), WIDTH, sphere, device, "float64", friction=friction, time_step=STEP,
                       tolerances=Tolerances(coupled=1e-6))  # fmt: skip
    flow.aggregates.bodies.force.assign(np.array([[force, 0.0, -PRESS]]))
    flow.aggregates.bodies.torque.assign(np.array([[0.0, torque, 0.0]]))
    flow.take(steps)
    return flow


def motion(flow):
    """Return velocity and spin of a sphere that is pushed along the first axis."""
    bodies = flow.aggregates.bodies
    return float(bodies.velocity.numpy()[0, 0]), float(bodies.spin.numpy()[0, 1])


def test_a_sphere_that_is_pushed_weakly_rolls(device):
    """Below the limit of friction a sphere rolls along the floor: the point of contact rests."""
    velocity, spin = motion(pushed(device, 0.3, 0.2 * PRESS))
    assert velocity > 0 and abs(velocity - spin * LEVER) < 0.01 * velocity
    # Without friction, the mortar between sphere and floor turns it the other way.
    assert motion(pushed(device, 0.0, 0.2 * PRESS))[1] < 0


def test_a_sphere_that_is_pushed_strongly_slides(device):
    """Sliding friction acts like the force mu N and its torque, because the flow of the mortar is linear."""
    flow, friction = pushed(device, 0.3, PRESS, steps=25), 0.3
    pairs, (velocity, spin) = flow.aggregates.pairs, motion(flow)
    normal = float(pairs.last_force.numpy()[0])
    assert normal == pytest.approx(PRESS, rel=0.03)
    slides = velocity - spin * LEVER
    assert float(pairs.grip.numpy()[0]) * slides == pytest.approx(friction * normal, rel=0.01)
    without = pushed(device, 0.0, PRESS - friction * normal, friction * normal * LEVER, steps=25)
    # Both spheres have moved by different parts of a cell, which changes their spin by up to 1.8 %.
    assert motion(flow) == pytest.approx(motion(without), rel=0.025)


def test_a_moving_wall_drags_a_sphere_along(device):
    """A sphere that is pressed onto a moving floor moves and turns with it, because both touch without sliding."""
    sphere = Aggregates(np.array([[0.0, 0.0, FLOOR + RADIUS + TOUCHING]]), np.array([RADIUS]), DENSITY)
    found = []
    for friction in (0.0, 0.5):
        flow = mortar_flow(
            (16, 12, 12), WIDTH, sphere, device, "float64", friction=friction, time_step=STEP, speed=1e-3,
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
