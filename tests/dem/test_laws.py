"""Every contact law behind the one interface: forces, history, losses, and a new law in a few lines."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
import warp as wp
from conftest import by_id
from test_contacts import DENSITY, K_PAIR, MASS, NO_GRAVITY, RADIUS, two_spheres

from warpcrete.core.errors import SceneError
from warpcrete.dem.laws import (
    BinghamMortar,
    Contact,
    ContactLaw,
    HertzMindlin,
    LubricationLayer,
    PlasticMortar,
    damping_ratio,
)  # fmt: skip
from warpcrete.dem.laws.linear import DASHPOTS
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.pumping.vessels import CONTACTS
from warpcrete.dem.scene.scene import Bodies, Scene, TimeStep
from warpcrete.geometry.walls import PlaneWall, Prescribed
from warpcrete.kernels.common.types import types
from warpcrete.kernels.dem.contact_law import contact_functions
from warpcrete.scenes import modules


@dataclass(frozen=True, kw_only=True)
class Toy(ContactLaw):
    """A law of one's own: one class, wherever it stands."""

    push: Annotated[float, "whatever the overlap [N]"]

    stress_scale = 1e4
    has_history = False

    def frictionless(self):
        return self

    @classmethod
    def device_functions(cls, scalar, parameters):
        Touch, t, Parameters = contact_functions(scalar).Touch, types(scalar), parameters

        @wp.func
        def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
            return -p.push * touch.normal, history, scalar(0.0)

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            return t.vec4(p.push / touch.length, scalar(0.0), scalar(0.0), scalar(0.0))

        @wp.func
        def energy(p: Parameters, touch: Touch, history: t.vec3):
            return -p.push * touch.gap

        return {"force": force, "stiffness": stiffness, "energy": energy}


PRECISIONS = pytest.mark.parametrize("precision", ["float32", "float64"])


@pytest.mark.thorough
@PRECISIONS
def test_a_new_law_is_one_class(start, precision):
    # A constant push of F parts two spheres from rest at F/m each, whatever the overlap, and gives them F d.
    depth, push = 1e-3, 0.5
    scene = two_spheres(gap=-depth, contact=Toy(push=push), dt=1e-5)
    stepper = start(scene, precision)
    stepper.take(50)
    velocity = by_id(stepper.state, "velocity")[:, 0]
    assert velocity == pytest.approx([-push / MASS * 49.5e-5, push / MASS * 49.5e-5], rel=1e-5)
    stepper.advance(0.02)
    parted = np.diff(by_id(stepper.state, "velocity")[:, 0])[0]
    assert 0.25 * MASS * parted**2 == pytest.approx(push * depth, rel=2e-3)


def test_bodies_and_walls_may_follow_different_laws_but_each_only_one(start):
    floor = PlaneWall(name="floor", point=(0, 0, -RADIUS), normal=(0, 0, 1))
    bodies = (Bodies(positions=[[0, 0, -1e-4], [1.9 * RADIUS, 0, -1e-4]], sizes=2 * RADIUS, density=DENSITY),)
    mixed = Scene(
        name="mixed", duration=1.0, gravity=NO_GRAVITY, walls=(floor,), bodies=bodies, time_step=TimeStep(fixed=1e-6),
        contacts={("aggregate", "wall"): Toy(push=0.25)}, contact=Contact(friction=0, normal_damping_ratio=0),
    )  # fmt: skip
    stepper = start(mixed)
    stepper.take(1)
    velocity = by_id(stepper.state, "velocity") / (0.5 * stepper.dt) * MASS
    pair = K_PAIR * 0.1 * RADIUS
    assert velocity == pytest.approx(np.array([[-pair, 0, 0.25], [pair, 0, 0.25]]), rel=1e-9)
    other = Bodies(positions=np.zeros((1, 3)), sizes=0.01, material="other")
    with pytest.raises(SceneError, match="must be one type of contact law for all contacts with walls"):
        start(Scene(name="bad", duration=1.0, walls=(floor,), bodies=(*bodies, other), contacts=dict(mixed.contacts)))


