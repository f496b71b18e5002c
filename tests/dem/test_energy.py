"""The books of energy: what piston, plug and gravity put in is stored or dissipated; the step follows what may come."""

import numpy as np
import pytest
from pumping import SMALL

from warpcrete import Simulation, scenes
from warpcrete.dem.laws import BinghamMortar, Contact, HertzMindlin, LubricationLayer
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.scene.clumps import elongated
from warpcrete.dem.scene.scene import Bodies, Scene, Settle, TimeStep
from warpcrete.geometry.prisms import rectangle
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed


@pytest.mark.thorough
@pytest.mark.parametrize(
    "case",
    [
        dict(), dict(shapes="reference", unit="bend-to-horizontal"), dict(wall="mesh", facets=24),
        dict(layer_yield=100.0, layer_viscosity=500.0),
    ],
    ids=["spheres", "clumps, elbow", "mesh", "layer"],
)  # fmt: skip
def test_a_pumping_run_closes_its_books(device, case):
    run = Simulation(scenes.pipe(**(SMALL | case), energy_balance=True), device=device).run()
    assert abs(run.result["energy_balance_error"]) < 3e-4  # measured: 1e-4 at most
    series = run.series
    assert series["dissipated_energy"][0] == 0.0 and np.all(np.diff(series["dissipated_energy"]) > 0)
    assert series["dissipated_energy"][-1] > 0.1 * series["wall_work"][-1]
    assert series["drive_work"][-1] < -0.1 * series["wall_work"][-1]  # the plug's pressure resists
    assert set(run.result["energies_at_end"]) > {"dissipated_energy", "drive_work"}


def one(
    contact, *, velocity=(0.0, 0.0, 0.0), height=0.0101, wall_velocity=None, precision="float64", **changes
) -> Scene:
    motion = None if wall_velocity is None else Prescribed(velocity=wall_velocity)
    settings = dict(
        name="one", duration=0.05, gravity=(0, 0, 0), contact=contact, precision=precision, energy_balance=True,
        walls=(PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1), motion=motion),),
        bodies=(Bodies(positions=[[0.0, 0, height]], sizes=0.02, velocities=np.array([velocity], float)),),
    )  # fmt: skip
    return Scene(**(settings | changes))


@pytest.mark.parametrize("template", [None, elongated(2.0)], ids=["sphere", "clump"])
def test_a_body_in_free_fall_keeps_its_energy(start, template):
    """Energies of motion and of height belong to one time, the middle of a step, so that their sum is constant."""
    bodies = Bodies(positions=[[0, 0, 0]], sizes=0.02, velocities=np.array([[1.0, 0.5, 2.0]]), template=template,
                    spins=np.array([[0, 0, 30.0]]))  # fmt: skip
    fixed = dict(gravity=(1.0, 0, -9.81), walls=(), time_step=TimeStep(fixed=1e-3))
    stepper = start(one(Contact(), bodies=(bodies,), **fixed))
    found = []
    for _ in range(10):
        stepper.take(20)
        sums = body_sums(stepper.model, stepper.state)
        found.append((sums.kinetic_energy, sums.potential_energy))
    kinetic, potential = np.array(found).T
    assert np.ptp(kinetic) > 0.1 * kinetic[0] and np.ptp(kinetic + potential) < 1e-12 * kinetic[0]


