"""Stiff bonds in rounds within a step: the physics of single steps, momentum, energy, loads, the same bits always."""

import dataclasses
import math
from contextlib import nullcontext

import numpy as np
import pytest
from conftest import bonds_of, by_id, pair_history
from test_checkpoint import mixed_scene

from warpcrete import Simulation, scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.errors import InstabilityError, SceneError
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.engine import batch
from warpcrete.dem.engine.bonding import bond_kinds
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.engine.subcycling import rounds_for
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import AxisDrive, Bodies, Bonds, Contact, Hydration, Scene, TimeStep
from warpcrete.geometry.axis import Axis, Line
from warpcrete.kernels.dem.bond_parallel import HYDRATED
from warpcrete.kernels.dem.subcycling import RELAXATION

SMALL = dict(length=0.12, diameter=0.06, ramp=0.02, travel=8e-3, settle=0.03, size_min=8e-3, size_max=12e-3)
FOREVER = dict(tensile_strength=1e12, cohesion=1e12)
ELASTIC = Contact(friction=0.0, normal_damping_ratio=0.0)
DIAMETER, DENSITY = 0.02, 2500.0
MASS = DENSITY * math.pi / 6 * DIAMETER**3


def bonded(scene, device, precision="float64", rounds=None, threads=1, **settings):
    """A stepper of placed bodies, all of whose contacts are hydrated."""
    scene = dataclasses.replace(scene, time_step=dataclasses.replace(scene.time_step, rounds=rounds))
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step, threads=threads, **settings)
    stepper.choose_dt()
    stepper.bond(scene.bonds, 1)
    stepper.hydrate(1.0, 0)
    stepper.choose_dt()
    return stepper


def scene_of(positions, *, modulus=1e8, contact=ELASTIC, strength=FOREVER, template=None, gravity=(0, 0, 0), **bodies):
    return Scene(
        name="bonded", duration=1.0, gravity=gravity, contact=contact, bonds=Bonds(gap=1e-6, **FOREVER),
        hydration=Hydration(fraction=1.0, bonds=Bonds(effective_modulus=modulus, **strength)), energy_balance=True,
        bodies=(Bodies(positions=np.asarray(positions, float), sizes=DIAMETER, density=DENSITY, template=template,
                       **bodies),),
    )  # fmt: skip


def rod(count=4, gap=1e-7, turned=0.0):
    """A chain of touching spheres."""
    place = (np.arange(count) - 0.5 * (count - 1))[:, None] * (DIAMETER + gap)
    return place * np.array([math.cos(turned), math.sin(turned), 0.0])


def energies(stepper) -> float:
    """All that is stored or has been lost [J]."""
    contacts, bodies = contact_sums(stepper.model, stepper.state), body_sums(stepper.model, stepper.state)
    lost = float(stepper.state.spheres.dissipated_energy.numpy().sum())
    return contacts.elastic_energy + contacts.bond_energy + bodies.kinetic_energy + lost


@pytest.fixture(scope="module")
def plain():
    """A pumping run with single steps, and the same in rounds."""
    found = {}
    for rounds in (1, None):
        scene = scenes.pipe(hydration=0.2, hydration_modulus=1e8, shapes="reference", plug="plate", energy_balance=True,
                            **SMALL)  # fmt: skip
        scene = dataclasses.replace(scene, time_step=TimeStep(rounds=rounds))
        simulation = Simulation(scene, device="cpu", threads=1)
        found[rounds] = simulation.run(), simulation
    return found


@pytest.mark.thorough
def test_a_pumping_run_in_rounds_is_that_of_single_steps(plain):
    (single, _), (rounds, simulation) = plain[1], plain[None]
    assert simulation.stepper.batch.subcycles.rounds > 5
    assert rounds.result["steps"] < 0.2 * single.result["steps"]
    assert abs(rounds.result["energy_balance_error"]) < 3e-4  # 1e-4; of single steps 2e-5
    time = single.series["time"]
    for name, tolerance in (("pressure", 3e-3), ("bond_energy", 8e-3), ("elastic_energy", 2e-3), ("bonds", 8e-3)):
        other = np.interp(time, rounds.series["time"], rounds.series[name])
        scale = np.abs(single.series[name]).max()
        assert np.abs(other - single.series[name])[1:].max() < tolerance * scale, name
    hydrated = single.series["hydrated_bonds"]
    assert (
        hydrated[0] == rounds.series["hydrated_bonds"][0] > 100 and hydrated[-1] == rounds.series["hydrated_bonds"][-1]
    )


