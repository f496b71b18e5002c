"""A pipe that is blocked says so, where and why; one that is not does not."""

import dataclasses
import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from orifices import orifice
from pumping import SMALL, small_run

from warpcrete import SceneError, Simulation, scenes
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.measure import blockage
from warpcrete.dem.measure.quantities import report
from warpcrete.dem.method import METHOD
from warpcrete.dem.scene.clumps import elongated
from warpcrete.dem.scene.scene import Blockage, Bodies, Scene
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import PipeWall, PlaneWall
from warpcrete.studies.cases import Case
from warpcrete.studies.study_result import Study

SHORT = dict(
    diameter=0.08, length=0.24, travel=0.14, ramp=0.02, settle=0.3, size_min=8e-3, size_max=14e-3, unit="horizontal"
)
END = PlaneWall(name="end", point=(0.27, 0, 0), normal=(-1, 0, 0), drawn_radius=0.04)


def closed(**changes):
    """The pipe with a plate at its end."""
    scene = scenes.pipe(**(SHORT | changes))
    return dataclasses.replace(scene, walls=(*scene.walls, END))


@functools.cache
def uncut(device):
    """A run that a closed end stops."""
    return Simulation(closed(stop_when_blocked=True), device=device).run()


def test_a_closed_pipe_is_blocked_at_its_end(device):
    run = uncut(device)
    assert run.finished and run["blocked"] == 1.0 and run.ended.reason == "blocked"
    # The plug's balls are squeezed against the end; the last of the concrete lies two balls before it.
    assert run["blocked_at"] == pytest.approx(0.245, abs=0.02)
    assert run["blocked_from_travel"] == pytest.approx(0.03, abs=0.01)
    window = min(0.08, 0.24 / 5)
    assert run.series["travel"][-1] == pytest.approx(run["blocked_from_travel"] + window, abs=0.25 * window)
    assert run["blocked_pressure"] > 2 * run["blocked_pressure_before"]
    # Measured with eight packings: 0.34 to 0.70. At the end of the pipe, the last balls have void on one side.
    assert run["blocked_chains"] >= 1 and 0.3 < run["blocked_solid_fraction"] < 0.9
    found = scenes.modules()["pipe"].check(run)
    assert [name for name, (passed, _) in found.items() if not passed] == ["not blocked"]
    assert "BLOCKED" in dict(report(run)) and "force chain" in found["not blocked"][1]
    assert "1 force chains" not in found["not blocked"][1] and "a larger --modulus" in found["not blocked"][1]


def test_an_open_pipe_is_not(device):
    run = Simulation(scenes.pipe(**SHORT | {"travel": 0.1}), device=device).run()
    assert run.series["travel"][-1] > uncut(device).series["travel"][-1]
    assert run["blocked"] == 0.0 and "blocked_at" not in run.result


def test_looking_for_it_changes_nothing(device):
    with_it = scenes.pipe(**SMALL)
    assert with_it.blockage is not None
    without = dataclasses.replace(with_it, blockage=None)
    one, other = small_run(device), Simulation(without, device=device).run()
    assert one.result["state_hash"] == other.result["state_hash"] and "blocked" not in other.result


class Cut(Recorder):
    def __init__(self, row):
        self.row = row

    def sample(self, simulation, row):
        simulation.stop_requested = len(simulation.rows) == self.row


@pytest.mark.parametrize("row", [pytest.param(12, marks=pytest.mark.thorough), 30])
def test_a_resumed_run_finds_the_same(device, row, tmp_path):
    whole = uncut(device)
    path = tmp_path / "checkpoint.npz"
    first = Simulation(closed(stop_when_blocked=True), device=device, checkpoint_path=path, recorders=[Cut(row)])
    assert not first.run().finished
    second = Simulation(closed(stop_when_blocked=True), device=device)
    second.resume(path)
    run = second.run()
    for name in ("state_hash", "blocked_at", "blocked_time", "blocked_pressure", "blocked_solid_fraction"):
        assert run.result[name] == whole.result[name]


# Parts of it, on numbers made by hand.


