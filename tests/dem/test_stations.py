"""Test what stations along a pipe measure: stresses, velocities, losses, and how far the concrete fills the pipe."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from test_bonds import bonded, strong
from test_part_elements import SMALL

from warpcrete import Simulation, scenes
from warpcrete.dem.laws import Contact, LubricationLayer
from warpcrete.dem.measure.station_forces import STRESS_RESOLUTION, body_stresses
from warpcrete.dem.measure.station_losses import layer_gradient, losses
from warpcrete.dem.measure.stations import COLUMNS, FRONT, _front, measured, stresses_along
from warpcrete.dem.scene.clumps import clump
from warpcrete.dem.scene.scene import Bodies, Scene, Stations
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.walls import PipeWall


def two_spheres(device, apart=0.019, **changes) -> Any:
    """Two spheres on the axis of a pipe along x, and slices round their middle; what is measured, and the overlap."""
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    scene = Scene(
        name="pair", duration=1.0, gravity=(0, 0, 0), contact=Contact(effective_modulus=1e5, normal_damping_ratio=0.0),
        bodies=(Bodies(positions=[[0.5 - apart / 2, 0, 0], [0.5 + apart / 2, 0, 0]], sizes=0.02, **changes),),
        walls=(PipeWall(name="pipe", axis=axis, radius=0.05),),
        stations=Stations(axis=axis, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.5, 1.0)),
    )  # fmt: skip
    simulation = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    return simulation


def test_stress_of_one_contact(device):
    """f l / V: k_n = E pi r^2 / L times the overlap, half of the branch in each slice."""
    simulation = two_spheres(device)
    found = measured(simulation.scene.stations, simulation.model, simulation.state, 0.0)
    force = 1e5 * math.pi * 1e-4 / 0.02 * 0.001
    exact = force * 0.0095 / (math.pi * 0.05**2 * 0.5)
    # The front is where 98 % of the solids lie behind, so only the first slice counts as full.
    named = dict(zip(COLUMNS, found[0], strict=True))
    assert named["axial_stress"] == pytest.approx(exact, rel=1e-12) and np.isnan(found[1]).all()
    assert named["pressure"] == pytest.approx(exact / 3, rel=1e-12) and named["wall_stress"] == 0
    # The first sphere lies in the slice but for its cap beyond the middle, and so does the other's cap.
    assert named["solid_fraction"] == pytest.approx(math.pi / 6 * 8e-6 / (math.pi * 0.05**2 * 0.5), rel=1e-12)


def test_stress_on_the_wall_of_one_sphere_that_slides(device):
    """A layer drags by eta pi r^2 v; the wall's push times the arm to it, over three volumes, is pressure."""
    contact = Contact(effective_modulus=1e5, friction=0.0, normal_damping_ratio=0.0)
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    scene = Scene(
        name="slide", duration=1.0, gravity=(0, 0, 0), contact=contact,
        contacts={("aggregate", "wall"): LubricationLayer(contact=contact, viscosity=100.0)},
        bodies=(Bodies(positions=[[0.25, 0.041, 0], [0.8, 0, 0]], sizes=0.02, velocities=[[0.2, 0, 0], [0, 0, 0]]),),
        walls=(PipeWall(name="pipe", axis=axis, radius=0.05),),
        stations=Stations(axis=axis, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.5, 1.0)),
    )  # fmt: skip
    simulation: Any = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    found = dict(zip(COLUMNS, measured(simulation.scene.stations, simulation.model, simulation.state, 0.0)[0]))
    assert found["wall_stress"] == pytest.approx(100 * math.pi * 1e-4 * 0.2 / (2 * math.pi * 0.05 * 0.5), rel=1e-9)
    push = 1e5 * math.pi * 1e-4 / 0.01 * 0.001
    assert found["pressure"] == pytest.approx(push * 0.009 / 3 / (math.pi * 0.05**2 * 0.5), rel=1e-9)
    assert found["axial_stress"] == pytest.approx(0.0, abs=1e-9) and found["velocity_0.9R"] == pytest.approx(0.2)


def along(stations, simulation):
    """Stresses along a pipe by those of its bodies, shape (slices, 2) [Pa]."""
    bodies, unit = simulation.state.bodies, 0.1
    stress = STRESS_RESOLUTION * unit * body_stresses(simulation.model, simulation.state, unit).numpy()
    s, size = stations.axis.along(bodies.position.numpy()), bodies.size.numpy().astype(float)
    return stresses_along(stations, stress, s, stations.axis.at(s)[1], size, bodies.group.numpy() == 0, 0.0)