@pytest.mark.parametrize("wall", [False, True])
def test_hertz_force_on_a_held_pair(start, wall):
    # F = 4/3 E* sqrt(R*) d^1.5, with R* = R/2 of the pair and R against a wall.
    law = HertzMindlin(effective_modulus=2e6, effective_shear_modulus=6e5, friction=0.0, restitution=1.0)
    depth = 1e-4
    if wall:
        scene = Scene(
            name="press", duration=1.0, gravity=NO_GRAVITY, contact=law, time_step=TimeStep(fixed=1e-6),
            walls=(PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1)),),
            bodies=(Bodies(positions=[[0, 0, RADIUS - depth]], sizes=2 * RADIUS, density=DENSITY),),
        )  # fmt: skip
    else:
        scene = two_spheres(gap=-depth, contact=law)
    stepper = start(scene)
    stepper.take(1)
    force = np.abs(by_id(stepper.state, "velocity")[0]).max() * MASS / (0.5 * stepper.dt)
    reduced = RADIUS if wall else RADIUS / 2
    assert force == pytest.approx(4 / 3 * 2e6 * math.sqrt(reduced) * depth**1.5, rel=1e-9)
    assert contact_sums(stepper.model, stepper.state).elastic_energy == pytest.approx(
        8 / 15 * 2e6 * math.sqrt(reduced) * depth**2.5, rel=1e-4
    )


@pytest.mark.parametrize("restitution", [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("law", ["linear", "hertz"])
def test_restitution_is_what_was_asked_for_at_any_speed(start, law, restitution):
    beta = damping_ratio(restitution)
    for speed in (0.1, 2.0):
        if law == "linear":
            contact = Contact(friction=0.0, normal_damping_ratio=beta)
        else:
            contact = HertzMindlin(
                effective_modulus=1e7, effective_shear_modulus=3e6, friction=0.0, restitution=restitution
            )
        stepper = start(two_spheres(velocity=(-speed, 0, 0), contact=contact, dt=1e-6))
        stepper.advance(0.02 if restitution == 0 else 0.012)  # the longest of these contacts takes 7 ms
        rebound = np.diff(by_id(stepper.state, "velocity")[:, 0])[0] / speed
        # e = 0 needs for ever: 3e-3 is left at 0.02 s.
        assert rebound == pytest.approx(restitution, abs=4e-3 if restitution == 0 else 8e-4)


def test_mindlin_stiffness_and_slip(start):
    # Held at overlap d and moved sideways: F_t = 8 G* sqrt(R* d) s up to mu F_n.
    law = HertzMindlin(effective_modulus=2e6, effective_shear_modulus=6e5, friction=0.2, restitution=1.0)
    depth, creep, dt = 1e-4, 1e-3, 1e-6
    stepper = start(two_spheres(gap=-depth, velocity=(0, creep, 0), contact=law, dt=dt, density=1e15))
    steps = 1000
    stepper.take(steps + 1)
    root = math.sqrt(RADIUS / 2 * depth)
    shear = np.linalg.norm(stepper.state.pairs.history.numpy()[0])
    assert shear == pytest.approx(8 * 6e5 * root * creep * steps * dt, rel=1e-6)
    stepper.take(12000)
    shear = np.linalg.norm(stepper.state.pairs.history.numpy()[0])
    parted = (creep * 13000 * dt) ** 2 / (4 * RADIUS)  # the centres' distance grows on the way
    assert shear == pytest.approx(0.2 * 4 / 3 * 2e6 * math.sqrt(RADIUS / 2) * (depth - parted) ** 1.5, rel=1e-6)


def sheared_wall(law, depth=1e-4, speed=0.2, dt=1e-6):
    """A sphere too heavy to move, held `depth` inside a floor that slides along x."""
    return Scene(
        name="drag", duration=1.0, gravity=NO_GRAVITY, contact=law, time_step=TimeStep(fixed=dt),
        walls=(
            PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1), motion=Prescribed(velocity=(speed, 0, 0))),
        ),
        bodies=(Bodies(positions=[[0, 0, RADIUS - depth]], sizes=2 * RADIUS, density=1e15),),
    )  # fmt: skip