def unequal_chain(shape, loose) -> Bodies:
    """Four touching bodies of different sizes in a row that turns, or two more that fly at it."""
    sizes, reach, template = np.array([0.02, 0.014, 0.018, 0.012]), np.array([0.5, 0.5]), None
    if shape == "clumps":
        template = clumps.clump("pair", np.array([[-0.5, 0.0, 0.0], [0.6, 0.0, 0.0]]), np.array([0.6, 0.5]))
        reach = np.abs(template.offsets[:, 0]) + template.radii
    ends = np.cumsum(reach.sum() * sizes - 1e-5)
    positions = np.outer(ends - reach[1] * sizes - 0.5 * ends[-1], [1.0, 0.0, 0.0])
    velocities = np.array([[0, 0.3, 0.1], [0, 0, 0], [0, 0, 0], [0, -0.5, 0.2]])
    if loose:
        sizes = np.append(sizes, [0.016, 0.015])
        positions = np.concatenate([positions, [[0.012, 0.021, 0.001], [-0.015, -0.021, 0.0]]])
        velocities = np.concatenate([0 * velocities, [[0.1, -1.0, 0.0], [0.0, 0.8, 0.2]]])
    return Bodies(positions=positions, sizes=sizes, density=DENSITY, velocities=velocities, template=template)


