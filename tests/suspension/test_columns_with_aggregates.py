"""Mortar with aggregates at a given flow in a straight pipe or channel."""

import numpy as np
import pytest
from flows import begin

import warpcrete
from warpcrete import scenes
from warpcrete.core.run.method import report_of
from warpcrete.core.units import number
from warpcrete.methods import method_of
from warpcrete.mps.scene import FluidScene
from warpcrete.suspension.stretch.probes import fraction_profile
from warpcrete.suspension.stretch.scene import StretchScene
from warpcrete.verification.suspensions_many import high_frequency_viscosity

PIPE = {
    "concrete": "own", "density": 2200.0, "viscosity": 20.0, "yield_stress": 0.0, "slip_viscosity": 1e6,
    "slip_yield": 0.0, "diameter": 0.08, "length": 0.08, "spacing": 0.0054, "aggregate_fraction": 0.1,
    "aggregate_smallest": 0.02, "aggregate_largest": 0.02, "gravity": 0.0,
}  # fmt: skip
SLOW = {"flow": 1e-6, "duration": 30.0, "sample_interval": 10.0}
"""A slow flow without inertia, which is steady after few long time steps."""


def column(name, device, **given):
    return warpcrete.Simulation(getattr(scenes, name)(**PIPE | given), device=device)


def begun(name, device, steps, **given):
    return begin(column(name, device, **given), steps)


@pytest.mark.parametrize("name", ["tube", "channel"])
def test_the_driving_force_keeps_the_flow(name, device):
    simulation = begun(name, device, 5, **SLOW)
    row, scene = simulation.measured(), simulation.scene
    # Measured: 0.9978 in the tube, whose cells fill 0.2 % less than its section, and 1 in the channel.
    assert row["flow"] == pytest.approx(1e-6, rel=3e-3)
    # Measured: 0.997 in the tube, for the same reason.
    assert row["wall_stress"] == pytest.approx(row["gradient"] * scene.radius / scene.ways, rel=4e-3)
    # The aggregates raise the friction by less than in a wide room, because they keep off the wall, where the mortar is
    # sheared most. Measured: 1.148 in the tube and 1.199 in the channel.
    assert 1.1 < row["gradient"] / scene.gradient < high_frequency_viscosity(simulation.fraction)


def test_flow_and_gradient_belong_together(device):
    """A constant gradient causes the flow that needs this gradient; the mortar is a Newtonian fluid."""
    given = begun("tube", device, 5, **SLOW).measured()
    free = {name: value for name, value in SLOW.items() if name != "flow"}
    gradient = {"gradient": given["gradient"], "surfaces": "slips", "regularisation": 100.0}
    found = begun("stretch", device, 4, **free, **gradient).measured()
    # Measured: 0.9977, because the aggregates have moved a little in the meantime.
    assert found["flow"] == pytest.approx(given["flow"], rel=4e-3)


def test_aggregates_between_planes_keep_off_planes_and_sides(device):
    simulation = begun("channel", device, 1, **SLOW, aggregate_fraction=0.2)
    bodies, scene = simulation.flow.aggregates, simulation.scene
    x, radius = bodies.bodies.centre.numpy().astype(float), bodies.radius
    assert scene.depth == pytest.approx(0.08) and scene.form == "plane"
    assert np.all(np.abs(x[:, 0]) + radius < 0.04) and np.all((x[:, 1] > radius) & (x[:, 1] < 0.08 - radius))
    layers = fraction_profile(simulation.flow)
    volume = 4 / 3 * np.pi * np.sum(radius**3)
    assert layers.sum() * 2 * 0.04 / len(layers) * 0.08 * 0.08 == pytest.approx(volume, rel=1e-6)
    display = simulation.display()
    assert [wall.name for wall in display.walls()] == ["lower plane", "upper plane"]
    assert np.count_nonzero(display.surface().fields["aggregate"]) % bodies.count == 0


def test_a_run_reports_friction_beside_theory_and_goes_on_with_the_same_bits(device):
    given = {"duration": 0.08, "sample_interval": 0.02, "flow": 1e-3, "gravity": 9.81}
    run = column("tube", device, **given).run()
    first, second = (begun("tube", device, 0, **given) for _ in range(2))
    first.flow.take(2)
    second.load_state_dict(first.state_dict())
    for flow in (first.flow, second.flow):
        flow.take(2)
    assert all(np.array_equal(a, second.flow.state_arrays()[name]) for name, a in first.flow.state_arrays().items())
    told = dict(report_of(method_of(run.scene).quantities, run))
    assert {"pressure", "friction", "flow", "wall's stress"} <= set(told) and "mortar without" in told["friction"]
    # Whole aggregates are placed, so their volume fraction is not that of the scene.
    placed, mortar = run.result["aggregates"]["fraction"], run.scene.concrete.density
    assert abs(placed - run.scene.aggregate_fraction) > 1e-3
    weight = 0.08 * 9.81 * (mortar + placed * (run.scene.aggregate_density - mortar))
    assert number(run.result["pressure"]) == pytest.approx(0.08 * number(run.result["gradient"]) + weight)
    assert number(run.result["gradient_theory"]) == pytest.approx(run.scene.gradient)
    assert set(scenes.modules()["tube"].check(run)) == {"steady", "balance of forces", "no overlap"}
    assert method_of(run.scene).show(run).axes[-1].get_ylabel() == "friction [kPa/m]"


def test_aggregates_of_particles_remain_the_choice_of_their_own_option():
    plain = {name: value for name, value in PIPE.items() if name not in ("aggregate_smallest", "aggregate_largest")}
    assert isinstance(scenes.tube(**PIPE), StretchScene) and isinstance(scenes.channel(**PIPE), StretchScene)
    for name in ("tube", "channel"):
        assert isinstance(getattr(scenes, name)(**plain | {"aggregate_fraction": 0.0}), FluidScene)
    two = scenes.tube(aggregates=True, aggregate_fraction=0.3)
    assert isinstance(two, FluidScene) and two.aggregates is not None and two.aggregates.fraction == 0.3


@pytest.mark.parametrize(
    "given, words",
    [
        ({"steadiness": 0.01}, "steadiness = 0.01: has no effect with aggregates that are simulated one by one"),
        ({"tolerated_error": 0.1}, "tolerated_error = 0.1: has no effect with aggregates that are simulated"),
        ({"time_step": 1e-3}, "time_step = 0.001: has no effect with aggregates"),
        ({"rest": 60.0}, "rest = 60.0: has no effect with aggregates"),
        ({"ends": "piston"}, "ends = 'piston': cannot be combined with aggregates"),
        ({"length": 0.05}, "length = 0.05: must be at least 3 diameters of the largest aggregate"),
    ],
)
def test_what_columns_with_aggregates_refuse(given, words):
    with pytest.raises(warpcrete.SceneError) as why:
        scenes.tube(**PIPE | given)
    assert words in str(why.value)