@pytest.mark.parametrize("rigid_partner, bodies", [(False, 2), (True, 1)])
def test_hertz_mindlin_moduli_follow_from_youngs_modulus(rigid_partner, bodies):
    """Mindlin 1949: 1/E* = sum of (1 - nu^2)/E over both bodies, 1/G* = sum of (2 - nu)/G, G = E/(2 (1 + nu))."""
    law = HertzMindlin.of(1e9, 0.25, rigid_partner=rigid_partner)
    assert law.effective_modulus == pytest.approx(1e9 / 0.9375 / bodies, rel=1e-12)
    assert law.effective_shear_modulus == pytest.approx(0.4e9 / 1.75 / bodies, rel=1e-12)


@pytest.mark.parametrize("speed", [0.05, 0.2])
def test_lubrication_layer_drags_with_yield_stress_and_viscosity(start, speed):
    contact = Contact(friction=0.1, normal_damping_ratio=0.0)
    law = LubricationLayer(contact=contact, yield_stress=251.0, viscosity=893.0)
    stepper = start(sheared_wall(law, speed=speed))
    stepper.advance(0.05)
    area, spring = math.pi * RADIUS**2, 1e5 * math.pi * RADIUS * 1e-4
    tau = 251.0 + 893.0 * speed
    assert -stepper.state.walls.force.numpy()[0, 0] == pytest.approx(0.1 * spring + tau * area, rel=1e-6)


@pytest.mark.parametrize("dashpot", DASHPOTS)
def test_the_shear_dashpot_of_a_sliding_layer_acts_unless_slip_cuts_it(start, dashpot):
    contact = Contact(friction=0.1, normal_damping_ratio=0.0, shear_damping_ratio=1e-6, dashpot=dashpot)
    law = LubricationLayer(contact=contact, yield_stress=251.0, viscosity=0.0)
    stepper = start(sheared_wall(law, speed=0.2))
    stepper.advance(2e-3)
    area, normal, mass = math.pi * RADIUS**2, 1e5 * math.pi * RADIUS, 1e15 * 4 / 3 * math.pi * RADIUS**3
    drag = 0.0 if dashpot in ("slip-cut", "both") else 2e-6 * math.sqrt(mass * normal / 2) * 0.2
    assert -stepper.state.walls.force.numpy()[0, 0] == pytest.approx(0.1 * normal * 1e-4 + 251 * area + drag, rel=1e-6)


def test_lubrication_layer_at_rest_holds_up_to_its_yield_stress(start):
    # A floor that tilts gravity: below tau_L0 A the sphere creeps to a stop, elastically.
    contact = Contact(friction=0.0, normal_damping_ratio=0.3, shear_damping_ratio=0.3, dashpot="slip-cut")
    law = LubricationLayer(contact=contact, yield_stress=50.0, viscosity=100.0)
    carried = 50.0 * math.pi * RADIUS**2 / MASS
    speeds = []
    for share in (0.8, 1.2):
        scene = Scene(
            name="hold", duration=1.0, gravity=(share * carried, 0, -9.81), contact=law,
            walls=(PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1)),),
            bodies=(Bodies(positions=[[0, 0, RADIUS]], sizes=2 * RADIUS, density=DENSITY),),
        )  # fmt: skip
        stepper = start(scene)
        # The sphere would roll: hold its spin, so that only sliding is left.
        while stepper.time < 2.0:
            stepper.take(1)
            stepper.state.bodies.spin.zero_()
            stepper.state.spheres.spin.zero_()
        speeds.append(by_id(stepper.state, "velocity")[0, 0])
    assert abs(speeds[0]) < 1e-6
    assert speeds[1] == pytest.approx(0.2 * 50.0 / 100.0, rel=5e-3)  # what is left after the drag has built up


SHELL = dict(effective_modulus=1e6, shell_fraction=0.1, shell_modulus=2e4, yield_stress=80.0, plastic_viscosity=3.0,
             friction=0.3, normal_damping_ratio=0.0)  # fmt: skip
"""Shell of mortar that is soft and yields."""


