"""Wear of walls: works of sliding and impacts against closed forms, the books of energy, patches, checkpoints."""

import numpy as np
import pytest
from pumping import SMALL

from warpcrete import Simulation, scenes
from warpcrete.dem.laws import Contact, HertzMindlin, LubricationLayer
from warpcrete.dem.scene import Bodies, Scene, TimeStep, Wear
from warpcrete.dem.wear import PipePatches
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.walls import MeshWall, PipeWall, PlaneWall

FLOOR = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
MESH = MeshWall(
    name="floor", vertices=np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]),
    faces=np.array([[0, 1, 2], [0, 2, 3]]),
)  # fmt: skip
MASS = 2500 * np.pi / 6 * 0.02**3


def sliding(contact, *, wall=FLOOR, height=None, velocity=(0.5, 0.0, 0.0), **changes) -> Scene:
    """A sphere that slides over a floor, at the depth where it rests."""
    stiffness = 1e6 * np.pi * 0.01
    height = 0.01 - MASS * 9.81 / stiffness if height is None else height
    settings = dict(
        name="one", duration=0.02, contact=contact, precision="float64", energy_balance=True, walls=(wall,),
        bodies=(Bodies(positions=[[0.1, 0.2, height]], sizes=0.02, velocities=np.array([velocity], float)),),
        wear=Wear(coefficient=1e-12), time_step=TimeStep(fixed=2e-6), sample_interval=0.005,
    )  # fmt: skip
    return Scene(**(settings | changes))


@pytest.mark.parametrize("wall", [FLOOR, MESH], ids=["plane", "mesh"])
def test_a_sliding_sphere_works_mu_n_s(device, wall):
    # It slides all the time: friction slows it by mu g and spins it up, so that its surface slows by 3.5 mu g.
    mu, t, v = 0.1, 0.02, 0.5
    contact = Contact(effective_modulus=1e6, friction=mu, normal_damping_ratio=0.5)
    run = Simulation(sliding(contact, wall=wall), device=device).run()
    way = v * t - 0.5 * 3.5 * mu * 9.81 * t**2
    load = MASS * 9.81
    worn = run.wear.main if wall is MESH else run.wear.walls[0]
    work, bumps, load_way = worn.done.sum(0)
    stretched = mu * load / (1e6 * np.pi * 0.01 / 2)  # of the shear spring, before it slips
    assert work == pytest.approx(mu * load * (way - stretched), rel=2e-4)
    assert load_way == pytest.approx(load * way, rel=2e-4)
    assert bumps < 1e-6 * work
    series = run.series
    assert series["floor_sliding_work"][-1] == work
    spring = 0.5 * mu * load * stretched
    assert series["dissipated_energy"][-1] == pytest.approx(work + bumps, rel=1e-9)
    assert run.result["energy_balance_error"] < 1e-3 and spring < work


def test_a_mesh_knows_which_triangle(device):
    contact = Contact(effective_modulus=1e6, friction=0.1)
    worn = Simulation(sliding(contact, wall=MESH), device=device).run().wear.main
    assert worn.done[0, 0] == 0 and worn.done[1, 0] > 0  # x < y lies in the second
    assert worn.depth[1] == pytest.approx(1e-12 * worn.done[1, 2] / 2.0)


@pytest.mark.parametrize(
    "contact",
    [
        Contact(effective_modulus=1e6, friction=0.3, normal_damping_ratio=0.4),
        LubricationLayer(contact=Contact(effective_modulus=1e6, friction=0.1), yield_stress=20.0, viscosity=50.0),
        HertzMindlin(effective_modulus=1e7, effective_shear_modulus=3e6, friction=0.3, restitution=0.6),
    ],
    ids=["linear", "layer", "hertz"],
)
def test_impacts_lose_what_a_straight_one_does(device, contact):
    # An impact at a slant loses across the wall what one straight on does, and the rest of its loss is sliding.
    slant = dict(gravity=(0, 0, 0), height=0.0101, duration=0.02)
    straight = Simulation(sliding(contact, velocity=(0, 0, -0.3), **slant), device=device).run()
    aslant = Simulation(sliding(contact, velocity=(0.4, 0, -0.3), **slant), device=device).run()
    before, after = straight.series["kinetic_energy"][[0, -1]]
    (work, bump, _), (slid, bumped, _) = (run.wear.walls[0].done.sum(0) for run in (straight, aslant))
    assert bump == pytest.approx(straight.series["dissipated_energy"][-1], rel=1e-9) and work == 0.0
    assert bump == pytest.approx(before - after, rel=2.5e-3)  # measured: 1.7e-3, of a step a thousandth of the impact
    assert bumped == pytest.approx(bump, rel=1e-6) and slid > 0.1 * bump


def test_patches_of_a_bend_add_up_to_a_torus():
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.3), Arc(0.5, np.pi / 2, (1, 0, 0)), Line(0.2)))
    patches = PipePatches(PipeWall(name="pipe", axis=axis, radius=0.075), None)
    straight, bend = 2 * np.pi * 0.075 * 0.5, 2 * np.pi * 0.075 * 0.5 * np.pi / 2
    assert patches.areas.sum() == pytest.approx(straight + bend, rel=1e-9)
    middle = patches.of(np.array([[0.5 - 0.575 * np.sqrt(0.5), 0, 0.3 + 0.575 * np.sqrt(0.5)]]))  # outside of the bend
    station, angle = divmod(int(middle[0]), patches.around)
    assert angle == 0 and patches.along[station] == pytest.approx(0.3 + 0.25 * np.pi / 2, abs=0.02)
    assert patches.areas[middle[0]] == pytest.approx(patches.areas.max())
    vertices, faces, patch = patches.surface()
    assert faces.max() == len(vertices) - 1 and len(patch) == len(vertices)
    centre = patches.of(vertices[patches.around : -patches.around])
    assert np.array_equal(centre, patch[patches.around : -patches.around])
