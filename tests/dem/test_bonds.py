"""Parallel bonds: stiffness, strength and how they break."""

import dataclasses
import math
from contextlib import nullcontext

import numpy as np
import pytest
from conftest import bonds_of, by_id, pair_history
from pumping import TINY
from test_contacts import MASS, RADIUS, two_spheres

from warpcrete import Simulation, scenes
from warpcrete.core.device.device import divide_work_like_gpu
from warpcrete.dem.engine.pairs import listed_pairs
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.measure.probes import contact_sums
from warpcrete.dem.scene.scene import Bodies, Bonds, Contact, Hydration, Scene, TimeStep

AREA, INERTIA = math.pi * RADIUS**2, math.pi * RADIUS**4 / 4
SMOOTH = Contact(friction=0.0, normal_damping_ratio=0.0)


def bonded(start, bonds, *, velocity, spins=None, gap=1e-7, dt=2e-6):
    stepper = start(two_spheres(gap=gap, velocity=velocity, spins=spins, contact=SMOOTH, bonds=bonds, dt=dt))
    assert stepper.bond(bonds, 1) == 1
    return stepper


def load(stepper):
    """Bond force (shear x, y, z, tension) and moment (bending x, y, z, twisting) of the only pair."""
    load = stepper.state.pairs.load.numpy()[0]
    return load[:4].copy(), load[4:].copy()


def strong(**changes):
    return Bonds(
        **(dict(effective_modulus=2e5, stiffness_ratio=2.0, tensile_strength=1e12, cohesion=1e12, gap=1e-6) | changes)
    )


def test_normal_vibration_has_the_bond_stiffness(start):
    # Pulled apart at 0.1 m/s: force peaks at v sqrt(k m_c), where k = E / L * A.
    k = 2e5 / (2 * RADIUS) * AREA
    stepper = bonded(start, strong(), velocity=(0.1, 0, 0))
    peak = 0.0
    quarter = math.pi / 2 * math.sqrt(MASS / 2 / k)
    for _ in range(int(1.2 * quarter / stepper.dt)):
        stepper.take(1)
        peak = max(peak, load(stepper)[0][3])
    assert peak == pytest.approx(0.1 * math.sqrt(k * MASS / 2), rel=2e-4)


@pytest.mark.parametrize(
    ("spin", "part", "stiffness"),
    [
        ((1.0, 0.0, 0.0), "twist", 2e5 / (2 * RADIUS) / 2 * 2 * INERTIA),
        ((0.0, 0.0, 1.0), "bend", 2e5 / (2 * RADIUS) * INERTIA),
    ],
)
def test_moments_grow_with_relative_rotation(start, spin, part, stiffness):
    spins = np.array([-0.5 * np.array(spin), 0.5 * np.array(spin)])
    stepper = bonded(start, strong(), velocity=(0, 0, 0), spins=spins)
    stepper.take(20)
    moment = load(stepper)[1]
    turned = 19 * stepper.dt * 1.0  # the first force is taken before anything moved
    value = moment[3] if part == "twist" else np.linalg.norm(moment[:3])
    assert value == pytest.approx(stiffness * turned, rel=2e-3)


def test_shear_spring_stiffness(start):
    stepper = bonded(start, strong(), velocity=(0.0, 0.01, 0.0))
    stepper.take(20)
    force = load(stepper)[0]
    assert np.linalg.norm(force[:3]) == pytest.approx(2e5 / (2 * RADIUS) / 2 * AREA * 19 * stepper.dt * 0.01, rel=2e-3)


def broken(stepper, steps=4000):
    history = []
    for _ in range(steps):
        history.append(load(stepper))
        stepper.take(1)
        sums = contact_sums(stepper.model, stepper.state)
        if sums.broken_tension or sums.broken_shear:
            return sums.broken_tension, sums.broken_shear, history
    return 0, 0, history