def test_stress_of_two_bodies_that_touch(device):
    """Half of force times branch each, in whichever direction they lie."""
    contact = Contact(effective_modulus=1e5, friction=0.0, normal_damping_ratio=0.0)
    way, reach = np.array([2.0, -1.0, 2.0]) / 3, 0.019
    scene = Scene(
        name="touch", duration=1.0, gravity=(0, 0, 0), contact=contact,
        bodies=(Bodies(positions=[[0.5, 0, 0], (np.array([0.5, 0, 0]) + reach * way).tolist()], sizes=0.02),),
        walls=(PipeWall(name="pipe", axis=Axis((0, 0, 0), (1, 0, 0), (Line(1.0),)), radius=0.05),),
    )  # fmt: skip
    simulation: Any = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    unit = 1e5 * 0.02**3
    found = STRESS_RESOLUTION * unit * body_stresses(simulation.model, simulation.state, unit).numpy()
    push = 1e5 * math.pi * 0.01**2 / 0.02 * 0.001  # of Zhan's spring, E pi r^2 / (r_i + r_j) times the overlap
    tensor = push * reach * np.outer(way, way)
    expected = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[1, 2], tensor[2, 0]]
    assert found == pytest.approx(np.array([expected, expected]) / 2, rel=1e-9)
    again = STRESS_RESOLUTION * 8 * unit * body_stresses(simulation.model, simulation.state, 8 * unit).numpy()
    assert again == pytest.approx(found, rel=1e-9)


def test_stress_of_two_bodies_that_a_bond_holds_together(start):
    """Expect a tensile stress in each body, minus half of the bond's pull times the branch vector."""
    stepper = bonded(start, strong(), velocity=(0.1, 0, 0))
    stepper.take(50)
    stretch = np.ptp(stepper.state.spheres.position.numpy()[:, 0]) - (0.02 + 1e-7)
    stepper.take(1)
    pull = 2e5 / 0.02 * math.pi * 0.01**2 * stretch
    branch = np.ptp(stepper.state.spheres.position.numpy()[:, 0])
    unit = 1e5 * 0.02**3
    found = STRESS_RESOLUTION * unit * body_stresses(stepper.model, stepper.state, unit).numpy()
    assert stretch > 1e-6
    assert found == pytest.approx(np.array([[-pull * branch / 2, 0, 0, 0, 0, 0]] * 2), rel=1e-6, abs=1e-15)


def test_stress_along_an_oblique_pipe_has_all_shear_components():
    """The stress along the tangent t is t . S t, with S written as its components xx, yy, zz, xy, yz and zx."""
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    stations = Stations(axis=axis, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.5, 1.0))
    t = np.array([1.0, 2.0, -2.0]) / 3.0
    volume = math.pi * 0.05**2 * 0.5
    for components in ([1.0, 2.0, 3.0, 0, 0, 0], *np.eye(6)[3:]):
        xx, yy, zz, xy, yz, zx = components
        tensor = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
        stress = np.array([components, np.zeros(6)])  # the second body only makes the first slice full
        places, sizes = np.array([0.25, 0.75]), np.array([0.02, 0.02])
        found = stresses_along(stations, stress, places, np.array([t, t]), sizes, sizes > 0, 0.0)
        mean, along = found[0] * volume
        assert along == pytest.approx(t @ tensor @ t, abs=1e-12)
        assert mean == pytest.approx(np.trace(tensor) / 3, abs=1e-12)


def test_stress_of_a_clump_on_a_wall(device):
    """Push times branch, which goes from the clump's middle to where it touches: by way of the sphere's own."""
    contact = Contact(effective_modulus=1e5, friction=0.0, normal_damping_ratio=0.0)
    shape = clump("pair", np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]]), np.array([0.6, 0.5]))
    lean = [0.0, 0.0, math.sin(math.radians(25)), math.cos(math.radians(25))]  # 50 degrees about z
    scene = Scene(
        name="leans", duration=1.0, gravity=(0, 0, 0), contact=contact,
        bodies=(Bodies(positions=[[0.5, 0.038, 0.0]], sizes=0.02, template=shape, orientations=[lean]),),
        walls=(PipeWall(name="pipe", axis=Axis((0, 0, 0), (1, 0, 0), (Line(1.0),)), radius=0.05),),
    )  # fmt: skip
    simulation: Any = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    unit = 1e5 * 0.02**3
    found = STRESS_RESOLUTION * unit * body_stresses(simulation.model, simulation.state, unit).numpy()
    spheres, middle = simulation.state.spheres.position.numpy(), simulation.state.bodies.position.numpy()[0]
    overlaps = spheres[:, 1] + spheres[:, 3] - 0.05
    (touching,) = np.flatnonzero(overlaps > 0)
    place, radius, overlap = spheres[touching, :3], spheres[touching, 3], overlaps[touching]
    branch = place + [0, radius - overlap, 0] - middle
    push = 1e5 * math.pi * radius * overlap  # of Zhan's spring on a wall, E pi r times the overlap
    assert abs(branch[0]) > 0.2 * abs(branch[1]) and 0 < overlap < 0.3 * radius
    expected = np.array([[0, push * branch[1], 0, push * branch[0] / 2, 0, 0]])
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * push * branch[1])


