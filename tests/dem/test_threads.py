"""Threads on a CPU: every chunk of a step on its own core; the same bits for a number of threads, the same physics."""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import by_id, pair_history
from contention import results_under_contention
from test_contacts import flowing_scene, small_packing

from warpcrete import Simulation, scenes
from warpcrete.core.device import cores
from warpcrete.core.device.cores import CoreContention
from warpcrete.core.device.device import find_device
from warpcrete.core.errors import SceneError
from warpcrete.dem.engine import batch
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.laws import Contact, HertzMindlin
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.clumps import ClumpTemplate
from warpcrete.dem.scene.scene import Bodies, Bonds, Scene, TimeStep
from warpcrete.geometry.walls import Driven, PlaneWall

SMALL = dict(
    length=0.12, diameter=0.08, ramp=0.02, travel=0.03, settle=0.02, size_min=8e-3, size_max=16e-3, plug="plate"
)


@pytest.fixture(autouse=True)
def threads_of_few_spheres(monkeypatch):
    monkeypatch.setattr(batch, "SPHERES_PER_THREAD", 16)


@pytest.fixture(scope="module")
def packing():
    return small_packing("cpu")


def flow(packing, threads, steps=400, **settings):
    fill, table = packing
    weak = Bonds(tensile_strength=20.0, cohesion=10.0, healing=True)
    scene = dataclasses.replace(flowing_scene(fill), bonds=weak)
    model = build_model(scene, find_device("cpu"), "float64")
    stepper = Stepper(model, State(model, table), TimeStep(fixed=2e-5), threads=threads, **settings)
    stepper.bond(model.scene.bonds, 1)
    stepper.take(steps)
    return stepper


OFTEN = dict(steps=1000, sort_every=100, skin=2e-4)  # so thin a skin that lists are built and sorted many times


@pytest.fixture(scope="module")
def alone(packing):
    return flow(packing, 1, **OFTEN)


@pytest.mark.parametrize("threads", [2, pytest.param(3, marks=pytest.mark.thorough), 5])
def test_any_number_of_threads_moves_the_same(packing, alone, threads):
    """Bonds break and heal, contacts slip, lists are rebuilt and sorted (so pairs change chunks), all across chunks."""
    one, many = alone, flow(packing, threads, **OFTEN)
    assert one.lists.builds[0] > 5 and many.lists.builds[0] > 5
    assert many.batch.threads == threads and len(many.state.chunks) == threads + 1
    assert one.state.spheres.broken.numpy().sum() == many.state.spheres.broken.numpy().sum() > 10
    # Sums in another order.
    assert np.abs(by_id(one.state, "position") - by_id(many.state, "position")).max() < 1e-14
    singles, copies = pair_history(one.state), pair_history(many.state)
    assert len(many.state.pairs.other.numpy()[: many.state.pair_total]) > len(copies)  # some stand at both spheres
    touching = {key for key, value in singles.items() if np.any(np.frombuffer(value[0]))}
    assert touching == {key for key, value in copies.items() if np.any(np.frombuffer(value[0]))}
    for quantity in ("contacts", "bonded", "elastic_energy", "bond_energy", "virial"):
        ours = getattr(contact_sums(many.model, many.state), quantity)
        assert ours == pytest.approx(getattr(contact_sums(one.model, one.state), quantity), rel=1e-10), quantity
    assert many.estimate() == pytest.approx(one.estimate(), rel=1e-10)


def test_a_chunk_may_be_empty():
    """A clump of more spheres than a chunk should have, last in order, leaves the chunk after it none."""
    random = np.random.default_rng(1)
    large = ClumpTemplate("cloud", random.uniform(-0.3, 0.3, (300, 3)), np.full(300, 0.1), np.full(3, 0.05))
    x = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3) * 0.0099
    scene = Scene(
        name="cloud", duration=1.0, gravity=(0, 0, 0),
        bodies=(Bodies(positions=x, sizes=0.01), Bodies(positions=[[0.2, 0.2, 0.2]], sizes=0.05, template=large)),
    )  # fmt: skip
    model = build_model(scene, find_device("cpu"), "float64")
    places = []
    for threads in (1, 2):
        stepper = Stepper(model, State(model, placed_bodies(scene)), TimeStep(), threads=threads)
        stepper.take(20)
        places.append(by_id(stepper.state, "position"))
    assert np.diff(stepper.batch.sphere_chunks).tolist() == [364, 0]
    assert np.abs(places[0] - places[1]).max() < 1e-12


