"""Loads of bonds have rows of their own: where these stand, alone, in batches, and in lists of either kind."""

import copy
import dataclasses
import functools
from contextlib import nullcontext

import numpy as np
import pytest
from conftest import bonds_of, pair_history
from pumping import SMALL
from test_bonds import strong
from test_contacts import two_spheres

from warpcrete import SceneError, Simulation, scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.errors import CapacityError
from warpcrete.core.run.coroutines import run_coroutine
from warpcrete.dem.engine import batch_arrays as joint
from warpcrete.dem.engine import bonding
from warpcrete.dem.engine.bonding import bond_rows
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.pairs import listed_pairs
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper, steppers_of
from warpcrete.dem.packing import pack
from warpcrete.dem.scene.bodies import placed_bodies

WAYS = pytest.mark.parametrize("way", [nullcontext, divide_work_like_gpu], ids=["its lists", "full lists"])


@functools.cache
def packing():
    """Bodies of a small pipe, packed, and the report of it; contacts of bonds and their lists do not change them."""
    simulation = Simulation(scenes.pipe(plug="plate", **SMALL), device="cpu", threads=1)
    scene = simulation.scene
    return pack(scene.fill, contact=scene.contact, seed=scene.seed, device="cpu", precision="float32", threads=1)


def prepared(scene, device) -> Simulation:
    """A simulation at t = 0 that begins with this packing."""
    simulation = Simulation(scene, device=device, threads=1)
    table, report = packing()
    simulation.place((copy.deepcopy(table), report), 0.0)
    simulation.join(Stepper(simulation.model, simulation.state, scene.time_step, threads=1))
    run_coroutine(simulation.preparing(), simulation.stepper.advance)
    return simulation


@pytest.fixture(scope="module")
def packed():
    """Bodies of a small pipe, packed and settled; strengths of bonds do not change them."""
    return prepared(scenes.pipe(plug="plate", **SMALL), "cpu").state.table()


def rows_of(state):
    """Rows of the loads of all entries that are bonded, and which entries these are."""
    bond = state.pairs.bond.numpy()
    entries = np.flatnonzero(bond[: state.pair_total] > 0)
    return bond_rows(bond[entries]), entries


def is_bond(value) -> bool:
    """Return whether a value of `pair_history` describes a bond."""
    return int(np.frombuffer(value[1], np.int32)[0]) > 0


def check_rows(state):
    """Every bond has a row, none has that of another, and all of its entries say which."""
    rows, entries = rows_of(state)
    _, _, place = listed_pairs(state)
    own = np.isin(entries, place)
    apart = 2 if state.model.features.half_list else 1
    assert len(np.unique(rows[own])) == own.sum() > 50 and np.all(rows[own] % apart == 0)
    assert np.isin(rows[~own] - (apart - 1), rows[own]).all()
    assert rows.max() < len(state.pairs.load)
    for load in pair_history(state).values():  # which compares both entries of a pair, where both count
        assert len(load) == 3


@WAYS
@pytest.mark.parametrize(
    "stiff", [{}, dict(hydration=0.3, hydration_modulus=1e7, hydration_rounds=8)], ids=["single steps", "rounds"]
)
def test_bonds_keep_their_rows(device, way, stiff):
    with nullcontext() if device.startswith("cuda") else way():
        simulation = prepared(scenes.pipe(plug="plate", **stiff, **SMALL), device)
        state = simulation.state
        check_rows(state)
        rows, _ = rows_of(state)
        # The lists hold only bonded pairs, and the room that arrays are given to grow.
        assert len(state.pairs.load) <= 1.25 * (rows.max() + 2) + 65
        simulation.stepper.advance(0.02)
        assert state.spheres.broken.numpy().sum() > 0
        check_rows(state)
        left, _ = rows_of(state)
        assert set(left) < set(rows)
        held = simulation.stepper.batch.subcycles
        assert (held.pair_count > 0) == bool(stiff)
        if held.pair_count:
            active = held.arrays.active.numpy() != 0
            entry = held.arrays.entry.numpy()[active]
            assert len(entry) > 50
            assert np.array_equal(bonds_of(state)[1][entry], held.arrays.held.load.numpy()[active])


def test_entries_across_a_border_of_threads_have_rows_of_their_own(monkeypatch):
    monkeypatch.setattr("warpcrete.dem.engine.batch.SPHERES_PER_THREAD", 16)
    simulation = Simulation(scenes.pipe(plug="plate", **SMALL), device="cpu", threads=2)
    simulation.prepare()
    simulation.stepper.advance(0.02)
    state = simulation.state
    check_rows(state)
    rows, _ = rows_of(state)
    assert np.sum(rows % 2 == 1) > 5 and len(np.unique(rows)) == len(rows)


