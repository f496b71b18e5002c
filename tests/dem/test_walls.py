"""Motion of walls, the sums of forces and work on them, and contacts that turn with them."""

import dataclasses
import math
import warnings
from contextlib import nullcontext

import numpy as np
import pytest
from conftest import by_id
from wall_spheres import DENSITY, K_WALL, MASS, RADIUS, sphere_scene

from warpcrete.core.device.device import divide_work_like_gpu
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.walls import Driven, MeshWall, PipeWall, PlaneWall, Prescribed


def test_prescribed_translation_and_rotation_follow_the_ramp(start):
    ramp, time = 0.02, 0.05
    moving = PlaneWall(
        name="piston", point=(0, 0, 0), normal=(0, 0, 1), motion=Prescribed(velocity=(0, 0, 0.3), ramp_time=ramp)
    )
    turning = PlaneWall(
        name="turner",
        point=(1, 0, 0),
        normal=(0, 0, 1),
        motion=Prescribed(spin=(0, -2.0, 0), pivot=(0, 0, 0), ramp_time=ramp, start_time=0.01),
    )
    scene = Scene(
        name="walls",
        duration=1,
        walls=(moving, turning),
        time_step=TimeStep(fixed=1e-4),
        gravity=(0, 0, 0),
        bodies=(Bodies(positions=[[5, 5, 5]], sizes=0.01),),
    )
    stepper = start(scene)
    stepper.advance(time)
    now = stepper.time
    position = stepper.state.walls.position.numpy().reshape(-1, 3)
    assert position[0] == pytest.approx([0, 0, 0.3 * (now - ramp / 2)], abs=1e-12)
    angle = 2.0 * (now - 0.01 - ramp / 2)
    assert position[1] == pytest.approx([math.cos(angle), 0, math.sin(angle)], abs=1e-12)
    assert stepper.state.walls.travel.numpy() == pytest.approx([0.3 * (now - ramp / 2), angle], rel=1e-12)


