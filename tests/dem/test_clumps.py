"""Clump templates, size distributions and packings."""

import dataclasses
import functools
import math
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from conftest import by_id
from pumping import TINY
from shortcuts import SharedPackings

from warpcrete import scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.errors import SceneError
from warpcrete.core.units import number
from warpcrete.dem import packing
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.packing import pack
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.containers import Fill, MeshContainer, PipeContainer
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.dem.scene.sizes import Gaussian, SieveCurve, Uniform
from warpcrete.dem.simulation import ElementSimulation
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.rotation import rotate


def test_union_properties_of_two_overlapping_spheres():
    # Exact: lens volume pi (2r - d)^2 (d^2 + 4 d r) / (12 d) for equal radii; its second moments by quadrature.
    r, d = 1.0, 0.8
    lens = math.pi * (2 * r - d) ** 2 * (d * d + 4 * d * r) / (12 * d)
    volume, centroid, inertia = clumps.union_properties(np.array([[-d / 2, 0, 0], [d / 2, 0, 0]]), np.array([r, r]))
    assert volume == pytest.approx(2 * 4 / 3 * math.pi - lens, rel=3e-5)
    assert centroid == pytest.approx([0, 0, 0], abs=1e-12)
    x = np.linspace(-d / 2 - r, d / 2 + r, 200_001)
    section = r * r - (np.abs(x) - d / 2) ** 2  # radius squared of the cut at x
    about_x = np.trapezoid(math.pi * section**2 / 2, x)
    about_y = np.trapezoid(math.pi * section**2 / 4 + math.pi * section * x**2, x)
    assert np.diag(inertia) == pytest.approx([about_x, about_y, about_y], rel=1e-4)  # measured 5e-5


def test_single_sphere_is_exact():
    template = clumps.sphere()
    assert template.radii == pytest.approx([0.5]) and template.inertia == pytest.approx([0.1] * 3)


@pytest.mark.parametrize("factor", [1.5, 2.5, 3.5, 4.5])
def test_shape_factor_templates_have_it(factor):
    template = clumps.elongated(factor)
    assert template.shape_factor == pytest.approx(factor, rel=1e-9)
    volume, centroid, _ = clumps.union_properties(template.offsets, template.radii)
    assert volume == pytest.approx(math.pi / 6, rel=3e-4) and np.abs(centroid).max() < 1e-4


def test_reference_templates_are_four_centred_clumps_in_principal_axes():
    assert len(clumps.reference()) == 4
    for template in clumps.reference():
        assert len(template.radii) > 1
        volume, centroid, inertia = clumps.union_properties(template.offsets, template.radii)
        assert volume == pytest.approx(math.pi / 6, rel=3e-4)
        assert np.abs(centroid).max() < 2e-4
        assert np.abs(inertia - np.diag(np.diag(inertia))).max() < 2e-4 * inertia.max()
        assert np.diag(inertia) / volume == pytest.approx(template.inertia, rel=1e-3)


@pytest.mark.parametrize("factor", [1.2, 1.5, 2.5, 3.5, 4.5, 20.0])
def test_rows_of_spheres_have_their_shape_factor_and_shallow_necks(factor):
    """Compute the row's radius where two spheres meet, sqrt(r^2 - d^2 / 4), from the distance d of their centres."""
    (template,) = clumps.templates(f"shape-{factor}")
    assert template.shape_factor == pytest.approx(factor, rel=1e-9)
    along, radius = np.sort(template.offsets[:, 0]), template.radii[0]
    assert np.all(template.radii == radius) and template.offsets[:, 1:] == pytest.approx(0.0, abs=1e-9)
    necks = np.sqrt(radius**2 - (np.diff(along) / 2) ** 2)
    assert necks.min() >= math.sqrt(0.75) * radius * (1 - 1e-9)


@functools.cache
def box_of(spheres):
    """A box and the clump that covers it."""
    box = trimesh.creation.box((0.03, 0.02, 0.015))
    return box, clumps.from_mesh(box, spheres)


@pytest.mark.parametrize(("spheres", "tolerance"), [(8, 0.1), pytest.param(40, 0.04, marks=pytest.mark.thorough)])
def test_mesh_is_covered_with_the_wanted_number_of_spheres(spheres, tolerance):
    box, template = box_of(spheres)
    assert len(template.radii) == spheres
    volume, *_ = clumps.union_properties(template.offsets, template.radii)
    assert volume == pytest.approx(math.pi / 6, rel=1e-3)
    moments = np.sort(np.linalg.eigvalsh(box.moment_inertia)) / box.volume / (6 * box.volume / np.pi) ** (2 / 3)
    assert np.sort(template.inertia) == pytest.approx(moments, rel=tolerance)  # measured 0.07 and 0.03