def test_the_part_that_goes_least():
    before = np.arange(200) * 0.01
    after = before + np.where(before < 1.5, 0.1, 0.02)
    volume = np.ones(200)
    assert blockage.least_advance(before, after, volume, 3.0) == pytest.approx(0.02)
    assert blockage.least_advance(before, after, volume, 1.0) == pytest.approx(0.1)  # past the end nothing counts
    thrown = after.copy()
    thrown[-3:] -= 0.5  # a few stones of a part that goes on do not stand for it
    assert blockage.least_advance(before, thrown, volume, 3.0) == pytest.approx(0.02)


def test_a_part_stands_from_the_last_check_before_it_was_found_to_stand(monkeypatch):
    """Stop the last part of a column at a travel of 30 mm, with checks every 10 mm; 80 mm later it has blocked."""
    scene = scenes.pipe(**SHORT)
    model = SimpleNamespace(scene=dataclasses.replace(scene, blockage=Blockage(travel=0.08)), stress_scale=1e5)
    watch = blockage.BlockageWatch(model, SimpleNamespace(body_count=100))  # type: ignore[arg-type]
    start, volume = np.linspace(0.05, 0.2, 100), np.ones(100)
    monkeypatch.setattr(watch, "_describe", lambda row, s, volume: {"travel": watch._stand_travel, "now": row["travel"],
                                                                     "pressure_before": watch._pressure})  # fmt: skip
    for number in range(15):
        travel = 0.01 * number
        places = start + np.where(start > 0.15, min(travel, 0.03), travel)
        monkeypatch.setattr(watch, "_aggregates", lambda places=places: (places, volume))
        watch({"travel": travel + 1e-9 * number, "pressure": 1e3 * number})
        if watch.found:
            break
    assert watch.found["travel"] == pytest.approx(0.03, abs=1e-6)
    assert watch.found["now"] == pytest.approx(0.11, abs=1e-6) and watch.found["pressure_before"] == 4e3


def test_where_the_load_ends():
    stations = np.linspace(0, 1, 101)
    places = np.stack([np.linspace(0, 0.6, 61) - 0.02, np.linspace(0, 0.6, 61) + 0.02], 1)
    assert blockage.last_loaded(stations, np.full(61, 3.0), places) == pytest.approx(0.6, abs=0.011)


def test_patience():
    assert blockage.blockage_travel(0.15, 1.0, 1e5) == pytest.approx(0.15)
    assert blockage.blockage_travel(0.15, 3.0, 1e5) == pytest.approx(0.3)
    assert blockage.blockage_travel(0.15, 0.3, 1e5) == pytest.approx(0.06)
    assert blockage.blockage_travel(0.15, 1.0, 1e9) == pytest.approx(0.05)
    assert blockage.blockage_travel(0.15, 1.0, 2e6) == pytest.approx(0.1)


def across(count, gap=0.0, shift=0.0) -> Scene:
    """Spheres in a row across a pipe of 0.1 m; with a `gap` in the middle."""
    size = 0.1 / count
    y = (np.arange(count) - (count - 1) / 2) * size
    y += np.where(y > 0, gap, 0.0)
    return Scene(
        name="row", duration=1.0, gravity=(0, 0, 0),
        bodies=(Bodies(positions=np.stack([np.full(count, 0.5 + shift), y, 0 * y], 1), sizes=1.02 * size),),
        walls=(PipeWall(name="pipe", axis=Axis((0, 0, 0), (1, 0, 0), (Line(1.0),)), radius=0.05),),
    )  # fmt: skip


def test_a_row_across_spans_the_pipe(start):
    stepper = start(across(5))
    body, point = blockage.wall_contacts(stepper.model, stepper.state)
    assert sorted(np.abs(point[:, 1]).round(6)) == [0.05, 0.05] and len(body) == 2
    axis = stepper.model.walls[0].axis
    pairs = np.stack([np.arange(4), np.arange(1, 5)], 1)
    assert blockage.count_spanning_networks(stepper.model, stepper.state, axis, 0.5, 0.1, pairs) == 1
    assert (
        blockage.count_spanning_networks(stepper.model, stepper.state, axis, 0.5, 0.1, pairs[[0, 1, 3]]) == 0
    )  # one link is missing
    assert blockage.count_spanning_networks(stepper.model, stepper.state, axis, 0.8, 0.1, pairs) == 0  # not there


