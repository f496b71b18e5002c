"""The entry `ended` of a run's result, for every way in which a run ends."""

import errno
import json
import os
import pickle
import signal
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from pumping import TINY, command, small_options, small_run, wait_until

import warpcrete
from warpcrete import ConvergenceError, InstabilityError, Simulation, scenes
from warpcrete.core.device.device import find_device
from warpcrete.core.run.ending import REASONS, Ending
from warpcrete.core.run.method import Quantity, results_of
from warpcrete.core.run.recorder import Recorder
from warpcrete.record.run_folder import TableRecorder

CPU = dict(device="cpu", threads=1)
FLOW = dict(spacing=10e-3)
FAST = dict(diameter=0.06, length=0.1, size_min=8e-3, size_max=12e-3, settle=0.1, ramp=0.005, travel=0.01)


def ended(folder):
    """Return the contents of result.json and its entry `ended`."""
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    return result, Ending.of(result)


class At(Recorder):
    """Does something at the second row."""

    def __init__(self, act):
        self.act = act

    def sample(self, simulation, row):
        if len(simulation.rows) == 2:
            self.act(simulation)


def fails_with(error):
    def act(simulation):
        raise error

    return act


def test_a_pump_run_ends_with_the_travel_of_its_piston():
    run = small_run("cpu")
    assert run.ended.reason == "travel" and run.ended.time == run["simulated_time"]
    assert run.ended.message == str(run.ended) == f"the piston completed its travel at t = {run.ended.time:.4g} s"
    assert "finished (travel)" in repr(run)


def test_a_flow_ends_steady_or_after_its_duration(tmp_path):
    run = Simulation(scenes.channel(**FLOW), **CPU).run()
    run.save(tmp_path / "run")
    assert run.ended.reason == "steady" and ended(tmp_path / "run")[1] == run.ended
    assert warpcrete.load(tmp_path / "run").ended == run.ended
    # A flow whose duration is stated lasts as long, even if it becomes steady before.
    for duration, steady in ((0.01, False), (2 * run.ended.time, True)):
        timed = Simulation(scenes.channel(**FLOW, duration=duration), **CPU).run()
        assert timed.ended.reason == "duration" and timed.result["steady"] == steady
        assert timed.ended.message == f"the run has reached its duration of {duration:.4g} s"


def test_a_slump_ends_at_rest_and_a_funnel_empty():
    slump = scenes.slump(yield_stress=600.0, viscosity=60.0, spacing=0.025)
    assert Simulation(slump, **CPU).run().ended.reason == "rest"
    short = Simulation(scenes.slump(yield_stress=600.0, viscosity=60.0, spacing=0.025, duration=0.1), **CPU).run()
    assert short.ended.reason == "duration" and not short.result["at_rest"]
    with pytest.raises(KeyError, match="no quantity 't500': runs have this quantity only if the spread grows"):
        short["t500"]
    with pytest.raises(KeyError, match=r"no quantity .spred.; similar names are .*spread"):
        short["spred"]
    funnel = Simulation(scenes.funnel(yield_stress=0.0, viscosity=2.0, spacing=0.016), **CPU).run()
    assert funnel.ended.reason == "empty" and "funnel_time" in funnel.result


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (InstabilityError("burst", time=0.5, body=3), "unstable"),
        (ConvergenceError(0.5, "pressure", 2, [1.0, 0.5], 0.1, 2), "unconverged"),
        (RuntimeError("broken"), "failed"),
        (OSError(errno.ENOSPC, "no space"), "disk full"),
    ],
)
def test_a_run_that_an_error_ends_says_so(tmp_path, error, reason):
    with pytest.raises(Exception, match=r"burst|converge|broken|no space"):
        Simulation(scenes.channel(**FLOW), **CPU, out=tmp_path / "run", recorders=[At(fails_with(error))]).run()
    result, why = ended(tmp_path / "run")
    assert not result["finished"] and result["steps"] > 0
    assert why.reason == reason in REASONS and 0 < why.time == result["simulated_time"]["value"]
    assert why.message == (str(error) if reason.startswith("un") else repr(error))


