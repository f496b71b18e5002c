"""Forces and torques between aggregates that touch with friction, evaluated for given velocities and spins."""

import numpy as np
import pytest
import warp as wp

from warpcrete.kernels.common.types import types
from warpcrete.kernels.suspension.bodies import BodyKind, body_structs
from warpcrete.kernels.suspension.pairs import CAPACITY, pair_functions, pair_struct

CENTRES = np.array([[0.1, -0.2, 0.3], [0.11, -0.19, 0.318]])
ARMS = np.array([[0.002, -0.001, 0.003], [-0.001, 0.002, -0.002]])
SIZES = np.array([0.012, 0.006])
GRIP, HOLD, LUBRICATION = 7.0, 30.0, 2.0


def forces_of_two(kind: BodyKind, device: str, velocity: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """Return force [N] and torque [N m] on each of two aggregates whose spheres touch, shape (2 bodies, 2, 3)."""
    vec3 = types(wp.float64).vec3
    Bodies, Pairs = body_structs(wp.float64).Bodies, pair_struct(wp.float64)
    between = pair_functions(wp.float64, kind).between

    @wp.kernel(enable_backward=False, module="unique")
    def evaluate(bodies: Bodies, pairs: Pairs, linear: wp.array(dtype=vec3), angular: wp.array(dtype=vec3),
                 found: wp.array2d(dtype=vec3)):  # fmt: skip
        b = wp.tid()
        force, torque = between(bodies, pairs, linear, angular, b, 0, 1)
        found[b, 0] = force
        found[b, 1] = torque

    def array(values, dtype):
        return wp.array(values, dtype=dtype, device=device)

    arms = ARMS if kind.clumps else 0 * ARMS
    offset = CENTRES[1] + arms[1] - CENTRES[0] - arms[0]
    apart = np.linalg.norm(offset)
    at = [0, CAPACITY]
    whole = {"other": np.zeros(2 * CAPACITY, np.int32), "touching": np.zeros(2 * CAPACITY, np.int32)}
    whole |= {name: np.zeros(2 * CAPACITY) for name in ("gap", "lubrication", "hold", "grip")}
    normal = np.zeros((2 * CAPACITY, 3))
    normal[at] = [offset / apart, -offset / apart]
    values = {"other": [1, 0], "touching": 1, "gap": apart - SIZES.sum(), "lubrication": LUBRICATION, "hold": HOLD,
              "grip": GRIP}  # fmt: skip
    for name, value in values.items():
        whole[name][at] = value
    pairs, bodies = Pairs(), Bodies()
    pairs.count, pairs.normal = array(np.ones(2, np.int32), wp.int32), array(normal, vec3)
    for name, value in whole.items():
        setattr(pairs, name, array(value, wp.int32 if value.dtype == np.int32 else wp.float64))
    bodies.radius, bodies.size = array(SIZES, wp.float64), array(SIZES, wp.float64)
    bodies.arm = array(arms, vec3)
    bodies.first, bodies.body = array(np.arange(3), wp.int32), array(np.arange(2), wp.int32)
    found = wp.zeros((2, 2), dtype=vec3, device=device)
    wp.launch(evaluate, 2, [bodies, pairs, array(velocity, vec3), array(spin, vec3), found], device=device)
    return found.numpy()


@pytest.mark.parametrize("clumps", [False, True])
def test_pairs_resist_relative_motion_only_and_with_forces_that_balance(device, clumps):
    """Two aggregates that move like one rigid body exert no forces; otherwise forces and torques balance."""
    kind, rng = BodyKind(clumps=clumps, friction=True), np.random.default_rng(3)
    spin = rng.normal(size=3)
    together = forces_of_two(kind, device, rng.normal(size=3) + np.cross(spin, CENTRES), np.tile(spin, (2, 1)))
    assert np.abs(together).max() < 1e-12
    velocity, spins = rng.normal(size=(2, 3)), 50 * rng.normal(size=(2, 3))
    apart = forces_of_two(kind, device, velocity, spins)
    force, torque = apart[:, 0], apart[:, 1]
    assert force[0] == pytest.approx(-force[1], abs=1e-12) and np.abs(force).max() > 1
    assert (torque + np.cross(CENTRES, force)).sum(0) == pytest.approx(np.zeros(3), abs=1e-12)
    # The point of contact lies in the middle of the gap between both surfaces. Across it, friction resists; along the
    # line through both centres, contact and lubrication resist.
    arms = ARMS if clumps else 0 * ARMS
    offset = CENTRES[1] + arms[1] - CENTRES[0] - arms[0]
    n = offset / np.linalg.norm(offset)
    point = CENTRES[0] + arms[0] + (SIZES[0] + 0.5 * (np.linalg.norm(offset) - SIZES.sum())) * n
    one, other = velocity + np.cross(spins, point - CENTRES)
    sliding, approach = (one - other) - np.dot(one - other, n) * n, np.dot(one - other, n)
    assert force[0] == pytest.approx(GRIP * sliding + (HOLD + LUBRICATION) * approach * n, abs=1e-12)
