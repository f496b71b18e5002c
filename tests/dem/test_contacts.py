"""Contact law: springs, dashpots, friction and history against exact answers."""

import dataclasses
import math
from contextlib import nullcontext

import numpy as np
import pytest
from conftest import by_id, pair_history

from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.laws import BinghamMortar, PlasticMortar
from warpcrete.dem.packing import pack
from warpcrete.dem.scene.clumps import clump
from warpcrete.dem.scene.containers import Fill, PipeContainer
from warpcrete.dem.scene.scene import Bodies, Bonds, Contact, Scene, TimeStep
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import PlaneWall

RADIUS, DENSITY, MODULUS = 0.01, 2500.0, 1e5
MASS = DENSITY * 4 / 3 * math.pi * RADIUS**3
K_PAIR = MODULUS * math.pi * RADIUS / 2  # A E / L with A = pi r^2, L = 2 r
K_WALL = MODULUS * math.pi * RADIUS  # L = r
NO_GRAVITY = (0.0, 0.0, 0.0)


def two_spheres(gap=0.0, velocity=(0.0, 0.0, 0.0), spins=None, contact=None, dt=1e-6, bonds=None, density=DENSITY):
    """Two equal spheres; the second one moves with `velocity` seen from the first."""
    positions = np.outer([-0.5, 0.5], [1.0, 0, 0]) * (2 * RADIUS + gap)
    velocities = np.outer([-0.5, 0.5], velocity)
    return Scene(
        name="two",
        duration=1.0,
        gravity=NO_GRAVITY,
        contact=contact or Contact(normal_damping_ratio=0.0, friction=0.0),
        bodies=(Bodies(positions=positions, sizes=2 * RADIUS, density=density, velocities=velocities, spins=spins),),
        time_step=TimeStep(fixed=dt),
        bonds=bonds,
    )


@pytest.mark.parametrize("beta", [0.0, 0.1, 0.5])
def test_head_on_collision_matches_the_damped_oscillator(start, beta):
    # Exact: contact lasts pi / omega_d, restitution exp(-pi beta / sqrt(1 - beta^2)).
    stepper = start(two_spheres(velocity=(-1.0, 0, 0), contact=Contact(normal_damping_ratio=beta, friction=0)))
    omega = math.sqrt(K_PAIR / (MASS / 2))
    duration = math.pi / (omega * math.sqrt(1 - beta**2))
    restitution = math.exp(-math.pi * beta / math.sqrt(1 - beta**2))
    half_way = duration / 2 if beta == 0 else None
    if half_way:
        stepper.advance(half_way)
        overlap = 2 * RADIUS - np.diff(by_id(stepper.state, "position")[:, 0])[0]
        assert overlap == pytest.approx(1.0 / omega, rel=1e-5)
    stepper.advance(1.1 * duration)
    speed = np.diff(by_id(stepper.state, "velocity")[:, 0])[0]
    assert speed == pytest.approx(restitution, rel=1e-4)


def test_collision_duration_gives_the_stiffness(start):
    stepper = start(two_spheres(velocity=(-1.0, 0, 0)))
    duration = math.pi * math.sqrt(MASS / 2 / K_PAIR)
    touching = 0
    while True:
        stepper.take(1)
        gap = np.diff(by_id(stepper.state, "position")[:, 0])[0] - 2 * RADIUS
        if gap > 0:
            break
        touching += 1
    assert touching * stepper.dt == pytest.approx(duration, rel=1e-3)


