"""How many steps are launched together, when lists are rebuilt, and which scenes run at the same time.

All of it is decided on the host, and the arrays of a GPU are made up.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from warpcrete.core.device.launching import graph_sizes, tasks_of
from warpcrete.dem import batch_run
from warpcrete.dem.engine import regrouping
from warpcrete.dem.engine.launch_planner import LaunchPlanner
from warpcrete.dem.scene.bodies import BodyTable
from warpcrete.kernels.common.control import ESTIMATED, FAILED, FLAGS, GOAL, HALTED, STALE, STEPS
from warpcrete.kernels.dem.structs import CLOCK, DT, TIME


def test_sizes_of_launches_in_one_dimension_and_several():
    for dim, tasks in ((7, 7), ((3, 256), 768), ((0, 256), 0), ((2, 3, 4), 24)):
        assert tasks_of(dim) == tasks


@pytest.mark.parametrize(
    ("device", "given", "steps"),
    [
        ("gpu", {}, [18, 20, 14]),  # until lists are expected to be stale, the estimate two steps old
        ("gpu", {"goal": 5}, [5]),
        ("gpu", {"time": 0.9985}, [2]),
        ("gpu", {"time": 0.9999999999}, [1]),
        ("gpu", {"dt": 0.0, "goal": 7}, [7]),
        ("gpu", {"halted": 1}, []),
        ("cpu", {}, [18]),
        ("cpu", {"goal": 5}, [5]),
    ],
)
def test_steps_ahead_end_where_the_scene_must_be_looked_after(device, given, steps):
    flags, clock = np.zeros((1, FLAGS), dtype=np.int32), np.zeros((1, CLOCK))
    flags[0, [int(STEPS), int(ESTIMATED)]] = 12, 10
    flags[0, int(GOAL)] = 12 + given.get("goal", 1000)
    flags[0, int(HALTED)] = given.get("halted", 0)
    clock[0, [int(TIME), int(DT)]] = given.get("time", 0.0), given.get("dt", 1e-3)
    rows = np.array([(1.0, 20)], dtype=[("until", float), ("interval", int)])
    assert LaunchPlanner(device == "gpu", 1).launch_sizes(flags, clock, rows) == steps


def two_scenes(steps, estimated, goal=1000):
    flags, clock = np.zeros((2, FLAGS), dtype=np.int32), np.zeros((2, CLOCK))
    flags[:, int(STEPS)], flags[:, int(ESTIMATED)], flags[:, int(GOAL)] = steps, estimated, goal
    clock[:, int(DT)] = 1e-3
    rows = np.array([(np.inf, 20, 4000)] * 2, dtype=[("until", float), ("interval", int), ("sort_every", int)])
    return flags, clock, rows


def test_scenes_of_a_batch_come_to_their_estimates_together():
    """Check the pieces into which a round of steps is divided, and which scenes wait between them."""
    planner = LaunchPlanner(True, 2)
    assert planner.launch_sizes(*two_scenes((20, 20), (20, 20))) == [20, 20]
    assert planner.launch_sizes(*two_scenes((40, 33), (40, 20))) == [20, 20]
    assert planner.launch_sizes(*two_scenes((33, 32), (20, 20))) == [8, 20]
    assert LaunchPlanner(False, 2).launch_sizes(*two_scenes((33, 30), (20, 20))) == [10]
    assert planner.launch_sizes(*two_scenes((20, 20), (20, 20), goal=45)) == [20, 5]
    assert planner.launch_sizes(*two_scenes((20, 20), (20, 20), goal=(21, 45))) == [20, 5]
    flags, _, rows = two_scenes((60, 60), (60, 60))
    flags[0, int(STALE)] = 1
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [0, 1]).tolist() == [
        0
    ]  # nothing is known of the other's
    planner.note_rebuilt(flags)
    assert planner.launch_sizes(*two_scenes((80, 80), (80, 80))) == [20]  # 37 more steps
    flags, _, rows = two_scenes((118, 118), (118, 118))
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [0, 1]).tolist() == [
        0
    ]  # 58 steps, and it took 57 to be stale
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [1]).tolist() == []  # who has ended wants none
    flags[1, int(STALE)] = 1
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [0, 1]).tolist() == [0, 1]
    flags[0, int(FAILED)] = 1
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [0, 1]).tolist() == [1]


@pytest.mark.parametrize("largest", [1, 16, 64])
def test_graphs_add_up_to_the_steps_wanted(largest):
    for count in (0, 1, 2, 3, 15, 16, 17, 31, 63, 64, 100, 1000):
        sizes = graph_sizes(count, largest)
        assert sum(sizes) == count and all(0 < size <= largest and size & (size - 1) == 0 for size in sizes)
        assert sizes == sorted(sizes, reverse=True) and len(sizes) <= count // largest + largest.bit_length()


def test_a_scene_alone_rebuilds_stale_lists_only_and_learns_how_long_they_last():
    planner = LaunchPlanner(True, 1)
    flags, clock, rows = two_scenes((40, 40), (40, 40))
    flags, clock, rows = flags[:1], clock[:1], rows[:1]
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [0]).tolist() == []
    assert planner.launch_sizes(flags, clock, rows) == [20, 4]  # 24 of 64 steps are left
    flags[0, int(STALE)] = 1
    assert planner.scenes_to_rebuild(flags, rows["sort_every"], [0]).tolist() == [0]
    planner.note_rebuilt(flags)
    flags[0, int(STALE)] = 0
    assert planner.launch_sizes(flags, clock, rows) == [20, 20]  # 40 steps, as long as the lists before lasted
    flags[0, int(STEPS)] = 85
    assert planner.launch_sizes(flags, clock, rows) == [1, 15]  # outlived: a few steps, at least 16
    planner.note_joined(0, 85)
    flags[0, int(STALE)] = 1
    flags[0, int(STEPS)] = 90
    planner.scenes_to_rebuild(flags, rows["sort_every"], [0])
    assert planner.launch_sizes(flags, clock, rows) == [1, 20, 14]  # lists of unknown age teach nothing: 40 - 5 steps
    planner.rebuilds_on_device = True
    rows["sort_every"] = 100
    assert planner.launch_sizes(flags, clock, rows) == [1, 9]  # until bodies are sorted
    rows["sort_every"] = 0
    assert max(planner.launch_sizes(flags, clock, rows)) == 20 and sum(planner.launch_sizes(flags, clock, rows)) > 100


@pytest.mark.parametrize(
    "parallel, threads, launched, rounds, steps",
    [
        (True, 1, 0, 0, 64),
        (True, 1, 0, 4, 32),
        (False, 1, 999, 0, 2),
        (False, 2, 256, 0, 2),
        (False, 2, 257, 0, 8),
        (False, 2, 257, 8, 2),
    ],
)
def test_graphs_grow_when_threads_keep_their_shares(parallel, threads, launched, rounds, steps):
    planner = LaunchPlanner(parallel, 1)
    planner.count_steps(launched - launched // 2)
    planner.count_steps(launched // 2)
    assert planner.largest_graph(threads, rounds) == steps
    planner.reset_step_count()
    assert planner.largest_graph(threads, 0) == (64 if parallel else 2)


@pytest.fixture
def room(monkeypatch):
    """Devices with 100 B of free memory, and simulations that need as many bytes as their scene says."""
    monkeypatch.setattr(batch_run, "memory_free", lambda device: 100 / batch_run.MEMORY_FRACTION)
    monkeypatch.setattr(batch_run, "parallel", lambda device: device.is_cuda)
    monkeypatch.setattr(batch_run, "memory_needed", lambda model, bodies: model + len(bodies))
    monkeypatch.setattr(batch_run, "placed_bodies", lambda scene: BodyTable.empty())
    monkeypatch.setattr(batch_run.wp, "Stream", lambda device, priority: priority)

    def make(needs, is_cuda=True, threads=1):
        return [
            SimpleNamespace(device=SimpleNamespace(is_cuda=is_cuda), model=need, threads=threads, scene=None)
            for need in needs
        ]

    return make


def test_batches_and_turns_fit_the_memory(room):
    here = room((40, 60, 1, 30, 90, 20))
    parts = batch_run._split_by_memory(here, {}, [0, 1, 2, 3, 5])
    assert parts == [([0, 1], 100), ([2, 3, 5], 51)]
    table = BodyTable.empty()
    table.size = np.zeros(9)
    table.joined = lambda other: table
    assert batch_run._split_by_memory(here, {1: ((table, None), 0.0)}, [1, 0]) == [([1], 69), ([0], 40)]
    assert batch_run._turns(here, [([0], 40.0), ([1], 60.0), ([2], 1.0)]) == [[([0], 40.0), ([1], 60.0)], [([2], 1.0)]]
    assert batch_run._turns(here, [([4], 90.0), ([3], 30.0), ([2], 1.0)]) == [[([4], 90.0)], [([3], 30.0), ([2], 1.0)]]
    on_cpu = room((40, 60), is_cuda=False)
    assert batch_run._turns(on_cpu, [([0], 4.0), ([1], 6.0)]) == [[([0], 4.0)], [([1], 6.0)]]
    assert batch_run._split_by_memory(on_cpu, {}, [0, 1]) == [([0, 1], 100)]
    assert batch_run._split_by_memory(room((4, 6), False, threads=2), {}, [1, 0]) == [([1], 0.0), ([0], 0.0)]
    assert batch_run._streams(here, [([0], 40.0), ([1], 60.0), ([2], 1.0)]) == [-1, 0, -1]
    assert batch_run._streams(here, [([0], 40.0)]) == [None]
    assert batch_run._streams(on_cpu, [([0], 4.0)] * 2) == [None] * 2


def test_batches_of_one_turn_share_the_blocks_of_sub_cycling():
    def part(subcycling):
        batch = SimpleNamespace(
            features=SimpleNamespace(subcycling=subcycling), subcycles=SimpleNamespace(concurrent_batches=1)
        )
        return SimpleNamespace(scenes={3: (SimpleNamespace(batch=batch), None)}), batch

    (one, first), (two, second), (three, third) = (part(each) for each in (True, False, True))
    batch_run._share_rounds([one, two, three])
    assert [each.subcycles.concurrent_batches for each in (first, second, third)] == [2, 1, 2]


def test_few_scenes_move_to_a_batch_of_their_own_if_it_fits(monkeypatch):
    """On a GPU, after some launches in a row with few spheres, and only into half of the free memory."""
    moved = []
    monkeypatch.setattr(regrouping, "memory_of_batch", lambda stepper: 1000.0)
    monkeypatch.setattr(regrouping, "memory_free", lambda device: device)
    monkeypatch.setattr(regrouping, "regroup", lambda steppers: moved.append(len(steppers)))
    few = int(regrouping.LARGEST_SHARE * 1000) // 2

    def launches(rule, count, spheres=few, parallel=True, of=3, free=1e9):
        batch = SimpleNamespace(parallel=parallel, count=of, sphere_count=1000, device=free)
        steppers = [SimpleNamespace(batch=batch, state=SimpleNamespace(sphere_count=spheres))] * 2
        moved.clear()
        for _ in range(count):
            rule(steppers)
        return len(moved)

    enough = regrouping.LAUNCHES_BEFORE_REGROUPING + 1
    assert launches(regrouping.Regrouping(), enough - 1) == 0 and launches(regrouping.Regrouping(), enough) == 1
    assert launches(regrouping.Regrouping(), 2 * enough - 1) == 1  # it counts anew
    assert launches(regrouping.Regrouping(), enough, spheres=few + 1) == 0
    assert launches(regrouping.Regrouping(), enough, parallel=False) == 0
    assert launches(regrouping.Regrouping(), enough, of=2) == 0
    needed = 1000.0 * 2 * few / 1000
    assert launches(regrouping.Regrouping(), enough, free=2 * needed) == 0
    assert launches(regrouping.Regrouping(), enough, free=2.01 * needed) == 1
    rule = regrouping.Regrouping()
    launches(rule, enough - 1)
    assert launches(rule, 1, spheres=1000) == 0 and launches(rule, 1) == 0  # many spheres in between