def test_a_pipe_that_moves_throws_a_sphere_at_twice_its_speed(start):
    """Hit a sphere at rest with the wall of a pipe: without damping, the impact reverses their relative velocity."""
    speed, gap = 0.2, 1e-3
    pipe = PipeWall(name="pipe", axis=Axis((0, 0, 0), (0, 0, 1), (Line(0.3),)), radius=0.05,
                    motion=Prescribed(velocity=(-speed, 0, 0)))  # fmt: skip
    place = [0.05 - RADIUS - gap, 0.0, 0.15]
    scene = sphere_scene((pipe,), [place], 1e-5)
    stepper = start(scene)
    stepper.advance(gap / speed + 1.2 * math.pi * math.sqrt(MASS / K_WALL))
    assert by_id(stepper.state, "velocity")[0] == pytest.approx([-2 * speed, 0, 0], rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_a_pipe_that_slides_along_its_axis_only_drags(start, speed):
    """Pull away a pipe against which a sphere lies: the wall still carries the sphere where the axis has passed it."""
    straight = Axis((0, 0, 0), (0, 0, 1), (Line(0.01), Line(0.01)))
    told = pytest.warns(PlausibilityWarning, match=r"pipe.motion: moves the pipe along its .* MeshWall with axis.tube")
    with told if speed else nullcontext():
        pipe = PipeWall(name="pipe", axis=straight, radius=0.05, motion=Prescribed(velocity=(0, 0, speed)))
    sphere = Bodies(positions=[[0.05 - RADIUS, 0, 0.01]], sizes=2 * RADIUS, density=DENSITY)
    scene = Scene(
        name="drag", duration=1, walls=(pipe,), gravity=(9.81, 0, 0), contact=Contact(effective_modulus=1e5),
        bodies=(sphere,), time_step=TimeStep(fixed=1e-5),
    )  # fmt: skip
    stepper = start(scene)
    stepper.advance(0.02)
    position, velocity = by_id(stepper.state, "position")[0], by_id(stepper.state, "velocity")[0]
    assert 0 < position[0] - (0.05 - RADIUS) < 0.1 * RADIUS
    limit = scene.contact.friction * 9.81 * stepper.time
    assert (0.8 * limit < velocity[2] < limit) if speed else (velocity[2] == 0)  # 0.91 of the limit: N needs some time


@pytest.mark.parametrize(
    "axis, velocity",
    [
        (Axis((0, 0, 0), (0, 0, 1), (Line(0.3),)), (0.1, 0, 0.1)),
        (Axis((0, 0, 0), (0, 0, 1), (Line(0.3), Arc(0.2, 0.5, (1, 0, 0)))), (0, 0, 0.1)),
    ],
    ids=["aslant", "bend"],
)
def test_other_motions_of_pipes_are_not_suspicious(axis, velocity):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PipeWall(name="pipe", axis=axis, radius=0.05, motion=Prescribed(velocity=velocity))


def test_driven_plate_comes_to_rest_on_what_carries_it(start):
    load = 3.0
    plate = PlaneWall(
        name="plate",
        point=(0, 0, 2 * RADIUS),
        normal=(0, 0, -1),
        motion=Driven(direction=(0, 0, -1), force=load, mass=0.05, damping=2.0),
    )
    floor = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
    scene = sphere_scene((floor, plate), [[0, 0, RADIUS]], 2e-5, contact=Contact())
    stepper = start(scene)
    stepper.advance(0.6)
    sunk = 2 * RADIUS - stepper.state.walls.position.numpy()[1, 2]
    assert sunk == pytest.approx(2 * load / K_WALL, rel=1e-4)
    assert stepper.state.walls.travel.numpy()[1] == pytest.approx(sunk, rel=1e-12)
    force = stepper.state.walls.force.numpy()
    assert force[1] == pytest.approx([0, 0, load], rel=1e-4, abs=1e-9)
    assert force[0] == pytest.approx([0, 0, -load], rel=1e-4, abs=1e-9)


def test_a_driven_plate_in_steps_of_many_sizes_moves_as_under_a_constant_force(start):
    """Its speed is that of the middle of the last step, as in a leapfrog scheme."""
    plate = PlaneWall(name="plate", point=(0, 0, 1), normal=(0, 0, 1),
                      motion=Driven(direction=(0, 0, -1), force=3.0, mass=0.5))  # fmt: skip
    sphere = Bodies(positions=[[0, 0, 2]], sizes=2 * RADIUS, density=DENSITY)
    stepper = start(Scene(name="free", duration=1, walls=(plate,), gravity=(0, 0, 0), bodies=(sphere,),
                          time_step=TimeStep(fixed=1e-5)))  # fmt: skip
    for size in (1, 5, 2, 4, 3):
        stepper.time_step = TimeStep(fixed=1e-5 * size)
        stepper.choose_dt()
        stepper.take(size)
        middle = stepper.time - 0.5 * stepper.dt
        assert -stepper.state.walls.velocity.numpy()[0, 2] == pytest.approx(3.0 / 0.5 * middle, rel=1e-9)


@pytest.mark.parametrize("steps", [(5000,), (3, 1, 4, 2, 5) * 8], ids=["all alike", "of five sizes"])
def test_wall_impulse_and_moment_are_those_of_the_forces(start, steps):
    # A sphere falls on a plane off its origin: impulse = change of momentum, moment = arm x force.
    floor = PlaneWall(name="floor", point=(0.1, 0.2, 0), normal=(0, 0, 1))
    scene = sphere_scene((floor,), [[0.3, 0.2, RADIUS]], 1e-5, [[0, 0, -0.5]])
    stepper = start(scene)
    for count in steps:
        if len(steps) > 1:  # some steps of each size while they touch
            stepper.time_step = TimeStep(fixed=1e-5 * count)
            stepper.choose_dt()
        stepper.take(count)
    impulse, angular = stepper.state.walls.impulse.numpy()[0], stepper.state.walls.angular_impulse.numpy()[0]
    velocity = by_id(stepper.state, "velocity")[0]
    change = MASS * (velocity - [0, 0, -0.5])
    assert abs(change[2]) > 0.1 * 0.5 * MASS
    assert -impulse == pytest.approx(change, rel=1e-9, abs=1e-12)
    assert angular == pytest.approx(np.cross([0.2, 0, 0], impulse), rel=1e-9, abs=1e-12)


def test_the_top_speed_of_a_wall_is_that_of_its_farthest_point_from_the_pivot():
    """Walls of the speed 5 m/s that spin with 2 rad/s; the farthest corner of the mesh is 5 m away from the pivot."""
    motion = Prescribed(velocity=(3.0, 0.0, 4.0), spin=(0.0, 0.0, 2.0), pivot=(4.0, 3.0, 0.0), ramp_time=0.1)
    mesh = dict(name="wall", vertices=np.array([[0.0, 0, 0], [7, 3, 0], [4, 7, 0]]), faces=np.array([[0, 1, 2]]))
    plane, axis = dict(name="wall", point=(4.0, 1.0, 0.0), normal=(0, 0, 1)), Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    assert MeshWall(**mesh, motion=motion).top_speed() == pytest.approx(5 + 2 * 5)
    assert PlaneWall(**plane, motion=motion).top_speed() == pytest.approx(5 + 2 * 2)
    aside = Prescribed(velocity=(0.0, 0.0, 5.0), pivot=(4.0, 3.0, 0.0))
    assert PipeWall(name="wall", axis=axis, radius=0.1, motion=aside).top_speed() == pytest.approx(5)
    driven = Driven(direction=(0, 0, 1), force=1.0, mass=1.0)
    assert MeshWall(**mesh).top_speed() == PlaneWall(**plane, motion=driven).top_speed() == 0


@pytest.mark.parametrize("mesh", [False, True], ids=["plane", "mesh"])
def test_work_of_a_wall_at_constant_speed_is_its_impulse_times_its_speed(start, mesh):
    """The work on the concrete is that of force and moment, also in steps of different lengths."""
    speed, spin = np.array([0.1, 0.0, 0.4]), np.array([0.0, 0.0, 2.0])
    given = dict(name="floor", motion=Prescribed(velocity=tuple(speed), spin=tuple(spin)))
    wall = PlaneWall(point=(0, 0, 0), normal=(0, 0, 1), **given)
    if mesh:
        vertices = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        wall = MeshWall(vertices=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), **given)
    rough = Contact(friction=0.4, shear_damping_ratio=0.1)
    scene = dataclasses.replace(sphere_scene((wall,), [[0.05, 0.02, RADIUS]], 1e-5, [[0, 0, -0.5]]), contact=rough)
    stepper = start(scene)
    for count in (3, 1, 4, 2, 5) * 4:
        stepper.time_step = TimeStep(fixed=1e-5 * count)
        stepper.choose_dt()
        stepper.take(count)
    walls = stepper.state.walls
    impulse, angular, work = (getattr(walls, name).numpy()[0] for name in ("impulse", "angular_impulse", "work"))
    assert abs(angular[2]) > 1e-8 and np.linalg.norm(impulse) > 0.1 * 0.5 * MASS
    assert work == pytest.approx(-impulse @ speed - angular @ spin, rel=1e-9)


