"""Interpolation of the grid's velocities at a particle, on cells whose widths differ between the axes."""

import numpy as np
import pytest
import warp as wp

from warpcrete.kernels.mps.grid.advection import sampling_functions
from warpcrete.kernels.mps.grid.cells import GridKind, grid_parameters_struct
from warpcrete.kernels.mps.structs import mps_types

COUNTS, WIDTHS, ORIGIN = (4, 3, 5), (0.01, 0.025, 0.004), (-0.02, 0.1, 0.0)


def test_a_linear_velocity_is_found_with_its_gradient(device):
    """Linear interpolation is exact for a linear field; where faces are unknown, the others keep a uniform field."""
    t = mps_types(wp.float64, 3)
    carry = sampling_functions(wp.float64, GridKind(3)).carry
    Grid = grid_parameters_struct(wp.float64, 3)

    @wp.kernel(module="unique")
    def sample(g: Grid, velocity: wp.array(dtype=wp.float64), good: wp.array(dtype=wp.int32),
               x: wp.array(dtype=t.vec), here: wp.array(dtype=t.vec), slope: wp.array(dtype=t.mat)):  # fmt: skip
        i = wp.tid()
        value, change, _total = carry(g, velocity, good, x[i])
        here[i] = value
        slope[i] = change

    g, shape = Grid(), tuple(n + 2 for n in reversed(COUNTS))
    g.n, g.width, g.origin, g.slots = t.whole(*COUNTS), t.vec(*WIDTHS), t.vec(*ORIGIN), int(np.prod(shape))
    uniform, gradient = np.array([0.3, -0.2, 0.5]), np.array([[1.0, 2.0, -3.0], [0.5, -4.0, 6.0], [7.0, 0.2, 3.0]])
    cells = np.stack(np.meshgrid(*(np.arange(-1, n + 1) for n in reversed(COUNTS)), indexing="ij")[::-1], -1)
    rng = np.random.default_rng(5)
    x = np.array(ORIGIN) + np.array(WIDTHS) * (0.6 + rng.random((50, 3)) * (np.array(COUNTS) - 1.2))

    def found(field, known):
        faces = []
        for axis in range(3):
            middle = np.array(ORIGIN) + (cells + 0.5 - 0.5 * np.eye(3)[axis]) * np.array(WIDTHS)
            faces.append(uniform[axis] + field[axis] @ np.moveaxis(middle, -1, -2).reshape(*shape[:2], 3, -1))
        velocity = np.concatenate([np.asarray(each).ravel() for each in faces])
        here, slope = (wp.zeros(len(x), dtype=dtype, device=device) for dtype in (t.vec, t.mat))
        given = [wp.array(velocity, dtype=wp.float64, device=device), wp.array(known, dtype=wp.int32, device=device),
                 wp.array(x, dtype=t.vec, device=device)]  # fmt: skip
        wp.launch(sample, len(x), [g, *given, here, slope], device=device)
        return here.numpy(), slope.numpy()

    everywhere = np.ones(3 * g.slots, np.int32)
    here, slope = found(gradient, everywhere)
    assert here == pytest.approx(uniform + x @ gradient.T, rel=1e-12)
    assert slope == pytest.approx(np.broadcast_to(gradient, (50, 3, 3)), rel=1e-10)
    here, slope = found(0 * gradient, (rng.random(3 * g.slots) < 0.8).astype(np.int32))
    assert here == pytest.approx(np.broadcast_to(uniform, (50, 3)), rel=1e-12) and np.abs(slope).max() < 1e-10