@pytest.mark.parametrize("shape", ["spheres", "clumps"])
def test_oblique_impact_conserves_momentum_and_angular_momentum(start, shape):
    """Two bodies of different sizes and densities collide, so that their lever arms and their masses differ."""
    pair = clump("pair", np.array([[0.0, 0.0, 0.0], [0.0, 0.9, 0.2]]), np.array([0.6, 0.45]))
    turned = None if shape == "spheres" else [np.array([0.5, -0.1, 0.4, 0.76]) / np.linalg.norm([0.5, -0.1, 0.4, 0.76])]
    bodies = tuple(
        Bodies(positions=[place], sizes=size, density=density, velocities=[velocity], spins=[spin],
               template=None if shape == "spheres" else pair, orientations=turned)
        for place, size, density, velocity, spin in (
            ([-0.011, 0.0, 0.0], 0.02, 2500.0, [0.5, -0.3, 0.1], [3.0, -20.0, 8.0]),
            ([0.008, 0.001, -0.002], 0.013, 4000.0, [-0.5, 0.4, 0.2], [1.0, 5.0, -40.0]),
        )
    )  # fmt: skip
    scene = Scene(
        name="oblique", duration=1.0, gravity=NO_GRAVITY, contact=Contact(friction=0.4, shear_damping_ratio=0.2),
        bodies=bodies, time_step=TimeStep(fixed=1e-6),
    )  # fmt: skip
    stepper = start(scene)

    def totals():
        m, x, v, w = (by_id(stepper.state, n) for n in ("mass", "position", "velocity", "spin"))
        size = by_id(stepper.state, "size")
        turning = 0.1 * (m * size**2)[:, None] * w if shape == "spheres" else by_id(stepper.state, "angular_momentum")
        return (m[:, None] * v).sum(0), (m[:, None] * np.cross(x, v) + turning).sum(0)

    before, speeds = totals(), by_id(stepper.state, "velocity")
    stepper.advance(0.02)
    after = totals()
    assert np.abs(after[0] - before[0]).max() < 1e-16
    # Angular momentum is that of half-step velocities at full-step places, which leapfrog keeps exactly.
    assert np.abs(after[1] - before[1]).max() < 3e-12 * np.abs(before[1]).max()
    assert np.abs(by_id(stepper.state, "spin")[0] - [3, -20, 8]).max() > 1  # friction did act
    assert np.linalg.norm(by_id(stepper.state, "velocity") - speeds, axis=1).min() > 0.1


def test_only_the_overlapped_part_of_the_first_step_loads_the_shear_spring(start):
    dt, share = 1e-4, 0.25
    closing = 1e-3 / dt * 1e-2  # moves 1e-5 m in a step
    gap = (1 - share) * closing * dt
    scene = two_spheres(
        gap=gap, velocity=(-closing, 0.02, 0.0), contact=Contact(friction=10.0, normal_damping_ratio=0), dt=dt
    )
    stepper = start(scene)
    stepper.take(2)
    shear = np.linalg.norm(np.frombuffer(pair_history(stepper.state)[0, 1][0]))
    ks = K_PAIR / 2
    assert shear == pytest.approx(ks * 0.02 * dt * share, rel=1e-3)


@pytest.mark.parametrize("mode", ["full", "no-tension"])
def test_no_tension_dashpot_never_pulls(start, mode):
    contact = Contact(friction=0.0, normal_damping_ratio=0.9, dashpot=mode)
    stepper = start(two_spheres(gap=-1e-4, velocity=(1.0, 0, 0), contact=contact))
    stepper.take(1)
    acceleration = (np.diff(by_id(stepper.state, "velocity")[:, 0])[0] - 1.0) / (0.5 * stepper.dt)
    spring, dashpot = K_PAIR * 1e-4, 2 * 0.9 * math.sqrt(MASS / 2 * K_PAIR)
    force = spring - dashpot if mode == "full" else 0.0
    assert acceleration * MASS / 2 == pytest.approx(force, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("mode", ["full", "slip-cut"])
def test_slip_cut_drops_the_shear_dashpot_in_slip(start, mode):
    contact = Contact(friction=0.01, normal_damping_ratio=0.0, shear_damping_ratio=0.3, dashpot=mode)
    stepper = start(two_spheres(gap=-1e-4, velocity=(0.0, 5.0, 0.0), contact=contact, dt=1e-5))
    stepper.take(3)  # slipping by now
    before = by_id(stepper.state, "velocity").copy()
    spin = by_id(stepper.state, "spin")[:, 2].copy()
    offset = np.diff(by_id(stepper.state, "position"), axis=0)[0]
    n = offset / np.linalg.norm(offset)
    along = np.array([-n[1], n[0], 0.0])
    stepper.take(1)
    force = -MASS * (by_id(stepper.state, "velocity") - before)[1] @ along / stepper.dt
    friction = 0.01 * K_PAIR * (2 * RADIUS - np.linalg.norm(offset))
    surface = (before[1] - before[0]) @ along - 0.5 * np.linalg.norm(offset) * (spin[0] + spin[1])
    dashpot = 2 * 0.3 * math.sqrt(MASS / 2 * K_PAIR / 2) * surface if mode == "full" else 0.0
    assert force == pytest.approx(friction + dashpot, rel=1e-6)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_sliding_sphere_starts_to_roll(start, damping):
    # Exact: rolling from t = 2 v / (7 mu g) on, at 5/7 of the speed.
    mu, g, speed = 0.2, 9.81, 0.5
    rest = MASS * g / K_WALL
    scene = Scene(
        name="roll",
        duration=1.0,
        contact=Contact(friction=mu, normal_damping_ratio=0.3, shear_damping_ratio=damping, dashpot="slip-cut"),
        time_step=TimeStep(fixed=2e-5),
        walls=(PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1)),),
        bodies=(
            Bodies(
                positions=[[0, 0, RADIUS - rest]],
                sizes=2 * RADIUS,
                density=DENSITY,
                velocities=np.array([[speed, 0, 0]]),
            ),
        ),
    )
    stepper = start(scene)
    onset = 2 * speed / (7 * mu * g)
    if damping == 0:  # pure sliding friction
        check_sliding(stepper, speed, mu * g, rest, 0.5 * onset)
        return
    # Whatever the force, m v a + I w is kept, and so is the speed at which it rolls.
    stepper.advance(3 * onset)
    velocity, spin = by_id(stepper.state, "velocity")[0, 0], by_id(stepper.state, "spin")[0, 1]
    lever = 2.5 * (1 - rest / RADIUS) ** 2
    assert velocity == pytest.approx(lever / (1 + lever) * speed, rel=1e-9)
    assert velocity == pytest.approx(spin * (RADIUS - rest), rel=1e-6)