@WAYS
def test_bonds_that_are_made_later_leave_loads_of_others_alone(device, way, packed):
    with nullcontext() if device.startswith("cuda") else way():
        scene = scenes.pipe(tensile_strength=1e9, cohesion=1e9, plug="plate", **SMALL)
        models = [build_model(scene, find_device(device), "float32") for _ in range(2)]
        first, second = steppers_of(models, [State(model, packed) for model in models])
        for stepper in (first, second):
            stepper.choose_dt()
            stepper.bond(scene.bonds, 1)
            stepper.take(200)
        before, others = pair_history(first.state), pair_history(second.state)
        bonded = {pair for pair, value in before.items() if is_bond(value)}
        made = first.bond(dataclasses.replace(scene.bonds, gap=2e-3), 1)
        after = pair_history(first.state)
        assert made > len(bonded) > 50
        assert all(after[pair] == before[pair] and any(after[pair][2]) for pair in bonded)
        fresh = [pair for pair, value in after.items() if is_bond(value) and pair not in bonded]
        assert len(fresh) == made - len(bonded) and all(not any(after[pair][2]) for pair in fresh)
        assert pair_history(second.state) == others
        check_rows(first.state)
        check_rows(second.state)


def test_more_bonds_than_can_be_numbered_are_refused(start, monkeypatch):
    scene = two_spheres(gap=1e-7, bonds=strong(), dt=1e-6)
    stepper = start(scene)
    monkeypatch.setattr(bonding, "MOST_ROWS", 0)
    with pytest.raises(CapacityError, match=r"^bonds = 1: one scene can hold at most 0 bonds;"):
        stepper.bond(scene.bonds, 1)
    monkeypatch.setattr(joint, "MOST_ROWS", 4)
    stepper = start(dataclasses.replace(scene, bonds=dataclasses.replace(scene.bonds, healing=True)))
    with pytest.raises(
        CapacityError, match=r"^bonds = 1000: too many pairs of neighbours could form bonds; one scene can hold"
    ):
        stepper.batch.reserve_pairs(np.array([1000]))


def test_more_kinds_of_bonds_than_can_be_told_apart_are_refused(device):
    scene = two_spheres(gap=1e-7, bonds=strong())
    (bodies,) = scene.bodies
    groups = {f"lump {number}": strong() for number in range(15)}
    scene = dataclasses.replace(
        scene, group_bonds=groups, bodies=tuple(dataclasses.replace(bodies, group=name) for name in groups)
    )
    with pytest.raises(SceneError, match=r"^group_bonds = 15: must be fewer, because a scene has at most 15 kinds"):
        build_model(scene, find_device(device), "float32")


@WAYS
def test_room_is_given_to_all_scenes_that_will_want_it_soon(device, way, packed):
    """All that a batch has recorded is made anew each time; what a scene holds stays."""
    with nullcontext() if device.startswith("cuda") else way():
        scene = scenes.pipe(plug="plate", **SMALL)
        models = [build_model(scene, find_device(device), "float32") for _ in range(3)]
        steppers = steppers_of(models, [State(model, packed) for model in models])
        batch = steppers[0].batch
        for stepper in steppers:
            stepper.choose_dt()
            before = batch.load_capacity.copy()
            stepper.bond(scene.bonds, 1)
        assert np.array_equal(batch.load_capacity, before)  # the first has brought room for the bonds of all
        held = [pair_history(stepper.state) for stepper in steppers]
        room = batch.capacity.copy()
        batch.reserve_pairs(np.array([room[0] + 1, int(0.95 * room[1]), int(0.5 * room[2])]))
        grown = batch.capacity.copy()
        assert grown[0] >= 1.25 * room[0] and grown[1] > 1.1 * room[1] and grown[2] == room[2]
        version = batch.version
        batch.reserve_pairs(grown)
        assert batch.version == version and np.array_equal(batch.capacity, grown)
        assert [pair_history(stepper.state) for stepper in steppers] == held
        for stepper in steppers:
            stepper.take(50)
        ends = [pair_history(stepper.state) for stepper in steppers]
        assert ends[0] == ends[1] == ends[2] != held[0]


@WAYS
def test_a_pair_that_is_let_go_of_bonds_again_without_load(device, way):
    """A pair whose loaded bond is released has no load after the lists are rebuilt.

    A run releases bonds in this way at t = 0, if they healed during settling. Pairs that do not touch at t = 0 may bond
    again later.
    """
    with nullcontext() if device.startswith("cuda") else way():
        bonds = strong(healing=True)
        scene = two_spheres(gap=1e-6, velocity=(0.01, 0.0, 0.0), bonds=bonds, dt=1e-6)
        model = build_model(scene, find_device(device), "float64" if way is nullcontext else "float32")
        stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
        stepper.choose_dt()
        stepper.bond(dataclasses.replace(bonds, gap=1e-5), 1)
        stepper.take(10)
        pairs = stepper.state.pairs
        assert np.any(bonds_of(stepper.state)[1])
        pairs.bond.assign(np.zeros_like(pairs.bond.numpy()))
        stepper.rebuild()
        assert len(pair_history(stepper.state)) == 1 and not np.any(pairs.load.numpy())
