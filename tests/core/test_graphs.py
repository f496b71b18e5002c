"""Launches as graphs, and what goes between host and device with them."""

import gc
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from pumping import TINY
from test_contacts import two_spheres

from warpcrete import Simulation, scenes
from warpcrete.core.device import launching
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.device.exchange import Exchange, LaunchAndRead
from warpcrete.core.device.graphs import Call, GraphLaunch, captured
from warpcrete.core.device.launching import Launcher
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.measure.probes import body_sums, contact_sums, row_sums
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.kernels.common.control import ESTIMATED


def test_a_capture_waits_for_a_garbage_collection_of_another_thread(device):
    """Warp lets other threads run while it frees memory, and CUDA refuses to capture a graph meanwhile."""
    array, started, order = wp.ones(4, dtype=wp.float32, device=device), threading.Event(), []

    class Cycle:
        def __init__(self):
            self.itself = self

        def __del__(self):
            started.set()
            time.sleep(0.1)
            order.append("freed")

    def launch():
        order.append("captured")
        Call(array.zero_)()

    gc.collect()
    gc.disable()
    try:
        Cycle()
        collector = threading.Thread(target=gc.collect)
        collector.start()
        assert started.wait(10)
        captured(find_device(device), launch)
        collector.join()
    finally:
        gc.enable()
    assert order == ["freed", "captured"]


def test_a_garbage_collection_of_another_thread_waits_for_a_capture(device):
    """Errors of a capture, and a collection within it, leave the lock free."""
    array, order = wp.ones(4, dtype=wp.float32, device=device), []

    class Cycle:
        def __init__(self):
            self.itself = self

        def __del__(self):
            order.append("freed")

    def launch():
        gc.collect()
        Cycle()
        collector.start()
        collector.join(0.1)
        order.append("captured")
        Call(array.zero_)()

    with pytest.raises(ZeroDivisionError):
        captured(find_device(device), lambda: 1 / 0)
    gc.collect()
    gc.disable()
    try:
        collector = threading.Thread(target=gc.collect)
        captured(find_device(device), launch)
        collector.join()
    finally:
        gc.enable()
    assert order == ["captured", "freed"]


def test_what_is_read_with_a_launch_is_as_that_left_it(device):
    place = find_device(device)
    array, other = wp.ones(4, dtype=wp.int32, device=device), wp.zeros((0, 3), dtype=wp.float64, device=device)
    reading = LaunchAndRead([Call(array.zero_)], [array, other], place)
    for value in (3, 5):
        array.fill_(value)
        zeros, none = reading()
        array.fill_(7)
        assert zeros.tolist() == [0] * 4 and none.shape == (0, 3)
    assert array.numpy().tolist() == [7] * 4


def test_writes_of_several_arrays_come_in_their_order(device):
    """Some of them together, some alone, one after the other without a look at any."""
    exchange = Exchange(find_device(device))
    rows, flags = (wp.zeros(3, dtype=wp.int32, device=device) for _ in range(2))
    for turn in range(9):
        values = np.full(3, turn, np.int32)
        exchange.write(*[[(rows, values), (flags, values)], [(flags, values)], [(rows, values)]][turn % 3])
        values[:] = -1  # what was written was copied
        if turn % 4 == 3:
            exchange.begin_read(rows)
            exchange.finish_read()
    assert [each.tolist() for each in exchange.read(rows, flags)] == [[8] * 3, [7] * 3]


def test_an_interruption_loses_nothing_that_was_to_be_sent(monkeypatch):
    """Changes that a run notes on the host go to the device with the next launch if an interruption stops this one."""
    with divide_work_like_gpu():
        scene = two_spheres(gap=1e-4)
        model = build_model(scene, find_device("cpu"), "float32")
        stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
        stepper.choose_dt()
        batch, write, calls = stepper.batch, Exchange.write, []

        def interrupted(self, *pairs):
            calls.append(pairs)
            if len(calls) == 1:
                raise KeyboardInterrupt
            write(self, *pairs)

        monkeypatch.setattr(Exchange, "write", interrupted)
        batch.estimated(0, 7)
        with pytest.raises(KeyboardInterrupt):
            batch.flush()
        assert stepper.time == 0 and len(calls) == 1  # something looks at the clock
        batch.flush()
        assert len(calls) == 2 and batch.flags.numpy()[0, int(ESTIMATED)] == 7


