"""Flows of concrete that has stood: what its grown structure bears, and how flow breaks it."""

import math
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import SceneError, Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.core.run.recorder import Recorder
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.pressures import Stop
from warpcrete.studies.lines.run import run_line
from warpcrete.theory.pipe import Concrete

PLUG = dict(
    concrete="own", viscosity=30.0, yield_stress=2000.0, slip_viscosity=1000.0, slip_yield=20.0, density=2350.0,
    ends="periodic", gravity=0.0, spacing=10e-3,
)  # fmt: skip
SHEARED = PLUG | dict(yield_stress=100.0, slip_yield=700.0)
DT = 5e-4


def run(name, device, precision="float32", **given):
    simulation = Simulation(getattr(scenes, name)(**given), device=device, precision=precision)
    return simulation.run(), simulation.scene


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name, ways", [("tube", 2), ("channel", 1)])
def test_a_plug_restarts_as_its_closed_form_says(device, precision, name, ways):
    found, scene = run(name, device, precision, **PLUG, rest=600.0, thixotropy=0.5, breakdown=0.02, duration=0.15)
    # dG/dt = -G V / breakdown: a step bears what there was as it began.
    before = np.maximum(found.series["time"] - DT, 0.0)
    layer = 20.0 + 300.0 * np.exp(-scene.velocity * before / 0.02)
    exact = ways * scene.length / scene.radius * (layer + 1000.0 * scene.velocity)
    np.testing.assert_allclose(found.series["pressure"][1:], exact[1:], rtol=3e-4)  # measured 1e-4
    np.testing.assert_allclose(
        found.series["layer_gained"], 300.0 * np.exp(-scene.velocity * found.series["time"] / 0.02), rtol=3e-4
    )
    assert found["restart_pressure"] == pytest.approx(exact[1], rel=3e-4)
    assert found["restart_pressure_theory"] == pytest.approx(
        ways * scene.length / scene.radius * (320.0 + 1000.0 * scene.velocity), rel=1e-9
    )
    assert found.series["bulk_gained"].min() > 299.0  # nothing is sheared but the layer


def test_structure_that_does_not_break_is_a_concrete_that_bears_more(device):
    grown, scene = run("tube", device, **SHEARED, rest=600.0, breakdown=1e4, breakdown_strain=1e9, duration=0.1)
    more = SHEARED | dict(yield_stress=400.0, slip_yield=1000.0)
    plain, _ = run("tube", device, **more, duration=0.1)
    np.testing.assert_allclose(grown.series["pressure"], plain.series["pressure"], rtol=2e-3)  # measured 3e-4
    assert grown.series["pressure"][-1] == pytest.approx(scene.restart().pressure, rel=5e-3)
    assert scene.restart().wall_stress < 1000.0  # it is the bulk that is sheared
    assert grown.series["bulk_gained"][-1] == pytest.approx(300.0, rel=1e-6)


@pytest.mark.parametrize("name, ways", [("tube", 2), ("channel", 1)])
def test_the_pressure_of_the_first_step_bears_the_wall_of_that_step(device, name, ways):
    """Expect the drag of the wall in the same step, because the momentum of a constant flow does not change."""
    found, scene = run(name, device, "float64", **PLUG, duration=DT, sample_interval=DT)
    assert found.series["time"][1] == pytest.approx(DT)
    stress, pressure = found.series["wall_stress"][1], found.series["pressure"][1]
    # The drive of a flow that starts reaches the concrete at the end of the step, so that the wall brakes it before.
    braked = DT / scene.concrete.density * ways / scene.radius * stress
    assert stress == pytest.approx(20.0 + 1000.0 * (scene.velocity - braked), rel=1e-4)  # measured 8e-5
    assert pressure == pytest.approx(ways * scene.length / scene.radius * stress, rel=1e-9)  # measured 5e-12


@pytest.mark.thorough
def test_structure_of_concrete_with_another_law_bears_more(device):
    thick = SHEARED | dict(flow_index=1.3, slip_flow_index=0.8)
    grown, scene = run("tube", device, **thick, rest=600.0, breakdown=1e4, breakdown_strain=1e9, duration=0.1)
    plain, _ = run("tube", device, **thick | dict(yield_stress=400.0, slip_yield=1000.0), duration=0.1)
    np.testing.assert_allclose(grown.series["pressure"], plain.series["pressure"], rtol=2e-3)
    assert grown.series["pressure"][-1] == pytest.approx(scene.restart().pressure, rel=5e-3)


