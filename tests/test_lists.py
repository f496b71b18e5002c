"""Lists against a search of all pairs: whatever the scenes' shape and place, sizes, cells, batch, device."""

from contextlib import nullcontext

import numpy as np
import pytest
from conftest import devices

from warpcrete.core.device import find_device, share_out_like_a_gpu
from warpcrete.dem import cells, neighbors
from warpcrete.dem.bodies import placed_bodies
from warpcrete.dem.model import build_model
from warpcrete.dem.scene import Bodies, Contact, Scene
from warpcrete.dem.state import State
from warpcrete.dem.stepper import steppers_of

WAYS = [*devices(), "like a GPU"]


@pytest.fixture(params=WAYS)
def way(request):
    """Device on which to build, with the lists of a GPU on a CPU, too."""
    with share_out_like_a_gpu() if request.param == "like a GPU" else nullcontext():
        yield "cpu" if request.param == "like a GPU" else request.param


def cloud(number: int, box, seed: int, sizes=(0.004, 0.02), at=(0.0, 0.0, 0.0)) -> Scene:
    """Spheres anywhere in a box, over one another."""
    rng = np.random.default_rng(seed)
    positions = np.asarray(at) + rng.uniform(0, 1, (number, 3)) * np.asarray(box)
    return Scene(
        name="cloud",
        duration=1.0,
        contact=Contact(),
        bodies=(Bodies(positions=positions, sizes=rng.uniform(*sizes, number)),),
    )


def started(scenes, device, precision="float32"):
    models = [build_model(scene, find_device(device), precision) for scene in scenes]
    return steppers_of(models, [State(m, placed_bodies(m.scene)) for m in models])


def listed(stepper) -> set[tuple[int, int]]:
    """Pairs of places in a scene's list; each once in a half list of one chunk, in order and twice in a full one."""
    state = stepper.state
    start, other = state.pairs.start.numpy(), state.pairs.other.numpy()
    found = []
    for i in range(state.sphere_count):
        row = other[start[i] : start[i + 1]]
        row = np.where(row >= 0, row, -1 - row)
        assert np.all(np.diff(row) > 0)
        found += [(min(i, j), max(i, j)) for j in row.tolist()]
    assert len(found) == len(set(found)) * (1 if state.model.features.half_list else 2)
    return set(found)


def near(stepper) -> tuple[set, set]:
    """Pairs that are surely within a skin of each other, and those that may be, but for rounding."""
    sphere = stepper.state.spheres.position.numpy().astype(float)
    i, j = np.triu_indices(len(sphere), 1)
    gap = np.linalg.norm(sphere[i, :3] - sphere[j, :3], axis=1) - sphere[i, 3] - sphere[j, 3]
    slack = 2e-7  # distances are below a metre, in single precision
    sure, perhaps = gap < stepper.skin - slack, gap < stepper.skin + slack
    return set(zip(i[sure].tolist(), j[sure].tolist())), set(zip(i[perhaps].tolist(), j[perhaps].tolist()))


def check(stepper) -> None:
    found, (sure, perhaps) = listed(stepper), near(stepper)
    assert sure <= found <= perhaps and len(sure) > 10


BOXES = {
    "cube": (0.1, 0.1, 0.1),
    "pipe": (0.05, 0.05, 2.0),
    "sheet": (0.6, 0.0, 0.6),
    "line": (0.0, 1.5, 0.0),
}


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_all_that_is_near_is_listed_whatever_the_shape(way, box, precision):
    (stepper,) = started([cloud(500, box, 1)], way, precision)
    check(stepper)


def test_cells_follow_the_shape_of_a_scene(way):
    """A pipe has as many cells along it as it is long, so that no two places share one."""
    (stepper,) = started([cloud(2000, (0.05, 0.05, 2.0), 1)], way)
    width = 2 * stepper.lists.mean_radius[0] + stepper.skin
    dims = stepper.lists._cells._dims
    assert dims[2] > 2.0 / width and np.all(dims[:2] <= 0.05 / width + 3)


def test_few_cells_change_nothing(way, monkeypatch):
    """Places wrap around a grid that is too small."""
    monkeypatch.setattr(cells, "CELLS", 0)
    monkeypatch.setattr(cells, "FEWEST_CELLS", 30)
    (stepper,) = started([cloud(500, (0.05, 0.05, 2.0), 2)], way)
    assert stepper.lists._cells._dims.prod() <= 30
    check(stepper)