@pytest.mark.parametrize("kind", ["plane", "mesh", "pair"])
def test_an_impact_without_damping_keeps_the_sum_of_its_energies(start, kind):
    """The stored energy belongs to the middle of a step as the energy of motion does.

    The sum of both then varies by (w dt)^2 / 4, with the frequency w of the contact. Energies of different ends of a
    step would make it vary by w dt / 2. Of the pair's energy, 0.8 is that of the motion relative to its centre.
    """
    law, dt = Contact(effective_modulus=1e6, normal_damping_ratio=0.0), 2e-5
    given = dict(velocity=(0, 0, -0.3), time_step=TimeStep(fixed=dt))
    if kind == "mesh":
        vertices, faces = rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0))
        given["walls"] = (MeshWall(name="floor", vertices=vertices, faces=faces),)
    if kind == "pair":
        given |= dict(walls=(), bodies=(Bodies(positions=[[0, 0, 0], [0, 0, 0.0201]], sizes=0.02,
                                               velocities=np.array([[0, 0, 0.3], [0, 0, -0.1]])),))  # fmt: skip
    stepper = start(one(law, **given))
    stepper.take(1)
    found = []
    for _ in range(30):
        stepper.take(4)
        stored = contact_sums(stepper.model, stepper.state).elastic_energy
        found.append((body_sums(stepper.model, stepper.state).kinetic_energy, stored))
    kinetic, elastic = np.array(found).T
    # A sphere on a wall has the stiffness pi E r, and half of it against another sphere, with half of the mass.
    mass = 2500 * 4 / 3 * np.pi * 0.01**3
    part, square = 0.8 if kind == "pair" else 1.0, np.pi * 1e6 * 0.01 / mass
    assert np.ptp(kinetic + elastic) == pytest.approx(part * kinetic[0] * square * dt**2 / 4, rel=0.02)
    assert elastic.max() > 0.95 * part * kinetic[0] and elastic[-1] == 0


@pytest.mark.parametrize(
    "contact",
    [
        Contact(shear_damping_ratio=1.0, friction=0.5),
        Contact(shear_damping_ratio=20.0, friction=0.5),
        LubricationLayer(viscosity=1e5),
        BinghamMortar(plastic_viscosity=100.0),
    ],
    ids=["critical", "overdamped", "layer", "mortar"],
)
def test_a_body_that_lands_on_strong_shear_dashpots_loses_energy_only(device, contact):
    # The step is chosen while the body is still in flight.
    run = Simulation(one(contact, velocity=(1.0, 0, -0.2)), device=device).run()
    before, after = run.series["kinetic_energy"][[0, -1]]
    assert after < 0.8 * before
    assert run.series["kinetic_energy"].max() < 1.001 * before


def test_a_hertz_body_at_rest_survives_what_hits_it(device):
    stiff = HertzMindlin(effective_modulus=1e8, effective_shear_modulus=3e7, friction=0.0, restitution=1.0)
    # A wall that comes at 5 m/s throws it off with 10 m/s.
    run = Simulation(one(stiff, wall_velocity=(0, 0, 5.0), duration=0.01), device=device).run()
    assert run.bodies.velocity[0, 2] == pytest.approx(10.0, rel=0.02)
    # A sphere of 1000 times the mass does nearly the same.
    pair = Bodies(
        positions=[[0.0, 0, 0], [0.0, 0, 0.0551]], sizes=[0.1, 0.01], velocities=np.array([[0, 0, 5.0], [0, 0, 0]])
    )
    run = Simulation(one(stiff, walls=(), bodies=(pair,), duration=0.01), device=device).run()
    assert run.bodies.velocity[1, 2] == pytest.approx(10.0 / 1.001, rel=0.02)


@pytest.mark.parametrize(
    "contact",
    [
        LubricationLayer(contact=Contact(friction=0.0), yield_stress=100.0),
        BinghamMortar(yield_stress=100.0, plastic_viscosity=0.1, friction=0.0),
    ],
    ids=["layer", "mortar"],
)
def test_a_spring_still_loaded_at_parting_is_booked(device, contact):
    from warpcrete.dem.scene.scene import TimeStep

    scene = one(contact, velocity=(0.3, 0, -0.3), time_step=TimeStep(fixed=2e-6))
    run = Simulation(scene, device=device).run()
    assert run.series["kinetic_energy"][-1] < run.series["kinetic_energy"][0]
    assert abs(run.result["energy_balance_error"]) < 1e-3


def test_settling_does_not_count(device):
    scene = one(Contact(), height=0.015, gravity=(0, 0, -9.81), settle=Settle(duration=0.2), duration=0.01)
    run = Simulation(scene, device=device).run()
    assert run.series["dissipated_energy"][0] == 0.0
    assert abs(run.series["dissipated_energy"][-1]) < 1e-9