def test_a_number_of_threads_gives_the_same_bits_every_time(packing):
    runs = [flow(packing, 3) for _ in range(3)]
    for other in runs[1:]:
        for name in ("position", "velocity", "spin"):
            assert np.array_equal(by_id(runs[0].state, name), by_id(other.state, name))
        assert pair_history(runs[0].state) == pair_history(other.state)


def test_momentum_is_kept_across_chunks(packing):
    fill, table = packing
    scene = dataclasses.replace(flowing_scene(fill), walls=(), gravity=(0.0, 0.0, 0.0))
    model = build_model(scene, find_device("cpu"), "float64")
    stepper = Stepper(model, State(model, table), TimeStep(fixed=2e-5), threads=4)
    stepper.take(300)
    sums = body_sums(stepper.model, stepper.state)
    speed = np.linalg.norm(by_id(stepper.state, "velocity"), axis=1)
    assert speed.max() > 1e-4
    assert np.linalg.norm(sums.momentum) < 1e-12 * float(speed @ stepper.state.bodies.mass.numpy())


@pytest.mark.thorough
def test_a_pumping_run_on_threads_resumes_with_the_same_bits(tmp_path):
    scene = scenes.pipe(**SMALL)
    uncut = Simulation(scene, device="cpu", threads=2).run()
    assert uncut.finished and uncut.result["momentum_balance_error"] < 0.01
    one = Simulation(scene, device="cpu", threads=2)
    one.prepare()
    one.save(tmp_path / "a.npz")
    other = Simulation(scene, device="cpu", threads=2)
    other.resume(tmp_path / "a.npz")
    assert not other.stepper.batch.scenes_with_new_chunks
    assert other.run().result["state_hash"] == uncut.result["state_hash"]
    alone = Simulation(scene, device="cpu", threads=1)
    alone.resume(tmp_path / "a.npz")
    assert alone.stepper.batch.scenes_with_new_chunks
    single = alone.run()
    plateau = single.result["plateau_pressure"]["value"]
    assert plateau == pytest.approx(uncut.result["plateau_pressure"]["value"], rel=0.02)


def test_few_spheres_are_the_work_of_one_thread(monkeypatch, packing):
    """Waiting for one another would take longer than what they do."""
    monkeypatch.undo()
    simulation = Simulation(scenes.pipe(**SMALL), device="cpu", threads=2)
    simulation.prepare()
    assert simulation.stepper.batch.threads == 1 and 32 < simulation.state.sphere_count < 500
    fill, table = packing
    model = build_model(flowing_scene(fill), find_device("cpu"), "float64")
    state = State(model, table)
    monkeypatch.setattr(batch, "SPHERES_PER_THREAD", state.sphere_count // 3)
    assert Stepper(model, state, TimeStep(fixed=2e-5), threads=2).batch.threads == 2


def test_senseless_numbers_of_threads_are_refused():
    for threads in (0, -1, 5000):
        with pytest.raises(SceneError, match=f"threads = {threads}"):
            Simulation(scenes.pipe(**SMALL), device="cpu", threads=threads)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["elements", "flow", "two phases"])
def test_one_thread_that_does_the_work_of_all_computes_the_same(kind, monkeypatch):
    """While other processes want the cores; to the bit, whenever it begins and ends."""
    if kind == "elements":
        scene = scenes.pipe(**SMALL | dict(travel=0.005, ramp=0.002))
    else:
        scene = scenes.channel(spacing=5e-3, duration=0.02, aggregates=kind == "two phases")

    def state_hash():
        return Simulation(scene, device="cpu", threads=2).run().result["state_hash"]

    assert len(results_under_contention(monkeypatch, state_hash)) == 1