@pytest.mark.parametrize("inwards", [True, False])
def test_a_hollow_stone_is_the_stone(inwards):
    (box, whole), cavity = box_of(8), trimesh.creation.box((0.028, 0.018, 0.013))
    if inwards:
        cavity.invert()
    hollow = trimesh.util.concatenate([box, cavity])
    shell = clumps.from_mesh(hollow, 8)
    assert np.array_equal(shell.offsets, whole.offsets) and np.array_equal(shell.radii, whole.radii)
    assert np.array_equal(shell.inertia, whole.inertia)


def test_open_mesh_is_refused():
    box = trimesh.creation.box()
    box.update_faces(np.arange(len(box.faces)) > 0)
    with pytest.raises(SceneError, match="is not closed: 3 of its edges"):
        clumps.from_mesh(box, 5)
    beside = trimesh.creation.box()
    beside.apply_translation([1, 1, 0])
    both = trimesh.util.concatenate([trimesh.creation.box(), beside])
    both.merge_vertices()
    with pytest.raises(SceneError, match="has 1 edges to which more than two triangles belong; join bodies"):
        clumps.from_mesh(both, 5)


def test_sieve_curve_is_met_by_mass():
    curve = SieveCurve((4e-3, 8e-3, 12e-3, 32e-3), (0.0, 0.3, 0.55, 1.0))  # no two classes are equally wide
    sizes = curve.sample(400_000, np.random.default_rng(0))
    mass = sizes**3
    for opening, passing in zip(curve.openings, curve.passing):
        # The coarse fraction is a few per mille of the numbers: its mass scatters by about 1 %.
        assert mass[sizes <= opening].sum() / mass.sum() == pytest.approx(passing, abs=0.015)
    middle = math.sqrt(12e-3 * 32e-3)
    share = mass[(sizes > 12e-3) & (sizes <= middle)].sum() / mass[sizes > 12e-3].sum()
    assert share == pytest.approx(0.5, abs=0.02)


def test_gaussian_is_cut_and_uniform_is_flat():
    random = np.random.default_rng(1)
    sizes = Gaussian().sample(50_000, random)
    assert sizes.min() >= 5e-3 and sizes.max() <= 20e-3
    assert sizes.mean() == pytest.approx(12.5e-3, rel=0.005)
    # Exact deviation of a normal cut at one deviation on both sides: 0.5396 sd.
    assert sizes.std() == pytest.approx(0.53959 * 7.5e-3, rel=0.01)
    flat = Uniform(1.0, 3.0).sample(50_000, random)
    assert flat.std() == pytest.approx(2 / math.sqrt(12), rel=0.01)


def test_free_tumbling_keeps_energy_and_angular_momentum(start):
    # Three principal moments, spun near the unstable middle axis.
    template = clumps.clump("slab", np.array([[1, 0.5, 0], [-1, 0.5, 0], [1, -0.5, 0], [-1, -0.5, 0]]), np.full(4, 0.6))
    moments = template.inertia
    assert moments[0] * 1.3 < moments[1] < moments[2] / 1.1
    spin = np.array([[0.3, 20.0, 0.4]])
    scene = Scene(
        name="tumble",
        duration=1,
        gravity=(0, 0, 0),
        time_step=TimeStep(fixed=2e-4),
        bodies=(Bodies(positions=[[0, 0, 0]], sizes=0.02, template=template, spins=spin),),
    )
    stepper = start(scene)
    body = stepper.state
    momentum = body.bodies.angular_momentum.numpy()[0].copy()
    energies, spins = [], []
    for _ in range(100):
        stepper.take(100)
        energies.append(body_sums(stepper.model, body).kinetic_energy)
        spins.append(rotate(by_id(body, "orientation"), by_id(body, "spin"), inverse=True)[0])
    assert np.array_equal(body.bodies.angular_momentum.numpy()[0], momentum)
    size_mass = float(body.bodies.mass.numpy()[0]) * 0.02**2
    exact = 0.5 * size_mass * (moments * spin[0] ** 2).sum()
    energies = np.array(energies)
    # Spin and orientation are half a step apart when the probe reads them: a small oscillation, no drift.
    assert np.abs(energies / exact - 1).max() < 3e-6  # measured 7e-7
    assert abs(energies[50:].mean() / energies[:50].mean() - 1) < 1e-9  # measured 7e-12
    assert np.array(spins)[:, 1].min() < -10  # it did flip: the middle axis is unstable