def check_sliding(stepper, speed, deceleration, rest, time):
    stepper.advance(time)
    velocity = by_id(stepper.state, "velocity")[0, 0]
    assert velocity == pytest.approx(speed - deceleration * time, rel=2e-4)
    spin = by_id(stepper.state, "spin")[0, 1]
    # The moment arm ends at the floor, a little inside the sphere.
    assert spin == pytest.approx(2.5 * deceleration * time / RADIUS * (1 - rest / RADIUS), rel=2e-3)


@pytest.mark.parametrize("axis", ["across", "along"])
def test_shear_history_turns_with_the_pair(start, axis):
    # A sheared, bonded pair without dashpots spins as one body: its energy stays what it was.
    contact = Contact(friction=0.0, normal_damping_ratio=0.0)
    bonds = Bonds(effective_modulus=1e5, tensile_strength=1e12, cohesion=1e12, gap=1e-6)
    rate = 40.0
    spin = np.array([0.0, 0.0, rate]) if axis == "across" else np.array([rate, 0.0, 0.0])
    # The second sphere's extra speed loads bond shear and bending.
    stepper = start(
        two_spheres(
            velocity=(0.0, rate * 2 * RADIUS, 0.05) if axis == "across" else (0.0, 0.0, 0.05),
            spins=np.stack([spin, spin]),
            contact=contact,
            bonds=bonds,
            dt=2e-6,
        )
    )
    stepper.bond(bonds, 1)
    from warpcrete.dem.measure.probes import body_sums, contact_sums

    def energy():
        sums = contact_sums(stepper.model, stepper.state)
        return body_sums(stepper.model, stepper.state).kinetic_energy + sums.elastic_energy + sums.bond_energy

    reference = energy()
    moving = reference - 0.5 * 2 * 0.4 * MASS * RADIUS**2 * rate**2
    if axis == "across":
        moving -= 0.25 * MASS * (rate * 2 * RADIUS) ** 2
    worst = 0.0
    for _ in range(5):  # one revolution
        stepper.advance(stepper.time + 2 * math.pi / rate / 5)
        worst = max(worst, abs(energy() - reference))
    # Measured against the energy of the vibration alone: 3e-3 across, 4e-4 along.
    assert worst < 1e-2 * moving


@pytest.mark.parametrize("part", ["friction", "bond shear", "bond bending"])
def test_history_turns_with_spin_about_the_normal(start, part):
    # Both spheres spin about their common normal; they are too heavy to yield to the load, which turns with them.
    rate, bonds = 50.0, Bonds(effective_modulus=1e5, tensile_strength=1e12, cohesion=1e12)
    spins = np.tile([rate, 0.0, 0.0], (2, 1))
    contact = Contact(friction=0.5, normal_damping_ratio=0.0)
    gap = -1e-5
    stepper = start(two_spheres(gap=gap, spins=spins, contact=contact, bonds=bonds, dt=1e-5, density=1e15))
    stepper.bond(bonds, 1)
    tiny = 1e-12
    name, first = {"friction": ("history", 0), "bond shear": ("load", 0), "bond bending": ("load", 4)}[part]
    array = getattr(stepper.state.pairs, name)
    value = array.numpy().copy()
    value[0, first + 1] = tiny  # along y
    array.assign(value)
    quarter = round(math.pi / 2 / rate / stepper.dt)
    stepper.take(quarter + 1)  # the first force is taken before anything turned
    turned = getattr(stepper.state.pairs, name).numpy()[0][first : first + 3]
    assert turned == pytest.approx([0.0, 0.0, tiny], abs=1e-3 * tiny)


