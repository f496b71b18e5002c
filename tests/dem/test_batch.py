"""Batches: a scene alone and among others holds the same bits; what ends or fails costs and harms no other."""

import dataclasses
import gc
import operator
import signal
from contextlib import nullcontext

import numpy as np
import pytest
import warp as wp
from test_checkpoint import mixed_scene

from warpcrete import Simulation, scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.device.launching import Launcher
from warpcrete.core.errors import CapacityError, InstabilityError
from warpcrete.core.run.recorder import Recorder
from warpcrete.core.run.run import Run
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.engine import regrouping, stepper, subcycling
from warpcrete.dem.engine.launch_planner import LaunchPlanner
from warpcrete.dem.engine.memory import check_memory, memory_needed
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.neighbors import NeighborLists
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.engine.subcycling import round_blocks
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import Bodies, Scene, Watch
from warpcrete.geometry.walls import PlaneWall
from warpcrete.kernels.common.control import STALE

SMALL = dict(length=0.12, diameter=0.08, ramp=0.02, travel=0.03, settle=0.02, size_min=8e-3, size_max=16e-3,
             plug="plate", solid_fraction=0.55)  # fmt: skip


def simulate(device, some, **settings):
    return [Simulation(scene, device=device, threads=1, **settings) for scene in some]


def alone(device, some, **settings):
    return [simulation.run() for simulation in simulate(device, some, **settings)]


def check_the_same(ones, others):
    for one, other in zip(ones, others, strict=True):
        assert isinstance(other, Run) and other.finished
        assert one.result["state_hash"] == other.result["state_hash"]
        assert one.result["steps"] == other.result["steps"]
        for name in one.series:
            assert np.array_equal(one.series[name], other.series[name], equal_nan=True), name


def touches_mesh(simulation) -> bool:
    return bool((simulation.state.slots.wall.numpy() >= 0).any())


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_scene_in_a_batch_holds_the_bits_of_one_alone(device, precision, monkeypatch):
    """Clumps, bonds that heal, a spinning mesh, a driven plate; scenes that end at different times."""
    monkeypatch.setattr(regrouping, "LAUNCHES_BEFORE_REGROUPING", 1000)
    some = [dataclasses.replace(mixed_scene(seed), duration=0.06 + 0.01 * seed) for seed in (0, 1, 2, 3)]
    together = simulate(device, some, precision=precision)
    batched = run_batch(together)
    assert len({id(s.stepper.batch) for s in together}) == 1
    assert touches_mesh(together[-1])
    check_the_same(alone(device, some, precision=precision), batched)


@pytest.mark.thorough
def test_pumping_cases_pack_settle_and_run_in_a_batch_as_alone(device):
    some = [scenes.pipe(velocity=v, seed=s, **SMALL) for v, s in ((0.3, 0), (0.6, 0), (0.6, 1))]
    batched = run_batch(simulate(device, some))
    for one, other in zip(alone(device, some), batched, strict=True):
        assert isinstance(other, Run) and other.finished
        assert one.result["state_hash"] == other.result["state_hash"]
        assert one.packing == other.packing


def falling(speed: float, **changes) -> Scene:
    grid = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return Scene(
        name="falling",
        duration=0.05,
        bodies=(Bodies(positions=0.0125 * grid + [0, 0, 0.01], sizes=0.012, velocities=[[0, 0, -speed]] * len(grid)),),
        walls=(PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1)),),
        **changes,
    )


def test_a_scene_that_fails_harms_no_other(device):
    some = [falling(0.1), falling(3.0, watch=Watch(speed=2.0)), falling(0.2)]
    batched = run_batch(simulate(device, some))
    assert isinstance(batched[1], InstabilityError) and "watch.speed" in str(batched[1])
    for k in (0, 2):
        assert isinstance(batched[k], Run) and batched[k].finished
        assert batched[k].result["state_hash"] == alone(device, [some[k]])[0].result["state_hash"]


