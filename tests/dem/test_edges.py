"""Odd scenes and odd arguments: no body, one body, light walls, short samples, wrong types."""

import json
import math

import numpy as np
import pytest
from conftest import bonds_of, by_id
from wall_spheres import DENSITY, K_WALL, MASS, RADIUS, grid_plane

from warpcrete import SceneError, Simulation, WarpcreteError, scenes
from warpcrete.dem.packing import NEAR_TARGET, pack
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.containers import Fill, PipeContainer
from warpcrete.dem.scene.scene import AxisDrive, Bodies, Contact, PressureProbe, Scene, TimeStep
from warpcrete.dem.scene.sizes import Gaussian
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import Driven, MeshWall, PipeWall, PlaneWall, Prescribed

AXIS = Axis((0, 0, 0), (0, 0, 1), (Line(1.0),))


def ball(**changes):
    return Bodies(**(dict(positions=[[0, 0, RADIUS]], sizes=2 * RADIUS, density=DENSITY) | changes))


def test_empty_scene_with_a_moving_mesh_runs(device):
    vertices, faces = grid_plane()
    wall = MeshWall(name="floor", vertices=vertices, faces=faces, motion=Prescribed(velocity=(0, 0, 5.0)))
    run = Simulation(Scene(name="empty", duration=0.5, walls=(wall,)), device=device).run()
    assert run.finished and run.series["kinetic_energy"].max() == 0


def test_approaching_mesh_is_met_in_time(start):
    # Sphere and mesh close in on each other, faster together than either alone.
    vertices, faces = grid_plane()
    wall = MeshWall(name="floor", vertices=vertices, faces=faces, motion=Prescribed(velocity=(0, 0, 0.45)))
    contact = Contact(effective_modulus=1e7, friction=0, normal_damping_ratio=0)
    gap = 0.0144
    bodies = ball(positions=[[0.001, 0.002, RADIUS + gap]], velocities=np.array([[0, 0, -1.0]]))
    scene = Scene(
        name="meet",
        duration=1,
        walls=(wall,),
        contact=contact,
        gravity=(0, 0, 0),
        bodies=(bodies,),
        time_step=TimeStep(safety=0.05),
    )
    stepper = start(scene)
    deepest = 0.0
    for _ in range(4000):
        stepper.take(1)
        lift = by_id(stepper.state, "position")[0, 2] - stepper.state.walls.position.numpy()[0, 2]
        deepest = max(deepest, RADIUS - lift)
        if stepper.time > 0.03:
            break
    assert deepest == pytest.approx(1.45 * math.sqrt(MASS / (100 * K_WALL)), rel=0.02)
    assert by_id(stepper.state, "velocity")[0, 2] == pytest.approx(1.0 + 2 * 0.45, rel=0.02)


def test_pipe_wall_limits_the_step_of_a_clump_like_a_plane(start):
    template = clumps.clump("pair", np.array([[-1.0, 0, 0], [1.0, 0, 0]]), np.array([1.0, 1.0]))
    reach = template.extent * 0.02
    steps = []
    for wall, place in (
        (PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1)), (0, 0, reach - 1e-4)),
        (
            PipeWall(name="floor", axis=Axis((0, 0, 0), (0, 1, 0), (Line(1.0),)), radius=50.0),
            (0, 0.5, -50 + reach - 1e-4),
        ),
    ):
        upright = np.array([[0, -math.sqrt(0.5), 0, math.sqrt(0.5)]])
        tilted = np.array([[0, math.sin(math.pi / 8), 0, math.cos(math.pi / 8)]])
        for turn in (upright, tilted):
            bodies = Bodies(positions=[place], sizes=0.02, template=template, orientations=turn)
            scene = Scene(name="clump", duration=1, walls=(wall,), bodies=(bodies,))
            steps.append(start(scene).estimate())
    assert steps[2] == pytest.approx(steps[0], rel=1e-3) and steps[3] == pytest.approx(steps[1], rel=1e-3)


def test_light_driven_wall_has_its_say_in_the_step(start):
    plate = PlaneWall(
        name="plate", point=(0, 0, 2 * RADIUS), normal=(0, 0, -1),
        motion=Driven(direction=(0, 0, -1), force=1.0, mass=1e-5, damping=0.05),
    )  # fmt: skip
    floor = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
    stepper = start(Scene(name="press", duration=1, walls=(floor, plate), bodies=(ball(),), gravity=(0, 0, 0)))
    stepper.advance(0.3)
    assert 2 * RADIUS - stepper.state.walls.position.numpy()[1, 2] == pytest.approx(2 / K_WALL, rel=1e-3)


def test_samples_shorter_than_the_step_repeat_the_last_figure(device):
    plate = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
    rest = ball(positions=[[0, 0, RADIUS - MASS * 9.81 / K_WALL]])
    scene = Scene(name="short", duration=0.02, walls=(plate,), bodies=(rest,), sample_interval=5e-5,
                  pressure=PressureProbe(wall="floor", area=1.0), time_step=TimeStep(fixed=2e-4))  # fmt: skip
    run = Simulation(scene, device=device).run()
    assert run.series["pressure"][2:] == pytest.approx(MASS * 9.81, rel=1e-3)