def small_packing(device):
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.1),))
    fill = Fill(container=PipeContainer(axis, 0.04, 0.1), solid_fraction=0.62)
    return fill, pack(fill, device=device, precision="float64", seed=3)[0]


def flowing_scene(fill):
    return Scene(
        name="flow",
        duration=1.0,
        fill=fill,
        walls=fill.container.walls("wall")[:2],
        contact=Contact(friction=0.3),
        bonds=Bonds(tensile_strength=2e3, cohesion=1e3, healing=True),
        gravity=(3.0, 0.0, -9.81),
    )


def test_history_survives_rebuild_and_sorting_bit_for_bit(device):
    fill, table = small_packing(device)
    model = build_model(flowing_scene(fill), find_device(device), "float64")
    stepper = Stepper(model, State(model, table), TimeStep(), sort_every=0)
    stepper.bond(model.scene.bonds, 1)
    stepper.take(200)
    stepper.rebuild()
    before, order = pair_history(stepper.state), stepper.state.bodies.id.numpy().copy()
    loaded = sum(np.any(np.frombuffer(value[0])) for value in before.values())
    assert loaded > 100
    stepper.batch.set(0, sort_every=1)
    stepper.rebuild()
    assert not np.array_equal(stepper.state.bodies.id.numpy(), order)
    after = pair_history(stepper.state)
    assert before == after
    ids = stepper.state.spheres.id.numpy()
    body = stepper.state.bodies.id.numpy()[stepper.state.spheres.body.numpy()]
    counts = np.array([len(t.radii) for t in stepper.state.templates])[table.template]
    assert np.array_equal(np.repeat(np.arange(len(table)), counts)[ids], body)


def test_sorting_changes_the_order_but_not_the_motion(device):
    """Again and again while contacts with bodies and walls are loaded: nothing that they remember may be lost."""
    fill, table = small_packing(device)
    runs = []
    for sort_every in (0, 100):
        # A skin so thin that lists are built, and sorted, many times on the way.
        model = build_model(flowing_scene(fill), find_device(device), "float64")
        stepper = Stepper(model, State(model, table), TimeStep(fixed=2e-5), sort_every=sort_every, skin=2e-4)
        stepper.bond(model.scene.bonds, 1)
        stepper.take(1000)
        assert stepper.lists.builds[0] > 5
        walls = stepper.state.slots.history.numpy()
        runs.append((by_id(stepper.state, "position"), stepper.state.bodies.id.numpy().copy(), np.abs(walls).max()))
    assert not np.array_equal(runs[0][1], runs[1][1])
    assert runs[0][2] > 0
    assert np.abs(runs[0][0] - runs[1][0]).max() < 1e-14  # sums in another order; measured 4e-17


def test_half_and_full_list_agree():
    """The lists of a CPU and of a GPU, on the CPU: motion, history, bonds and their breakage."""
    fill, table = small_packing("cpu")
    results = []
    for way in (nullcontext, divide_work_like_gpu):
        with way():
            weak = Bonds(tensile_strength=20.0, cohesion=10.0, healing=True)
            scene = dataclasses.replace(flowing_scene(fill), bonds=weak)
            model = build_model(scene, find_device("cpu"), "float64")
            stepper = Stepper(model, State(model, table), TimeStep(fixed=2e-5))
            made = stepper.bond(weak, 1)
            stepper.take(400)
        # Lists hold different pairs that do not touch: their skins differ.
        history = pair_history(stepper.state)
        shear = {key: np.frombuffer(value[0]) for key, value in history.items() if np.any(np.frombuffer(value[0]))}
        bonds = {key: kind for key, value in history.items() if (kind := int(np.frombuffer(value[1], np.int32)[0]))}
        assert model.features.half_list == (way is nullcontext)
        results.append((made, by_id(stepper.state, "position"), shear, bonds, stepper.state.spheres.broken.numpy()))
    (made, half, shear, bonds, broken), (_, full, shear_full, bonds_full, broken_full) = results
    assert made == results[1][0] > 100
    assert np.array_equal(broken.sum(0), broken_full.sum(0)) and broken.sum() > 10
    assert bonds == bonds_full and len(bonds) > 100
    assert np.abs(half - full).max() < 1e-10
    assert shear.keys() == shear_full.keys()
    largest = max(np.abs(value).max() for value in shear.values())
    assert largest > 0
    assert max(np.abs(shear[key] - shear_full[key]).max() for key in shear) < 1e-7 * largest