def test_velocity_profile_goes_by_rings(device):
    simulation = two_spheres(device, velocities=[[0.3, 0, 0], [0.3, 0, 0]])
    found = dict(zip(COLUMNS, measured(simulation.scene.stations, simulation.model, simulation.state, 0.0)[0]))
    assert found["velocity"] == pytest.approx(0.3) and found["velocity_0.1R"] == pytest.approx(0.3)
    assert np.isnan(found["velocity_0.9R"])


@pytest.mark.parametrize("wall", ["exact", "mesh"])
def test_a_column_at_rest_bears_what_stands_on_it(device, wall):
    """Without friction on the wall the stress along the pipe is the weight above and the plate's force, per area."""
    frictionless = dict(concrete="zhan-table1", bonds=False, friction=0.0, wall_friction=0.0, modulus=1e6)
    given = dict(SMALL, **frictionless, settle=2.0, unit="vertical", straight=0.15, plug="plate", slices=1.5)
    given |= {"gravity": 9.81, "plug_pressure": 200.0}
    scene: Any = scenes.part_dem(**given)
    if wall == "mesh":
        pipe = scenes.part_dem(**given | {"outlet_diameter": 0.0800001, "taper": 0.05, "straight": 0.125}).walls[-1]
        scene = dataclasses.replace(scene, walls=(*scene.walls[:-1], pipe))
    simulation: Any = Simulation(scene, device=device)
    simulation.prepare()
    found = measured(scene.stations, simulation.model, simulation.state, 0.0)
    state, area = simulation.state, math.pi * 0.04**2
    z, mass = state.bodies.position.numpy()[:, 2], state.bodies.mass.numpy()
    full = np.isfinite(found[:, 1])
    above = [200 + 9.81 * mass[z > place - scene.stations.origin].sum() / area for place in scene.stations.places[full]]
    assert full.sum() >= 3
    # Measured with twelve packings: 0.6 to 2.2 %, because stones are counted by their centres.
    assert found[full, 1] == pytest.approx(above, rel=0.03)
    by_bodies = along(scene.stations, simulation)
    assert np.array_equal(np.isfinite(by_bodies[:, 0]), full)
    # Measured with twelve packings: 1.7 % along the pipe, 8 % for the mean normal stress of one slice, and 1.7 % for
    # that of all slices together.
    assert by_bodies[full, 1] == pytest.approx(found[full, 1], rel=0.025)
    assert by_bodies[full, 0] == pytest.approx(found[full, 0], rel=0.12)
    assert by_bodies[full].sum(axis=0) == pytest.approx(found[full, :2].sum(axis=0), rel=0.025)
    solids = state.bodies.size.numpy() ** 3 * math.pi / 6
    lower = scene.stations.edges[-2]
    inside = z + scene.stations.origin < lower
    assert found[full, 3].mean() == pytest.approx(solids[inside].sum() / (area * lower), rel=0.03)


@pytest.mark.thorough
def test_gradient_is_what_rubs_on_the_wall(device):
    """4 tau / d, tau from the wall's forces and the gradient from contacts; and the piston bears it, too."""
    run = Simulation(scenes.part_dem(**SMALL | dict(unit="horizontal", straight=0.2, travel=0.1)), device=device).run()
    table = run.tables["stations"].columns
    full = np.isfinite(table["axial_stress"])
    place, stress, shear = (table[name][full] for name in ("place", "axial_stress", "wall_stress"))
    rubbed = np.concatenate([[0.0], np.cumsum(0.5 * (shear[1:] + shear[:-1]) * np.diff(place))]) * 4 / 0.08
    assert stress[0] - stress == pytest.approx(rubbed, abs=0.04 * stress[0])
    assert run["wall_stress"] * 4 / 0.08 == pytest.approx(run["gradient"], rel=0.1)
    ahead = stress[0] + place[0] * 4 / 0.08 * shear[0]
    assert run["end_pressure"] == pytest.approx(ahead, rel=0.06)