def test_shear_breaks_the_bulk_where_it_is_sheared(device):
    simulation = Simulation(scenes.tube(**SHEARED, rest=600.0, breakdown=1e4, breakdown_strain=0.5, duration=0.1),
                            device=device)  # fmt: skip
    simulation.prepare()
    simulation.stepper.take(200)
    gained = simulation.state.cells("gained")
    row = gained[0]
    assert row[0] > 295.0 and row[-1] < 200.0 and np.all(np.diff(row) <= 1e-2)  # whole on the axis, broken at the wall
    np.testing.assert_allclose(gained, np.broadcast_to(row, gained.shape), rtol=1e-4)  # the same all along
    simulation.stepper.take(1)
    after = simulation.state.cells("gained")
    rate = np.sqrt(simulation.state.cells("strain"))
    np.testing.assert_allclose(after / gained, np.exp(-rate * DT / 0.5), rtol=1e-5)


def test_a_rested_flow_ends_when_its_layer_is_broken(device):
    found, scene = run("tube", device, concrete="no1", ends="periodic", spacing=10e-3, rest=300.0, breakdown=0.01)
    assert found.finished and found.result["steady"]
    assert found.series["layer_gained"][-1] < 1.5
    module = sys.modules["warpcrete.scenes.tube"]
    for name, (passed, what) in module.check(found).items():
        assert passed, f"{name}: {what}"
    assert found["restart_over_steady"] > 1.1
    # Its bulk bears more than the wall now, so that it is a plug: slip alone.
    bears = 251.0 + 893.0 * scene.velocity
    assert found.series["wall_stress"][-1] == pytest.approx(bears, rel=0.01)


class CutAt(Recorder):
    """Stops after the row at a time."""

    def sample(self, simulation, row):
        simulation.stop_requested = row["time"] >= 0.03


def test_a_restart_that_was_cut_goes_on_with_the_same_bits(device, tmp_path):
    scene = scenes.tube(**SHEARED, rest=600.0, breakdown=0.02, breakdown_strain=1.0, duration=0.06)
    whole = Simulation(scene, device=device).run()
    first = Simulation(scene, device=device, checkpoint_path=tmp_path / "c.npz", recorders=[CutAt()])
    assert not first.run().finished
    second = Simulation(scene, device=device)
    second.resume(tmp_path / "c.npz")
    rest = second.run()
    assert rest.result["state_hash"] == whole.result["state_hash"]
    for name in whole.series:
        assert np.array_equal(whole.series[name], rest.series[name], equal_nan=True), name


def test_flows_that_never_rested_know_nothing_of_it(device):
    simulation = Simulation(scenes.tube(**PLUG, duration=0.01), device=device)
    found = simulation.run()
    assert "layer_gained" not in found.series and "restart_pressure" not in found.result
    assert len(simulation.state.mesh.gained) == len(simulation.state.mesh.layer) == 0


@pytest.mark.parametrize(
    "bad, message",
    [
        (dict(ends="piston", rest=600.0), "rest = 600.0: needs a flow on a grid"),
        (dict(ends="periodic", rest=-1.0), "rest = -1.0: must be"),
        (dict(ends="periodic", rest=math.nan), "rest = nan: must be"),
        (dict(ends="periodic", thixotropy=0.3), "thixotropy = 0.3: has no effect unless 'rest' is above 0"),
        (dict(ends="periodic", rest=5.0, breakdown=0.0), "breakdown = 0.0: must be"),
    ],
)
def test_rests_that_cannot_be_are_refused_in_one_line(bad, message):
    with pytest.raises(SceneError) as caught:
        scenes.tube(**bad)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_a_line_restarts_as_the_sum_of_its_parts():
    line = line_of({"parts": [{"straight": "10 m"}, {"bend": {"to": "up", "radius": "0.5 m", "factor": 1}},
                              {"straight": "5 m"}],
                    "diameter": "100 mm"})  # fmt: skip
    plug = Concrete(density=2400, viscosity=30, yield_stress=500, slip_viscosity=1000, slip_yield=20)
    length, rise = 15 + 0.25 * math.pi, 5.5
    weight = 2400 * 9.81 * rise
    stopped = run_line(line, plug, 2e-3, simulate=False, stop=Stop(600.0, 0.3))
    assert stopped.restart().value == pytest.approx(weight + 4 * 200 / 0.1 * length, rel=1e-9)
    speed = 2e-3 / (math.pi * 0.05**2)
    moving = weight + 4 * (200 + 1000 * speed) / 0.1 * length
    assert stopped.restart(2e-3).value == pytest.approx(moving, rel=1e-9)
    found = CliRunner().invoke(cli, ["line", "burj-khalifa", "--theory", "--rest", "600", "--thixotropy", "0.3"])
    words = "with a yield stress that grows by 0.3 Pa/s (theory), the concrete starts to move at 198.2 ("
    assert found.exit_code == 0 and words in found.output
    bad = CliRunner().invoke(cli, ["line", "burj-khalifa", "--theory", "--thixotropy", "0.3"])
    assert (
        str(bad.exception) == "thixotropy = 0.3: needs the duration of the rest; add, for example, --rest 600 for 600 s"
    )
    assert bad.output == ""


