"""Threads of a GPU that share work: lists and bits are those of one thread for itself."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from bench_speed import make
from test_laws import LAWS

from warpcrete.core.device.device import find_device
from warpcrete.dem.engine import neighbors, stages
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.scene.bodies import placed_bodies

pytestmark = pytest.mark.skipif(
    not wp.is_cuda_available(), reason="needs a GPU: only there do several threads share the work of a sphere"
)


def box(kind, count, spread):
    """Spheres, by another law than the linear one if that is named, clumps or bonded spheres under gravity, sizes from
    one over the `spread` on."""
    scene = make(kind if kind in ("clumps", "bonded") else "spheres", count)
    if kind in LAWS:
        scene = dataclasses.replace(scene, contact=LAWS[kind])
    sizes = scene.bodies[0].sizes * np.random.default_rng(3).uniform(1 / spread, 1.0, count)
    return dataclasses.replace(scene, bodies=(dataclasses.replace(scene.bodies[0], sizes=sizes),))


def stepped(scene, many, monkeypatch, precision):
    monkeypatch.setattr(neighbors, "MANY_SPHERES", many)
    monkeypatch.setattr(stages, "MANY_SPHERES", many)
    monkeypatch.setattr(stages, "WALL_THREADS", many)
    monkeypatch.setattr(stages, "THREADS_PER_LINK", 0.02 if many == 0 else 0.5)
    model = build_model(scene, find_device("cuda:0"), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
    if scene.bonds is not None:
        stepper.bond(scene.bonds, 1)
    for _ in range(5):  # the second of a rebuild's parts is a graph, the third uses it
        stepper.take(80)
        stepper.rebuild()
    assert set(stepper.lists._rebuild(False).graphs) == {("cells", "starts"), ("fill", "near")}
    return stepper


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    ("kind", "spread"),
    [("spheres", 1.0), ("spheres", 4.0), ("clumps", 1.5), ("bonded", 1.0), *((law, 1.0) for law in LAWS)],
)
def test_lists_and_bits_are_those_of_one_thread(kind, spread, precision, monkeypatch):
    """Rows of lists by octants and by one search, clumps by one thread and by four, near links by few threads and by
    many, walls by one and by eight; at rest and moving, lists built several times."""
    one, few = (stepped(box(kind, 3000, spread), many, monkeypatch, precision) for many in (0, 10**9))
    assert one.lists._searchers == 1 and few.lists._searchers == neighbors.OCTANTS
    assert one.lists.builds[0] == few.lists.builds[0] > 1
    total = one.state.pair_total
    assert total == few.state.pair_total > 3000
    for name in ("start", "other"):
        ours, theirs = (getattr(s.state.pairs, name).numpy()[: total if name == "other" else None] for s in (few, one))
        assert np.array_equal(ours, theirs), name
    for name in ("position", "velocity", "spin"):
        assert np.array_equal(*(getattr(s.state.spheres, name).numpy() for s in (few, one))), name
    assert np.array_equal(few.state.bodies.position.numpy(), one.state.bodies.position.numpy())