def test_coincident_centres_part(start):
    scene = two_spheres(gap=-2 * RADIUS)
    stepper = start(scene)
    stepper.advance(0.05)
    x = by_id(stepper.state, "position")
    assert np.all(np.isfinite(x)) and np.linalg.norm(x[1] - x[0]) > 1.9 * RADIUS


@pytest.mark.parametrize("direction", [(1, 2, 3), (-3, 1, 0), (1, -1, 1)])
def test_the_stable_step_of_an_oblique_contact_is_by_the_rows_of_its_matrix(start, direction):
    """The stable step of a sphere between two others, without dashpots, follows from its rotational stiffness by shear.

    That stiffness is K = 2 k r^2 (1 - n n^T). Its largest absolute row sum sets the step.
    """
    steps = []
    for n in ((1.0, 0.0, 0.0), direction):
        n = np.array(n) / np.linalg.norm(n)
        positions = np.outer([-1.9, 0.0, 1.9], RADIUS * n)  # a wall at the next touch would count as much as one
        bodies = Bodies(positions=positions, sizes=2 * RADIUS, density=DENSITY)
        scene = dataclasses.replace(two_spheres(), bodies=(bodies,), time_step=TimeStep())
        steps.append(start(scene).estimate())
    rows = np.abs(np.eye(3) - np.outer(n, n)).sum(1)
    assert steps[1] / steps[0] == pytest.approx(1 / np.sqrt(rows.max()), rel=1e-12)


@pytest.mark.parametrize("spin, slides", [((0.0, 0.0, 8.0), False), ((0.0, 0.0, -4.0), True)])
def test_unequal_spheres_that_turn_like_gears_do_not_slide(start, spin, slides):
    """The surfaces at the contact have speeds arm x spin: with arms of 1 and 2, spins of 8 and -4 rad/s roll off."""
    small, large, gap = 0.005, 0.01, -1e-6
    spins = np.array([spin, [0.0, 0.0, -4.0]])
    scene = dataclasses.replace(
        two_spheres(contact=Contact(effective_modulus=MODULUS, friction=0.5, normal_damping_ratio=0.0), dt=1e-6),
        bodies=(Bodies(positions=[[0, 0, 0], [small + large + gap, 0, 0]], sizes=[2 * small, 2 * large],
                       spins=spins),),
    )  # fmt: skip
    stepper = start(scene)
    stepper.take(20)
    across = np.abs(by_id(stepper.state, "velocity")[:, 1])
    slip = (small + 0.5 * gap) * spins[0, 2] + (large + 0.5 * gap) * spins[1, 2]
    if slides:
        assert across[0] > 1e-7 and slip < -0.05
    else:
        assert np.all(across < 1e-9) and abs(slip) < 3e-6


@pytest.mark.parametrize(("kind", "name", "overlap"), [
    (Contact, "normal", 1e-4), (Contact, "shear", 1e-4),
    (BinghamMortar, "normal", 4e-3), (PlasticMortar, "normal", 4e-3),
])  # fmt: skip
def test_dashpots_are_a_part_of_the_critical_ones(start, kind, name, overlap):
    """The force is 2 zeta sqrt(m k) times the velocity, with half a sphere's mass m and a pair's stiffness k or k_s.

    Below their shells of mortar, aggregates have the dashpot of aggregates.
    """
    radius, density, speed, dt = 0.01, 1e6, 0.1, 1e-7
    mass, direction = density * 4 / 3 * math.pi * radius**3, {"normal": 0, "shear": 2}[name]
    velocities = np.zeros((2, 3))
    velocities[:, direction] = speed / 2, -speed / 2
    found = []
    for ratio in (0.0, 0.25):
        law = kind(effective_modulus=1e6, friction=1e3, **{f"{name}_damping_ratio": ratio})
        bodies = Bodies(positions=[[0, 0, 0], [2 * radius - overlap, 0, 0]], sizes=2 * radius, density=density,
                        velocities=velocities)  # fmt: skip
        stepper = start(Scene(name="dashpot", duration=1.0, gravity=(0, 0, 0), contact=law, bodies=(bodies,),
                              time_step=TimeStep(fixed=dt)))  # fmt: skip
        stepper.take(5)
        found.append(by_id(stepper.state, "velocity")[0, direction])
    normal = 1e6 * math.pi * radius**2 / (2 * radius)
    stiffness = normal if name == "normal" else normal / law.stiffness_ratio
    # The first of five leapfrog steps changes the velocity by half. The measured errors are at most 4e-5.
    lost = 2 * 0.25 * math.sqrt(mass / 2 * stiffness) * speed * 4.5 * dt / mass
    assert found[0] - found[1] == pytest.approx(lost, rel=5e-5)