def test_a_bond_that_breaks_in_contact_adds_its_energy_to_the_loss_of_the_contact(start):
    """Two spheres that are too heavy to be slowed down: the dashpot takes the same energy in every step."""
    bonds, booked = strong(cohesion=20.0, friction_angle=0.0), []
    for damping in (0.0, 1e-6):
        contact = Contact(friction=0.0, normal_damping_ratio=damping)
        scene = two_spheres(gap=-1e-4, velocity=(0.05, 0.1, 0), contact=contact, bonds=bonds, dt=2e-6, density=1e15)
        stepper = start(dataclasses.replace(scene, energy_balance=True))
        assert stepper.bond(bonds, 1) == 1
        lost = [0.0]
        for _ in range(30):
            stepper.take(1)
            lost.append(stepper.state.spheres.dissipated_energy.numpy().sum())
        assert stepper.state.spheres.broken.numpy().sum() == 1
        booked.append(np.diff(lost))
    step = int(np.argmax(booked[0]))
    stiffness = 2e5 / (2 * RADIUS - 1e-4) * AREA
    held = 0.5 * stiffness * ((0.05 * step * 2e-6) ** 2 + (0.1 * step * 2e-6) ** 2 / 2)
    assert booked[0][step] == pytest.approx(held, rel=0.02) and np.count_nonzero(booked[0]) == 1
    dashpot = (booked[1] - booked[0])[1:]
    assert dashpot.min() > 0.05 * held and dashpot == pytest.approx(np.full(29, dashpot.mean()), rel=1e-3)


def test_breaks_in_tension_at_its_strength(start):
    strength = 2000.0
    stepper = bonded(start, strong(tensile_strength=strength), velocity=(0.3, 0, 0))
    tension, shear, history = broken(stepper)
    assert (tension, shear) == (1, 0)
    increment = 2e5 / (2 * RADIUS) * AREA * 0.3 * stepper.dt
    last = history[-1][0][3]
    assert last <= strength * AREA <= last + increment
    assert stepper.state.pairs.bond.numpy()[0] == -1
    assert np.all(load(stepper)[0] == 0)


@pytest.mark.parametrize("compression", [0.0, 2e-5])
def test_breaks_in_shear_with_friction_angle(start, compression):
    # Under tension the shear strength is lower, under compression higher: c - sigma tan(phi).
    cohesion, angle, dt = 500.0, 40.0, 2e-7
    bonds = strong(cohesion=cohesion, friction_angle=angle)
    stepper = bonded(start, bonds, velocity=(-0.06 if compression else 0.06, 0.3, 0.0), dt=dt)
    tension, shear, history = broken(stepper, steps=10_000)
    assert (tension, shear) == (0, 1)
    force = history[-1][0]
    stress = force[3] / AREA
    assert abs(stress) > 150 and (stress < 0) == bool(compression)
    limit = (cohesion - stress * math.tan(math.radians(angle))) * AREA
    step = 2e5 / (2 * RADIUS) / 2 * AREA * dt * 0.3
    # Between the last value that held and the next: a thousandth of the strength.
    assert np.linalg.norm(force[:3]) <= limit <= np.linalg.norm(force[:3]) + 1.5 * step


def test_bending_counts_by_the_moment_factor(start):
    strength = 1000.0
    spins = np.array([[0.0, 0, -8.0], [0.0, 0, 8.0]])
    limits = []
    for factor in (1.0, 0.5):
        stepper = bonded(
            start, strong(tensile_strength=strength, moment_factor=factor), velocity=(0, 0, 0), spins=spins
        )
        tension, shear, history = broken(stepper)
        assert (tension, shear) == (1, 0)
        limits.append(np.linalg.norm(history[-1][1][:3]) * RADIUS / INERTIA)
    assert limits[0] == pytest.approx(strength, rel=0.02)
    assert limits[1] == pytest.approx(2 * strength, rel=0.02)