def test_a_finished_scene_stands_still_while_others_go_on(device):
    some = [dataclasses.replace(falling(0.1), duration=0.01), dataclasses.replace(falling(0.2), duration=0.06)]
    simulations = simulate(device, some)
    runs = run_batch(simulations)
    assert runs[0].result["steps"] < runs[1].result["steps"]
    assert state_hash(simulations[0].state) == runs[0].result["state_hash"]
    assert simulations[0].stepper.steps == runs[0].result["steps"]


def test_a_launch_goes_on_while_a_scene_runs_and_ends_when_none_does(monkeypatch):
    """Two scenes on a CPU, the first of which is to take 3 steps and the second 11."""
    models = [build_model(falling(0.1), find_device("cpu"), "float32") for _ in range(2)]
    first, _ = steppers = stepper.steppers_of(models, [State(m, placed_bodies(m.scene)) for m in models])
    for each in steppers:
        each.take(1)
    first.batch.set_goal(0, steps=3)
    first.batch.set_goal(1, steps=11)
    ends = []
    replay = Launcher.replay

    def noting(self, step, alone, sizes, ended, appended=None):
        replay(self, step, alone, sizes, lambda: ends.append(ended()) or ends[-1], appended)

    counted = []
    monkeypatch.setattr(Launcher, "replay", noting)
    monkeypatch.setattr(LaunchPlanner, "count_steps", lambda self, steps: counted.append(steps))
    first.batch.launch()
    first.batch.settle()
    assert [each.steps for each in steppers] == [3, 11]
    assert ends[-1] and not any(ends[:-1]) and len(ends) > 2 and counted == [10]


def test_unlike_scenes_fall_into_batches_of_their_own(device):
    short = SMALL | dict(ramp=5e-3, travel=0.01)
    bonded = scenes.pipe(**short)
    frictionless = scenes.pipe(friction=0.0, bonds=False, **short)
    simulations, told = simulate(device, [bonded, frictionless]), []
    runs = run_batch(simulations, progress=lambda *each: told.append(each))
    # A CPU runs one batch after the other.
    assert [each for each in told if each[0] == "running"][-2 * (device == "cpu") :] == (
        [("running", 0.5), ("running", 1.0)] if device == "cpu" else [("running", 1.0)]
    )
    assert [isinstance(run, Run) and run.finished for run in runs] == [True] * 2
    assert simulations[1].stepper.batch.count == 1


def test_what_a_scene_does_not_need_takes_no_memory(device):
    # On a GPU what touches is noted whether there is history or not.
    noted = () if device.startswith("cuda") else ("spheres.touching",)
    for scene, names in (
        (falling(0.1), ("pairs.bond", "pairs.load", "spheres.broken", "candidates.face", "slots.normal")),
        (
            dataclasses.replace(falling(0.1), contact=dataclasses.replace(falling(0.1).contact, friction=0.0)),
            ("pairs.history", "pairs.bond", *noted),
        ),
    ):
        state = State(build_model(scene, find_device(device), "float32"), placed_bodies(scene))
        for name in names:
            assert operator.attrgetter(name)(state).size == 0, name


def test_too_many_bodies_for_the_memory_are_refused(device, monkeypatch):
    scene = falling(0.1)
    model = build_model(scene, find_device(device), "float32")
    table = placed_bodies(scene)
    monkeypatch.setattr("warpcrete.dem.engine.memory.memory_free", lambda device: 20e3)
    with pytest.raises(CapacityError, match=r"bodies = 64: need about .* GiB free; about \d+ bodies would fit"):
        check_memory(model, table)


class Interrupted(Recorder):
    """Raises what Ctrl-C raises, after some rows."""

    def __init__(self, rows=3):
        self.rows = rows

    def sample(self, simulation, row):
        if len(simulation.rows) == self.rows:
            raise KeyboardInterrupt


def test_an_interruption_of_one_scene_ends_all(device):
    simulations = simulate(device, [falling(0.1), falling(0.2), falling(0.3)])
    simulations[1].recorders.append(Interrupted())
    runs = run_batch(simulations)
    assert [isinstance(run, Run) and not run.finished for run in runs] == [True] * 3
    assert all(0 < len(run.series["time"]) <= 4 for run in runs)


