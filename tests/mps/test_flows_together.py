"""Flows that run at the same time on a GPU: order of launches and checks, failures, memory, and interruptions.

Simulations, flows and devices are made up. `test_gpu_ways.py` compares the bits of real flows.
"""

from types import SimpleNamespace

import pytest

from warpcrete.core.errors import CapacityError, InstabilityError
from warpcrete.mps.common import stepping
from warpcrete.mps.common.stepping import run_abreast


class Flow:
    """Flow that takes up to two steps a launch."""

    def __init__(self, log, name, fails_at=None):
        self.log, self.name, self.fails_at, self.steps, self.goal = log, name, fails_at, 0, 0

    @property
    def goal_reached(self):
        return self.steps >= self.goal

    def share(self, abreast):
        self.log.append(("share", self.name, abreast))

    def set_goal(self, until):
        self.goal = int(until)

    def launch(self):
        self.log.append(("launch", self.name))
        self.launched = min(2, self.goal - self.steps)

    def settle(self):
        self.steps += self.launched
        self.log.append(("settle", self.name, self.steps))
        if self.fails_at is not None and self.steps >= self.fails_at:
            raise InstabilityError(f"{self.name} failed")


class Simulated:
    """Simulation that wants some goals one after the other, and returns them with all that was thrown into it."""

    def __init__(self, log, name, goals, fails_at=None, room=lambda: True, begins=True):
        self.log, self.name, self.goals, self.room, self.begins = log, name, goals, room, begins
        self.device = SimpleNamespace(is_cuda=False)
        self.flow, self.prepared, self.stop_requested = Flow(log, name, fails_at), False, False

    def begin(self, checkpoint):
        if not self.begins:
            raise ValueError("cannot begin")
        if not self.room():
            self.log.append(("no room", self.name))
            raise CapacityError("no room")
        self.log.append(("begin", self.name, checkpoint))
        self.prepared = True

    def running(self):
        try:
            for goal in self.goals:
                yield SimpleNamespace(time=goal)
        except KeyboardInterrupt:
            return f"{self.name} interrupted"
        return f"{self.name} finished"

    def release(self):
        self.log.append(("release", self.name))


@pytest.fixture
def together(monkeypatch):
    log, told = [], []
    monkeypatch.setattr(stepping, "parallel", lambda device: True)
    monkeypatch.setattr(stepping.wp, "synchronize_device", lambda device: log.append("wait"))

    def run(simulations, checkpoints=None):
        made = [each(log) for each in simulations]
        found = run_abreast(made, checkpoints or [None] * len(made), lambda *each: told.append(each))
        return found, log, told

    return run


def test_flows_launch_together_and_are_checked_together(together):
    found, log, told = together(
        [lambda log: Simulated(log, "a", (1, 3)), lambda log: Simulated(log, "b", (5,))], ["a.npz", None]
    )
    assert found == ["a finished", "b finished"]
    assert log == [
        ("begin", "a", "a.npz"), ("share", "a", 2), ("begin", "b", None), ("share", "b", 2),
        ("launch", "a"), ("launch", "b"), "wait", ("settle", "a", 1), ("settle", "b", 2),
        ("launch", "a"), ("launch", "b"), "wait", ("settle", "a", 3), ("release", "a"), ("settle", "b", 4),
        ("launch", "b"), "wait", ("settle", "b", 5), ("release", "b"),
    ]  # fmt: skip
    assert told == [("running", 0.5), ("running", 1.0)]


def test_goals_that_are_reached_already_need_no_launch(together):
    found, log, _ = together([lambda log: Simulated(log, "a", (0, 0)), lambda log: Simulated(log, "b", ())])
    assert found == ["a finished", "b finished"] and not [each for each in log if each[0] == "launch"]


def test_a_flow_that_fails_harms_no_other(together):
    found, log, _ = together(
        [
            lambda log: Simulated(log, "a", (4,), fails_at=2),
            lambda log: Simulated(log, "b", (4,)),
            lambda log: Simulated(log, "c", (4,), begins=False),
        ]
    )
    assert str(found[0]) == "a failed" and found[1] == "b finished" and str(found[2]) == "cannot begin"
    assert [each[1] for each in log if each[0] == "release"] == ["a", "c", "b"]


def test_a_flow_without_room_waits_for_another_to_end(together):
    log_of = []

    def room():
        return ("release", "a") in log_of[0]

    def second(log):
        log_of.append(log)
        return Simulated(log, "b", (2,), room=room)

    found, log, _ = together([lambda log: Simulated(log, "a", (4,)), second, lambda log: Simulated(log, "c", (2,))])
    assert found == ["a finished", "b finished", "c finished"]
    begun = [each for each in log if each[0] in ("no room", "begin") or each == ("release", "a")]
    assert begun == [
        ("begin", "a", None), ("no room", "b"), ("release", "a"), ("begin", "b", None), ("begin", "c", None)
    ]  # fmt: skip


def test_a_flow_that_finds_no_room_alone_fails(together):
    found, _, _ = together(
        [lambda log: Simulated(log, "a", (2,), room=lambda: False), lambda log: Simulated(log, "b", (2,))]
    )
    assert isinstance(found[0], CapacityError) and found[1] == "b finished"


def test_no_more_flows_run_together_than_pay(together, monkeypatch):
    monkeypatch.setattr(stepping, "MAX_CONCURRENT_FLOWS", 2)
    found, log, told = together([lambda log, name=name: Simulated(log, name, (2,)) for name in "abc"])
    assert found == ["a finished", "b finished", "c finished"] and len(told) == 3
    assert {each[2] for each in log if each[0] == "share"} == {2}
    assert log.index(("begin", "c", None)) > log.index(("release", "a"))


def test_an_interruption_ends_begun_flows_with_what_they_have(together, monkeypatch):
    waits = []

    def wait(device):
        waits.append(True)
        if len(waits) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(stepping, "MAX_CONCURRENT_FLOWS", 2)
    monkeypatch.setattr(stepping.wp, "synchronize_device", wait)
    found, log, _ = together([lambda log, name=name, to=to: Simulated(log, name, (to,)) for name, to in
                              (("a", 2), ("b", 9), ("c", 9), ("d", 9))])  # fmt: skip
    assert found[:3] == ["a finished", "b interrupted", "c interrupted"]
    assert isinstance(found[3], KeyboardInterrupt) and ("release", "d") in log


def test_a_flow_that_was_asked_to_stop_does_not_begin(together):
    def stopped(log):
        made = Simulated(log, "b", (2,))
        made.stop_requested = True
        return made

    found, log, _ = together([lambda log: Simulated(log, "a", (2,)), stopped])
    assert found[0] == "a finished" and isinstance(found[1], KeyboardInterrupt) and ("begin", "b", None) not in log


def test_a_share_that_changes_makes_the_step_anew():
    forgotten = []
    flow = SimpleNamespace(
        abreast=1, _step="step", _launcher=SimpleNamespace(invalidate_graphs=lambda: forgotten.append(1))
    )
    stepping.Stepping.share(flow, 1)
    assert flow._step == "step" and not forgotten
    stepping.Stepping.share(flow, 3)
    assert (flow.abreast, flow._step, forgotten) == (3, None, [1])