def test_work_of_a_moving_wall_is_the_energy_it_gives(start):
    from warpcrete.dem.measure.probes import body_sums, contact_sums

    wall = PlaneWall(
        name="piston", point=(0, 0, 0), normal=(0, 0, 1), motion=Prescribed(velocity=(0, 0, 0.4), ramp_time=0.01)
    )
    scene = sphere_scene((wall,), [[0, 0, RADIUS]], 5e-6)
    stepper = start(scene)
    for _ in range(5):
        stepper.advance(stepper.time + 0.004)
        energy = body_sums(stepper.model, stepper.state).kinetic_energy
        energy += contact_sums(stepper.model, stepper.state).elastic_energy
        assert stepper.state.walls.work.numpy()[0] == pytest.approx(energy, rel=5e-3)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_spheres_on_a_spinning_mesh_go_as_on_a_spinning_plane(start, precision):
    """A turntable: its surface drags, spins and twists what lies on it, off its axis and on it."""
    motion = Prescribed(spin=(0.0, 0.0, 4.0), pivot=(0.01, 0.0, 0.0))
    places = [[0.02, 0.01, RADIUS - 1e-4], [0.01, 0.0, RADIUS - 1e-4], [-0.02, -0.015, RADIUS - 1e-4]]
    vertices = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    ends = []
    for wall in (
        PlaneWall(name="table", point=(0, 0, 0), normal=(0, 0, 1), motion=motion),
        MeshWall(name="table", vertices=vertices, faces=faces, motion=motion),
    ):
        scene = Scene(
            name="turntable", duration=1.0, walls=(wall,), contact=Contact(friction=0.4, shear_damping_ratio=0.1),
            time_step=TimeStep(fixed=5e-5), bodies=(Bodies(positions=places, sizes=2 * RADIUS, density=DENSITY),),
        )  # fmt: skip
        stepper = start(scene, precision)
        stepper.take(1500)
        state = stepper.state
        sums = [getattr(state.walls, name).numpy()[0] for name in ("impulse", "angular_impulse", "work")]
        ends.append([by_id(state, name).astype(float) for name in ("position", "velocity", "spin")] + sums)
    tolerance = 1e-12 if precision == "float64" else 2e-6  # measured 2e-14 and 5e-7
    for plane, mesh in zip(*ends):
        assert mesh == pytest.approx(plane, abs=tolerance * np.abs(plane).max())
    moved = ends[0][0] - np.array(places)
    assert moved[0] @ [-0.01, 0.01, 0] > 1e-6  # carried along, counter-clockwise
    assert np.all(ends[0][2][:, 2] != 0)


