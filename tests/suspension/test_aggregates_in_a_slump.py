"""Slump in space: a quarter of a cone between two planes of symmetry, with and without aggregates."""

from dataclasses import replace

import numpy as np
import pytest

import warpcrete
from warpcrete import scenes
from warpcrete.core.units import number
from warpcrete.mps.free.quantities import start_volume
from warpcrete.mps.free.simulation import FreeSimulation
from warpcrete.suspension.scene import SuspensionScene

CONE = {"concrete": "own", "density": 2300.0, "viscosity": 50.0, "yield_stress": 500.0, "spacing": 0.0125}
MORTAR = CONE | {
    "aggregate_fraction": 0.1, "aggregate_smallest": 0.05, "aggregate_largest": 0.05, "base_diameter": 0.3,
    "top_diameter": 0.2, "mould_height": 0.2, "lift_time": 0.0, "yield_stress": 300.0,
}  # fmt: skip


def quarter(scene):
    """Return the same test without aggregates, as a quarter in space instead of a flow about an axis."""
    mirrors = {"left": "mirror", "front": "mirror"}
    return replace(scene, axial=False, round=True, depth=scene.width, sides=mirrors)


def test_a_quarter_starts_with_the_shape_and_volume_of_the_cone():
    whole = scenes.slump(**CONE)
    part = quarter(whole)
    assert 4 * start_volume(part) == pytest.approx(2 * np.pi * start_volume(whole), rel=1e-9)
    simulation = FreeSimulation(part, device="cpu")
    simulation.begin()
    # Measured with cells of 12.5 mm: 0.2 % less than the volume of the cone.
    assert simulation.volume == pytest.approx(start_volume(part), rel=4e-3)
    row = simulation.measured()
    assert row["top"] == pytest.approx(0.3, abs=1e-3) and row["spread"] == pytest.approx(0.2, abs=2e-3)


@pytest.mark.thorough
def test_a_quarter_in_space_slumps_as_the_flow_about_an_axis(device):
    whole = scenes.slump(**CONE, lift_time=0.5, duration=8.0)
    flows = [FreeSimulation(scene, device=device).run().result for scene in (whole, quarter(whole))]
    assert all(result["at_rest"] for result in flows)
    slump, spread = (np.diff([number(result[name]) for result in flows])[0] for name in ("slump", "spread"))
    # Measured: slump 186.3 and 185.1 mm, spread 314.7 and 314.0 mm.
    assert abs(slump) < 2.5e-3 and abs(spread) < 2e-3


def test_only_aggregates_make_a_slump_a_flow_in_space():
    plain, mixed = scenes.slump(**CONE), scenes.slump(**MORTAR)
    assert plain.axial and not plain.round and not isinstance(plain, SuspensionScene)
    assert isinstance(mixed, SuspensionScene) and mixed.round and mixed.depth == mixed.width


def test_aggregates_start_within_the_cone(device):
    simulation = warpcrete.Simulation(scenes.slump(**MORTAR), device=device)
    simulation.begin()
    bodies = simulation.flow.aggregates
    x, r = bodies.bodies.centre.numpy(), bodies.radius
    # Distance from the sloping side of the cone, which is 0.05 m wide over a height of 0.2 m.
    aside = (0.15 - np.hypot(x[:, 0], x[:, 1]) - 0.25 * x[:, 2]) / np.hypot(1, 0.25)
    assert np.all(aside > r) and np.all(x[:, :2] > r[:, None]) and np.all((x[:, 2] > r) & (x[:, 2] < 0.2 - r))
    display = simulation.display()
    assert np.count_nonzero(display.surface().fields["aggregate"]) % (4 * bodies.count) == 0
    assert 0 < display.cut < 0.15
    assert [wall.name for wall in display.walls()] == ["plate"]


@pytest.mark.slow
def test_a_cone_with_aggregates_slumps_to_rest(device):
    given = MORTAR | {"viscosity": 20.0, "density": 2200.0, "lift_time": 0.3, "duration": 2.5, "sample_interval": 0.05}
    run = warpcrete.Simulation(scenes.slump(**given), device=device).run()
    result, series = run.result, run.series
    assert result["at_rest"] and series["smallest_gap"][1:].min() > -0.02
    # Measured: 0.35 %.
    assert abs(result["volume_error"]) < 0.01
    # The heap is symmetric, and aggregates raise the yield stress. Measured: slump 121 mm and spread 453 mm.
    assert 0.11 < number(result["slump"]) < 0.13 and 0.43 < number(result["spread"]) < 0.47


@pytest.mark.parametrize(
    "given, words",
    [
        ({"aggregate_smallest": 0.08, "aggregate_largest": 0.08}, "aggregate_largest = 0.08: is too large: a quarter"),
        (
            {"aggregate_smallest": None, "aggregate_largest": None, "spacing": 0.02},
            "spacing = 0.02: is too coarse: aggregates of the default size, whose narrowest side is 4 cells wide, are "
            "0.08 m large, but a quarter",
        ),
    ],
)
def test_what_a_slump_with_aggregates_refuses(given, words):
    with pytest.raises(warpcrete.SceneError) as why:
        scenes.slump(**MORTAR | given)
    assert words in str(why.value) and "\n" not in str(why.value)
