"""Long: the paper's units at full size, with spheres. `python -m pytest -m slow`; a minute or two a run on a CPU."""

import functools

import numpy as np
import pytest

from warpcrete import Simulation, scenes
from warpcrete.core.run_loop import Run

pytestmark = pytest.mark.slow


@functools.cache
def pumped(device: str, **changes) -> Run:
    """The default case, a metre of spheres, once for all tests."""
    return Simulation(scenes.pipe(**changes), device=device).run()


def figures(run: Run) -> tuple[float, float]:
    """Peak and plateau [Pa]."""
    return run.result["peak_pressure"]["value"], run.result["plateau_pressure"]["value"]


def test_vertical_unit_has_the_papers_curve(device):
    run = pumped(device)
    pressure, travel = run.series["pressure"], run.series["travel"]
    peak, plateau = figures(run)
    assert run.result["peak_travel"]["value"] < 0.1  # rises fast ...
    late, early = travel > 0.4, (travel > 0.06) & (travel < 0.2)
    assert np.ptp(pressure[late]) < np.ptp(pressure[early]) < 0.2 * peak  # ... oscillates, ever less ...
    assert pressure[late].mean() == pytest.approx(plateau, rel=0.02)  # ... about a plateau
    assert pytest.approx(plateau, rel=0.02) == 27.3e3  # three seeds lie within 1 %
    assert run.result["momentum_balance_error"] < 1e-6


def test_horizontal_unit_needs_far_less(device):
    assert figures(pumped(device, unit="horizontal"))[1] < 0.2 * figures(pumped(device))[1]


def test_mesh_pipe_agrees_at_full_size(device):
    exact, faceted = figures(pumped(device)), figures(pumped(device, wall="mesh"))
    assert faceted[1] == pytest.approx(exact[1], rel=0.03)


def test_devices_agree_within_the_scatter_of_seeds(device):
    if device == "cpu":
        pytest.skip("compares a GPU with the CPU")
    here, there = figures(pumped(device)), figures(pumped("cpu"))
    seeds = [figures(pumped(device, seed=seed)) for seed in (0, 1, 2)]
    for k in range(2):
        scatter = np.ptp([s[k] for s in seeds])
        assert abs(here[k] - there[k]) < max(2 * scatter, 0.01 * here[k])