def test_a_body_of_revolution_precesses_about_its_angular_momentum(start):
    """Expect a rate of |L| / I, with the angular momentum L and the moment of inertia I about a transverse axis."""
    offsets = 0.4 * np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    template = clumps.ClumpTemplate("rod", offsets, np.full(2, 0.3), np.array([0.05, 0.15, 0.15]))
    scene = Scene(
        name="precess", duration=1, gravity=(0, 0, 0), time_step=TimeStep(fixed=2e-4),
        bodies=(Bodies(positions=[[0, 0, 0]], sizes=0.02, template=template, spins=[[30.0, 20.0, 0.0]]),),
    )  # fmt: skip
    stepper = start(scene)
    momentum = template.inertia * [30.0, 20.0, 0.0]  # by mass times size squared
    about, rate = momentum / np.linalg.norm(momentum), np.linalg.norm(momentum) / template.inertia[1]
    x, beside = np.array([1.0, 0, 0]), np.cross(about, [1.0, 0, 0])
    for _ in range(20):
        stepper.take(100)
        angle = rate * stepper.time
        exact = (x @ about) * about + math.cos(angle) * (x - (x @ about) * about) + math.sin(angle) * beside
        found = rotate(by_id(stepper.state, "orientation"), x[None])[0]
        assert found == pytest.approx(exact, abs=1e-4)
        energy = body_sums(stepper.model, stepper.state).kinetic_energy
    mass = float(stepper.state.bodies.mass.numpy()[0])
    assert angle > 8 and energy == pytest.approx(0.5 * mass * 0.02**2 * momentum @ [30.0, 20.0, 0.0], rel=1e-4)


@pytest.fixture(scope="module")
def straight():
    return Axis((0, 0, 0), (0, 0, 1), (Line(0.15),))


def inside_pipe(table, axis, radius):
    centres = np.linalg.norm(table.position[:, :2], axis=1)
    return np.all(centres < radius) and table.position[:, 2].min() > 0 and table.position[:, 2].max() < axis.length


@pytest.mark.parametrize("shapes", ["spheres", "reference"])
def test_pipe_is_packed_to_a_solid_fraction(device, straight, shapes):
    fill = Fill(container=PipeContainer(straight, 0.05, 0.15), solid_fraction=0.58, templates=clumps.templates(shapes))
    table, report = pack(fill, device=device)
    assert report.solid_fraction == pytest.approx(0.58, rel=0.003)  # half of the last aggregate
    assert report.largest_overlap < 0.05 and inside_pipe(table, straight, 0.05)
    assert report.bodies == len(table) and report.size_factor == 1.0
    assert np.abs(table.velocity).max() == 0
    if shapes == "reference":
        share = np.bincount(table.template, weights=table.volume) / table.volume.sum()
        assert np.abs(share - 0.25).max() < 0.12  # few hundred bodies of very unequal volume


def test_pipe_is_packed_to_a_pressure(device, straight):
    fill = Fill(container=PipeContainer(straight, 0.05, 0.15), pressure=2000.0)
    table, report = pack(fill, device=device)
    assert report.pressure == pytest.approx(2000.0, rel=0.05)
    assert abs(report.size_factor - 1) < 0.03
    assert 4.5 < report.coordination_number < 8 and inside_pipe(table, straight, 0.05)


def test_elbow_is_packed(device):
    axis = Axis((0, 0, 0), (0, 0, 1), (Arc(0.1, math.pi / 2, (1, 0, 0)),))
    fill = Fill(
        container=PipeContainer(axis, 0.04, axis.length), solid_fraction=0.55, templates=clumps.templates("spheres")
    )
    table, report = pack(fill, device=device)
    ring = np.linalg.norm(table.position[:, [0, 2]] - [0.1, 0.0], axis=1) - 0.1
    assert np.hypot(ring, table.position[:, 1]).max() < 0.04
    assert report.largest_overlap < 0.05 and table.position[:, 2].min() > 0