def test_interruptions_and_requests_to_stop(tmp_path):
    def request(simulation):
        simulation.stop_requested = True

    for name, act in (("stopped", request), ("interrupted", fails_with(KeyboardInterrupt()))):
        run = Simulation(scenes.channel(**FLOW), **CPU, out=tmp_path / name, recorders=[At(act)]).run()
        assert run.ended == ended(tmp_path / name)[1] and run.ended.reason == "interrupted"
        assert run.ended.message == f"interrupted at t = {run.ended.time:.3f} s" and "not finished (int" in repr(run)
    # A run that goes on ends as any other.
    assert Simulation(scenes.channel(**FLOW), **CPU, out=tmp_path / "stopped").run().ended.reason == "steady"
    assert ended(tmp_path / "stopped")[1].reason == "steady"


def test_a_recorder_that_fails_at_the_end_is_the_reason(tmp_path):
    class Broken(Recorder):
        def finish(self, simulation, run):
            raise RuntimeError("broken")

    for words, every in (("kept", 60), ("none", 0)):
        with pytest.raises(RuntimeError, match="broken"):
            settings = dict(out=tmp_path / words, recorders=[Broken()], checkpoint_every=every)
            Simulation(scenes.channel(**FLOW), **CPU, **settings).run()
        result, why = ended(tmp_path / words)
        assert not result["finished"] and why.reason == "failed" and "broken" in why.message


def broken(*unused):
    raise ZeroDivisionError("broken")


def test_results_that_cannot_be_computed_leave_the_series_and_the_error(tmp_path, monkeypatch):
    """An error in the results of a run neither prevents its recordings nor hides the error that ended the run."""
    flow = type(Simulation(scenes.channel(**FLOW), **CPU))
    monkeypatch.setattr(flow, "sizes", broken)
    for name, at, error, reason in (
        ("complete", [], ZeroDivisionError, "failed"),
        ("interrupted", [At(fails_with(KeyboardInterrupt()))], ZeroDivisionError, "interrupted"),
        ("burst", [At(fails_with(InstabilityError("burst", time=0.5)))], InstabilityError, "unstable"),
    ):
        settings = dict(out=tmp_path / name, recorders=at, checkpoint_every=0)
        with pytest.raises(error, match=r"broken|burst"):
            Simulation(scenes.channel(**FLOW, duration=0.05), **CPU, **settings).run()
        result, why = ended(tmp_path / name)
        assert why.reason == reason and not result["finished"] and result["steps"] > 0
        assert result["simulated_time"]["value"] == why.time > 0 and "provenance" in result
        assert len((tmp_path / name / "series.csv").read_text(encoding="utf-8").splitlines()) > 2


def test_results_count_the_steps_that_an_interruption_kept_the_host_from_counting():
    simulation = Simulation(scenes.channel(**FLOW), **CPU)
    simulation.begin()
    simulation.flow.set_goal(steps=3)
    simulation.flow.launch()
    result = simulation.result(False).result
    assert result["steps"] == 3 and result["simulated_time"]["value"] == simulation.flow.time > 0


def test_a_quantity_that_cannot_be_computed_costs_only_itself():
    wanted = [Quantity("first", "m", lambda known: 2.0), Quantity("second", "1", broken), Quantity("third", "1", float)]
    with pytest.warns(UserWarning, match=r"the results lack second, which could not be computed: .*broken"):
        assert results_of(wanted, 3) == {"first": {"value": 2.0, "unit": "m"}, "third": 3.0}