@pytest.mark.parametrize("loose", [False, True], ids=["bonded", "hit"])
@pytest.mark.parametrize("shape", ["spheres", "clumps"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_momentum_is_kept(device, precision, shape, loose):
    """A chain of unequal bodies turns and vibrates, or meets loose ones, with friction and dashpots."""
    scene = scene_of([[0.0, 0.0, 0.0]], contact=Contact(friction=0.3), modulus=1e8)
    scene = dataclasses.replace(scene, bodies=(unequal_chain(shape, loose),))
    stepper = bonded(scene, device, precision)
    assert stepper.batch.subcycles.pair_count == 3

    def momenta():
        m, v, x = (by_id(stepper.state, name).astype(float) for name in ("mass", "velocity", "position"))
        spin = by_id(stepper.state, "angular_momentum").astype(float)
        return (m[:, None] * v).sum(0), (m[:, None] * np.cross(x, v) + spin).sum(0)

    before, turning = momenta()
    stepper.take(1500)
    after, turned = momenta()
    assert np.abs(by_id(stepper.state, "velocity")[1:3]).max() > 0.05  # the chain was hit, or drawn along
    # Velocities of bodies in rounds and of others stand at the same half step.
    rounding = MASS * 1.0 * (2e-14 if precision == "float64" else 1e-5)
    assert np.abs(after - before).max() < rounding
    # A loose body's contact is seen where the chain will be if nothing stops it: right to second order in the step,
    # measured 2.3e-6.
    assert np.abs(turned - turning).max() < 0.03 * (rounding + (5e-6 * MASS if loose else 0.0))


def test_a_drawn_chain_carries_the_load(device):
    """Statics: every bond holds the force that draws at the ends, not what one kick a step would make of it."""
    force = 0.5
    left, *middle, right = rod(4)
    axis = Axis((-1, 0, 0), (1, 0, 0), (Line(2.0),))
    common = dict(sizes=DIAMETER, density=DENSITY)
    scene = dataclasses.replace(
        scene_of(rod(4)),
        bodies=(Bodies(positions=[left], group="left", **common), Bodies(positions=middle, **common),
                Bodies(positions=[right], group="right", **common)),
        drives=(AxisDrive(group="left", axis=axis, force=-force), AxisDrive(group="right", axis=axis, force=force)),
    )  # fmt: skip
    stepper = bonded(scene, device)
    assert stepper.batch.subcycles.rounds > 10
    for _ in range(30):
        stepper.take(10)
        loads = stepper.state.pairs.load.numpy()[:, 3]
        assert loads.max() < 2 * force  # what a force doubles to that comes at once
    kinds, held = bonds_of(stepper.state)
    held = held[(kinds == 2) & (stepper.state.pairs.other.numpy() >= 0), 3]
    assert len(held) >= 3 and held == pytest.approx(force, rel=1e-6)


def test_a_stiff_pair_vibrates_at_its_own_frequency(device):
    """The bond between two spheres pulled apart, seen in its load at the end of each step; and its period."""
    modulus = 4e5
    scene = scene_of(rod(2), modulus=modulus, velocities=np.array([[-0.05, 0, 0], [0.05, 0, 0]]))
    scene = dataclasses.replace(scene, time_step=TimeStep(fixed=2e-5))
    stepper = bonded(scene, device, rounds=8)
    k = modulus / DIAMETER * math.pi * (DIAMETER / 2) ** 2
    period = 2 * math.pi / math.sqrt(k / (MASS / 2))
    loads = []
    for _ in range(int(1.2 * period / 2e-5)):
        stepper.take(1)
        loads.append(float(stepper.state.pairs.load.numpy()[0, 3]))
    peak = 0.1 * math.sqrt(k * MASS / 2)
    assert max(loads) == pytest.approx(peak, rel=1e-3)  # less what dashpots take
    crossing = np.flatnonzero(np.diff(np.sign(loads)) < 0)[0]
    # Compressed, the contact's own spring adds to the bond: only the half period of tension is the bond's.
    assert (crossing + 1.5) * 2e-5 == pytest.approx(period / 2, rel=2e-3)


@pytest.mark.parametrize("template", [None, clumps.reference()[1]], ids=["spheres", "clumps"])
def test_a_free_cluster_loses_what_its_dashpots_take_and_no_more(device, template):
    random = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[np.arange(3) - 1.0] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = grid * (0.999 if template is None else 0.8) * DIAMETER
    scene = scene_of(positions, velocities=random.normal(scale=0.02, size=positions.shape), template=template,
                     spins=random.normal(scale=1.0, size=positions.shape), modulus=1e8)  # fmt: skip
    stepper = bonded(scene, device, rounds=None)
    assert stepper.batch.subcycles.pair_count > 20
    stepper.take(1)
    start = energies(stepper)
    kinetic = body_sums(stepper.model, stepper.state).kinetic_energy
    found = []
    for _ in range(40):
        stepper.take(20)
        found.append(energies(stepper))
    # Overlaps are measured where bodies will be at the end of the step, by their velocities: of spheres 4 % here.
    assert np.abs(np.array(found) - start).max() < 0.05 * kinetic
    assert np.abs(np.array(found) - found[-1]).max() < 2e-6 * start  # clumps overlap and hold a joule
    assert stepper.state.spheres.dissipated_energy.numpy().sum() > 0.1 * kinetic


@pytest.mark.parametrize("rounds", [1, 20])
def test_bonds_break_at_their_strength(device, rounds):
    """Two spheres drawn apart by ever more: the last load is the strength, in rounds as in single steps."""
    area = math.pi * (DIAMETER / 2) ** 2
    for speed, breaks in ((0.95, False), (1.05, True)):
        modulus, strength = 1e8, 1e5
        k = modulus / DIAMETER * area
        velocity = speed * strength * area / math.sqrt(k * MASS / 2)
        scene = scene_of(rod(2), modulus=modulus, strength=dict(tensile_strength=strength, cohesion=1e12),
                         velocities=np.array([[-velocity / 2, 0, 0], [velocity / 2, 0, 0]]))  # fmt: skip
        scene = dataclasses.replace(scene, time_step=TimeStep(fixed=1e-6 * rounds))
        stepper = bonded(scene, device, rounds=rounds)
        stepper.take(1000 // rounds)
        assert stepper.state.spheres.broken.numpy().sum(axis=0).tolist() == [int(breaks), 0]
        assert (int(bonds_of(stepper.state)[0][0]) == 2) is not breaks
        if breaks and rounds > 1:
            assert stepper.batch.subcycles.arrays.active.numpy().tolist() == [0]


def test_a_broken_pair_is_a_contact_as_all_others(device):
    """Thrust together while its bond is sheared off, a pair ends as overlap, friction and dashpots make it."""
    ends = {}
    for rounds in (1, 20):
        scene = scene_of(rod(2, gap=-2e-4), modulus=1e7, contact=Contact(friction=0.2),
                         strength=dict(tensile_strength=1e12, cohesion=50.0, friction_angle=0.0),
                         velocities=np.array([[0.2, -0.1, 0], [-0.2, 0.1, 0]]))  # fmt: skip
        scene = dataclasses.replace(scene, time_step=TimeStep(fixed=1e-6 * rounds))
        stepper = bonded(scene, device, rounds=rounds)
        stepper.advance(0.02)
        assert stepper.state.spheres.broken.numpy().sum(axis=0).tolist() == [0, 1]
        ends[rounds] = by_id(stepper.state, "velocity"), by_id(stepper.state, "spin")
    for one, other in zip(ends[1], ends[20]):
        assert np.abs(one - other).max() < 2e-3 * np.abs(one).max()


@pytest.mark.parametrize("way", [nullcontext, divide_work_like_gpu], ids=["its lists", "full lists"])
def test_what_a_stiff_bond_held_parts_at_the_first_look(device, way):
    """A bond breaks in its rounds, and by the end of the step the two are apart: what they remember of the touch goes,
    and not at the next touch or when lists are built."""
    scene = scene_of(rod(2, gap=-2e-4), modulus=1e7, contact=Contact(friction=0.2))
    scene = dataclasses.replace(scene, time_step=TimeStep(fixed=1e-5))
    with nullcontext() if device.startswith("cuda") else way():
        stepper = bonded(scene, device, "float64" if way is nullcontext else "float32", rounds=4)
        stepper.take(3)
        pairs, held = stepper.state.pairs, stepper.batch.subcycles.arrays
        bond, history = pairs.bond.numpy(), pairs.history.numpy()
        broken = bond_kinds(bond) == int(HYDRATED)
        assert broken.any()
        bond[broken], history[broken, :3] = -1, 1e-6
        pairs.bond.assign(bond)
        pairs.history.assign(history)
        held.active.zero_()
        for array in (stepper.state.spheres.position, stepper.state.bodies.position):
            place = array.numpy()
            place[np.argmax(place[:, 0]), 0] += 3e-4
            array.assign(place)
        stepper.take(1)
        # A full list has two entries for each pair; the second one holds no history.
        own = broken & (pairs.other.numpy() >= 0) if stepper.batch.parallel else broken
        assert own.any() and np.all(pairs.history.numpy()[own] == 0)


@pytest.mark.thorough
@pytest.mark.parametrize("modulus", [1e6, 1e8, 1e10, 1e12])
def test_any_stiffness_is_stable(device, modulus):
    """A block under its own turning: the energy does not grow, in single precision."""
    random = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(*[np.arange(4) - 1.5] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = grid * 0.999 * DIAMETER + random.normal(scale=1e-5, size=grid.shape)
    velocities = np.cross([0.0, 0.0, 5.0], positions)
    scene = scene_of(positions, modulus=modulus, velocities=velocities, contact=Contact(friction=0.1))
    scene = dataclasses.replace(scene, time_step=TimeStep(largest=2e-4))
    stepper = bonded(scene, device, "float32", rounds=None)
    first = body_sums(stepper.model, stepper.state).kinetic_energy
    stepper.take(60)
    assert body_sums(stepper.model, stepper.state).kinetic_energy < 1.02 * first
    assert stepper.state.dt == pytest.approx(2e-4)  # With too few rounds, the estimate shortens the time step instead.


def healing_scene(seed=0, modulus=1e8):
    scene = mixed_scene(seed, energy_balance=True)
    weak = Bonds(effective_modulus=modulus, tensile_strength=2e4, cohesion=1e4)
    close = dataclasses.replace(scene.bodies[0], positions=0.78 * scene.bodies[0].positions + [0, 0, 0.01])
    return dataclasses.replace(
        scene, duration=0.03, bodies=(close,), hydration=Hydration(fraction=0.3, bonds=weak), time_step=TimeStep()
    )  # fmt: skip


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_same_bits_alone_in_a_batch_and_resumed(device, precision, tmp_path):
    some = [healing_scene(seed, 10.0 ** (8 + 0.5 * seed)) for seed in range(3)]
    alone = [Simulation(scene, device=device, precision=precision, threads=1) for scene in some]
    for simulation in alone:
        simulation.run()
    rounds = [simulation.stepper.batch.subcycles.rounds for simulation in alone]
    assert min(rounds) > 2 and len(set(rounds)) == 3
    together = [Simulation(scene, device=device, precision=precision, threads=1) for scene in some]
    run_batch(together)
    assert len({id(s.stepper.batch) for s in together}) == 1
    for one, other in zip(alone, together):
        assert state_hash(one.state) == state_hash(other.state)
    path = tmp_path / "half.npz"
    half = Simulation(some[1], device=device, precision=precision, threads=1)
    half.prepare()
    half.stepper.take(37)
    half.save(path)
    rest = Simulation(some[1], device=device, precision=precision, threads=1)
    rest.resume(path)
    for simulation in (half, rest):
        simulation.stepper.take(311)
    assert state_hash(half.state) == state_hash(rest.state)
    broken = alone[0].state.spheres.broken.numpy().sum()
    assert broken > 0


def test_two_threads_move_the_same(monkeypatch):
    monkeypatch.setattr(batch, "SPHERES_PER_THREAD", 16)
    found = []
    for count in (1, 2):
        simulation = Simulation(healing_scene(), device="cpu", precision="float64", threads=count)
        simulation.prepare()
        stepper = simulation.stepper
        assert stepper.batch.threads == count
        stepper.take(150)
        found.append((by_id(stepper.state, "position"), stepper.state.spheres.broken.numpy().sum(axis=0)))
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-12
    assert np.array_equal(found[0][1], found[1][1])


def test_full_lists_hold_both_copies_alike(device):
    """Full lists, which a GPU uses, hold every pair twice, and both copies hold the same bits after 80 steps.

    The positions agree with those from half lists to 1e-12 m.
    """
    ends = []
    for like_a_gpu in (False, True):
        with divide_work_like_gpu() if like_a_gpu else nullcontext():
            simulation = Simulation(healing_scene(), device=device, precision="float64", threads=1)
            simulation.prepare()
            simulation.stepper.take(80)
            pair_history(simulation.state)  # asserts that copies hold the same bits
            ends.append(by_id(simulation.state, "position"))
    assert np.abs(ends[0] - ends[1]).max() < 1e-12


def test_who_asks_for_single_steps_gets_them(device):
    stiff = dict(hydration=0.2, hydration_modulus=1e9, plug="plate", **SMALL)
    scene = scenes.pipe(**stiff)
    assert build_model(scene, find_device(device), "float32").features.subcycling
    single = scenes.pipe(**stiff, hydration_rounds=1)
    damped = dataclasses.replace(scene, local_damping=0.1)
    soft = scenes.pipe(**(stiff | dict(hydration_modulus=1e6)))
    for other in (single, damped, soft):
        assert not build_model(other, find_device(device), "float32").features.subcycling


def test_rounds_are_the_fewest_that_are_stable():
    """n rounds are stable if n^2 >= ratio^2 (1 + RELAXATION n)."""
    for ratio in (0.3, 1.0, 2.5, 12.0, 80.0, 1000.0):
        rounds = rounds_for(ratio)
        stable = [n > 0 and n * n >= ratio * ratio * (1 + RELAXATION * n) for n in (rounds - 1, rounds)]
        assert stable == [False, True], ratio


def test_senseless_rounds_are_refused():
    for rounds in (0, -3, 2.5):
        with pytest.raises(SceneError, match="rounds"):
            TimeStep(rounds=rounds)


def test_a_fixed_step_that_rounds_cannot_stand_is_refused(device):
    scene = scene_of(rod(2), modulus=1e9)
    scene = dataclasses.replace(scene, time_step=TimeStep(fixed=1e-4))
    with pytest.raises((SceneError, InstabilityError), match="time_step"):
        bonded(scene, device, rounds=2)
