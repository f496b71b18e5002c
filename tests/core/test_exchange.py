"""Asynchronous copies between host and GPU, on a GPU that is made up: it does its work only when the host waits."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from warpcrete.core.device import exchange
from warpcrete.core.device.device import quiet_init
from warpcrete.core.device.exchange import Exchange, LaunchAndRead, PinnedBuffers
from warpcrete.core.drawing import snapshots
from warpcrete.core.drawing.snapshots import PendingCopies, PinnedPool, snapshot_of


class Gpu:
    """Device with one stream, whose launched copies wait in a queue; counts waits, graphs and their launches."""

    is_cuda = True

    def __init__(self):
        self.queue, self.log, self.pinned = [], [], []
        self.stream = SimpleNamespace(record_event=lambda known: self.log.append("event") or known)

    def work(self):
        while self.queue:
            self.queue.pop(0)()

    def waits(self, what):
        self.log.append(what)
        self.work()


@pytest.fixture
def gpu(monkeypatch):
    quiet_init()
    gpu = Gpu()
    event = SimpleNamespace(is_complete=False)

    def empty(shape, dtype, device, pinned):
        assert device == "cpu" and pinned
        gpu.pinned.append(wp.empty(shape, dtype=dtype, device="cpu"))
        return gpu.pinned[-1]

    monkeypatch.setattr(exchange, "empty", empty)
    monkeypatch.setattr(
        exchange, "copy_array", lambda target, source: gpu.queue.append(lambda: wp.copy(target, source))
    )
    monkeypatch.setattr(exchange, "captured", lambda device, copy: gpu.log.append("captured") or copy)
    launch = SimpleNamespace(
        Event=lambda device: event,
        capture_launch=lambda graph: gpu.log.append("graph") or graph(),
        synchronize_stream=lambda stream: gpu.waits("stream"),
        synchronize_event=lambda event: gpu.waits("event"),
    )
    monkeypatch.setattr(exchange, "wp", launch)
    return gpu


def array(*values):
    return wp.array(values, dtype=wp.float64, device="cpu")


def test_a_read_waits_once_and_copies_by_a_graph_from_the_second_time_on(gpu):
    one, other, both = array(1.0, 2.0), array(3.0), Exchange(gpu)
    for k in range(3):
        found = both.read(one, other)
        assert [each.tolist() for each in found] == [[1.0 + k, 2.0], [3.0]]
        one.assign(np.array([2.0 + k, 2.0]))
    assert gpu.log == ["stream", "captured", "graph", "stream", "graph", "stream"] and len(gpu.pinned) == 2
    assert found[0].tolist() == [3.0, 2.0]  # a copy, which later reads leave alone
    both.read(other)
    assert len(gpu.pinned) == 3


def test_reads_on_the_cpu_are_copies_that_later_steps_leave_alone():
    quiet_init()
    cpu, one = wp.get_device("cpu"), array(1.0, 2.0)
    both, ask = Exchange(cpu), LaunchAndRead([], [one], cpu)
    both.begin_read(one)
    found = [*both.read(one), *both.finish_read(), *ask()]
    one.assign(np.array([3.0, 4.0]))
    assert [each.tolist() for each in found] == [[1.0, 2.0]] * 3


def test_copies_of_nothing_need_no_graph(gpu):
    nothing, both = wp.zeros(0, dtype=float, device="cpu"), Exchange(gpu)
    for _ in range(3):
        assert [each.size for each in both.read(nothing)] == [0]
    assert gpu.log == ["stream"] * 3


def test_a_write_reuses_memory_only_after_the_copy_before_has_arrived(gpu):
    one, both = array(0.0, 0.0), Exchange(gpu)
    both.write((one, np.array([1.0, 2.0])))
    assert gpu.log == [] and one.numpy().tolist() == [0.0, 0.0]
    both.write((one, np.array([3.0, 4.0])))
    assert gpu.log[0] == "stream" and one.numpy().tolist() == [1.0, 2.0]
    gpu.work()
    assert one.numpy().tolist() == [3.0, 4.0]
    both.read(one)
    gpu.log.clear()
    both.write((one, np.array([5.0, 6.0])))
    assert "stream" not in gpu.log  # the read has waited for the write before
    other = array(0.0)
    both.write((other, np.array([7.0])))
    assert "stream" not in gpu.log  # memory of its own
    gpu.work()
    assert one.numpy().tolist() == [5.0, 6.0] and other.numpy().tolist() == [7.0]


def test_a_read_in_flight_completes_the_writes_before_it_only(gpu):
    one, other, both = array(0.0), array(1.0), Exchange(gpu)
    both.write((one, np.array([1.0])))
    both.begin_read(other)
    both.write((other, np.array([2.0])))
    assert not both.read_is_done
    assert both.finish_read()[0].tolist() == [1.0] and "event" in gpu.log
    gpu.log.clear()
    both.write((one, np.array([3.0])))
    assert "stream" not in gpu.log
    both.write((other, np.array([4.0])))
    assert "stream" in gpu.log
    both._read_event.is_complete = True
    assert both.read_is_done


def test_page_locked_memory_has_a_limit(gpu, monkeypatch):
    monkeypatch.setattr(exchange, "MAXIMUM_BUFFERS", 2)
    arrays, both = [array(float(k)) for k in range(3)], Exchange(gpu)
    for each in arrays[:2]:
        both.write((each, np.array([9.0])))
    assert not gpu.log and len(gpu.pinned) == 2
    both.begin_read(arrays[2])
    assert gpu.log[0] == "stream" and len(gpu.pinned) == 3 and len(both._buffers_by_use) == 1
    assert both.finish_read()[0].tolist() == [2.0]


def test_stages_and_the_copies_behind_them_are_one_launch(gpu, monkeypatch):
    one, launched = array(1.0), []

    class Launch:
        def __init__(self, stages, device):
            self.stages = stages
            for stage in stages:
                stage.record()

        def __call__(self):
            launched.append(len(self.stages))
            for stage in self.stages:
                stage()

    class Doubling:
        record = staticmethod(lambda: None)

        def __call__(self):
            gpu.queue.append(lambda: one.assign(2 * one.numpy()))

    monkeypatch.setattr(exchange, "GraphLaunch", Launch)
    ask = LaunchAndRead([Doubling()], [one], gpu)
    assert [ask()[0].tolist() for _ in range(2)] == [[2.0], [4.0]] and launched == [2, 2]


@pytest.fixture
def drawn(gpu, monkeypatch):
    monkeypatch.setattr(snapshots, "_is_on_gpu", lambda array: True)
    monkeypatch.setattr(snapshots, "POLL_INTERVAL", 0.0)
    return gpu


def test_displays_share_one_copy_of_each_array(drawn):
    one, other, asked = array(1.0, 2.0), array(5.0), []
    simulation = SimpleNamespace(stepper=SimpleNamespace(time=0.5, steps=7))

    class Simulation:
        stepper = simulation.stepper

    simulation = Simulation()

    def source(name, value):
        return lambda: asked.append(name) or value

    first = snapshot_of(simulation, {"one": source("one", one), "word": source("word", "w")})
    second = snapshot_of(simulation, {"one": source("one", one), "other": source("other", other)})
    assert asked == ["one", "word", "other"] and set(second.values) == {"one", "other"}
    one.assign(np.array([1.5, 2.5]))
    drawn.work()
    assert first.read("one").tolist() == [1.5, 2.5] and first.read("word") == "w"
    assert second.read("other").tolist() == [5.0] and second.read("one") is first.read("one")
    assert first.derived is second.derived and (first.time, first.steps) == (0.5, 7)
    simulation.stepper.steps = 8
    assert snapshot_of(simulation, {"one": source("one", one)}).values["one"] is not first.values["one"]
    assert asked == ["one", "word", "other", "one"]


def test_memory_of_copies_is_reused_once_they_have_arrived(drawn):
    pool, one = PinnedPool(), array(1.0)
    copies = PendingCopies({"one": one}, pool)
    del copies  # has not arrived: its memory may still be written to
    drawn.work()
    made = len(drawn.pinned)
    copies = PendingCopies({"one": one}, pool)
    assert len(drawn.pinned) == 2 * made and copies._views[""][0] == 0
    drawn.work()
    assert copies["one"].tolist() == [1.0]
    del copies
    copies = PendingCopies({"one": one}, pool)
    assert len(drawn.pinned) == 2 * made
    drawn.work()
    del copies
    other = array(1.0, 2.0)
    PendingCopies({"one": other}, pool)  # other sizes: memory for the old ones is given up
    assert len(drawn.pinned) == 3 * made and not pool._outdated_queues[0]


def test_copies_that_do_not_arrive_are_an_error(drawn, monkeypatch):
    monkeypatch.setattr(snapshots, "COPY_TIMEOUT", 0.02)
    copies = PendingCopies({"one": array(1.0)}, PinnedPool())
    with pytest.raises(RuntimeError, match=r"took longer than 0\.02 s"):
        copies["one"]


def test_buffers_copy_in_the_order_of_the_arrays(gpu):
    first, second = array(1.0), array(2.0, 3.0)
    buffers = PinnedBuffers([first, second], gpu)
    buffers.gather([first, second])
    gpu.work()
    assert [view.tolist() for view in buffers.views] == [[1.0], [2.0, 3.0]]
    buffers.views[1][0] = 7.0
    buffers.scatter([first, second])
    gpu.work()
    assert second.numpy().tolist() == [7.0, 3.0] and first.numpy().tolist() == [1.0]
