"""Bodies that go so fast that a step carries them past what they would touch."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from conftest import by_id
from wall_spheres import DENSITY, RADIUS

from warpcrete import InstabilityError, SceneError
from warpcrete.dem.scene.clumps import elongated
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed

BOX = trimesh.creation.box((0.1, 0.1, 0.1))
INSIDE = (MeshWall(name="box", vertices=BOX.vertices, faces=BOX.faces),)
ELASTIC = Contact(effective_modulus=1e8, friction=0.0, normal_damping_ratio=0.0)


def thrown(start, contact=ELASTIC, walls=INSIDE, dt=None, velocity=(100.0, 0.0, 0.0), **body):
    """Stepper of one body of 20 mm in the middle of a box of 100 mm."""
    bodies = Bodies(positions=[[0, 0, 0]], sizes=2 * RADIUS, density=DENSITY, velocities=[velocity], **body)
    scene = Scene(name="thrown", duration=1.0, gravity=(0, 0, 0), walls=walls, contact=contact,
                  time_step=TimeStep(fixed=dt), bodies=(bodies,))  # fmt: skip
    return start(scene)


@pytest.mark.parametrize("template", [None, elongated(2.0)], ids=["sphere", "clump"])
def test_a_fixed_step_that_carries_a_body_past_the_wall_ends_the_run(start, template):
    soft = Contact(effective_modulus=1e3)
    radius = RADIUS if template is None else 2 * RADIUS * template.radii.min()
    for part, fails in ((0.9, False), (1.1, True), (6.0, True)):
        stepper = thrown(start, soft, dt=part * radius / 100.0, template=template)
        if not fails:
            stepper.take(1)
            continue
        with pytest.raises(InstabilityError, match=r"^t = 0 s, body 0: a speed of 100 m/s moves it .*: a time_step"):
            stepper.take(2)


@pytest.mark.parametrize("template", [None, elongated(2.0)], ids=["sphere", "clump"])
def test_a_sphere_and_a_moving_mesh_may_together_move_by_a_radius(start, template):
    """Each moves by less than a radius in a step; a wall that is held at rest does not count."""
    radius = RADIUS if template is None else 2 * RADIUS * template.radii.min()
    box = replace(INSIDE[0], motion=Prescribed(velocity=(-50.0, 0.0, 0.0)))
    for part, fails in ((0.62, False), (0.7, True)):  # of the sphere, with half of it from the wall: 0.93 and 1.05
        dt = part * radius / 100.0
        stepper = thrown(start, Contact(effective_modulus=1e3), (box,), dt, template=template)
        if not fails:
            stepper.take(1)
            continue
        what = (
            r"body 0: a speed of 100 m/s and mesh walls that move at up to 50 m/s bring it .* by 1\.05 times its radius"
        )
        with pytest.raises(InstabilityError, match=what):
            stepper.take(2)
        held = thrown(start, Contact(effective_modulus=1e3), (box,), dt, template=template)
        held.batch.set(0, held=1)
        held.take(1)


def test_a_clump_that_spins_so_fast_ends_the_run(start):
    template = elongated(3.0)
    centres, radii = 2 * RADIUS * template.offsets, 2 * RADIUS * template.radii
    far = int(np.argmax(np.linalg.norm(centres, axis=1)))
    dt = 1e-5
    for part, fails in ((0.9, False), (1.1, True)):
        spin = part * radii[far] / np.linalg.norm(centres[far]) / dt
        across = np.cross(centres[far], [0.3, 0.2, 0.7])
        spins = [spin * across / np.linalg.norm(across)]
        stepper = thrown(start, Contact(effective_modulus=1e3), (), dt, (0, 0, 0), template=template, spins=spins)
        if not fails:
            stepper.take(1)
            continue
        with pytest.raises(InstabilityError, match="times its radius in a step"):
            stepper.take(2)


def test_an_automatic_step_is_short_enough_to_meet_the_wall(start):
    stepper = thrown(start)
    for _ in range(40):
        stepper.take(20)
        assert np.abs(by_id(stepper.state, "position")).max() < 0.05
    stepper = thrown(start, Contact(effective_modulus=1e3))
    assert 0.3 * RADIUS < 2 * 100.0 * stepper.dt < RADIUS


def test_a_body_that_no_contact_can_hold_ends_the_run(start):
    stepper = thrown(start, Contact(effective_modulus=1e5))
    with pytest.raises(InstabilityError, match=r"body 0: a speed of .* m/s carries it through the mesh wall 'box';"):
        stepper.advance(0.01)


def test_a_wall_that_goes_further_than_a_radius_in_a_fixed_step_is_refused(start):
    wall = PlaneWall(name="piston", point=(0, 0, -0.1), normal=(0, 0, 1), motion=Prescribed(velocity=(0, 0, 50.0)))
    thrown(start, walls=(wall,), dt=1e-6)
    with pytest.raises(SceneError, match=r"time_step = 0.0003: moves the wall 'piston' by 0.015 m per step"):
        thrown(start, Contact(effective_modulus=1e3), (wall,), 3e-4, (0, 0, 0))


def test_the_proposed_step_moves_sphere_and_wall_by_half_a_radius(start):
    """At 100 m/s a sphere takes 5e-5 s for half of its radius; towards a wall of 50 m/s it takes 3.3e-5 s."""
    box = replace(INSIDE[0], motion=Prescribed(velocity=(-50.0, 0.0, 0.0)))
    for walls, part, proposed in (((), 1.1, "5e-05"), ((box,), 0.7, "3.3e-05")):
        stepper = thrown(start, Contact(effective_modulus=1e3), walls, part * RADIUS / 100.0)
        with pytest.raises(InstabilityError) as failed:
            stepper.take(2)
        assert failed.value.cure.startswith(f"a time_step below {proposed} s or an automatic one, or slower ")


def test_the_smallest_sphere_limits_what_a_wall_may_move_in_a_step(start):
    """A wall of 50 m/s moves 1.5 mm in 3e-5 s, and 3 mm in 6e-5 s, further than the smaller radius of 2 mm."""
    wall = PlaneWall(name="piston", point=(0, 0, -0.1), normal=(0, 0, 1), motion=Prescribed(velocity=(0, 0, 50.0)))
    bodies = Bodies(positions=[[0, 0, 0], [0.05, 0, 0]], sizes=[2 * RADIUS, 0.004], density=DENSITY)
    scene = Scene(name="two sizes", duration=1.0, gravity=(0, 0, 0), walls=(wall,), bodies=(bodies,),
                  contact=Contact(effective_modulus=1e3), time_step=TimeStep(fixed=3e-5))  # fmt: skip
    state = start(scene).state
    assert (state.smallest_radius, state.mean_radius, state.largest_radius) == pytest.approx((0.002, 0.006, RADIUS))
    with pytest.raises(SceneError, match=r"time_step = 6e-05: moves the wall 'piston' by 0.003 m per step"):
        start(replace(scene, time_step=TimeStep(fixed=6e-5)))
