"""Rows of the series that are completed while a GPU takes the next steps, as far as a CPU can do it."""

import dataclasses

import numpy as np
import pytest
from pumping import TINY
from test_blockage import closed
from test_recording_later import contents

from warpcrete import Simulation, scenes
from warpcrete.core.errors import InstabilityError
from warpcrete.core.run.recorder import Recorder, says
from warpcrete.dem.engine.batch import Batch
from warpcrete.dem.measure.blockage import BlockageWatch
from warpcrete.dem.simulation import ElementSimulation
from warpcrete.record.paraview import ParaViewRecorder
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.usd import UsdRecorder

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("like_a_gpu")]


class Rows(Recorder):
    """Keeps each row with where the run was then."""

    rows_alone = True

    def __init__(self):
        self.rows = []

    def sample(self, simulation, row):
        self.rows.append((*simulation.sampled, row["time"], row["pressure"]))


def test_rows_are_completed_while_steps_go_on(monkeypatch):
    """The same rows, in the same order; where a look may find a blockage none is left for later."""
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    begun, begin = [], ElementSimulation.begin_measure
    monkeypatch.setattr(ElementSimulation, "begin_measure", lambda self: begun.append(begin(self)) or begun[-1])
    runs, rows = [], []
    for later in (True, False):
        recorder = Rows()
        monkeypatch.setattr(Rows, "rows_alone", later)
        runs.append(Simulation(scene, device="cpu", recorders=[recorder], frame_interval=1.0).run())
        rows.append(recorder.rows)
    assert sum(begun) > 15 and not all(begun) and len(begun) < len(rows[0])
    assert rows[0] == rows[1] and all(time == of_row for time, _, of_row, _ in rows[0])
    assert runs[0].result["state_hash"] == runs[1].result["state_hash"]
    for name in runs[1].series:
        assert np.array_equal(runs[0].series[name], runs[1].series[name], equal_nan=True), name


@pytest.mark.parametrize("blocked", [False, True], ids=["open", "closed"])
def test_looks_for_a_blockage_are_completed_while_steps_go_on(blocked, monkeypatch):
    """They see what they would have seen at once; none that may find one is left for later."""
    scene = closed(stop_when_blocked=True) if blocked else scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    looks, begun, look, begin = [], [], BlockageWatch.__call__, BlockageWatch.begin

    def looked(self, row):
        before, standing = self._looked, self._standing
        look(self, row)
        if self._looked != before:
            looks[-1].append((row["time"], self._standing, self._places.tobytes()))
        assert not self.found or standing is not None

    monkeypatch.setattr(BlockageWatch, "__call__", looked)
    monkeypatch.setattr(BlockageWatch, "begin", lambda self: begun.append(self._looked) or begin(self))
    runs = []
    for later in (True, False):
        looks.append([])
        if not later:
            monkeypatch.setattr(BlockageWatch, "may_wait", False)
        runs.append(Simulation(scene, device="cpu", frame_interval=1.0).run())
    assert looks[0] == looks[1] and 3 < len(begun) < len(looks[0])
    assert [run.result["state_hash"] for run in runs] == [runs[0].result["state_hash"]] * 2
    assert [run["blocked"] for run in runs] == [float(blocked)] * 2
    if blocked:
        assert runs[0]["blocked_time"] == runs[1]["blocked_time"] == runs[0].series["time"][-1]


class Frames(Rows):
    """Keeps when frames were taken, and how many rows there were."""

    draws_alone = True

    def frame(self, simulation):
        self.rows.append(("frame", *simulation.sampled, simulation.stepper.time, len(simulation.rows)))


def test_frames_are_taken_before_a_run_goes_on(monkeypatch):
    """At the moments at which they would be otherwise, though the row of that moment is not complete."""
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    begun, begin = [], ElementSimulation.begin_measure
    monkeypatch.setattr(ElementSimulation, "begin_measure", lambda self: begun.append(begin(self)) or begun[-1])
    taken = []
    for alone in (True, False):
        recorder = Frames()
        monkeypatch.setattr(Frames, "draws_alone", alone)
        simulation = Simulation(scene, device="cpu", recorders=[recorder], frame_interval=2e-3)
        run = simulation.run()
        taken.append((recorder.rows, run.result["state_hash"]))
    frames, plain = ([row for row in rows if row[0] == "frame"] for rows, _ in taken)
    assert [row[1:4] for row in frames] == [row[1:4] for row in plain] and len(frames) > 10
    assert all(row[1] == row[3] for row in frames)
    assert sum(one[4] < other[4] for one, other in zip(frames, plain)) > 5  # left for later
    rows, others = ([row for row in rows if row[0] != "frame"] for rows, _ in taken)
    assert rows == others and taken[0][1] == taken[1][1]


