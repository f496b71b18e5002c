"""Whatever is asked for: a scene is refused with the package's own error, or runs and keeps its invariants."""

import dataclasses
import inspect
import math
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from warpcrete import Simulation, scenes
from warpcrete.core.errors import InstabilityError, PlausibilityWarning, SceneError, WarpcreteError
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.laws import BinghamMortar, Contact, HertzMindlin, LubricationLayer, PlasticMortar
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.scene.containers import Fill, PipeContainer
from warpcrete.dem.scene.scene import AxisDrive, Bodies, Bonds, Hydration, Scene, Settle, TimeStep, Watch
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import Driven, PipeWall, PlaneWall, Prescribed
from warpcrete.scenes import modules

ANYTHING = st.one_of(
    st.floats(), st.integers(-10, 10**6), st.none(), st.text(max_size=4), st.booleans(), st.just(float("inf")),
    st.lists(st.floats(), max_size=4),
)  # fmt: skip
QUICK = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
RUNS = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

PARTS = {
    Contact: (
        "effective_modulus", "stiffness_ratio", "friction", "normal_damping_ratio", "shear_damping_ratio", "dashpot",
    ),
    HertzMindlin: ("effective_modulus", "effective_shear_modulus", "friction", "restitution", "unloading"),
    LubricationLayer: ("yield_stress", "viscosity"),
    BinghamMortar: ("effective_modulus", "shell_fraction", "shell_modulus", "yield_stress", "plastic_viscosity"),
    PlasticMortar: ("yield_stress", "tension", "bending"),
    Bonds: (
        "effective_modulus", "tensile_strength", "cohesion", "friction_angle", "radius_multiplier", "moment_factor",
        "gap",
    ),
    TimeStep: ("fixed", "safety", "largest", "interval"),
    Watch: ("overlap", "speed", "energy"),
    Prescribed: ("velocity", "spin", "ramp_time", "start_time"),
    Bodies: ("sizes", "density", "velocities", "spins", "orientations"),
    PlaneWall: ("point", "normal"),
}  # fmt: skip
NAMED = {"fixed": "time_step"}  # as the command's option calls it
NEEDED = {
    HertzMindlin: dict(effective_modulus=1e6, effective_shear_modulus=3e5),
    Bodies: dict(positions=[[0.0, 0, 0]], sizes=0.01),
    PlaneWall: dict(name="floor", point=(0, 0, 0), normal=(0, 0, 1)),
}


@QUICK
@given(data=st.data())
def test_parts_are_made_or_refused_by_name(data):
    part = data.draw(st.sampled_from(list(PARTS)))
    field = data.draw(st.sampled_from(PARTS[part]))
    value = data.draw(ANYTHING)
    try:
        made = part(**(NEEDED.get(part, {}) | {field: value}))
    except SceneError as error:
        assert NAMED.get(field, field.split("_")[-1]) in str(error)
        return
    numbers = np.asarray(getattr(made, field), dtype=object).ravel()
    assert all(math.isfinite(x) for x in numbers if isinstance(x, float))


ALL_SCENES = tuple(name.replace("-", "_") for name in modules())


@pytest.mark.parametrize("scene", ALL_SCENES)
@settings(QUICK, max_examples=60)
@given(data=st.data())
def test_a_scene_is_made_or_refused(scene, data):
    name = data.draw(st.sampled_from(list(inspect.signature(getattr(scenes, scene)).parameters)))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", PlausibilityWarning)
            made = getattr(scenes, scene)(**{name: data.draw(ANYTHING)})
    except WarpcreteError as error:
        assert str(error).isprintable()
        return
    assert made.duration is None or made.duration > 0


