"""Test that a GPU's lists miss nothing: near links, long rows, far bonds, the smallest scenes.

Test also what else the steps on a GPU share with the host.
"""

from contextlib import nullcontext

import numpy as np
import pytest
import warp as wp
from conftest import by_id

from warpcrete import Simulation, scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.device.exchange import Exchange
from warpcrete.core.device.launching import Launcher, Stage
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.engine import stages
from warpcrete.dem.engine.batch import Batch
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.measure.probes import contact_sums
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import Bodies, Bonds, Contact, Scene, TimeStep
from warpcrete.kernels.common.types import types
from warpcrete.kernels.dem.linking import MASKED_ENTRIES
from warpcrete.kernels.dem.motion import rotation_functions
from warpcrete.kernels.dem.near import CHOICE_BLOCK, NEAR, near_kernels
from warpcrete.kernels.dem.pairs import BLOCK
from warpcrete.kernels.dem.structs import APART, STIFF, TOUCHING, array_structs, links_struct, scene_struct

SMALL = dict(length=0.1, diameter=0.06, ramp=0.005, travel=0.01, settle=0.02, size_min=8e-3, size_max=12e-3,
             solid_fraction=0.55)  # fmt: skip


@pytest.fixture
def near_list_exceeded(monkeypatch):
    """Record after every launch, for each scene, whether near links may miss a contact."""
    found: list[int] = []
    settle = Batch.settle

    def noting(self):
        flags = settle(self)
        found.extend(self.links.near_list_exceeded.numpy().tolist())
        return flags

    monkeypatch.setattr(Batch, "settle", noting)
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("shapes", ["spheres", "reference"])
def test_whatever_links_are_near_the_state_hash_is_the_same(shapes, monkeypatch, shared_packings, near_list_exceeded):
    """They are chosen every twenty steps, or only with new lists: then spheres outrun them, and all links are read."""
    scene, found = scenes.pipe(shapes=shapes, hydration=0.2, healing=True, **SMALL), []
    with divide_work_like_gpu():
        for chosen in (stages.NEAR_LINK_INTERVAL, 10**6):
            monkeypatch.setattr(stages, "NEAR_LINK_INTERVAL", chosen)
            near_list_exceeded.clear()
            simulation = Simulation(scene, device="cpu")
            run = simulation.run()
            links = simulation.stepper.batch.links
            near, every = int(links.near_count.numpy()[0]), int((links.link.numpy()[:, 0] >= 0).sum())
            assert 0.1 * every < near < 0.8 * every
            found.append((run.result["state_hash"], np.mean(near_list_exceeded)))
    assert len({state for state, _ in found}) == 1
    now_and_then, never_again = (share for _, share in found)
    assert never_again > 0.5 and now_and_then < 0.5 * never_again


@pytest.mark.thorough
def test_links_are_chosen_anew_however_short_graphs_are(near_list_exceeded):
    """Batches go eight steps at a time."""
    with divide_work_like_gpu():
        run_batch([Simulation(scenes.pipe(seed=seed, **SMALL), device="cpu") for seed in (0, 1)])
    assert len(near_list_exceeded) > 100 and np.mean(near_list_exceeded) < 0.3


@pytest.mark.thorough
def test_the_smallest_scenes_meet_in_full_lists():
    """Two spheres that collide, so one pair of which nothing is near at first; once a launch had no thread for it."""
    found = []
    for way in (nullcontext, divide_work_like_gpu):
        with way():
            bodies = Bodies(positions=[[0.0, 0, 0], [0.025, 0, 0]], sizes=0.02, velocities=[[1.0, 0, 0], [0, 0, 0]])
            scene = Scene(name="two", duration=1.0, gravity=(0, 0, 0), bodies=(bodies,))
            model = build_model(scene, find_device("cpu"), "float64")
            stepper = Stepper(model, State(model, placed_bodies(scene)), TimeStep(fixed=1e-5))
            stepper.take(3000)
            found.append(by_id(stepper.state, "velocity")[:, 0])
    half, full = found
    assert full == pytest.approx(half, rel=1e-12) and full[1] > full[0] >= -1e-12


