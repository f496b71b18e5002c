"""Near candidates: the triangles that a sphere tests for contact until it has moved through a margin."""

import numpy as np
import pytest
import trimesh

from warpcrete.dem.engine import stages
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.geometry.walls import MeshWall, Prescribed

RADIUS = 0.01


def tumbler(motion=None, subdivisions=3):
    """Scene of 27 spheres that fly about in a ball of triangles, and of a paddle that may move among them."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.08)
    paddle = trimesh.creation.box(extents=(0.1, 0.004, 0.02))
    paddle.apply_translation((0.0, 0.0, -0.05))
    walls = (
        MeshWall(name="ball", vertices=np.asarray(ball.vertices), faces=np.asarray(ball.faces)[:, ::-1]),
        MeshWall(name="paddle", vertices=np.asarray(paddle.vertices), faces=np.asarray(paddle.faces), motion=motion),
    )
    places = 0.022 * np.stack(np.meshgrid(*[[-1.0, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    speeds = np.random.default_rng(1).normal(scale=1.0, size=places.shape)
    sizes = 2 * RADIUS * np.linspace(0.3, 1.0, len(places))
    return Scene(
        name="tumbler", duration=1.0, gravity=(0, 0, -9.81), walls=walls,
        contact=Contact(friction=0.3, normal_damping_ratio=0.1), time_step=TimeStep(fixed=2e-5),
        bodies=(Bodies(positions=places, sizes=sizes, velocities=speeds),),
    )  # fmt: skip


def state_after(start, steps, near_margin, monkeypatch, motion, precision):
    """Return the stepper after some steps with a margin, and the hash of its state."""
    monkeypatch.setattr(stages, "NEAR_MARGIN", near_margin)
    stepper = start(tumbler(motion), precision)
    stepper.take(steps)
    return stepper, state_hash(stepper.state)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    "motion", [None, Prescribed(spin=(0.0, 20.0, 0.0), pivot=(0.0, 0.0, 0.0))], ids=["fixed", "turning"]
)
def test_near_candidates_change_no_bit(start, motion, precision, monkeypatch):
    """Choose them at every move, in time, or hardly ever; many lists of candidates come and go meanwhile."""
    found = {}
    for margin in (0.0, stages.NEAR_MARGIN, 100.0):
        stepper, found[margin] = state_after(start, 3000, margin, monkeypatch, motion, precision)
        assert stepper.lists.builds[0] > 20
        assert stepper.state.walls.impulse.numpy().any(axis=1).all()  # spheres hit the ball and the paddle
    assert len(set(found.values())) == 1


def test_near_candidates_change_no_bit_in_the_work_of_a_gpu(start, like_a_gpu, monkeypatch):
    motion = Prescribed(spin=(0.0, 20.0, 0.0), pivot=(0.0, 0.0, 0.0))
    found = {state_after(start, 1500, margin, monkeypatch, motion, "float32")[1] for margin in (0.0, 0.25, 100.0)}
    assert len(found) == 1


def test_few_candidates_are_near(start, monkeypatch):
    """With the margin of the program, a sphere tests less than a quarter of its candidates."""
    stepper, _ = state_after(start, 1000, stages.NEAR_MARGIN, monkeypatch, None, "float32")
    every = near = 0
    for _ in range(10):
        stepper.take(100)
        candidates = stepper.batch.candidates
        own = np.diff(candidates.start.numpy())
        every += own.sum()
        near += candidates.near_count.numpy()[own > 0].sum()
    assert 0 < near < 0.25 * every


def test_near_candidates_are_those_within_the_margin(start, monkeypatch):
    """Compare with the distance from every triangle, for spheres that have just chosen."""
    stepper, _ = state_after(start, 1500, stages.NEAR_MARGIN, monkeypatch, None, "float64")
    stepper.rebuild()
    before = stepper.state.spheres.position.numpy().copy()
    stepper.take(1)
    batch, candidates = stepper.batch, stepper.batch.candidates
    begin, near = candidates.start.numpy(), candidates.near.numpy()
    corners, faces, found = batch.corners.numpy(), batch.faces.numpy(), 0
    for i, (x, y, z, radius) in enumerate(before):
        triangles = corners[faces]
        nearest = trimesh.triangles.closest_point(triangles, np.tile([x, y, z], (len(triangles), 1)))
        gap = np.linalg.norm(nearest - [x, y, z], axis=1) - radius
        wanted = np.flatnonzero(gap < stages.NEAR_MARGIN * stepper.skin)
        count = candidates.near_count.numpy()[i] if begin[i] < begin[i + 1] else 0
        assert sorted(near[begin[i] : begin[i] + count]) == wanted.tolist()
        found += len(wanted)
    assert found > 0
