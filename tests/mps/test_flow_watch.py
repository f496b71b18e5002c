"""Flows that mean nothing end with an error, and those that do are never mistaken for such."""

import dataclasses
import math
from types import SimpleNamespace

import pytest
from flows import flow_of, step

from warpcrete import Simulation, scenes
from warpcrete.core.errors import InstabilityError, SceneError
from warpcrete.core.run.recorder import Recorder
from warpcrete.mps.column import check_flow
from warpcrete.mps.probes import measured
from warpcrete.mps.quantities import report
from warpcrete.mps.scene import FlowWatch
from warpcrete.mps.watch import WatchedFlow

SHEARED = dict(
    concrete="own", density=2400.0, viscosity=20.0, yield_stress=0.0, slip_viscosity=1e6, slip_yield=0.0, gravity=0.0,
)  # fmt: skip


def test_particles_that_have_all_left_the_measured_part_end_the_run(device):
    flow = step(flow_of(device))
    flow.state.particles.position.assign(flow.state.particles.position.numpy() + [0.0, flow.state.layout.height])
    row = measured(flow)
    assert math.isnan(row["volume_error"]) and math.isfinite(row["fastest"])
    with pytest.raises(InstabilityError, match="is not a finite number"):
        WatchedFlow(flow.scene)(row)


def row_of(scene, **changes):
    theory = scene.theory()
    sound = {
        "time": 0.1, "pressure": theory.pressure, "wall_stress": theory.wall_stress, "fastest": scene.velocity,
        "volume_error": 0.0, "momentum": 1.0, "force_balance_error": 0.01,
    }  # fmt: skip
    return sound | changes


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pressure": math.nan}, "pressure is not a finite number"),
        ({"momentum": math.inf}, "momentum is not a finite number"),
        ({"pressure": -1e6}, r"the pressure on the piston is -1e\+06 Pa, but theory gives .*watch\.pressure = 10"),
        ({"pressure": 1e6}, r"watch\.pressure = 10"),
        ({"fastest": 5.0}, r"the fastest particle moves at 5 m/s, .*watch\.speed = 4"),
        ({"force_balance_error": 0.25}, r"the resultant is 0\.25 of .*watch\.force_balance = 0\.2"),
        ({"force_balance_error": -0.25}, r"the resultant is -0\.25 of"),
        ({"force_balance_error": math.nan}, "the resultant is nan of"),
        ({"volume_error": -0.02}, r"has lost or gained 0\.02 of its volume; the limit is watch\.volume = 0\.015"),
    ],
)
def test_a_row_that_means_nothing_stops_the_flow(changes, words):
    scene = scenes.channel()
    watch = WatchedFlow(scene)
    watch(row_of(scene))
    with pytest.raises(InstabilityError, match=words) as caught:
        watch(row_of(scene, **changes))
    assert "t = 0.1 s: " in str(caught.value) and "usual cures" in str(caught.value)


def test_cures_never_include_ends_that_the_scene_refuses():
    """Only particles can simulate aggregates, so that a flow on a grid is no cure for a column with aggregates."""
    one, two = scenes.channel(), scenes.channel(aggregates=True)
    assert "ends = periodic" in WatchedFlow(one).cures and "periodic" not in WatchedFlow(two).cures
    assert "without aggregates" in WatchedFlow(two).cures
    result = dict.fromkeys(
        ("pressure_error", "slip_velocity_error", "wall_stress_error", "force_balance_error", "volume_error",
         "profile_error", "simulated_time"), 1.0,
    ) | {"steady": False}  # fmt: skip
    for scene, cure in ((one, "--ends periodic"), (two, "without --aggregates")):
        found = check_flow(SimpleNamespace(scene=scene, result=result))
        assert cure in found["pressure"][1] and cure in found["wall's stress"][1]
        assert all("periodic" not in text for _, text in found.values()) or scene is one
    with pytest.raises(SceneError, match="or leave out 'aggregates'"):
        scenes.channel(aggregates=True, length=9e3, spacing=2e-3)


def test_limits_may_be_others_or_none():
    scene = dataclasses.replace(
        scenes.channel(), watch=FlowWatch(force_balance=None, pressure=None, speed=None, volume=None)
    )
    WatchedFlow(scene)(row_of(scene, force_balance_error=0.9, pressure=1e7, fastest=1e3, volume_error=0.5))
    strict = dataclasses.replace(scenes.channel(), watch=FlowWatch(force_balance=1e-3))
    with pytest.raises(InstabilityError, match=r"watch\.force_balance = 0\.001"):
        WatchedFlow(strict)(row_of(strict))
    with pytest.raises(SceneError, match=r"watch speed = -1\.0"):
        FlowWatch(speed=-1.0)


def test_a_flow_that_bursts_is_not_called_steady(device):
    """Newtonian concrete at a wall that it sticks to, on a piston, whose corner with the wall no particles fill."""
    scene = scenes.channel(**SHEARED, ends="piston", duration=1.0)
    with pytest.raises(InstabilityError, match=r"usual cures.*ends = periodic"):
        Simulation(scene, device=device).run()


class FrameTimes(Recorder):
    """Times of all frames [s]."""

    def __init__(self):
        self.times = []

    def frame(self, simulation):
        self.times.append(simulation.stepper.time)


def test_nothing_is_called_steady_that_is_not(device):
    """A flow of given duration that ends before it is steady; one without a second sample."""
    run = Simulation(scenes.channel(spacing=10e-3, duration=0.01), device=device).run()
    assert not run.result["steady"] and "steady" not in check_flow(run)
    assert "not steady" in dict(report(run))
    frames = FrameTimes()
    whole = Simulation(scenes.channel(spacing=10e-3), device=device, recorders=[frames], frame_interval=10.0).run()
    assert whole.result["steady"] and check_flow(whole)["steady"][0] and "not steady" not in dict(report(whole))
    # The last state is drawn, although no frame is due when the flow is found to be steady.
    assert frames.times == [0.0, whole.series["time"][-1]] and frames.times[1] < 10.0
    short = Simulation(scenes.channel(spacing=10e-3, duration=5e-4, sample_interval=5e-4), device=device).run()
    assert not all(ok for ok, _ in check_flow(short).values())