@pytest.mark.parametrize(
    ("law", "tension"), [(BinghamMortar(**SHELL), math.sqrt(3)), (PlasticMortar(**SHELL, tension=2.0), 2.0)]
)
def test_mortar_yields_flows_and_hands_over_to_the_core(start, law, tension):
    """Slid along a wall, all of a plastic shell's slider yields: what loaded it before is forgotten."""
    area, shell = math.pi * RADIUS**2, 0.1 * RADIUS
    for depth in (0.05 * RADIUS, 0.15 * RADIUS):
        stepper = start(sheared_wall(law, depth=depth, speed=0.2, dt=2e-6))
        stepper.advance(0.05)
        force = stepper.state.walls.force.numpy()[0]
        core = 1e6 * area / RADIUS * max(depth - shell, 0)
        normal = 2e4 * area / shell * depth + core - tension * 80.0 * area
        shear = 0.3 * core + 80.0 * area + 3.0 * area / shell * 0.2
        assert -force[2] == pytest.approx(normal, rel=1e-6)
        assert -force[0] == pytest.approx(shear, rel=1e-6)


def test_shells_that_pull_keep_energy(start):
    """Head on and without dashpots: kinetic and stored energy have one sum amid the contact and after it."""
    law = BinghamMortar(shell_modulus=1e4, yield_stress=50.0, plastic_viscosity=0.0, friction=0.0,
                        normal_damping_ratio=0.0)  # fmt: skip
    stepper = start(two_spheres(velocity=(-0.1, 0.0, 0.0), contact=law, dt=2e-6))
    before, stored = body_sums(stepper.model, stepper.state).kinetic_energy, []
    while stepper.time < 8e-3:
        stepper.take(400)
        stored.append(contact_sums(stepper.model, stepper.state).elastic_energy)
        assert body_sums(stepper.model, stepper.state).kinetic_energy + stored[-1] == pytest.approx(before, rel=1e-3)
    assert max(stored) > 0.9 * before and stored[-1] == 0.0


def test_plastic_shells_yield_as_von_mises_in_any_strain():
    """Means over all directions n of |D n| and its square, from which the law of a concrete's yield stress follows."""
    count = 100_000
    z = (2 * np.arange(count) + 1) / count - 1
    angle = np.pi * (1 + math.sqrt(5)) * np.arange(count)
    n = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], 1)
    shear, extension = 0.5 * np.eye(3)[[1, 0, 2]] * [1, 1, 0], np.diag([1.0, -0.5, -0.5])
    means = [np.mean(np.linalg.norm(n @ D, axis=1)) for D in (shear, extension)]
    assert means[0] == pytest.approx(math.pi / 8, rel=1e-5)
    assert means[1] / means[0] == pytest.approx(math.sqrt(3), rel=0.015)
    squares = [np.mean(np.sum((n @ D) ** 2, axis=1)) for D in (shear, extension)]
    assert squares == pytest.approx([1 / 6, 1 / 2], rel=1e-5)
    given = modules()["slump-dem"].scene(law="plastic", yield_stress=120.0, viscosity=7.0, shell_fraction=0.08)
    law, filled = given.contact, 0.75 * CONTACTS * 0.66
    assert law.yield_stress * filled * means[0] == pytest.approx(120.0, rel=1e-5)
    assert law.plastic_viscosity / 0.08 * filled * squares[0] == pytest.approx(7.0, rel=1e-5)
    # On what it flows on a lone sphere does not roll away.
    assert law.bending == 0 and given.contacts["aggregate", "plate"].bending > 0.7


def test_the_force_of_plastic_shells_turns_with_the_pair(start):
    """Two spheres that turn about one another as one body, held together by nothing but what their spring holds, the
    centripetal force: they stay on their circle only if it turns with them."""
    law = PlasticMortar(
        effective_modulus=1.0, shell_modulus=1.0, yield_stress=1e5, plastic_viscosity=0.0, friction=0.0,
        normal_damping_ratio=0.0, tension=0.0,
    )  # fmt: skip
    spin, apart = 20.0, 2 * RADIUS * 0.98
    scene = two_spheres(velocity=(0.0, 0.0, 0.0), contact=law, dt=1e-4)
    places = np.array([[-apart / 2, 0, 0], [apart / 2, 0, 0]])
    bodies = dataclasses.replace(
        scene.bodies[0], positions=places, velocities=np.cross([0, 0, spin], places), spins=[[0, 0, spin]] * 2
    )
    stepper = start(dataclasses.replace(scene, bodies=(bodies, *scene.bodies[1:])))
    stepper.take(1)
    history = stepper.state.pairs.history.numpy()
    history[0, :3] = [MASS * spin**2 * apart / 2, 0, 0]
    stepper.state.pairs.history.assign(history)
    for turn in (0.5, 1.0, 1.5):
        stepper.advance(turn / spin)
        place = by_id(stepper.state, "position")
        n = place[1, :3] - place[0, :3]
        assert np.linalg.norm(n) == pytest.approx(apart, rel=1e-2)
        assert np.arctan2(n[1], n[0]) == pytest.approx(turn, abs=0.01)