def test_closed_mesh_is_packed(device):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    fill = Fill(
        container=MeshContainer(mesh),
        solid_fraction=0.5,
        templates=clumps.templates("spheres"),
        sizes=Uniform(6e-3, 12e-3),
    )
    table, report = pack(fill, device=device)
    assert report.solid_fraction == pytest.approx(0.5, rel=0.01)
    assert (np.linalg.norm(table.position, axis=1) + table.size / 2).max() < 0.0505
    assert report.largest_overlap < 0.05


def test_packing_is_seeded(device, straight):
    fill = Fill(container=PipeContainer(straight, 0.05, 0.06), solid_fraction=0.5)
    first, again, other = (pack(fill, device=device, seed=seed)[0] for seed in (4, 4, 5))
    assert np.array_equal(first.position, again.position)
    assert len(first) != len(other) or not np.array_equal(first.position, other.position)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(solid_fraction=0.95), "solid_fraction = 0.95"),
        (dict(solid_fraction=0.5, sizes=Uniform(0.05, 0.2)), "largest size = 0.2"),
        (dict(solid_fraction=0.5, fractions=(1.0,)), "fractions"),
        (dict(pressure=-5.0), "packing pressure = -5.0"),
        (dict(), "solid_fraction = None"),
    ],
)
def test_impossible_fills_are_refused(straight, changes, message):
    with pytest.raises(SceneError, match=message):
        Fill(container=PipeContainer(straight, 0.05, 0.15), **changes)