def test_threads_that_wait_for_cores_become_one_and_are_tried_again(monkeypatch):
    now, late = [100.0], [0.0]
    monkeypatch.setattr(cores, "core_waiting_time", lambda thread: late[0])
    monkeypatch.setattr(cores.time, "monotonic", lambda: now[0])
    contention = CoreContention()
    contention.register_thread()
    assert contention.is_uncertain and not contention.use_one_thread()
    contention.add_step_time(0.02)  # nobody waited
    assert not contention.is_uncertain and not contention.contended
    for hold in (0.5, 1.0, 2.0, 4.0, 8.0, 8.0):
        late[0] += 0.015
        contention.add_step_time(0.02)
        assert not contention.use_one_thread() and contention.is_uncertain  # once may be by chance
        late[0] += 0.015
        contention.add_step_time(0.02)
        assert contention.use_one_thread()
        now[0] += 0.99 * hold
        assert contention.use_one_thread()
        now[0] += 0.02 * hold
        assert not contention.use_one_thread() and contention.is_uncertain
    contention.add_step_time(0.02)
    for _ in range(2):
        late[0] += 0.015
        contention.add_step_time(0.02)
    assert contention.use_one_thread()
    now[0] += 0.51
    assert not contention.use_one_thread()  # after a quiet time the wait is short again


@pytest.mark.linux
@pytest.mark.parametrize("there", [{0, 1, 2}, {3, 5, 9}, {0, 1, 2, 3}, {4}])
def test_threads_have_a_core_each_where_there_are_as_many(there, monkeypatch):
    taken = []
    monkeypatch.setattr(cores.os, "sched_getaffinity", lambda thread: there, raising=False)
    monkeypatch.setattr(cores.os, "sched_setaffinity", lambda thread, own: taken.append((thread, own)), raising=False)
    gate = threading.Barrier(3)  # so that all three threads begin
    with ThreadPoolExecutor(3, initializer=cores.thread_pinner(3)) as pool:
        list(pool.map(lambda _: gate.wait(), range(3)))
    assert sorted(map(str, taken)) == ([str((0, {core})) for core in sorted(there)] if len(there) == 3 else [])


@pytest.mark.linux
def test_a_core_that_is_no_more_stops_no_thread(monkeypatch):
    def refuse(thread, own):
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(cores.os, "sched_getaffinity", lambda thread: {7}, raising=False)
    monkeypatch.setattr(cores.os, "sched_setaffinity", refuse, raising=False)
    with ThreadPoolExecutor(1, initializer=cores.thread_pinner(1)) as pool:
        assert pool.submit(lambda: 3).result() == 3


@pytest.mark.parametrize("fast", [0, -1])
def test_threads_find_the_same_stable_step_together(fast):
    """A fast sphere and a driven wall bound the step of all, whichever thread comes upon them."""
    count = 2 * batch.SPHERES_PER_THREAD
    places = np.stack([*np.divmod(np.arange(count), 32), np.zeros(count)], axis=1) * 0.02
    speeds = np.zeros((count, 3))
    speeds[fast, 2] = 30.0
    lid = PlaneWall(
        name="lid", point=(0, 0, 0.0099), normal=(0, 0, -1), motion=Driven(direction=(0, 0, -1), force=1.0, mass=0.1)
    )

    def steps(velocities, contact, *walls):
        body = Bodies(positions=places, sizes=0.02, density=2500.0, velocities=velocities)
        scene = Scene(name="row", duration=1.0, bodies=(body,), contact=contact, walls=walls)
        for threads in (1, 2):
            model = build_model(scene, find_device("cpu"), "float64")
            stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step, threads=threads)
            assert stepper.batch.threads == threads
            stepper.choose_dt()
            yield stepper.dt

    hertz = HertzMindlin.of(1e7, 0.3)
    calm, fast_one, lidded = (list(steps(*each)) for each in ((0 * speeds, hertz), (speeds, hertz),
                                                              (0 * speeds, Contact(), lid)))  # fmt: skip
    for alone, together in (calm, fast_one, lidded):
        assert alone == pytest.approx(together, rel=1e-12)
    assert fast_one[0] < 0.8 * calm[0]
    assert lidded[0] < 0.8 * next(steps(0 * speeds, Contact()))
