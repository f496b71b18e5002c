"""Recorders beside the run: what they show of a moment that has passed, what holds them up, what ends them."""

import math
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from pumping import wait_until
from test_recordings import columns, everything, recording

from warpcrete import RunFolderError, Simulation, scenes
from warpcrete.core.device import interpreter_priority as turns
from warpcrete.core.device.recorder_thread import MAXIMUM_JOBS, RecorderThread
from warpcrete.core.drawing import snapshots as moments
from warpcrete.core.drawing.display import Display
from warpcrete.core.drawing.snapshots import PendingCopies, PinnedPool, snapshot_of
from warpcrete.record.paraview import ParaViewRecorder
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.usd import UsdRecorder

SMALL = dict(diameter=0.08, length=0.1, ramp=0.0, travel=0.008, settle=0.0, size_min=8e-3, size_max=16e-3, plug="plate")
PASTE = dict(concrete="own", density=2300.0, viscosity=20.0, yield_stress=100.0)
DRAWN = {
    "pipe": (lambda: scenes.pipe(shapes="reference", hydration=0.5, hydration_modulus=1e6, **SMALL), "speed", True),
    "pipe, force": (lambda: scenes.pipe(**SMALL), "force", False),
    "pipe, size": (lambda: scenes.pipe(**SMALL), "size", False),
    "channel": (lambda: scenes.channel(spacing=2e-2, duration=0.01, sample_interval=2e-3), "pressure", False),
    "grains": (lambda: scenes.channel(spacing=5e-3, duration=5e-3, sample_interval=1e-3, aggregates=True), "phase",
               False),
    "ring": (lambda: scenes.tube(ends="periodic", spacing=1e-2, duration=0.01, sample_interval=2e-3), "speed", False),
    "slump": (lambda: scenes.slump(**PASTE, spacing=0.02, duration=0.05, sample_interval=0.01), "shear", False),
    "funnel": (lambda: scenes.funnel(**PASTE, spacing=0.015, duration=0.02, sample_interval=5e-3), "speed", False),
    "part": (lambda: scenes.modules()["part"].scene(concrete="no1", unit="bend-to-vertical", spacing=0.0125,
                                                    duration=0.02, sample_interval=5e-3), "pressure", False),
    "part of elements": (lambda: scenes.part_dem(unit="horizontal", diameter=0.08, straight=0.1, size_min=12e-3,
                                                 size_max=20e-3, travel=4e-3, ramp=0.0, settle=0.0, flow=1e-3,
                                                 plug="plate", sample_interval=1e-3), "force", False),
}  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize("name", DRAWN)
def test_what_is_drawn_later_is_what_was_there(name, device, tmp_path, monkeypatch, shared_packings):
    """Every display takes all that it draws of a moment: a recorder that lags shows the same."""
    make, colouring, network = DRAWN[name]
    found = []
    for in_thread in (False, True):
        recording(monkeypatch, in_thread)
        folder = tmp_path / str(in_thread)
        folder.mkdir()
        recorders = [RerunRecorder(folder / "run.rrd", colouring=colouring, network=network),
                     UsdRecorder(folder / "scene.usdc", colouring=colouring),
                     ParaViewRecorder(folder, colouring=colouring)]  # fmt: skip
        if in_thread:
            for recorder in recorders:
                lag(recorder, monkeypatch)
        run = Simulation(make(), device=device, threads=1, recorders=recorders, frame_interval=1e-4).run()
        found.append((run.result["state_hash"], contents(folder)))
    assert found[0] == found[1]
    assert len(next(iter(found[0][1].values()))) > 3


def lag(recorder, monkeypatch):
    """Let a recorder draw when the run is further on."""
    draw = recorder._draw

    def slowly(*snapshot):
        if threading.current_thread() is not threading.main_thread():
            time.sleep(0.02)
        draw(*snapshot)

    monkeypatch.setattr(recorder, "_draw", slowly)


def contents(folder):
    """All that recordings hold of bodies, walls, networks and curves, as text."""
    from pxr import Usd
    from rerun.chunk import RrdReader

    run, scene, found = folder / "run.rrd", folder / "scene.usdc", {}
    chunks = RrdReader(str(run)).stream().to_chunks() if run.is_file() else []
    for entity in sorted({str(chunk.entity_path) for chunk in chunks if not chunk.is_static}):
        if entity.startswith(("/scene", "/pressure", "/shape", "/slip", "/energy", "/friction", "/profile")):
            held = columns(run, entity)
            found |= {f"{entity} {column}": [str(v) for v in values] for column, values in held.items()}
    stage = Usd.Stage.Open(str(scene)) if scene.is_file() else Usd.Stage.CreateInMemory()
    for prim in stage.Traverse():
        for attribute in prim.GetAttributes():
            codes = attribute.GetTimeSamples()
            if codes:
                found[str(attribute.GetPath())] = [(code, str(attribute.Get(code))) for code in codes]
    for path in sorted(folder.glob("*.vtkhdf")):
        found |= {f"{path.stem} {name}": [str(array.tolist())] for name, array in everything(path).items()}
    return found