def test_a_pump_run_that_bursts_before_its_first_row_leaves_a_result(tmp_path):
    """Its body group settles with a time step that is too large; the error has the fields that its message states."""
    words = [word for name, value in FAST.items() for word in (f"--{name.replace('_', '-')}", value)]
    done = command("run", "pipe", *words, "--safety", 4, "--device", "cpu", "--quiet", "--out", tmp_path / "run")
    result, why = ended(tmp_path / "run")
    assert done.returncode == 1 and not result["finished"] and "steps" not in result
    assert why.reason == "unstable" and why.time == 0.0 and f"error: {why.message}\n" in done.stderr
    assert warpcrete.load(tmp_path / "run").ended == why
    with pytest.raises(InstabilityError) as caught:
        Simulation(scenes.pipe(**FAST, safety=4), **CPU).run()
    error = caught.value
    assert (
        str(error)
        == why.message
        == f"t = {error.time:.6g} s, body {error.body}: {error.what}; usual cures: " + (error.cure)
    )
    assert error.time > 0 and error.body >= 0 and "time_step below" in error.cure


@pytest.mark.parametrize("checkpoint_every", [0, 60])
def test_every_run_of_a_batch_that_bursts_leaves_a_result(tmp_path, checkpoint_every):
    from warpcrete.dem.batch_run import run_batch

    made = [
        Simulation(scenes.pipe(**FAST, safety=safety), **CPU, out=tmp_path / name, checkpoint_every=checkpoint_every)
        for name, safety in (("good", 0.8), ("bad", 4))
    ]
    good, bad = run_batch(made)
    assert good.ended.reason == "travel" and isinstance(bad, InstabilityError)
    assert ended(tmp_path / "bad")[1].message == str(bad)


@pytest.mark.posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_concrete_settles_leaves_a_result(tmp_path, number):
    folder = tmp_path / "run"

    def send():
        assert wait_until((folder / "checkpoint.npz").exists, 300)
        os.kill(os.getpid(), number)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with ThreadPoolExecutor(1) as pool:
            sent = pool.submit(send)
            words = small_options(**TINY | {"settle": 100.0})
            done = command("run", "pipe", *words, "--device", "cpu", "--quiet", "--out", folder)
            sent.result()
    finally:
        signal.signal(signal.SIGINT, handler)
    assert done.returncode == 130, done.stderr
    result, why = ended(tmp_path / "run")
    assert why == Ending("interrupted", "interrupted at t = 0.000 s", 0.0) and not result["finished"]


@pytest.mark.parametrize(
    "error",
    [InstabilityError("burst", time=0.5, body=3, cure="a, b"), ConvergenceError(0.5, "flow", 2, [1.0, 0.5], 0.1, 2)],
)
def test_errors_keep_their_fields_between_processes(error):
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error) and vars(copy) == vars(error) and type(copy) is type(error)


def test_an_error_states_what_is_known():
    assert str(InstabilityError("burst")) == "burst"
    assert str(InstabilityError("burst", time=0.5, cure="glue")) == "t = 0.5 s: burst; usual cure: glue"
    assert str(InstabilityError("burst", body=0, cure="a, b")) == "body 0: burst; usual cures: a, b"


def test_a_run_that_ends_before_its_first_row_replaces_no_results(tmp_path):
    """The reason of the latest attempt counts; a result.json with steps holds results, and stays."""
    recorder = object.__new__(TableRecorder)
    recorder.folder = tmp_path
    scene = SimpleNamespace(name="pipe", seed=3)
    simulation = SimpleNamespace(scene=scene, device=find_device("cpu"), precision="float32", threads=1)
    path = tmp_path / "result.json"
    for reason in ("unstable", "unconverged"):
        recorder._write_early_end(simulation, Ending(reason, f"it was {reason}", 0.5))
        found = json.loads(path.read_text(encoding="utf-8"))
        assert (found["scene"], found["finished"], found["ended"]["reason"]) == ("pipe", False, reason)
    path.write_text(json.dumps(found | {"steps": 0}), encoding="utf-8")
    recorder._write_early_end(simulation, Ending("unstable", "it was unstable", 0.5))
    assert json.loads(path.read_text(encoding="utf-8")) == found | {"steps": 0}