def test_a_stone_across_the_pipe_spans_it_only_as_part_of_a_strong_contact(start):
    """It touches both sides of the wall, but a network consists of strong contacts between bodies."""
    template = elongated(3.0)
    size = 0.0501 / float(np.max(np.abs(template.offsets[:, 0]) + template.radii))
    turn = [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]  # from x, the axis of the pipe, to y
    bodies = Bodies(positions=[[0.5, 0, 0], [0.5 + size, 0, 0]], sizes=size, template=template, orientations=[turn] * 2)
    stepper = start(dataclasses.replace(across(2), bodies=(bodies,)))
    body, point = blockage.wall_contacts(stepper.model, stepper.state)
    assert sorted(body.tolist()) == [0, 0, 1, 1] and np.abs(point[:, 1]) == pytest.approx(0.05, abs=1e-6)
    axis = stepper.model.walls[0].axis
    for chains, count in ((np.zeros((0, 2), int), 0), (np.array([[0, 1]]), 1)):
        assert blockage.count_spanning_networks(stepper.model, stepper.state, axis, 0.5, 0.2, chains) == count


def test_loads_are_the_axial_part(start):
    # Two overlapping spheres, at 60 degrees to the axis.
    lean = np.array([np.cos(np.pi / 3), np.sin(np.pi / 3), 0.0])
    scene = dataclasses.replace(
        across(2), bodies=(Bodies(positions=[[0.5, 0, 0], 0.0195 * lean + [0.5, 0, 0]], sizes=0.02),)
    )
    stepper = start(scene)
    forces, places, strong = blockage.axial_forces(stepper.model, stepper.state, stepper.model.walls[0].axis)
    stiffness = 1e5 * np.pi * 0.01**2 / 0.02
    assert forces == pytest.approx([0.5 * stiffness * 0.0005], rel=1e-6) and len(strong) == 0
    assert places == pytest.approx(np.array([[0.5, 0.5 + 0.0195 / 2]]))


def test_blockage_needs_a_pipe_and_a_pressure():
    with pytest.raises(SceneError, match=r"^blockage = .*needs a pipe and a pressure"):
        Scene(name="none", duration=1.0, blockage=Blockage(stop=True))
    assert not Scene(name="none", duration=1.0, blockage=Blockage()).looks_for_blockage


@pytest.mark.thorough
@pytest.mark.parametrize(("ratio", "blocked"), [(1.5, True), (2.0, True), (5.0, False)])
def test_stones_of_half_the_pipe_block_it_and_small_ones_do_not(device, ratio, blocked):
    run = Simulation(orifice(ratio), device=device).run()
    assert run["blocked"] == blocked
    if blocked:  # before the narrow pipe, which begins at 0.195 m
        assert 0.1 < run["blocked_at"] < 0.2 and run["blocked_chains"] >= 1
        # In eight packings none of 244 got so far into its mouth, but for one in one of them (0.242 m).
        assert np.count_nonzero(run.bodies.position[:, 0] > 0.23) <= 2
    else:
        assert np.count_nonzero(run.bodies.position[:, 0] > 0.235) > 30


def test_a_study_tells_how_often(tmp_path):
    cases = [Case(name=f"{d}-{k}", varied={"diameter": d}, parameters={}) for d in (0.1, 0.2) for k in range(4)]
    told = dict(zip([case.name for case in cases], [1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], strict=True))
    study = Study(tmp_path, "pipe", cases, METHOD.quantities, results={k: {"blocked": v} for k, v in told.items()})
    assert [row["blocked"] for row in study.rows()] == [0.75, 0.0]
    assert "| 75 +- 50 |" in study.markdown()
    never = Study(tmp_path, "pipe", cases, METHOD.quantities, results={k: {"blocked": 0.0} for k in told})
    assert "blocked" not in [each.name for each in never.compared]