class Unanswering:
    """A stream whose writer takes its time, or died of a full disk; `path` grows by what it writes."""

    def __init__(self, path, answers_after=math.inf):
        self.path, self.left, self.closed = path, answers_after, threading.Event()

    def flush(self, timeout_sec):
        self.left -= 1
        if self.left < 0:
            return
        time.sleep(timeout_sec)
        if math.isfinite(self.left):
            self.path.write_bytes(self.path.read_bytes() + b"more")
        raise RuntimeError("Flush timed out")

    def disconnect(self):
        if not math.isfinite(self.left):
            self.closed.wait(20)


def test_a_moment_stays_as_it_was_and_its_memory_is_used_again(device):
    class Run:
        stepper = SimpleNamespace(time=0.0, steps=0)

    run, array = Run(), wp.zeros((1000, 3), dtype=wp.float32, device=device)
    taken = []
    for steps in range(3):
        run.stepper.steps = steps
        array.fill_(float(steps))
        taken.append(snapshot_of(run, {"a": lambda: array, "steps": lambda: run.stepper.steps}))
    array.fill_(-1.0)
    for steps, snapshot in enumerate(taken):
        assert snapshot.read("steps") == steps
        assert np.all(snapshot.read("a") == steps) and snapshot.read("a").shape == (1000, 3)
    last = snapshot_of(run, {"a": lambda: array})
    assert np.all(last.read("a") == 2)  # of the same moment: not read again
    if array.device.is_cuda:
        used = {snapshot.values["a"]._buffers for snapshot in taken}
        del snapshot, taken
        for steps in range(3, 9):  # the copies are a graph now
            run.stepper.steps = steps
            array.fill_(float(steps))
            again = snapshot_of(run, {"a": lambda: array, "steps": lambda: run.stepper.steps}).values["a"]
            assert again._buffers in used and np.all(again["a"] == steps)
        array = wp.full((7, 3), -1.0, dtype=wp.float32, device=device)  # lists have become others
        run.stepper.steps = 9
        other = snapshot_of(run, {"a": lambda: array, "steps": lambda: run.stepper.steps})
        assert other.values["a"]._buffers not in used and np.all(other.read("a") == -1)


def test_what_is_worked_out_of_a_moment_is_that_of_all_who_draw_it(device):
    """Once a moment, whoever asks first; of what is drawn at once each time."""

    class Bare(Display):
        colourings = ("plain",)
        centres = colours = plots = radii = walls = bounds = None

    Bare.__abstractmethods__ = frozenset()
    asked = []

    class Run:
        stepper = SimpleNamespace(time=0.0, steps=0)

    run = Run()
    one, other = Bare(run), Bare(run)

    def job(display):
        return lambda time, steps: display.derived("half", lambda: asked.append(steps))

    for display in (one, other):
        display.draw(RecorderThread(in_thread=False), job(display))
    assert asked == [0, 0]
    later = RecorderThread(in_thread=True)
    for display in (one, other):
        display._complete = True
    for steps in (1, 2):
        run.stepper.steps = steps
        for display in (one, other):
            display.draw(later, job(display))
    later.close()
    assert asked == [0, 0, 1, 2]


def test_copies_that_never_come_are_told(device, monkeypatch):
    array = wp.zeros(3, dtype=wp.float32, device=device)
    if not array.device.is_cuda:
        pytest.skip("needs a GPU: on a CPU copies to the host are complete at once")
    monkeypatch.setattr(moments, "COPY_TIMEOUT", 0.0)
    copies = PendingCopies({"a": array}, PinnedPool())
    wp.synchronize()
    copies._views[""][0] = 0
    with pytest.raises(RuntimeError, match="took longer than"):
        copies["a"]


def test_a_writer_that_never_answers_does_not_hold_up_the_end(tmp_path, monkeypatch):
    """One line, and nothing that waits for it when the program ends; one that is slow is waited for."""
    given_up = []
    monkeypatch.setattr("warpcrete.record.rerun_stream.PATIENCE", 0.15)
    monkeypatch.setattr("warpcrete.record.rerun_stream.POLL_INTERVAL", 0.05)
    monkeypatch.setattr("atexit.unregister", given_up.append)
    path = tmp_path / "run.rrd"
    path.write_bytes(b"begun")
    for stream, dies in ((Unanswering(path), True), (Unanswering(path, 4), False)):
        recorder = RerunRecorder(path)
        recorder._stream._recording = stream
        if dies:
            with pytest.raises(RunFolderError, match=r"run\.rrd': cannot be written \(Flush timed out\); .* are kept$"):
                recorder.finish(None, None)
            stream.closed.set()
            assert [each.__name__ for each in given_up] == ["rerun_shutdown"]
        else:
            recorder.finish(None, None)
            assert stream.left == -1 and len(given_up) == 1
    assert path.read_bytes() == b"begun" + 4 * b"more"


