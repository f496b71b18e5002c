"""Spheres and inertia of clumps in a mortar, which turn with the clumps."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from warpcrete.kernels.common.types import types
from warpcrete.kernels.suspension.bodies import body_structs, pose_kernel


def test_spheres_and_inertia_turn_with_a_clump(device):
    """Without torque, the angular momentum I w is constant, so I dw/dt = -w x (I w)."""
    t, rng = types(wp.float64), np.random.default_rng(2)
    turn = Rotation.from_quat(rng.normal(size=(2, 4)))
    offset, moments = rng.normal(size=(5, 3)), rng.random((2, 3)) + 0.5
    spin, mass = 30 * rng.normal(size=(2, 3)), np.array([0.3, -0.1])
    bodies = body_structs(wp.float64).Bodies()

    def array(values, dtype):
        return wp.array(values, dtype=dtype, device=device)

    bodies.first = array(np.array([0, 2, 5]), wp.int32)
    bodies.turn, bodies.offset = array(turn.as_quat(), t.quat), array(offset, t.vec3)
    bodies.moments, bodies.spin = array(moments, t.vec3), array(spin, t.vec3)
    bodies.extra_mass = array(mass, wp.float64)
    bodies.arm, bodies.gyration = (wp.zeros(n, dtype=t.vec3, device=device) for n in (5, 2))
    bodies.tensor = wp.zeros(2, dtype=t.mat33, device=device)
    flags = wp.zeros(8, dtype=wp.int32, device=device)
    wp.launch(pose_kernel(wp.float64), 2, [flags, bodies], device=device)
    for b, own in enumerate((slice(0, 2), slice(2, 5))):
        matrix = turn[b].as_matrix()
        inertia = mass[b] * matrix @ np.diag(moments[b]) @ matrix.T
        assert bodies.arm.numpy()[own] == pytest.approx(turn[b].apply(offset[own]), abs=1e-12)
        assert bodies.tensor.numpy()[b] == pytest.approx(inertia, abs=1e-12)
        # The angular momentum after a short time, with the spin that follows from `gyration`, is that of before.
        change = 1e-7
        later = Rotation.from_rotvec(change * spin[b]).as_matrix() @ matrix
        after = spin[b] + change * np.linalg.solve(inertia, bodies.gyration.numpy()[b])
        momentum = mass[b] * later @ np.diag(moments[b]) @ later.T @ after
        # The deviation is of second order in `change`: measured at most 3e-11. Without the torque it is at least 3e-6.
        assert momentum == pytest.approx(inertia @ spin[b], abs=1e-10)