LAWS = {
    "linear": Contact(friction=0.3, normal_damping_ratio=0.2, shear_damping_ratio=0.1),
    "hertz_mindlin": HertzMindlin(effective_modulus=1e7, effective_shear_modulus=3e6, friction=0.3, restitution=0.7),
    "lubrication": LubricationLayer(contact=Contact(friction=0.1), yield_stress=100.0, viscosity=200.0),
    "mortar": BinghamMortar(effective_modulus=1e5, shell_modulus=1e4, yield_stress=50.0, plastic_viscosity=1.0),
    "plastic": PlasticMortar(effective_modulus=1e5, shell_modulus=1e4, yield_stress=50.0, plastic_viscosity=1.0),
}


@pytest.mark.parametrize("law", LAWS)
def test_what_an_oblique_impact_loses_is_booked(start, law):
    # Kinetic energy before, less after, is what friction and dashpots took; first order in dt.
    errors = []
    for dt in (8e-6, 2e-6):
        scene = two_spheres(
            velocity=(-1.0, 0.7, 0.3), contact=LAWS[law], spins=np.array([[3.0, -20, 8], [1, 5, -40]]), dt=dt
        )
        stepper = start(dataclasses.replace(scene, energy_balance=True))
        before = body_sums(stepper.model, stepper.state).kinetic_energy
        stepper.advance(0.03)
        assert contact_sums(stepper.model, stepper.state).contacts == 0
        lost = before - body_sums(stepper.model, stepper.state).kinetic_energy
        booked = stepper.state.spheres.dissipated_energy.numpy().sum()
        assert lost > 0.1 * before
        errors.append(abs(booked - lost) / lost)
    assert errors[1] < 1e-3
    assert errors[1] < 0.4 * errors[0] or errors[1] < 1e-4


def test_each_wall_and_body_has_the_law_of_its_own_materials(start):
    """Two walls and two bodies of different materials: four contacts, four stiffnesses."""
    modulus = {("light", "rough"): 1e5, ("light", "smooth"): 2e5, ("heavy", "rough"): 3e5, ("heavy", "smooth"): 5e5}
    depth = 1e-4
    bodies = tuple(
        Bodies(positions=[[x, 0, RADIUS - depth], [x, 0.1, RADIUS - depth]], sizes=2 * RADIUS, density=DENSITY,
               material=name)
        for name, x in (("light", 0.0), ("heavy", 0.1))
    )  # fmt: skip
    up = (0.0, 0.0, 1.0)
    floors = (
        PlaneWall(name="a", point=(0, 0, 0), normal=up, material="rough"),
        PlaneWall(name="b", point=(0, 0, 0), normal=up, material="smooth"),
    )
    contacts = {pair: Contact(effective_modulus=value, friction=0) for pair, value in modulus.items()}
    for some in ((floors[0],), (floors[1],), floors):
        names = {floor.material for floor in some}
        scene = Scene(
            name="materials", duration=1.0, gravity=NO_GRAVITY, walls=some, bodies=bodies,
            contacts={pair: law for pair, law in contacts.items() if pair[1] in names},
            time_step=TimeStep(fixed=1e-6),
        )  # fmt: skip
        stepper = start(scene)
        stepper.take(1)
        force = by_id(stepper.state, "velocity")[:, 2] * MASS / (0.5 * stepper.dt)
        stiffness = [sum(modulus[name, f.material] for f in some) * math.pi * RADIUS for name in ("light", "heavy")]
        assert force == pytest.approx(np.repeat(stiffness, 2) * depth, rel=1e-9)