@pytest.mark.parametrize("pressure", [150.0, pytest.param(300.0, marks=pytest.mark.thorough), 8000.0])
def test_packing_meets_low_and_high_pressures_or_says_so(device, pressure):
    fill = Fill(container=PipeContainer(AXIS, 0.05, 0.12), pressure=pressure, templates=clumps.templates("spheres"))
    _, report = pack(fill, device=device)
    assert report.pressure == pytest.approx(pressure, rel=0.2) and abs(report.size_factor - 1) < 0.07
    assert report.solid_fraction > 0.56


def test_clumps_meet_a_pressure_that_is_low_to_their_stiffness(device):
    """A packing that hardly holds gives way to most of what its sizes grow by, so that takes more looks than usual."""
    sizes = Gaussian(23.4e-3, 14e-3, 9.4e-3, 37.5e-3)
    fill = Fill(container=PipeContainer(AXIS, 0.0625, 0.9), pressure=1000.0, sizes=sizes)
    _, report = pack(fill, contact=Contact(effective_modulus=5e5), device=device)
    # 687 Pa, which was refused, before sizes grew faster after a while.
    assert report.pressure == pytest.approx(1000.0, rel=NEAR_TARGET) and abs(report.size_factor - 1) < 0.03


def test_impossible_pressure_is_refused(device):
    fill = Fill(container=PipeContainer(AXIS, 0.05, 0.06), pressure=1e6, templates=clumps.templates("spheres"))
    with pytest.raises(SceneError, match=r"^packing pressure = 1000000.0: cannot be met"):
        pack(fill, device=device)


def test_healed_bonds_start_without_the_loads_of_settling(device):
    small = dict(
        diameter=0.06, length=0.06, travel=0.01, size_min=8e-3, size_max=12e-3, settle=0.2, tensile_strength=1e9
    )
    simulation = Simulation(scenes.pipe(healing=True, cohesion=1e9, **small), device=device)
    simulation.prepare()
    state = simulation.state
    kinds, loads = bonds_of(state)
    assert np.sum(kinds == 1) > 50 and np.all(loads[kinds == 1] == 0)
    simulation.stepper.advance(0.005)
    kinds, loads = bonds_of(state)
    assert np.abs(loads[kinds == 1]).max() > 0


def test_one_size_is_a_distribution():
    sizes = Gaussian(0.012, 1e-9, 0.012, 0.012).sample(5, np.random.default_rng(0))
    assert np.array_equal(sizes, np.full(5, 0.012))


def test_a_simulation_runs_once(device):
    simulation = Simulation(Scene(name="one", duration=0.01, bodies=(ball(),)), device=device)
    simulation.run()
    with pytest.raises(WarpcreteError, match="has already run"):
        simulation.run()


def test_pivot_travels_with_a_turning_and_moving_wall(start):
    motion = Prescribed(velocity=(1.0, 0, 0), spin=(0, 0, math.pi / 2))
    wall = PlaneWall(name="wall", point=(0, 1.0, 0), normal=(0, 0, 1), motion=motion)
    stepper = start(
        Scene(name="walls", duration=1, walls=(wall,), bodies=(ball(positions=[[9, 9, 9]]),), gravity=(0, 0, 0))
    )
    stepper.advance(1.0)
    turned = math.pi / 2 * stepper.time
    expected = [stepper.time - math.sin(turned), math.cos(turned), 0]
    assert stepper.state.walls.position.numpy()[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: scenes.pipe(shapes=5), "shapes = 5: must be text"),
        (lambda: scenes.pipe(bonds="no"), "bonds = 'no': must be True or False"),
        (lambda: scenes.pipe(seed=1.5), "seed = 1.5: must be a whole number"),
        (
            lambda: scenes.pipe(diametre=0.1),
            "parameter = 'diametre': is not a parameter of scene pipe; did you mean 'diameter'",
        ),
        (
            lambda: scenes.slump_dem(nonsense=1),
            "parameter = 'nonsense': is not a parameter of scene slump-dem; must be one of",
        ),
        (lambda: ball(sizes=[1.0, 2.0]), "sizes = .*must be one number or 1 numbers"),
        (lambda: ball(positions="here"), "positions = 'here'"),
        (lambda: ball(orientations=np.array([[0, 2.0, 0, 2.0]])), "must be unit quaternions"),
        (lambda: MeshWall(name="m", vertices="x", faces=[[0, 1, 2]]), "m.vertices"),
        (lambda: Driven(direction=(0, 0, 1), force=math.nan, mass=1.0), "driving force = nan"),
        (lambda: AxisDrive(group="a", axis=AXIS, force=math.inf), "drive force = inf"),
        (lambda: TimeStep(interval=0), "interval = 0"),
        (lambda: clumps.clump("none", np.zeros((0, 3)), np.zeros(0)), "must contain at least one radius"),
        (lambda: clumps.from_mesh(None, 3), "must be a trimesh.Trimesh or the path"),
    ],
)
def test_wrong_arguments_are_refused_by_name(build, words):
    with pytest.raises(SceneError, match=words):
        build()


def test_numpy_numbers_are_numbers(tmp_path):
    scene = scenes.pipe(
        seed=np.int64(3), diameter=np.float32(0.1), facets=np.int64(32), wall="mesh", travel=np.float64(0.1)
    )
    json.dumps(dict(scene.parameters))
    assert scene.seed == 3