@pytest.mark.thorough
@pytest.mark.parametrize("count", [2, 240])
def test_bonds_across_more_than_the_skin_stay_in_full_lists(count):
    """A sphere flies off that soft bonds tie to another, of which many more lie too close for the first search."""
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    out = np.stack([np.cos(turn) * np.sqrt(1 - height**2), np.sin(turn) * np.sqrt(1 - height**2), height], axis=1)
    away = 5.0 * out * (np.arange(count) < 2)[:, None]
    scene = Scene(
        name="tied",
        duration=1.0,
        gravity=(0, 0, 0),
        contact=Contact(friction=0.0, normal_damping_ratio=0.0),
        bonds=Bonds(effective_modulus=1.0, tensile_strength=1e12, cohesion=1e12, gap=1e-3),
        bodies=(
            Bodies(positions=[[0.0, 0, 0]], sizes=0.1),
            Bodies(positions=0.0551 * out, sizes=0.01, velocities=away),
        ),
    )
    with divide_work_like_gpu():
        check_ties(scene, count)


def check_ties(scene, count):
    model = build_model(scene, find_device("cpu"), "float64")
    stepper = Stepper(model, State(model, placed_bodies(scene)), TimeStep(fixed=1e-4))
    assert stepper.bond(scene.bonds, 1) >= count
    gaps = []
    for _ in range(6):
        stepper.take(100)
        before = contact_sums(model, stepper.state)
        stepper.rebuild()
        after = contact_sums(model, stepper.state)
        assert after.bonded == before.bonded and after.bond_energy == pytest.approx(before.bond_energy, rel=1e-12)
        position = by_id(stepper.state, "position")
        gaps.append(np.linalg.norm(position[1] - position[0]) - 0.055)
    assert max(gaps) > 2 * stepper.skin