def test_a_frame_that_fails_does_not_cost_the_row_of_its_moment(monkeypatch):
    monkeypatch.setattr(ElementSimulation, "begin_measure", lambda self: self.sampler.begin() or True)

    class Full(Frames):
        draws_alone = True

        def frame(self, simulation):
            super().frame(simulation)
            if simulation.sampled[0] > 0.01:
                raise OSError("no space left")

    recorder = Full()
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    simulation = Simulation(scene, device="cpu", recorders=[recorder], frame_interval=2e-3)
    with pytest.raises(OSError, match="no space left"):
        simulation.run()
    *_, (_, time, *_), (last, *_) = recorder.rows
    assert time == last == simulation.rows[-1]["time"] == simulation.stepper.time > 0.01


@pytest.mark.parametrize("recorder", [RerunRecorder, UsdRecorder, ParaViewRecorder])
def test_what_is_drawn_does_not_hang_on_rows(recorder, monkeypatch, tmp_path):
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    found = []
    for alone in (True, False):
        monkeypatch.setattr(recorder, "draws_alone", alone)
        folder = tmp_path / str(alone)
        folder.mkdir()
        names = {RerunRecorder: "run.rrd", UsdRecorder: "scene.usdc", ParaViewRecorder: ""}
        recorders = [recorder(folder / names[recorder])]
        Simulation(scene, device="cpu", recorders=recorders, frame_interval=2e-3).run()
        found.append(contents(folder))
    assert found[0] == found[1] and sum(len(str(values)) for values in found[0].values()) > 10_000


def test_what_a_row_completed_later_complains_of_ends_the_run(monkeypatch):
    """And it keeps that row."""
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    monkeypatch.setattr(ElementSimulation, "begin_measure", lambda self: self.sampler.begin() or True)
    watched, watch = [], ElementSimulation.watch_row

    def complain(self, row):
        watch(self, row)
        watched.append(row["time"])
        if len(watched) == 7:
            raise InstabilityError("enough")

    monkeypatch.setattr(ElementSimulation, "watch_row", complain)
    simulation = Simulation(scene, device="cpu")
    with pytest.raises(InstabilityError, match="enough"):
        simulation.run()
    assert [row["time"] for row in simulation.rows] == watched
    assert simulation.stepper.time > watched[-1]


def test_an_interrupted_run_completes_the_row_that_it_began(monkeypatch):
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=1e-3)
    monkeypatch.setattr(ElementSimulation, "begin_measure", lambda self: self.sampler.begin() or True)
    launched, launch = [], Batch.launch

    def interrupted(self):
        launched.append(simulation.sampled[0] if simulation.__dict__.get("sampler") else 0.0)
        if launched[-1] > 0.01:
            raise KeyboardInterrupt
        launch(self)

    monkeypatch.setattr(Batch, "launch", interrupted)
    simulation = Simulation(scene, device="cpu")
    run = simulation.run()
    assert run.interrupted and run.series["time"][-1] == launched[-1]


class Broken(Rows):
    """Its last row fails, in a way that nobody foresaw."""

    rows_alone = True
    finished = False

    def sample(self, simulation, row):
        super().sample(simulation, row)
        if simulation.time_is_up:
            raise ValueError("no such row")

    def finish(self, simulation, run):
        self.finished = True


def test_a_row_that_fails_after_an_interruption_does_not_cost_the_outputs(monkeypatch):
    monkeypatch.setattr(ElementSimulation, "begin_measure", lambda self: self.sampler.begin() or True)
    monkeypatch.setattr(ElementSimulation, "time_is_up", False, raising=False)
    launch = Batch.launch

    def interrupted(self):
        if simulation.sampled[0] > 0.005:
            simulation.time_is_up = True
            raise KeyboardInterrupt
        launch(self)

    monkeypatch.setattr(Batch, "launch", interrupted)
    recorder = Broken()
    scene = scenes.pipe(**TINY, sample_interval=1e-3)
    simulation = Simulation(scene, device="cpu", recorders=[recorder], frame_interval=1.0)
    with pytest.raises(ValueError, match="no such row"):
        simulation.run()
    assert recorder.finished and len(recorder.rows) > 5


def test_rows_that_no_step_lies_between_are_all_there(monkeypatch):
    """Samples closer than steps: each has its row, whether it was left for later or not."""
    scene = dataclasses.replace(scenes.pipe(**TINY), duration=1e-3, sample_interval=1e-5)
    rows = []
    for later in (True, False):
        recorder = Rows()
        monkeypatch.setattr(Rows, "rows_alone", later)
        run = Simulation(scene, device="cpu", recorders=[recorder], frame_interval=1.0).run()
        rows.append(recorder.rows)
        assert len(run.series["time"]) == len(recorder.rows) == 101 and run.result["steps"] < 60
    assert rows[0] == rows[1]


def test_a_recorder_that_reads_the_state_is_not_left_for_later():
    """Though the class that it is made of reads rows alone."""

    class Reading(Rows):
        def sample(self, simulation, row):
            super().sample(simulation, row)

    told = [says(kind, "sample", "rows_alone") for kind in (Recorder, Rows, Reading)]
    assert told == [True, True, False]