def test_healing_bonds_at_first_touch_only_where_asked_for(start):
    for healing in (False, True):
        bonds = Bonds(healing=healing, tensile_strength=1e12, cohesion=1e12, effective_modulus=2e5)
        stepper = start(two_spheres(gap=1e-4, velocity=(-0.1, 0, 0), contact=SMOOTH, bonds=bonds, dt=5e-6))
        stepper.advance(0.02)
        distance = np.linalg.norm(np.diff(by_id(stepper.state, "position"), axis=0))
        if healing:
            assert bonds_of(stepper.state)[0][0] == 1 and distance < 2 * RADIUS + 2e-4
        else:
            assert distance > 2 * RADIUS + 1e-4


def test_bond_across_a_gap_wider_than_the_skin_stays_listed(start):
    bonds = strong(effective_modulus=1e3)
    scene = two_spheres(gap=1e-7, velocity=(1.0, 0, 0), contact=SMOOTH, bonds=bonds, dt=2e-5)
    stepper = start(scene, skin=0.5 * RADIUS)
    stepper.bond(bonds, 1)
    reach = 0.0
    for _ in range(1800):
        stepper.take(1)
        reach = max(reach, np.linalg.norm(np.diff(by_id(stepper.state, "position"), axis=0)) - 2 * RADIUS)
    k = 1e3 / (2 * RADIUS) * AREA
    assert reach > 2 * stepper.skin
    assert reach == pytest.approx(1.0 * math.sqrt(MASS / 2 / k), rel=1e-2)
    assert len(pair_history(stepper.state)) == 1


@pytest.mark.parametrize(("apart", "made"), [(0.99, 1), (1.01, 0)])
def test_bonds_reach_across_gaps_wider_than_the_skin(apart, made, start):
    """The lists hold such pairs while bonds are made, and have their own skin again afterwards."""
    bonds = strong(gap=RADIUS)
    stepper = start(two_spheres(gap=apart * RADIUS, contact=SMOOTH, bonds=bonds, dt=2e-5), skin=0.5 * RADIUS)
    assert stepper.bond(bonds, 1) == made
    assert stepper.batch.rows["skin"][0] == stepper.skin == 0.5 * RADIUS


def test_a_hash_does_not_tell_whether_a_broken_pair_is_listed(start):
    """Lists of another skin hold it while it is apart, or have let go of it; nor later, when it touches again."""
    bonds, hashes = strong(tensile_strength=2000.0), []
    for skin, listed in ((0.2 * RADIUS, 0), (20 * RADIUS, 1)):
        stepper = start(two_spheres(gap=1e-7, velocity=(0.3, 0, 0), contact=SMOOTH, bonds=bonds, dt=2e-6), skin=skin)
        stepper.bond(bonds, 1)
        found = [state_hash(stepper.state)]
        stepper.take(8000)
        assert len(pair_history(stepper.state)) == listed
        found.append(state_hash(stepper.state))
        bodies, spheres = stepper.state.bodies, stepper.state.spheres
        for array in (bodies.velocity, spheres.velocity):
            turned = array.numpy().copy()
            turned[:, :3] *= -1
            array.assign(turned)
        stepper.take(8200)
        assert np.linalg.norm(np.diff(by_id(stepper.state, "position"), axis=0)) < 2 * RADIUS
        assert stepper.state.pairs.bond.numpy()[0] == -listed
        hashes.append([*found, state_hash(stepper.state)])
    assert hashes[0] == hashes[1] and len(set(hashes[0])) == 3