@pytest.mark.thorough
def test_a_bond_pulls_at_gaps_of_more_than_a_quarter_of_the_skin():
    """Two bonded spheres fly apart; once such a pair was not near, and its force stayed what it had been before."""
    found = []
    for way in (nullcontext, divide_work_like_gpu):
        with way():
            scene = Scene(
                name="pulled",
                duration=1.0,
                gravity=(0, 0, 0),
                contact=Contact(friction=0.0, normal_damping_ratio=0.0),
                bonds=Bonds(effective_modulus=1e3, tensile_strength=1e12, cohesion=1e12, gap=1e-3),
                bodies=(
                    Bodies(positions=[[0.0, 0, 0], [0.0201, 0, 0]], sizes=0.02, velocities=[[-0.1, 0, 0], [0.1, 0, 0]]),
                ),
            )
            model = build_model(scene, find_device("cpu"), "float64")
            stepper = Stepper(model, State(model, placed_bodies(scene)), TimeStep(fixed=1e-5))
            assert stepper.bond(scene.bonds, 1) == 1
            gaps = []
            for _ in range(20):
                stepper.take(200)
                gaps.append(np.diff(by_id(stepper.state, "position")[:, 0])[0] - 0.02)
            found.append(gaps)
    half, full = found
    assert NEAR * stepper.skin < max(half) < stepper.skin and half[-1] < max(half)
    assert full == pytest.approx(half, rel=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("energies", [False, True], ids=["", "energies"])
@pytest.mark.parametrize("count", [60, 240])
def test_a_sphere_feels_entries_of_which_no_bits_tell(count, energies):
    """A large sphere that many small ones press on, some of which are thrown off and come back. A link gives rows for
    both its spheres; with energies some for each."""
    assert int(BLOCK) < 60 < int(MASKED_ENTRIES) < 240
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    out = np.stack([np.cos(turn) * np.sqrt(1 - height**2), np.sin(turn) * np.sqrt(1 - height**2), height], axis=1)
    found = []
    for way in (nullcontext, divide_work_like_gpu):
        with way():
            scene = Scene(
                name="urchin",
                duration=1.0,
                gravity=(0, 0, 0),
                contact=Contact(friction=0.4),
                energy_balance=energies,
                bodies=(
                    Bodies(positions=[[0.0, 0, 0]], sizes=0.1, spins=np.array([[0.0, 0, 3.0]])),
                    Bodies(positions=0.0549 * out, sizes=0.01, velocities=0.08 * out * (height[:, None] > 0.3)),
                ),
            )
            model = build_model(scene, find_device("cpu"), "float64")
            stepper = Stepper(model, State(model, placed_bodies(scene)), TimeStep(fixed=2e-6))
            assert np.diff(stepper.state.pairs.start.numpy()).max() >= count or not model.features.half_list
            states = []
            for _ in range(6):
                stepper.take(200)
                stepper.rebuild()
                states.append((contact_sums(model, stepper.state).contacts, by_id(stepper.state, "position")))
            found.append((states, by_id(stepper.state, "spin"), stepper.state.spheres.dissipated_energy.numpy().sum()))
    (half, spin, lost), (full, other_spin, other_lost) = found
    counts = [count for count, _ in half]
    assert counts == [count for count, _ in full] and max(counts) > 31 and min(counts) < max(counts)
    assert np.abs(half[-1][1] - full[-1][1]).max() < 1e-13 and np.abs(spin - other_spin).max() < 1e-10
    assert lost == pytest.approx(other_lost, rel=1e-9) and (lost > 0) == energies


def test_a_rebuild_marks_each_touching_pair_at_both_spheres(like_a_gpu):
    """Three spheres in a row. The outer ones have one entry each and the middle one has two, so a pair's entries lie at
    different places in the two rows."""
    row = Bodies(positions=[[0.0, 0, 0], [0.0199, 0, 0], [0.0398, 0, 0]], sizes=0.02, spins=[[0.0, 0, 3]] * 3)
    scene = Scene(name="row", duration=1.0, gravity=(0, 0, 0), contact=Contact(friction=0.4), bodies=(row,))
    model = build_model(scene, find_device("cpu"), "float64")
    stepper = Stepper(model, State(model, placed_bodies(scene)), TimeStep(fixed=1e-5))
    stepper.take(20)
    stepper.rebuild()
    links, start, found = stepper.batch.links, stepper.state.pairs.start.numpy(), [0, 0, 0]
    touching = np.flatnonzero((links.link.numpy()[:, 0] >= 0) & (links.state.numpy() == int(TOUCHING)))
    places = {}
    for i, j, k, twin in links.link.numpy()[touching].tolist():
        places[i, j] = (k - start[i], twin - start[j])
        found[i] |= 1 << int(k - start[i])
        found[j] |= 1 << int(twin - start[j])
    assert len(places) == 2 and any(at_first != at_second for at_first, at_second in places.values())
    assert stepper.state.spheres.touching.numpy().tolist() == found
    assert not links.later_touching.numpy().any()


@pytest.mark.parametrize("scalar", [wp.float32, wp.float64], ids=["float32", "float64"])
def test_near_links_are_those_within_a_quarter_of_the_skin_and_those_that_remember(device, scalar):
    """A pair that touched or is bonded stays near however far it is: it must be told that the touch is over."""
    skin, t = 0.01, types(scalar)
    gaps = skin * np.array([-0.5, 0.24, 0.26, 0.26, 0.9, 0.24])
    state = [int(state) for state in (APART, APART, APART, TOUCHING, STIFF, APART)]
    listed = [1, 1, 1, 1, 1, 0]
    count = len(gaps)
    place = np.zeros((2 * count, 4))
    place[:, 3] = 0.02
    place[1::2, 0] = 0.04 + gaps
    structs = array_structs(scalar)
    batch, spheres, links = structs.Scenes(), structs.Spheres(), links_struct(scalar)()
    row = scene_struct(scalar)()
    row.skin, row.spheres, row.pairs = skin, 0, 100
    batch.row = wp.array([row], dtype=scene_struct(scalar), device=device)
    spheres.position = wp.array(place, dtype=t.vec4, device=device)
    link = [(2 * p, 2 * p + 1, p, 50 + p) if listed[p] else (-1, -1, -1, -1) for p in range(count)]
    links.link = wp.array(link, dtype=wp.vec4i, device=device)
    links.scene = wp.zeros(count, dtype=wp.int32, device=device)
    links.state = wp.array(state, dtype=wp.int32, device=device)
    links.near = wp.full(count, wp.vec4i(-1, -1, -1, -1), dtype=wp.vec4i, device=device)
    links.near_count = wp.zeros(2, dtype=wp.int32, device=device)
    wp.launch(near_kernels(scalar).choose_near, CHOICE_BLOCK, inputs=[batch, spheres, links], device=device,
              block_dim=CHOICE_BLOCK)  # fmt: skip
    assert NEAR == 0.25 and links.near_count.numpy().tolist() == [4, 0]
    assert sorted(links.near.numpy()[:4].tolist()) == [[2 * p, 2 * p + 1, 100 + p, p] for p in (0, 1, 3, 4)]


def test_a_stage_that_is_due_now_and_then_is_left_out_else():
    @wp.kernel(module="unique")
    def count_up(counts: wp.array(dtype=wp.int32), place: wp.int32):
        counts[place] = counts[place] + 1

    device = find_device("cpu")
    counts = wp.zeros(2, dtype=wp.int32, device=device)
    step = [[Stage(count_up, 1, {"counts": counts, "place": k}, device, every=every) for k, every in ((0, 1), (1, 4))]]
    launcher = Launcher(1, device)
    for sizes, now_and_then in (([8], 2), ([2], 1), ([1], 0), ([4, 1, 6], 1 + 0 + 2)):
        counts.zero_()
        launcher.replay(step, lambda: step, sizes, lambda: False)
        assert counts.numpy().tolist() == [sum(sizes), now_and_then]


def test_what_the_host_writes_and_reads_is_the_same(device):
    exchange = Exchange(find_device(device))
    small = wp.zeros((3, 2), dtype=wp.float64, device=device)
    whole = wp.zeros(5, dtype=wp.int32, device=device)
    for value in range(4):  # nothing waits for what was written in the turn before
        exchange.write((small, np.full((3, 2), value)))
        exchange.write((whole, np.arange(5) + value))
    a, b = exchange.read(small, whole)
    assert a.tolist() == [[3.0, 3.0]] * 3 and b.tolist() == [3, 4, 5, 6, 7]
    exchange.write((small, np.zeros((3, 2))))
    assert a[0, 0] == 3.0  # a copy
    assert not exchange.read(small)[0].any()


def test_what_was_asked_for_is_there_however_much_else_is_read(device, monkeypatch):
    """Memory for many arrays is given up; an answer on its way keeps its own."""
    monkeypatch.setattr("warpcrete.core.device.exchange.MAXIMUM_BUFFERS", 3)
    exchange = Exchange(find_device(device))
    a, b, *others = (wp.full(4 + k, k, dtype=wp.int32, device=device) for k in range(9))
    for count in range(len(others)):
        exchange.read(*others[:count])
        exchange.begin_read(a, b)
        exchange.write((others[0], np.full(others[0].shape, 7)))
        finish_read = exchange.finish_read()
        assert exchange.read_is_done and [each.tolist() for each in finish_read] == [[0] * 4, [1] * 5]


@pytest.mark.parametrize("scalar", [wp.float32, wp.float64], ids=["float32", "float64"])
def test_turns_of_any_size_are_exact(device, scalar):
    t = types(scalar)
    turned, _ = rotation_functions(scalar)

    @wp.kernel(module="unique")
    def turn(rotation: wp.array(dtype=t.vec3), out: wp.array(dtype=t.quat)):
        i = wp.tid()
        out[i] = turned(t.quat(scalar(0.0), scalar(0.0), scalar(0.0), scalar(1.0)), rotation[i])

    angle = np.array([0.0, 1e-9, 0.05, 0.0999, 0.1001, 0.3, 1.0, 3.0, 30.0])
    axis = np.array([2.0, -3.0, 6.0]) / 7
    out = wp.zeros(len(angle), dtype=t.quat, device=device)
    wp.launch(
        turn, len(angle), inputs=[wp.array(angle[:, None] * axis, dtype=t.vec3, device=device), out], device=device
    )
    exact = np.concatenate([np.sin(angle / 2)[:, None] * axis, np.cos(angle / 2)[:, None]], axis=1)
    error = np.abs(out.numpy() - exact).max(axis=1)
    eps = np.finfo(out.numpy().dtype).eps
    # Each doubling doubles what rounding made of the part.
    assert np.all(error <= eps * np.maximum(1.0, 8 * angle))