def test_checkpoints_of_threaded_runs_go_on_in_a_batch(tmp_path, monkeypatch):
    """Pairs that stood at both spheres of two chunks must not count twice where there is one chunk."""
    monkeypatch.setattr("warpcrete.dem.engine.batch.SPHERES_PER_THREAD", 16)
    paths = []
    for seed in (0, 1):
        simulation = Simulation(scenes.pipe(seed=seed, **SMALL | dict(travel=0.01)), device="cpu", threads=2)
        simulation.prepare()
        assert simulation.stepper.batch.threads == 2
        paths.append(tmp_path / f"{seed}.npz")
        simulation.save(paths[-1])
    some = [scenes.pipe(seed=seed, **SMALL | dict(travel=0.01)) for seed in (0, 1)]
    together = run_batch(simulate("cpu", some), checkpoints=paths)
    for path, scene, other in zip(paths, some, together, strict=True):
        one = Simulation(scene, device="cpu", threads=1)
        one.resume(path)
        assert one.run().result["state_hash"] == other.result["state_hash"]


def test_checkpoints_of_a_batch_go_on_alone(device, tmp_path):
    """Also of one that is not the first: whatever counts over all scenes of a batch must not stand in it."""
    some = [dataclasses.replace(mixed_scene(seed), duration=0.1) for seed in (0, 1)]
    paths = [tmp_path / f"{seed}.npz" for seed in (0, 1)]
    together = [
        Simulation(scene, device=device, threads=1, checkpoint_path=path, checkpoint_every=0.0)
        for scene, path in zip(some, paths)
    ]
    together[0].recorders.append(Interrupted(rows=22))
    assert not any(run.finished for run in run_batch(together))
    assert touches_mesh(together[1])
    for scene, path in zip(some, paths):
        one = Simulation(scene, device=device, threads=1)
        one.resume(path)
        assert one.run().result["state_hash"] == alone(device, [scene])[0].result["state_hash"]


def allotted() -> dict[int, int]:
    """Bytes of every array that owns its memory, by address."""
    gc.collect()
    arrays = [a for a in gc.get_objects() if type(a) is wp.array and a.ptr and getattr(a, "_ref", None) is None]
    return {a.ptr: a.capacity for a in arrays if getattr(a, "deleter", None) is not None}


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("bonds", [False, True], ids=["", "bonds"])
def test_the_estimate_of_memory_is_what_is_allotted(device, precision, bonds):
    """The estimate of memory exceeds the memory allotted by less than 40 %.

    The scene is a dense packing that has stepped, been rebuilt and been measured. The measured ratio of the estimate to
    the allotted memory is 1.10 to 1.29 on a CPU.
    """
    before = allotted()
    scene = dataclasses.replace(scenes.pipe(bonds=bonds, **SMALL | dict(length=0.4, solid_fraction=0.6)), settle=None)
    simulation = Simulation(scene, device=device, precision=precision, threads=1)
    simulation.prepare()
    simulation.stepper.advance(2e-3)
    simulation.measure()
    taken = sum(size for address, size in allotted().items() if address not in before)
    assert taken < memory_needed(simulation.model, simulation.state.table()) < 1.4 * taken


def mixed(part):
    return dataclasses.replace(mixed_scene(part), duration=0.07 + 0.015 * part)


def drops(part):
    return dataclasses.replace(falling(0.1 + 0.1 * part), duration=0.015 + 0.03 * part)


def hydrated(part):
    short = SMALL | dict(length=0.06, travel=0.015)
    return scenes.pipe(hydration=0.2, hydration_modulus=1e7, velocity=0.9 - 0.3 * part, **short)


def rested(part):
    stopping = SMALL | dict(length=0.06, settle=0.05, ramp=5e-3, travel=0.04, strokes=2, pause=0.06)
    return scenes.pipe(rest=600.0, velocity=0.9 - 0.3 * part, **stopping)