def test_some_that_are_far_away_do_not_need_cells(way):
    """Spheres that left their scene wrap around, too."""
    scene = cloud(2000, (0.1, 0.1, 0.1), 3)
    lost = Bodies(positions=np.array([[3e3, 0.0, 0.0], [3e3, 0.0, 0.003], [0.05, -9e3, 0.05]]), sizes=0.01)
    scene = Scene(name="lost", duration=1.0, contact=scene.contact, bodies=(*scene.bodies, lost))
    (stepper,) = started([scene], way)
    assert stepper.lists._cells._dims.max() < 30
    found, (sure, _) = listed(stepper), near(stepper)
    far = np.flatnonzero(np.abs(stepper.state.spheres.position.numpy()[:, :3]).max(1) > 1e3)
    together = [pair for pair in found if set(pair) <= set(far.tolist())]
    assert len(far) == 3 and len(together) == 1
    assert {p for p in sure if not set(p) & set(far.tolist())} <= found


@pytest.mark.parametrize("kept", [32, 3])
def test_a_sphere_among_more_than_a_search_keeps(way, monkeypatch, kept):
    """The largest has a hundred neighbours; with three kept, all rows are searched for twice."""
    monkeypatch.setattr(neighbors, "KEPT", kept)
    monkeypatch.setattr(neighbors, "MOST_KEPT", 2 * kept)
    small = cloud(1500, (0.1, 0.1, 0.1), 4, sizes=(0.004, 0.006))
    large = Bodies(positions=np.array([[0.05, 0.05, 0.05]]), sizes=0.06)
    (stepper,) = started([Scene(name="one", duration=1.0, contact=small.contact, bodies=(*small.bodies, large))], way)
    check(stepper)
    neighbours = np.bincount(np.array(list(listed(stepper))).ravel())
    assert neighbours.max() > 64
    if not stepper.state.model.features.half_list:
        assert len(stepper.lists._finds) == 2 * kept
    stepper.rebuild()
    check(stepper)


def test_scenes_of_a_batch_have_their_own_neighbours_only(way):
    """Shapes, sizes and places differ; some lie over one another in space, some a kilometre away."""
    scenes = [
        cloud(300, (0.1, 0.1, 0.1), 5),
        cloud(200, (0.05, 0.05, 1.0), 6),
        cloud(250, (0.05, 1.0, 0.05), 7, at=(-0.02, 0.5, 0.0)),
        cloud(300, (0.1, 0.1, 0.1), 5, at=(100.0, -20.0, 3.0)),
        cloud(100, (0.3, 0.3, 0.0), 8, sizes=(0.02, 0.06)),
    ]
    steppers = started(scenes, way)
    for stepper in steppers:
        check(stepper)
    for stepper, scene in zip(steppers, scenes):
        (alone,) = started([scene], way)
        assert listed(alone) == listed(stepper)


def test_what_spreads_gets_more_cells(way):
    """A cloud that flies apart: cells follow at a re-sorting, lists stay complete."""
    scene = cloud(500, (0.1, 0.1, 0.1), 9)
    (stepper,) = started([scene], way)
    before = stepper.lists._cells._dims.copy()
    position = stepper.state.spheres.position.numpy().copy()
    position[:, :3] *= 6
    stepper.state.spheres.position.assign(position)
    bodies = stepper.state.bodies.position.numpy().copy()
    stepper.state.bodies.position.assign(6 * bodies)
    stepper.lists.sort_every[0] = 1
    stepper.rebuild()
    assert np.all(stepper.lists._cells._dims > before)
    found, (sure, perhaps) = listed(stepper), near(stepper)
    assert sure <= found <= perhaps and len(sure) > 0


def test_a_state_that_is_no_number_does_not_stop_the_cells(way):
    (stepper,) = started([cloud(50, (0.1, 0.1, 0.1), 10)], way)
    position = stepper.state.spheres.position.numpy().copy()
    position[:25, 0] = np.nan
    stepper.state.spheres.position.assign(position)
    stepper.lists.sort_every[0] = 1
    stepper.rebuild()
    sure = near(stepper)[0]
    assert sure <= listed(stepper)