# Structure that also rebuilds while the concrete flows.


@pytest.mark.parametrize("name, ways", [("tube", 2), ("channel", 1)])
def test_a_layer_rebuilds_while_it_slips(device, name, ways):
    """dG/dt = A - G V / breakdown in the layer, and dG/dt = A in a plug, from no structure at the start."""
    found, scene = run(name, device, **PLUG, rebuild_rate=2000.0, breakdown=0.02, duration=0.1)
    most, before = 2000.0 * 0.02 / scene.velocity, np.maximum(found.series["time"] - DT, 0.0)
    layer = 20.0 + most * -np.expm1(-scene.velocity * before / 0.02)
    exact = ways * scene.length / scene.radius * (layer + 1000.0 * scene.velocity)
    np.testing.assert_allclose(found.series["pressure"][1:], exact[1:], rtol=3e-4)
    after = most * -np.expm1(-scene.velocity * found.series["time"] / 0.02)
    np.testing.assert_allclose(found.series["layer_gained"], after, rtol=3e-4, atol=1e-3)
    np.testing.assert_allclose(found.series["bulk_gained"], 2000.0 * found.series["time"], rtol=1e-4, atol=1e-3)
    assert "restart_pressure" not in found.result


def test_a_rest_and_rebuilding_add_up(device):
    found, scene = run("tube", device, **PLUG, rest=600.0, thixotropy=0.5, rebuild_rate=2000.0, breakdown=0.02,
                       duration=0.05)  # fmt: skip
    fall = np.exp(-scene.velocity * found.series["time"] / 0.02)
    most = 2000.0 * 0.02 / scene.velocity
    np.testing.assert_allclose(found.series["layer_gained"], most + (300.0 - most) * fall, rtol=3e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("name, power", [("tube", 2), ("channel", 1)])
def test_steady_structure_bears_its_closed_form(device, name, power):
    """Sheared concrete bears tau_0 + A / (alpha g) + mu g, which has a minimum; what bears less than it is a plug."""
    rate, strain, viscosity, yields = 100.0, 0.5, 20.0, 40.0
    given = PLUG | dict(viscosity=viscosity, yield_stress=yields, slip_viscosity=1e6, slip_yield=0.0, spacing=5e-3)
    found, scene = run(name, device, **given, length=0.04, rebuild_rate=rate, breakdown_strain=strain, breakdown=1e-3,
                       duration=2.0, time_step=1e-3, sample_interval=0.1)  # fmt: skip
    least = yields + 2 * math.sqrt(viscosity * rate * strain)

    def mean(stress):
        s = least + (np.arange(20_000) + 0.5) / 20_000 * (stress - least)
        over = s - yields
        g = (over + np.sqrt(over**2 - 4 * viscosity * rate * strain)) / (2 * viscosity)
        return scene.radius / stress ** (power + 1) * np.mean(s**power * g) * (stress - least)

    low, high = least, 10 * least
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if mean(middle) < scene.velocity else (low, middle)
    plain = found.result["wall_stress_theory"]["value"]
    assert high > 1.02 * plain  # structure makes a difference
    assert found.series["wall_stress"][-1] == pytest.approx(high, rel=3e-3)  # measured 1.1e-3


@pytest.mark.parametrize(
    "bad, message",
    [
        (dict(ends="piston", rebuild_rate=0.5), "rebuild_rate = 0.5: needs a flow on a grid"),
        (dict(ends="periodic", rebuild_rate=-1.0), "rebuild_rate = -1.0: must be"),
        (dict(ends="periodic", breakdown=0.3), "breakdown = 0.3: has no effect unless 'rest' or 'rebuild_rate' is"),
        (dict(aggregates=True, rebuild_rate=0.5), "rebuild_rate = 0.5: needs a flow on a grid"),
    ],
)
def test_structure_that_cannot_rebuild_is_refused_in_one_line(bad, message):
    with pytest.raises(SceneError) as caught:
        scenes.tube(**bad)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "ends"),
    [
        ({}, "piston"), ({"slip_viscosity": 1e6}, "periodic"), ({"rest": 60.0, "thixotropy": 0.1}, "periodic"),
        ({"rebuild_rate": 0.5}, "periodic"), ({"step_error": 1e-4}, "periodic"), ({"aggregates": True}, "piston"),
    ],
)  # fmt: skip
def test_flows_that_need_cells_of_a_grid_have_periodic_ends(given, ends):
    assert scenes.channel(**given).ends == ends