def test_jobs_are_done_in_order_and_the_run_waits_for_those_that_lag():
    done, go, waited = [], threading.Event(), threading.Event()
    later = RecorderThread(in_thread=True)

    def fill():
        for number in range(MAXIMUM_JOBS + 3):
            later.submit(lambda number=number: (go.wait(), done.append(number)))
        waited.set()

    run = threading.Thread(target=fill)
    run.start()
    assert not waited.wait(0.2) and not done  # one is at work, so many wait, and the run with the next
    go.set()
    run.join(5)
    later.wait()
    assert done == list(range(MAXIMUM_JOBS + 3))
    later.close()


@pytest.mark.parametrize("end", ["submit", "wait", "close"])
def test_what_a_job_fails_with_is_raised_from_then_on(end):
    """Who puts up with it once, as a checkpoint does, is told again, or a recording would end without a word."""
    done = []

    def fail():
        raise OSError("no room")

    later = RecorderThread(in_thread=True)
    later.submit(lambda: done.append(1))
    later.submit(fail)
    with pytest.raises(OSError, match="no room"):
        for _ in range(100):
            getattr(later, end)(*([lambda: done.append(2)] if end == "submit" else []))
            time.sleep(0.05)
    for call in (later.wait, lambda: later.submit(lambda: done.append(3)), later.close):
        with pytest.raises(OSError, match="no room"):
            call()
    assert done == [1]
    with pytest.raises(OSError, match="no room"):
        RecorderThread(in_thread=False).submit(fail)


def test_a_frame_that_cannot_be_drawn_costs_its_recording_alone(tmp_path, monkeypatch):
    recording(monkeypatch, True)
    recorder, frames = UsdRecorder(tmp_path / "scene.usdc"), []

    def draw(when, steps, draw=recorder._draw):
        frames.append(when)
        if len(frames) == 3:
            raise OSError("no paint")
        draw(when, steps)

    monkeypatch.setattr(recorder, "_draw", draw)
    simulation = Simulation(
        scenes.pipe(**SMALL | dict(travel=0.02)), device="cpu", recorders=[recorder], frame_interval=1e-4,
        checkpoint_path=tmp_path / "checkpoint.npz", checkpoint_every=0.0,
    )  # fmt: skip
    with pytest.warns(UserWarning, match="^UsdRecorder failed, and the run continues without its output: no paint$"):
        assert simulation.run().finished
    assert len(frames) == 3 and (tmp_path / "scene.usdc").is_file()
    assert not (tmp_path / "checkpoint.npz").exists()


def test_a_recorder_gives_way_to_a_run_that_has_work_for_its_device(monkeypatch):
    """It works while the run waits for the device, or for the recorder; or when it has been patient for long enough."""
    monkeypatch.setattr(turns, "LONGEST_YIELD", 30.0)
    later, done = RecorderThread(in_thread=True, yields_to_run=True), []

    def job(name):
        done.append(name)
        later.yield_to_run()
        done.append(f"{name}, second part")

    later.submit(lambda: job("first"))
    time.sleep(0.05)
    assert not done
    with turns.run_is_waiting():
        assert wait_until(lambda: len(done) == 2, 60)
    later.submit(lambda: job("second"))
    later.wait()
    later.submit(lambda: job("third"))
    later.close()
    assert done == [f"{name}{part}" for name in ("first", "second", "third") for part in ("", ", second part")]
    monkeypatch.setattr(turns, "LONGEST_YIELD", 1e-3)
    busy = RecorderThread(in_thread=True, yields_to_run=True)
    busy.submit(lambda: done.append("though nobody waits"))
    assert wait_until(lambda: done[-1] == "though nobody waits", 60)
    busy.close()
    later.yield_to_run()  # of others than its thread it keeps nobody


def test_recorders_give_way_on_a_gpu_alone():
    """Where the run never waits for a device they would only be patient."""
    for cuda in (False, True):
        device = SimpleNamespace(is_cuda=cuda)
        later = RecorderThread.for_simulation(SimpleNamespace(device=device, shares_cores=False, threads=0))
        assert later.in_thread and later._yields_to_run is cuda


def test_a_run_that_goes_on_does_not_keep_the_recorders_of_another_that_waits():
    with turns.run_is_waiting():
        with turns.run_is_waiting():
            assert turns._run_waits.is_set()
        assert turns._run_waits.is_set()
    assert not turns._run_waits.is_set()
