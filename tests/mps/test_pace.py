"""Steps as long as the flow lets them be: their error, their way, and where they end."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from test_free_flows import slump, vessel

from warpcrete import Simulation, scenes
from warpcrete.core.errors import SceneError
from warpcrete.kernels.mps.grid.cells import DT
from warpcrete.mps.free.forecast import course_of
from warpcrete.mps.grid import flow as grid_flow
from warpcrete.mps.grid.flow import GridFlow
from warpcrete.verification.starting import worst


def flow_of(scene, device, precision="float64"):
    simulation = Simulation(scene, device=device, precision=precision)
    simulation.prepare()
    return simulation.flow


def test_what_falls_freely_goes_in_steps_that_grow_until_it_passes_a_cell(device):
    """A uniform acceleration is exact however long steps are: each is a quarter longer than the one before."""
    corners = ((0.1, 0.55), (0.3, 0.55), (0.3, 0.75), (0.1, 0.75))
    flow = flow_of(vessel(height=0.8, outline=corners, spacing=0.02), device, "float32")
    times = [0.0]
    while times[-1] < 0.25:
        flow.take(1)
        times.append(flow.time)
    steps, longest = np.diff(times), flow.scene.time_step
    way = 0.02 / (9.81 * np.array(times[1:-1]))
    assert steps[0] == pytest.approx(0.01 * longest, rel=1e-12)
    assert steps[1:] == pytest.approx(np.minimum(np.minimum(1.25 * steps[:-1], longest), way), rel=5e-3)
    assert steps[-1] == pytest.approx(way[-1], rel=5e-3)  # in the end it is the way that counts


@pytest.mark.parametrize(("error", "most"), [(1e-4, 0.018), (3e-6, 0.005)])
def test_a_smaller_error_is_one(error, most):
    """A yield stress that a force overcomes from rest in a channel; measured: 1.74 and 0.35 % at any time."""
    rms, _ = worst(2, 1.0, 1e6, 2e-3, error, 0.2, "cpu", "float64")
    assert 0.6 * most < rms < most


def test_it_is_where_it_was_to_go_and_takes_as_many_steps_as_it_is_told(device):
    flow = flow_of(slump(lift_time=0.0), device)
    for until in (1e-3, 0.05, 0.0500001, 0.2):
        flow.advance(until)
        assert flow.time == pytest.approx(until, rel=1e-12) and flow.goal_reached
    steps = flow.steps
    flow.advance(0.2)
    assert flow.steps == steps
    flow.take(3)
    assert flow.steps == steps + 3 and flow.time > 0.2
    flow.advance(0.1)  # has been
    assert flow.steps == steps + 3


def test_no_step_is_a_sliver():
    """The time left until a wanted time is divided evenly when it is only a few steps long."""
    flow = flow_of(slump(lift_time=0.0), "cpu")
    flow.advance(0.3)
    wanted = flow.next_step
    begun, times = flow.time, [flow.time]
    flow.set_goal(begun + 2.1 * wanted)
    while not flow.goal_reached:
        flow.launch()
        flow.settle()
        times.append(flow.time)
    assert flow.time == pytest.approx(begun + 2.1 * wanted, rel=1e-12)
    assert flow.steps >= 3 and np.diff(times).min() > 0.2 * wanted


@pytest.mark.parametrize(("left", "steps"), [(0.5, 1), (1.0, 1), (1.1, 2), (1.9, 2), (2.1, 3), (3.9, 4), (4.1, 4.1)])
def test_the_time_left_is_divided_into_steps_that_are_no_longer_than_wanted(left, steps):
    """Only four wanted steps or more need no division yet."""
    flow = flow_of(slump(lift_time=0.0), "cpu")
    wanted = flow.next_step
    flow.set_goal(flow.time + left * wanted)
    flow.begin_goal()
    assert flow.mesh.clock.numpy()[int(DT)] == pytest.approx(left * wanted / steps, rel=1e-9)


def test_no_more_steps_are_launched_than_are_left():
    def left(**given):
        flow = dict(adaptive=True, steps=40, time=0.5, next_step=0.01, _goal=60, _goal_time=0.55) | given
        return GridFlow._steps_left.fget(SimpleNamespace(**flow))

    assert [left(), left(_goal_time=0.5501), left(_goal_time=0.5), left(_goal_time=9.0)] == [5, 6, 1, 20]
    assert left(adaptive=False) == 20 and left(_goal_time=np.inf, _goal=10**10) == grid_flow.UNREACHABLE_STEPS


def test_equal_steps_are_as_long_as_the_scene_has_them(device):
    flow = flow_of(slump(step_error=0.0, time_step=2e-3), device)
    flow.advance(0.0211)
    assert flow.steps == 11 and flow.time == pytest.approx(0.022, rel=1e-12) and flow.next_step == 2e-3


def test_a_run_that_goes_on_takes_the_steps_of_one_that_was_not_cut(device):
    """Steps that are wanted, and what they are judged by, go into the checkpoint."""
    scene = slump(lift_time=0.0, duration=0.1)
    whole, cut, rest = (Simulation(scene, device=device) for _ in range(3))
    for one in (whole, cut, rest):
        one.prepare()
    whole.flow.advance(0.03)
    whole.flow.advance(0.06)
    cut.flow.advance(0.03)
    rest.flow.load_state_dict(cut.flow.state_dict())
    assert rest.flow.time == cut.flow.time and rest.flow.next_step == cut.flow.next_step
    rest.flow.advance(0.06)
    assert rest.flow.steps == whole.flow.steps
    for name, array in whole.flow.state_arrays().items():
        assert np.array_equal(array, rest.flow.state_arrays()[name]), name


def test_noise_of_the_transfer_does_not_shorten_steps(device):
    """Films in an L-box flow and stop; measured: 288 steps, most of them of the longest length."""
    scene = scenes.lbox(spacing=0.025, duration=3.0, column_height=0.4, length=0.5)
    run = Simulation(scene, device=device).run()
    assert run.result["steps"] < 400


@pytest.mark.thorough
def test_a_forecast_tells_the_mean_step():
    """A run of a coarser copy forecasts the mean step.

    Concrete takes longer to cross the copy's cells. Measured errors are 1.4 % of the time and 4 % of the step. A thin
    heap of 100 Pa, which is two cells high in the copy, takes a third of the forecast steps.
    """
    scene = slump(spacing=0.0075, yield_stress=500.0, lift_time=0.0, duration=4.0)
    run = Simulation(scene, device="cpu").run()
    course = course_of(Simulation(scene, device="cpu"))
    assert course.duration == pytest.approx(run.series["time"][-1], rel=0.03) and not course.remarks
    assert course.time_step == pytest.approx(run.series["time"][-1] / run.result["steps"], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "spacing"), [("slump", 0.015), ("slump", 0.01), ("funnel", 0.016), ("funnel", 0.0125),
                                               ("lbox", 0.02), ("lbox", 0.016)])  # fmt: skip
def test_forecasts_of_vessels_are_right_within_a_third(name, spacing):
    """Simulated time and number of steps; the mean cost of a step depends on the load of the machine."""
    scene = getattr(scenes, name)(spacing=spacing)
    run = Simulation(scene, device="cpu").run()
    course = course_of(Simulation(scene, device="cpu"))
    assert course.duration == pytest.approx(run.series["time"][-1], rel=0.3)
    assert course.duration / course.time_step == pytest.approx(run.result["steps"], rel=0.3)


@pytest.mark.parametrize(
    ("given", "text"),
    [({"step_error": -1e-3}, "step_error = -0.001"), ({"step_error": 0.7}, "step_error = 0.7"),
     ({"step_error": 0.0, "time_step": 0.02}, "time_step = 0.02: must be shorter, because concrete that falls")],
)  # fmt: skip
def test_what_it_refuses(given, text):
    with pytest.raises(SceneError, match=text):
        slump(**given)


def test_a_column_on_a_piston_has_equal_steps():
    with pytest.raises(SceneError, match=r"step_error = 0\.001: needs a flow on a grid.*set 'ends' to periodic"):
        scenes.channel(step_error=1e-3, ends="piston")
    assert scenes.channel(step_error=1e-3, ends="periodic").step_error == 1e-3


@pytest.mark.parametrize("name", ["slump", "funnel", "lbox"])
def test_what_is_traded_is_the_step_s_error_or_its_length(name):
    module = __import__(f"warpcrete.scenes.{name}", fromlist=["trading"])
    scene = getattr(scenes, name)()
    equal = dataclasses.replace(scene, step_error=0.0, time_step=2e-3)
    for changed, knob in ((scene, "step error"), (equal, "time step")):
        names = [found.name for found in module.trading.knobs(_given(module, changed))]
        assert knob in names and len(names) == 4


def _given(module, scene):
    kind = next(value for value in vars(module).values() if getattr(value, "__module__", "") == module.__name__
                and value.__name__.endswith("Parameters"))  # fmt: skip
    return kind(**scene.parameters | {"step_error": scene.step_error, "time_step": scene.time_step})