def test_friction_by_theory_of_a_slip_layer():
    """Plug flow in bores of 100 and 80 mm: 4 tau / d, where the layer acts on 80 % of the wall."""
    given = dict(concrete="no1", unit="horizontal", diameter=0.1, outlet_diameter=0.08, flow=1500e-6)
    scene = scenes.part_dem(**given)
    for d, edge in ((0.1, 0), (0.08, -1)):
        tau = 251 + 893 * 1500e-6 / (np.pi * d**2 / 4)
        assert layer_gradient(scene, scene.stations.edges[edge]) == pytest.approx(4 * tau / d, rel=1e-9)
    assert layer_gradient(scenes.part_dem(**given, wall_friction=0.05), 0.0) is None
    assert layer_gradient(scenes.part_dem(**given, friction=0.0), 0.0) is None
    assert layer_gradient(scenes.part_dem(**given, friction=0.0, shapes="reference"), 0.0) is not None
    assert layer_gradient(scenes.part_dem(**given | dict(concrete="zhan-table1")), 0.0) is None


def test_losses_of_a_middle_where_friction_rises_with_pressure():
    """sigma' = -(a + b sigma) all along but for a middle that takes twice as much."""
    axis, d = Axis((0, 0, 0), (1, 0, 0), (Line(3.0),)), 0.1
    stations = Stations(
        axis=axis, bores=Bores((0.0,), (d / 2,)), edges=tuple(np.linspace(0, 1.3, 27)), middle=(0.4, 0.9)
    )
    a, b = 4000.0, 0.8
    way = stations.places + np.clip(stations.places - 0.4, 0, 0.5)
    stress = (20e3 + a / b) * np.exp(-b * way) - a / b
    table = {"axial_stress": stress, "wall_stress": d / 4 * (a + b * stress), "bulk_density": 0 * stress + 1500,
             "velocity": 1 + 0 * stress, "solid_fraction": 0.6 + 0 * stress, "radius": d / 2 + 0 * stress}  # fmt: skip
    found = losses(stations, table, (0.0, 0.0, -9.81))
    assert found["middle_ratio"] == pytest.approx(2.0, rel=0.03) and found["flux_ratio"] == pytest.approx(1.0)
    exact = np.exp(-b * 0.4) - np.exp(-b * 1.4)
    assert found["middle_loss"] == pytest.approx((20e3 + a / b) * exact, rel=0.02)
    # The concrete upstream has stopped.
    for still in (0.0, -1e-9):
        stopped = losses(stations, table | {"velocity": np.where(stations.places < 0.4, still, 1.0)}, (0.0, 0.0, 0.0))
        assert set(found) - set(stopped) == {"flux_ratio"}
    upright = dataclasses.replace(stations, axis=Axis((0, 0, 0), (0, 0, 1), (Line(3.0),)))
    heavy = table | {"axial_stress": stress + 1500 * 9.81 * (3 - stations.places)}
    assert losses(upright, heavy, (0.0, 0.0, -9.81))["middle_loss"] == pytest.approx(found["middle_loss"], rel=1e-6)


def test_a_scene_without_stations_has_no_code_or_memory_for_them(device):
    simulation = two_spheres(device)
    plain: Any = Simulation(dataclasses.replace(simulation.scene, stations=None), device=device)
    plain.prepare()
    plain.measure()
    assert "pair pushes" not in plain.state._scratch and plain.sampler.log is None
    assert "stations" not in plain.sampler.state_dict()


def test_the_front_is_looked_for_among_the_farthest():
    """The search among the farthest bodies finds the same front as a search among all bodies.

    This holds also where the far bodies have no volume or nearly all of the volume.
    """
    rng = np.random.default_rng(3)
    s, plain = rng.random(500), rng.random(500) + 0.5
    for volume in (
        plain,
        np.where(s > 0.8, 0.0, plain),
        np.where(s > 0.5, 1e3 * plain, plain),
        np.where(s < 0.9, 0, plain),
    ):
        for few in (3, 500):
            order = np.argsort(s[:few])
            total = np.cumsum(volume[:few][order])
            for part in (0.02, 0.5, FRONT):
                behind = part * total[-1]
                exact = s[:few][order][np.searchsorted(total, behind)]
                assert _front(s[:few], volume[:few], behind) == exact


def test_a_slice_is_full_only_between_the_piston_and_the_front():
    """The slice in which the piston stands is not full, nor the one that holds the front; the others are."""
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(1.0),))
    slices = Stations(axis=axis, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
    s = np.linspace(0.3, 0.9, 61)
    tangent, stress = np.tile([0.0, 0.0, 1.0], (61, 1)), np.tile([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], (61, 1))

    def full(travel: float) -> list[bool]:
        found = stresses_along(slices, stress, s, tangent, np.full(61, 0.01), np.ones(61, bool), travel)
        return np.isfinite(found[:, 1]).tolist()

    assert full(0.3) == [False, False, True, True, False]
    assert full(0.2) == [False, True, True, True, False]  # A piston exactly at an edge leaves the slice behind it full.
    assert full(0.2001) == [False, False, True, True, False]