def test_hydration_takes_the_fraction_asked_for(start):
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*[np.arange(12)] * 3), -1).reshape(-1, 3) * 0.0199 + rng.normal(0, 1e-5, (1728, 3))
    bonds = Bonds()
    scene = Scene(
        name="block",
        duration=0,
        bodies=(Bodies(positions=grid, sizes=0.02),),
        bonds=bonds,
        hydration=Hydration(fraction=0.2),
        gravity=(0, 0, 0),
        time_step=TimeStep(rounds=1),
    )
    stepper = start(scene)
    made = stepper.bond(bonds, 1)
    assert made == 3 * 11 * 12 * 12
    hydrated = stepper.hydrate(0.2, 7)
    assert abs(hydrated - 0.2 * made) < 4 * math.sqrt(made * 0.2 * 0.8)
    # Bonds of a sphere are chosen independently of one another: of three, all are taken once in 125.
    i, j, entry = listed_pairs(stepper.state)
    kind = bonds_of(stepper.state)[0][entry]
    i, j, taken = i[kind > 0], j[kind > 0], kind[kind > 0] == 2  # Lists also hold pairs that do not touch.
    number = stepper.state.spheres.id.numpy()
    for ends in (np.minimum(number[i], number[j]), np.maximum(number[i], number[j])):
        count, chosen = np.bincount(ends), np.bincount(ends, taken)
        assert (count == 3).sum() == 11**3 and 0 < (chosen[count == 3] == 3).sum() < 30
    soft = stepper.estimate()
    assert soft < 1e-5  # a gigapascal counts in the time step


def test_another_seed_hydrates_other_bonds_of_the_same_packing(start):
    """The same seed hydrates the same bonds, and another seed hydrates other bonds."""
    found = []
    small = dict(length=0.08, diameter=0.06, ramp=0.0, travel=1e-3, settle=0.0, size_min=8e-3, size_max=12e-3)
    scene = scenes.pipe(hydration=0.3, hydration_modulus=1e5, plug="plate", **small)
    first = Simulation(scene, device="cpu", threads=1)
    first.prepare()
    table = first.state.table()
    for seed in (0, 0, 1):
        again = dataclasses.replace(scene, seed=seed)
        simulation = Simulation(again, device="cpu", threads=1)
        model = simulation.model
        simulation.state = State(model, table)
        simulation.stepper = Stepper(model, simulation.state, again.time_step)
        simulation.bond()
        history = pair_history(simulation.state)
        found.append({key for key, value in history.items() if int(np.frombuffer(value[1], np.int32)[0]) == 2})
    assert found[0] == found[1] != found[2]
    assert len(found[0]) > 20 and len(found[0] & found[2]) < 0.6 * len(found[0])


def test_bonds_that_heal_carry_no_force_after_settling(device):
    """Bonds that formed while the packing settled are loaded, so all contacts are bonded anew before the run begins."""
    simulation = Simulation(scenes.pipe(**TINY, healing=True), device=device)
    simulation.prepare()
    kinds, load = bonds_of(simulation.state)
    assert np.count_nonzero(kinds > 0) > 100 and np.abs(load).max() == 0.0


@pytest.mark.parametrize("full", [False, True], ids=["half lists", "full lists"])
def test_a_bond_that_breaks_across_a_gap_leaves_no_dashpot_force(start, full):
    """The dashpot of the contact law brakes bonded spheres that are apart, but not in the step that breaks the bond."""
    weak, contact = strong(tensile_strength=1e-9, cohesion=1e-9), Contact(normal_damping_ratio=0.5, friction=0.0)
    with divide_work_like_gpu() if full else nullcontext():
        stepper = start(two_spheres(gap=1e-7, velocity=(0.5, 0, 0), contact=contact, bonds=weak, dt=2e-6))
        assert stepper.bond(weak, 1) == 1
        stepper.take(1)
        braked = by_id(stepper.state, "velocity")[:, 0].copy()
        assert contact_sums(stepper.model, stepper.state).bonded == 1 and 0 < braked[1] < 0.25
        stepper.take(1)
        assert contact_sums(stepper.model, stepper.state).broken_tension == 1
        assert by_id(stepper.state, "velocity")[:, 0] == pytest.approx(braked, rel=1e-12)