def like_a_gpu(device):
    return nullcontext() if device.startswith("cuda") else divide_work_like_gpu()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("scene", "parts", "made"),
    [
        (mixed, (0, 0, 1, 1, 2), [(5, 1)]),
        (mixed, (0, 1, 2, 3, 4, 5), [(6, 3), (3, 1)]),
        (drops, (0, 1, 2, 3, 4, 5), [(6, 3), (3, 1)]),
        (hydrated, (0, 2), [(2, 1)]),
        (rested, (0, 2), [(2, 1)]),
    ],
)
def test_a_batch_made_anew_of_those_that_run_on_changes_no_bits(scene, parts, made, device, monkeypatch):
    """When most scenes have ended; friction, bonds, meshes, driven walls; bonds in rounds; a layer that is worn."""
    counts = []
    regroup = regrouping.regroup

    def noted(steppers):
        counts.append((steppers[0].batch.count, len(steppers)))
        regroup(steppers)
        assert {stepper.batch.count for stepper in steppers} == {len(steppers)}

    monkeypatch.setattr(regrouping, "regroup", noted)
    monkeypatch.setattr(regrouping, "LAUNCHES_BEFORE_REGROUPING", 1)
    some = [scene(part) for part in parts]
    with like_a_gpu(device):
        batched = run_batch(simulate(device, some))
        assert counts == made
        check_the_same(alone(device, some), batched)


def test_an_interruption_while_a_batch_is_made_anew_waits_for_that(monkeypatch):
    regroup, interrupted = regrouping.regroup, []

    def disturbed(steppers):
        interrupted.append(True)
        signal.raise_signal(signal.SIGINT)
        regroup(steppers)

    monkeypatch.setattr(regrouping, "regroup", disturbed)
    monkeypatch.setattr(regrouping, "LAUNCHES_BEFORE_REGROUPING", 2)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background of a shell it is ignored
    try:
        with divide_work_like_gpu():
            runs = run_batch(simulate("cpu", [drops(0), drops(3)]))
    finally:
        signal.signal(signal.SIGINT, before)
    assert interrupted and runs[0].finished
    assert isinstance(runs[1], Run) and not runs[1].finished and len(runs[1].series["time"]) > 1


def test_a_batch_is_not_made_anew_where_there_is_no_room_for_it(monkeypatch):
    monkeypatch.setattr(regrouping, "LAUNCHES_BEFORE_REGROUPING", 2)
    monkeypatch.setattr(regrouping, "memory_free", lambda device: 1e3)
    monkeypatch.setattr(regrouping, "regroup", lambda steppers: pytest.fail("no room"))
    with divide_work_like_gpu():
        runs = run_batch(simulate("cpu", [dataclasses.replace(falling(0.1), duration=0.02 + 0.02 * k) for k in (0, 1)]))
    assert all(run.finished for run in runs)


@pytest.mark.thorough
def test_unlike_scenes_run_abreast_with_the_bits_of_one_alone(device, monkeypatch):
    """Two batches at a time, each on a stream of its own where there are streams."""
    monkeypatch.setattr(regrouping, "LAUNCHES_BEFORE_REGROUPING", 1000)
    some = [mixed(0), falling(0.1), mixed(1), falling(0.2)]
    with like_a_gpu(device):
        simulations = simulate(device, some)
        batched = run_batch(simulations)
        assert len({id(s.stepper.batch) for s in simulations}) == 2
        check_the_same(alone(device, some), batched)


@pytest.mark.thorough
def test_rounds_of_batches_abreast_share_a_gpu(device, monkeypatch):
    """Blocks that wait for one another must all have room: of two batches each has half of it, and the same bits."""
    assert [round_blocks(10**6, 132, concurrent_batches) for concurrent_batches in (1, 2, 500)] == [264, 132, 1]
    assert round_blocks(1, 132, 1) == 1 and round_blocks(129, 132, 2) == 2
    monkeypatch.setattr(regrouping, "LAUNCHES_BEFORE_REGROUPING", 1000)
    some = [
        scenes.pipe(
            hydration=0.2,
            hydration_modulus=1e7,
            hydration_rounds=8,
            energy_balance=energies,
            **SMALL | dict(length=0.08, travel=0.01),
        )
        for energies in (False, True)
    ]
    with like_a_gpu(device):
        simulations = simulate(device, some)
        # Blocks are so small that each thread has several pairs, as in a large batch.
        monkeypatch.setattr(subcycling, "ROUND_BLOCK", 32)
        monkeypatch.setattr(
            subcycling, "round_blocks", lambda count, multiprocessors, concurrent_batches: 4 // concurrent_batches
        )
        batched = run_batch(simulations)
        assert all(s.stepper.batch.subcycles.pair_count > 2 * 32 for s in simulations)
        assert [s.stepper.batch.subcycles.concurrent_batches for s in simulations] == [2, 2]
        check_the_same(alone(device, some), batched)