def test_sums_of_a_row_are_those_of_separate_launches(device):
    simulation = Simulation(scenes.pipe(**TINY), device=device)
    simulation.prepare()
    model, state, stepper = simulation.model, simulation.state, simulation.stepper
    for _ in range(3):
        walls = stepper.batch.host_walls(state.index).copy()
        bodies, contacts = body_sums(model, state), contact_sums(model, state)
        then = row_sums(model, state)
        stepper.take(30)
        assert then[0].kinetic_energy == bodies.kinetic_energy and then[0].reach == bodies.reach
        assert then[1].elastic_energy == contacts.elastic_energy and then[1].contacts == contacts.contacts
        assert np.array_equal(then[2], walls)
        assert body_sums(model, state).kinetic_energy != bodies.kinetic_energy


def test_estimates_within_a_graph_of_steps_are_those_behind_it(device, monkeypatch):
    if not find_device(device).is_cuda:
        pytest.skip("only a GPU computes estimates within a graph of steps; a CPU computes them between two launches")
    scene = scenes.pipe(**TINY | dict(travel=0.03), sample_interval=0.05)
    within, replay = [], Launcher.replay

    def counting(self, step, alone, sizes, ended, appended=None):
        within.append(appended is not None)
        replay(self, step, alone, sizes, ended, appended)

    def apart(self, step, alone, sizes, ended, appended=None):
        replay(self, step, alone, sizes, ended)
        if appended is not None:
            appended()

    hashes = []
    for way in (counting, apart):
        monkeypatch.setattr(Launcher, "replay", way)
        hashes.append(Simulation(scene, device=device).run().result["state_hash"])
    assert hashes[0] == hashes[1] and sum(within) > 10


def test_stages_are_launched_at_once_again_and_again(device):
    array = wp.ones(4, dtype=wp.float32, device=device)
    both = GraphLaunch([Call(array.zero_)], find_device(device))
    for _ in range(2):
        array.fill_(1.0)
        both()
        assert not array.numpy().any()


def test_stages_on_a_side_stream_run_beside_the_others_until_one_joins_them(monkeypatch):
    """On a made-up GPU: the side stream begins after what came before, and each join waits for it once."""
    log = []

    class Stream:
        def __init__(self, name, priority=3):
            self.name, self.priority, self.events = name, priority, 0

        def record_event(self):
            self.events += 1
            return f"{self.name} {self.events}"

        def wait_event(self, event):
            log.append((self.name, "waits", event))

    def stage(name, side=False, joins=False):
        run = SimpleNamespace(on_side_stream=side, joins_side_stream=joins)

        class Made:
            on_side_stream, joins_side_stream = run.on_side_stream, run.joins_side_stream

            def __call__(self, stream=None):
                log.append((stream.name if stream else "main", name))

        return Made()

    monkeypatch.setattr(launching.wp, "Stream", lambda device, priority: Stream("side", priority))
    stages = [stage("a"), stage("b", side=True), stage("c", side=True), stage("d"), stage("e", joins=True),
              stage("f", joins=True), stage("g", side=True)]  # fmt: skip
    launching._launch_on_side_stream(stages, SimpleNamespace(stream=Stream("main")))
    assert log == [
        ("main", "a"), ("side", "waits", "main 1"), ("side", "b"), ("side", "c"), ("main", "d"),
        ("main", "waits", "side 1"), ("main", "e"), ("main", "f"), ("side", "g"), ("main", "waits", "side 2"),
    ]  # fmt: skip
    log.clear()
    launching._launch_on_side_stream([stage("a", joins=True), stage("b")], SimpleNamespace(stream=Stream("main")))
    assert log == [("main", "a"), ("main", "b")]