@st.composite
def small_scenes(draw):
    """A few bodies in a box that may move, with any law, and speeds that do not tear it apart."""
    count = draw(st.integers(0, 12))
    seed = draw(st.integers(0, 10**6))
    random = np.random.default_rng(seed)
    size = draw(st.floats(2e-3, 0.03))
    places = random.uniform(-2.5 * size, 2.5 * size, (count, 3)) + [0, 0, 3 * size]
    modulus = draw(st.sampled_from([1e4, 1e5, 1e7]))
    friction = draw(st.sampled_from([0.0, 0.3, 5.0]))
    contact = draw(
        st.sampled_from(
            [
                Contact(effective_modulus=modulus, friction=friction),
                HertzMindlin.of(modulus, 0.3, friction=friction, restitution=0.5),
                LubricationLayer(contact=Contact(effective_modulus=modulus), yield_stress=50.0, viscosity=300.0),
                BinghamMortar(effective_modulus=modulus, friction=friction),
                PlasticMortar(effective_modulus=modulus, friction=friction),
            ]
        )
    )
    walls = [PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))]
    if draw(st.booleans()):
        motion = Driven(direction=(0, 0, -1), force=draw(st.floats(-1, 50)), mass=draw(st.floats(1e-3, 10)))
        walls.append(PlaneWall(name="lid", point=(0, 0, 7 * size), normal=(0, 0, -1), motion=motion))
    if draw(st.booleans()):
        walls.append(PipeWall(name="pipe", axis=Axis((0, 0, -1), (0, 0, 1), (Line(3.0),)), radius=4.5 * size))
    bonds = Bonds(gap=0.2 * size, healing=draw(st.booleans()), tensile_strength=1e3, cohesion=1e3)
    return Scene(
        name="random",
        duration=0.02,
        sample_interval=0.005,
        gravity=(0, 0, -draw(st.sampled_from([0.0, 9.81, 300.0]))),
        contact=contact,
        bonds=bonds if draw(st.booleans()) else None,
        walls=tuple(walls),
        bodies=(
            Bodies(
                positions=places, sizes=random.uniform(0.3, 1.0, count) * size, density=draw(st.floats(100, 8000)),
                velocities=random.normal(scale=0.2, size=(count, 3)), spins=random.normal(scale=5, size=(count, 3)),
            ),
        ),
        energy_balance=draw(st.booleans()),
        watch=Watch(overlap=None),
    )  # fmt: skip


def deepest(scene):
    """Return by how much the elastic energy may lie below that of separate bodies [J].

    Each shell that pulls lowers the energy by at most P^2 / 2k.
    With P = tension tau A and k = E A / (f L) that is (tension tau)^2 A f L / (2 E), most for the largest spheres.
    """
    law = scene.contact
    if not isinstance(law, BinghamMortar):
        return 0.0
    radius = 0.5 * float(np.max(scene.bodies[0].sizes, initial=0.0))
    count = len(scene.bodies[0].positions)
    pull, volume = law.tension * law.yield_stress, np.pi * radius**2 * law.shell_fraction * 2 * radius
    return (count * (count - 1) / 2 + count * len(scene.walls)) * pull**2 * volume / (2 * law.shell_modulus)


def test_shells_that_pull_hold_energy_and_no_more_than_their_pull_gives():
    """Two balls of mortar that barely overlap, at the shell's rest: exactly -P^2 / 2k, which the bound allows."""
    law = BinghamMortar(effective_modulus=1e4, friction=0.0)
    overlap = law.tension * law.yield_stress * law.shell_fraction * 0.02 / law.shell_modulus
    scene = Scene(
        name="pair", duration=1e-4, sample_interval=1e-4, gravity=(0, 0, 0), contact=law,
        bodies=(Bodies(positions=[[0, 0, 0], [0.02 - overlap, 0, 0]], sizes=0.02, density=1000.0),),
        precision="float64",
    )  # fmt: skip
    energy = Simulation(scene, device="cpu", precision="float64").run().series["elastic_energy"][0]
    one = (law.tension * law.yield_stress) ** 2 * np.pi * 1e-4 * law.shell_fraction * 0.02 / (2 * law.shell_modulus)
    assert energy == pytest.approx(-one, rel=1e-9)
    scene = dataclasses.replace(scene, bodies=(dataclasses.replace(scene.bodies[0], sizes=[0.02, 0.02]),))
    assert deepest(scene) == pytest.approx(one)