@pytest.mark.parametrize("mesh", [False, True], ids=["plane", "mesh"])
def test_what_a_contact_with_a_wall_remembers_turns_with_both(start, mesh):
    """A heavy sphere and a turntable under it spin at different rates: shear turns at their mean."""
    spin, table = 30.0, 70.0
    motion = Prescribed(spin=(0.0, 0.0, table))
    wall = PlaneWall(name="table", point=(0, 0, 0), normal=(0, 0, 1), motion=motion)
    if mesh:
        vertices = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1.5, 0], [-1, 1, 0]])
        wall = MeshWall(name="table", vertices=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), motion=motion)
    scene = Scene(
        name="turned", duration=1.0, gravity=(0, 0, 0), walls=(wall,), time_step=TimeStep(fixed=1e-5),
        contact=Contact(friction=0.5, normal_damping_ratio=0.0),
        bodies=(Bodies(positions=[[0, 0, RADIUS - 1e-5]], sizes=2 * RADIUS, density=1e15, spins=[[0, 0, spin]]),),
    )  # fmt: skip
    stepper = start(scene)
    stepper.take(1)
    history = stepper.state.slots.history
    value, tiny = history.numpy().copy(), 1e-12
    (place,) = [k for k in range(value.shape[1]) if not mesh or stepper.state.slots.wall.numpy()[0, k] >= 0]
    value[0, place] = [tiny, 0.0, 0.0]
    history.assign(value)
    quarter = round(math.pi / 2 / (0.5 * (spin + table)) / stepper.dt)
    stepper.take(quarter)
    # Measured 2e-4, half a step.
    assert stepper.state.slots.history.numpy()[0, place] == pytest.approx([0.0, tiny, 0.0], abs=5e-4 * tiny)


@pytest.mark.parametrize("full", [False, True], ids=["half lists", "full lists"])
def test_a_plane_that_comes_from_afar_hits_a_sphere_that_was_far_from_all_walls(start, full):
    """Without damping, a sphere at rest leaves a heavy wall of the speed v at 2 v."""
    speed, radius = 2.0, 0.01
    scene = Scene(
        name="racket", duration=1.0, gravity=(0, 0, 0), bodies=(Bodies(positions=[[0, 0, 0]], sizes=2 * radius),),
        contact=Contact(effective_modulus=1e6, normal_damping_ratio=0.0, friction=0.0),
        walls=(PlaneWall(name="racket", point=(0, 0, -0.03), normal=(0, 0, 1),
                         motion=Prescribed(velocity=(0, 0, speed))),),
        time_step=TimeStep(fixed=5e-6),
    )  # fmt: skip
    with divide_work_like_gpu() if full else nullcontext():
        stepper = start(scene)
        stepper.advance(0.02 / speed - 1e-4)
        assert np.abs(stepper.state.bodies.velocity.numpy()).max() == 0.0
        stepper.advance(0.02 / speed + 3e-3)
    velocity = stepper.state.bodies.velocity.numpy()[0]
    # The contact lasts about 360 steps; measured 3.4e-6.
    assert velocity == pytest.approx([0, 0, 2 * speed], rel=1e-5, abs=1e-12)