def test_a_turned_body_starts_with_the_spin_it_is_given(start):
    """Angular momentum is in space: R I R^T w, not that of a body that stands upright."""
    shape = clumps.reference()[3]
    random = np.random.default_rng(5)
    turned = random.normal(size=(4, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    spins = random.normal(scale=30, size=(4, 3))
    places = np.arange(4)[:, None] * [0.1, 0, 0]
    bodies = Bodies(positions=places, sizes=0.02, template=shape, orientations=turned, spins=spins)
    stepper = start(Scene(name="turned", duration=1.0, gravity=(0, 0, 0), bodies=(bodies,),
                          time_step=TimeStep(fixed=1e-7)))  # fmt: skip
    mass = by_id(stepper.state, "mass")[:, None]
    inertia = shape.inertia * mass * 0.02**2
    assert np.ptp(shape.inertia) > 0.1 * shape.inertia.max()
    expected = rotate(turned, rotate(turned, spins, inverse=True) * inertia)
    assert by_id(stepper.state, "angular_momentum") == pytest.approx(expected, rel=1e-12)
    stepper.take(1)
    assert by_id(stepper.state, "spin") == pytest.approx(spins, rel=1e-4)


@pytest.mark.parametrize("template", [clumps.sphere(), clumps.reference()[3]], ids=["sphere", "clump"])
def test_a_body_falls_freely_in_steps_of_many_sizes(start, template):
    """Its speed is that of the middle of the last step, as in a leapfrog scheme."""
    body = Bodies(positions=[[0, 0, 0]], sizes=0.02, template=template)
    stepper = start(Scene(name="fall", duration=1.0, bodies=(body,), time_step=TimeStep(fixed=1e-5)))
    for size in (1, 5, 2, 4, 3):
        stepper.time_step = TimeStep(fixed=1e-5 * size)
        stepper.choose_dt()
        stepper.take(size)
        middle = stepper.time - 0.5 * stepper.dt
        assert by_id(stepper.state, "velocity")[0] == pytest.approx([0, 0, -9.81 * middle], rel=1e-9)


def test_shared_packings_have_the_bits_of_new_ones(device, tmp_path, monkeypatch):
    """Tests that need the same packing share it, with its report; another seed, precision or law gets its own."""
    scene, shared = scenes.pipe(**TINY | dict(length=0.05)), SharedPackings(tmp_path)
    settings = dict(contact=scene.contact, seed=0, device=find_device(device), precision="float32", progress=None,
                    threads=1)  # fmt: skip
    first, again = (shared(scene.fill, **settings) for _ in range(2))
    assert shared.reused == 1 and again[1] == first[1] and again[0] is not first[0]
    for field in dataclasses.fields(again[0]):
        ours, theirs = getattr(again[0], field.name), getattr(first[0], field.name)
        assert ours.tobytes() == theirs.tobytes() if isinstance(ours, np.ndarray) else ours == theirs, field.name
    packed = []
    monkeypatch.setattr("shortcuts.packing.pack", lambda fill, **given: packed.append(given) or first)
    softer = dataclasses.replace(scene.contact, effective_modulus=0.9 * scene.contact.effective_modulus)
    for other in (dict(seed=1), dict(precision="float64"), dict(contact=softer), dict(threads=2)):
        shared(scene.fill, **settings | other)
    shared(dataclasses.replace(scene.fill, density=2000.0), **settings)
    with divide_work_like_gpu() if device == "cpu" else nullcontext():
        shared(scene.fill, **settings)
    assert len(packed) == (6 if device == "cpu" else 5) and shared.reused == 7 - len(packed)


def test_a_result_counts_bodies_and_spheres_and_names_each_time(monkeypatch):
    """Two clumps of four spheres: speeds count spheres, and each phase has its own time."""
    shape = clumps.clump("four", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), np.ones(4))
    scene = Scene(
        name="two", duration=1.0, gravity=(0, 0, 0), bodies=(Bodies(positions=[[0, 0, 0], [1, 0, 0]], sizes=0.02,
                                                                    template=shape),),
    )  # fmt: skip
    simulation = ElementSimulation(scene, device="cpu", precision="float64")
    simulation.prepare()
    monkeypatch.setattr(ElementSimulation, "pace", 1000.0)
    simulation.wall_times.phases = {"packing": 2.0, "settling": 3.0, "running": 5.0}
    result = simulation.result(False).result
    speed = {name: number(value) for name, value in result["speed"].items()}
    assert result["bodies"] == 2 and result["spheres"] == 8
    assert speed["steps_per_second"] == 1000.0 and speed["sphere_steps_per_second"] == 8000.0
    assert (speed["packing_time"], speed["settling_time"], speed["wall_time"]) == (2.0, 3.0, 5.0)


def test_the_virial_of_clumps_has_the_vector_from_centroid_to_centroid(start):
    """Each pair of touching spheres adds k times the overlap, projected on its normal and times the branch vector."""
    shape = clumps.clump("pair", np.array([[0, 0, 0], [1.2, 0, 0]]), np.array([1.0, 0.7]))
    scene = Scene(
        name="pairs", duration=1.0, gravity=(0, 0, 0), contact=Contact(effective_modulus=1e5, friction=0.0),
        bodies=(Bodies(positions=[[0, 0, 0], [0.012, 0.015, 0.004]], sizes=0.02, template=shape,
                       orientations=[[0, 0, 0, 1], [0, 0, 0.6, 0.8]]),),
        time_step=TimeStep(fixed=1e-6),
    )  # fmt: skip
    state = (stepper := start(scene)).state
    place, body = state.spheres.position.numpy(), state.spheres.body.numpy()
    centre, sum, touching = state.bodies.position.numpy(), 0.0, 0
    for i in range(4):
        for j in range(i + 1, 4):
            offset = place[j, :3] - place[i, :3]
            apart, radii = np.linalg.norm(offset), (place[i, 3], place[j, 3])
            if body[i] == body[j] or apart >= np.sum(radii):
                continue
            force = 1e5 * math.pi * min(radii) ** 2 / np.sum(radii) * (np.sum(radii) - apart)
            sum += force * (centre[body[j]] - centre[body[i]]) @ offset / apart
            touching += 1
    found = contact_sums(stepper.model, state)
    assert found.contacts == touching > 0
    assert found.virial == pytest.approx(sum, rel=1e-9)


@pytest.mark.parametrize("pilot, wanted", [(0.5, 0.51), (0.74, packing.CLOSE_FRACTION)])
def test_a_packing_to_a_pressure_begins_a_little_denser_than_its_trial(straight, monkeypatch, pilot, wanted):
    """Sizes grow until the pressure is reached, so the wanted fraction must lie above that of the trial packing."""
    asked = []

    def grow(growths, threads, tell):
        return {number: (None, SimpleNamespace(solid_fraction=pilot)) for number in growths}

    monkeypatch.setattr(packing, "_Growth", lambda request, container, fraction, *more: asked.append(fraction))
    monkeypatch.setattr(packing, "_grow_together", grow)
    fill = Fill(container=PipeContainer(straight, 0.05, 0.15), pressure=2000.0)
    (found,) = packing.pack_many([packing.Request(fill, Contact(), 3)], device="cpu")
    assert asked == [packing.CLOSE_FRACTION, pytest.approx(wanted, rel=1e-12)]
    assert found[1].solid_fraction == pilot