@pytest.mark.thorough
@RUNS
@given(scene=small_scenes())
def test_small_random_scenes_run_or_stop_with_our_own_error(scene):
    simulation = Simulation(scene, device="cpu")
    try:
        run = simulation.run()
    except InstabilityError as error:
        assert "usual cures" in str(error)
        return
    assert run.finished
    state = simulation.state
    for name in ("position", "velocity", "spin"):
        assert np.all(np.isfinite(getattr(state.bodies, name).numpy())), name
    assert np.allclose(np.linalg.norm(state.bodies.orientation.numpy(), axis=1), 1, atol=1e-5)
    assert sorted(state.bodies.id.numpy()) == list(range(state.body_count))
    for column in ("kinetic_energy", "bond_energy"):
        assert np.all(run.series[column] >= 0)
    assert np.all(run.series["elastic_energy"] >= -deepest(scene))
    if scene.energy_balance and state.body_count:
        assert np.all(np.diff(run.series["dissipated_energy"]) >= -1e-12)  # nothing is ever won back
    assert contact_sums(simulation.model, state).contacts == run.series["contacts"][-1]
    assert body_sums(simulation.model, state).mass == pytest.approx(run.bodies.mass.sum(), rel=1e-5)


@pytest.mark.thorough
@settings(RUNS, max_examples=6)
@given(scene=small_scenes())
def test_the_same_scene_gives_the_same_bits(scene):
    hashes = set()
    for _ in range(2):
        simulation = Simulation(scene, device="cpu")
        try:
            hashes.add(simulation.run().result["state_hash"])
        except InstabilityError:
            hashes.add(state_hash(simulation.state))
    assert len(hashes) == 1


BAD = [
    (Driven, dict(direction=(0, 0, 1), force=1.0, mass=0.0), "driven mass"),
    (Driven, dict(direction=(0, 0, 1), force=1.0, mass=1.0, damping=-1.0), "driven damping"),
    (Driven, dict(direction=(0, 0, 1), force=math.nan, mass=1.0), "driving force"),
    (Driven, dict(direction=(0, 0, 0), force=1.0, mass=1.0), "direction"),
    (Driven, dict(direction=(0, 0, 1), force=1.0, mass=1.0, start_time=-1.0), "start_time"),
    (Prescribed, dict(velocity=(0, 0, math.inf)), "velocity"),
    (Prescribed, dict(spin=(0, 0)), "spin"),
    (Prescribed, dict(ramp_time=-1.0), "ramp_time"),
    (PlaneWall, dict(name="w", point=(0, 0, 0), normal=(0, 0, 0)), "normal"),
    (Contact, dict(friction=-0.1), "friction"),
    (Contact, dict(normal_damping_ratio=-0.1), "normal_damping_ratio"),
    (Contact, dict(dashpot="none"), "dashpot"),
    (HertzMindlin, dict(effective_modulus=1e6, effective_shear_modulus=0.0), "effective_shear_modulus"),
    (HertzMindlin, dict(effective_modulus=1e6, effective_shear_modulus=1e5, restitution=1.1), "restitution"),
    (LubricationLayer, dict(viscosity=-1.0), "viscosity"),
    (BinghamMortar, dict(shell_fraction=0.6), "shell_fraction"),
    (Bonds, dict(friction_angle=95.0), "friction_angle"),
    (Bonds, dict(cohesion=-1.0), "cohesion"),
    (Bonds, dict(tensile_strength=-1.0), "tensile_strength"),
    (TimeStep, dict(safety=0.0), "safety"),
    (Watch, dict(speed=-1.0), "speed"),
    (Watch, dict(energy=0.0), "energy"),
    (Hydration, dict(fraction=1.5, bonds=Bonds()), "fraction"),
    (AxisDrive, dict(group="plug", axis=Axis((0, 0, 0), (0, 0, 1), (Line(1.0),)), force=math.inf), "force"),
    (Settle, dict(duration=-1.0), "duration"),
    (Settle, dict(local_damping=1.5), "local_damping"),
    (Fill, dict(container=PipeContainer(Axis((0, 0, 0), (0, 0, 1), (Line(1.0),)), 0.05, 0.1), solid_fraction=1.2),
     "solid_fraction"),
]  # fmt: skip


@pytest.mark.parametrize(("part", "values", "field"), BAD, ids=[f"{p.__name__}-{f}" for p, _, f in BAD])
def test_the_error_of_a_bad_value_names_that_field_and_no_other(part, values, field):
    with pytest.raises(SceneError) as caught:
        part(**values)
    text = str(caught.value)
    assert field in text.partition(" = ")[0], text
    for name in values:
        assert name in field or f"{name} = " not in text, text
