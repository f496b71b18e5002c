"""Compact copy of the viscous matrix, which the preconditioner of the coupled solve uses on a GPU."""

from types import SimpleNamespace

import numpy as np
import pytest

from warpcrete.core.device.launching import Stage, completed
from warpcrete.kernels.suspension.compact import ENTRIES, compact_kernels, compact_struct
from warpcrete.mps.common.allocation import allocate
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow
from warpcrete.verification.suspensions_many import suspension


def periodic(device, precision):
    return suspension(0.4, 0, device, precision, wide=3, long=3, rate=10.0)


def closed(device, precision):
    """A closed box with one sphere."""
    sphere = Aggregates(np.zeros((1, 3)), np.full(1, RADIUS), DENSITY + 8000)
    return mortar_flow((12, 12, 16), RADIUS / 2, sphere, device, precision, time_step=0.1)


@pytest.fixture(params=[(periodic, "float32"), (periodic, "float64"), (closed, "float32")], ids=lambda p: p[0].__name__)
def products(request, device):
    """The product of exact and of compact matrix with a vector of face velocities."""
    flow = request.param[0](device, request.param[1])
    flow.take(2)
    solve, rows = flow.coupled, 3 * flow.state.slots
    compact = allocate(compact_struct(solve.scalar), solve.device, entries=ENTRIES // 2 * rows, diagonal=rows)
    kernels = compact_kernels(solve.scalar, not flow.parallel, flow.state.layout.kind)
    arrays = solve._arrays | {"compact": compact}

    def launch(kernel, tasks, **named):
        Stage(kernel, tasks, completed(kernel, named, arrays), solve.device, block=256)()

    def both(velocities):
        vector, exact, near = (solve.directions.vector() for _ in range(3))
        vector.faces.assign(np.where(free, 0.0, velocities))
        launch(solve.search.multiply, solve.tasks, direction=vector, result=exact)
        launch(kernels.multiply, solve.tasks, direction=vector, result=near)
        return exact.faces.numpy().astype(float), near.faces.numpy().astype(float)

    launch(kernels.compress, rows)
    free = flow.viscous.matrix.free.numpy()[:rows] != 0
    rounding = 1e-6 if request.param[1] == "float32" else 3e-15
    return SimpleNamespace(both=both, rows=rows, unknowns=rows - np.count_nonzero(free), rounding=rounding)


def test_entries_are_those_of_the_matrix_within_rounding(products):
    assert products.unknowns > 1000
    exact, near = products.both(np.random.default_rng(0).normal(size=products.rows))
    # Measured: 0.0010 to 0.0013. The largest rounding error of a number with eight significant bits is 2^-9 = 0.002.
    assert np.abs(near - exact).max() < 2**-9 * np.abs(exact).max()
    assert np.count_nonzero(near != exact) > products.unknowns / 2


@pytest.mark.parametrize("axis", range(3))
def test_uniform_motion_causes_the_exact_forces(products, axis):
    exact, near = products.both(np.repeat(np.arange(3) == axis, products.rows // 3))
    assert np.linalg.norm(exact) > 0
    # Measured: 2e-8 to 3e-7, and 7e-16 in double precision.
    assert np.linalg.norm(near - exact) < products.rounding * np.linalg.norm(exact)