def test_an_interruption_of_one_scene_ends_those_abreast(device):
    with like_a_gpu(device):
        simulations = simulate(device, [falling(0.1), falling(0.2, energy_balance=True)])
        simulations[1].recorders.append(Interrupted())
        runs = run_batch(simulations)
        assert len({id(s.stepper.batch) for s in simulations}) == 2
    assert all(isinstance(run, Run) and not run.finished for run in runs)


def breaking(part):
    """Stiff bonds that break in their rounds, as parts are drawn apart, and may heal."""
    weak = dict(hydration=0.5, hydration_modulus=1e7, hydration_strength=2e3, hydration_rounds=8, healing=True)
    return scenes.pipe(seed=part, velocity=2.0, energy_balance=True, **weak, **SMALL | dict(length=0.07, ramp=1e-3))


@pytest.mark.thorough
@pytest.mark.parametrize("way", [nullcontext, divide_work_like_gpu], ids=["half lists", "full lists"])
@pytest.mark.parametrize(
    ("scene", "bonds"), [(lambda part: dataclasses.replace(mixed_scene(part), duration=0.05), 0), (breaking, 100)]
)
def test_lists_may_be_built_at_any_time(scene, bonds, way, monkeypatch):
    """Building the lists of randomly chosen scenes of a batch, at any check, gives the same results as single runs.

    The scenes have meshes, bonds that heal or break in rounds, and bodies that are sorted during the run. Scenes of a
    batch may have their lists built together only because a build of lists that are not stale changes no result.
    """
    some = [scene(part) for part in (0, 1, 2)]
    monkeypatch.setattr(stepper, "SORT_EVERY", dict.fromkeys(stepper.SORT_EVERY, 100))
    built, scenes_to_rebuild = [], LaunchPlanner.scenes_to_rebuild
    with way():
        ones = alone("cpu", some)
        rng = np.random.default_rng(1)

        def at_random(self, flags, sort_every, among):
            more = rng.choice(among, size=rng.integers(len(among) + 1), replace=False) if among else []
            found = np.union1d(scenes_to_rebuild(self, flags, sort_every, among), more).astype(int)
            built.append(len(found))
            return found

        monkeypatch.setattr(LaunchPlanner, "scenes_to_rebuild", at_random)
        together = simulate("cpu", some)
        check_the_same(ones, run_batch(together))
    assert np.count_nonzero(built) > 20 and max(built) == 3
    assert sum(s.state.spheres.broken.numpy().sum() for s in together) >= bonds


@pytest.mark.thorough
def test_scenes_of_a_batch_have_their_lists_built_together(monkeypatch):
    """Before they are stale, as soon as it is known how long they last; and not much more often than alone."""
    counts = []
    with divide_work_like_gpu():
        call = NeighborLists.__call__

        def counting(self):
            counts.append(np.count_nonzero(self.batch.host_flags()[:, int(STALE)]))
            call(self)

        some = [scenes.pipe(seed=seed, **SMALL | dict(length=0.05)) for seed in range(4)]
        ones = simulate("cpu", some)
        for one in ones:
            one.run()
        together = simulate("cpu", some)
        monkeypatch.setattr(NeighborLists, "__call__", counting)
        run_batch(together)
    built = together[0].stepper.lists.builds
    assert np.mean(counts) > 2.5  # 1.5 where each has its own built when they are stale
    assert built.sum() < 1.6 * sum(one.stepper.lists.builds[0] for one in ones)
