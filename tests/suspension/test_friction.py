"""Friction between aggregates in a mortar, and between aggregates and walls."""

import numpy as np
import pytest

from warpcrete.kernels.suspension.pairs import CAPACITY, WALL
from warpcrete.mps.grid.geometry import MIRROR, ROUGH
from warpcrete.mps.grid.geometry import WALL as WALL_SIDE
from warpcrete.mps.grid.layout import Motion
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.suspension.balance import step_with_balance
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow
from warpcrete.verification.suspensions_friction import FLOOR, LEVER, PRESS, TOUCHING, WIDTH, motion, pushed
from warpcrete.verification.suspensions_many import suspension


def test_walls_resist_sliding_by_mu_n_and_planes_of_symmetry_do_not(device):
    """Six spheres lie at the sides of a box, are pressed onto them and pushed along them.

    In the second step, the coefficient of friction times the speed of sliding at the end of the first step is mu times
    the normal force then, but at most the resistance to approach. Half of the sides are planes of symmetry.
    """
    ways, walls = np.concatenate([np.eye(3), -np.eye(3)]), np.array([True, False, True, False, True, False])
    # Two spheres touch at half the gap of a sphere and a wall. The gap to a mirror image is twice that to the plane.
    gaps = np.where(walls, TOUCHING, 0.25 * TOUCHING)
    spheres = Aggregates((6 * WIDTH - RADIUS - gaps)[:, None] * ways, np.full(6, RADIUS), DENSITY)
    sides = ((MIRROR, WALL_SIDE), (WALL_SIDE, MIRROR), (MIRROR, WALL_SIDE))
    flow = mortar_flow((12,) * 3, WIDTH, spheres, device, "float64", friction=0.3, time_step=0.02, sides=sides)
    bodies, pairs = flow.aggregates.bodies, flow.aggregates.pairs
    bodies.force.assign(PRESS * (ways + 0.2 * np.roll(ways, 1, axis=1)))
    flow.take(1)
    velocity, spin = bodies.velocity.numpy().copy(), bodies.spin.numpy().copy()
    force = pairs.last_force.numpy()[:: int(CAPACITY)].copy()
    flow.take(1)
    other, grip, hold, gap, touching = (
        getattr(pairs, name).numpy().reshape(6, -1) for name in ("other", "grip", "hold", "gap", "touching")
    )
    normal = pairs.normal.numpy().reshape(6, -1, 3)
    for sphere in range(6):
        (k,) = np.flatnonzero(other[sphere, : pairs.count.numpy()[sphere]] == int(WALL))
        n = normal[sphere, k]
        assert n == pytest.approx(ways[sphere], abs=1e-6) and touching[sphere, k] == 1 and force[sphere] > 0.5 * PRESS
        moved = velocity[sphere] + np.cross(spin[sphere], (RADIUS + 0.5 * gap[sphere, k]) * n)
        speed = np.linalg.norm(moved - (moved @ n) * n)
        expected = min(0.3 * force[sphere] / speed, hold[sphere, k]) if walls[sphere] else 0.0
        assert grip[sphere, k] == pytest.approx(expected, rel=1e-6)
        assert not walls[sphere] or expected < hold[sphere, k]


@pytest.mark.thorough
def test_friction_turns_a_sphere_the_other_way(device):
    """A sphere that is pushed along a floor rolls; without friction, the mortar at the floor turns it backwards."""
    assert motion(pushed(0.0, 0.2 * PRESS, 0.0, device, "float64", steps=4))[1] < 0
    assert motion(pushed(0.3, 0.2 * PRESS, 0.0, device, "float64", steps=4))[1] > 0


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_power_and_momentum_are_balanced_with_friction(device):
    flow, gripped = crowd(device, coupled=1e-9), 0
    for _ in range(4):
        balance = step_with_balance(flow)
        gripped += int((flow.aggregates.pairs.grip.numpy() > 0).sum())
        assert abs(balance.error) < 1e-7
        assert abs(balance.momentum - balance.impulse) < 1e-7 * balance.impulse_scale
    assert gripped > 0


@pytest.mark.thorough
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
