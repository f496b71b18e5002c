"""Lists against a search of all pairs: whatever the scenes' shape and place, sizes, cells, batch, device."""

from contextlib import nullcontext

import numpy as np
import pytest
import warp as wp
from conftest import devices

from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.dem.engine import cells, neighbors
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import steppers_of
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.kernels.dem.structs import APART

WAYS = [*devices(), "like a GPU", "like a GPU, a thread a sphere"]


@pytest.fixture(params=WAYS)
def way(request, monkeypatch):
    """Device on which to build, with the lists of a GPU on a CPU, too: of few spheres, and of many."""
    if request.param.endswith("a thread a sphere"):
        monkeypatch.setattr(neighbors, "MANY_SPHERES", 0)
    with divide_work_like_gpu() if request.param.startswith("like") else nullcontext():
        yield "cpu" if request.param.startswith("like") else request.param


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
    slack = 2e-7 if stepper.state.model.scalar is wp.float32 else 1e-11  # distances are below a metre
    sure, perhaps = gap < stepper.skin - slack, gap < stepper.skin + slack
    return set(zip(i[sure].tolist(), j[sure].tolist())), set(zip(i[perhaps].tolist(), j[perhaps].tolist()))


def check(stepper) -> None:
    found, (sure, perhaps) = listed(stepper), near(stepper)
    assert sure <= found <= perhaps and len(sure) > 10


def check_links(steppers) -> None:
    """Check that a GPU has one link for each listed pair of each scene, which both entries of the pair name."""
    batch = steppers[0].batch
    if not batch.parallel:
        return
    links, first = batch.links, np.append(0, np.cumsum(batch.capacity // 2))
    link, end = links.link.numpy().reshape(-1, 4), links.end.numpy()
    for s, stepper in enumerate(steppers):
        own = slice(first[s], first[s + 1])
        assert np.all(links.scene.numpy()[own] == s)
        used = np.flatnonzero(link[own][:, 0] >= 0)
        one, other, entry, twin = link[own][used].T
        pairs = stepper.state.pairs
        start, neighbour = pairs.start.numpy(), pairs.other.numpy()
        assert set(zip(np.minimum(one, other).tolist(), np.maximum(one, other).tolist())) == listed(stepper)
        assert len(used) == len(listed(stepper)) and 2 * len(used) == start[-1]
        for sphere, place in ((one, entry), (other, twin)):
            assert np.all((start[sphere] <= place) & (place < start[sphere + 1]))
        assert np.array_equal(neighbour[entry], other) and np.array_equal(neighbour[twin], -1 - one)
        ends = end[2 * first[s] : 2 * first[s + 1]]
        assert np.array_equal(ends[entry], used) and np.array_equal(ends[twin], -1 - used)
        assert np.all(links.state.numpy()[own][used] == APART) or stepper.steps


BOXES = {"cube": (0.1, 0.1, 0.1), "pipe": (0.05, 0.05, 2.0), "sheet": (0.6, 0.0, 0.6), "line": (0.0, 1.5, 0.0)}


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_all_that_is_near_is_listed_whatever_the_shape(way, box, precision):
    (stepper,) = started([cloud(500, box, 1)], way, precision)
    check(stepper)


def test_cells_follow_the_shape_of_a_scene(way):
    """A pipe has as many cells along it as it is long, so that no two places share one."""
    (stepper,) = started([cloud(2000, (0.05, 0.05, 2.0), 1)], way)
    width = 2 * stepper.state.mean_radius + stepper.skin
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
    found, (sure, perhaps) = listed(stepper), near(stepper)
    far = np.flatnonzero(np.abs(stepper.state.spheres.position.numpy()[:, :3]).max(1) > 1e3)
    together = [pair for pair in found if set(pair) <= set(far.tolist())]
    assert len(far) == 3 and len(together) == 1
    assert {p for p in sure if not set(p) & set(far.tolist())} <= found
    assert {p for p in found if not set(p) & set(far.tolist())} <= perhaps


def test_a_scene_far_from_the_origin_has_as_many_cells(way):
    """A hundred kilometres away, where double precision still holds it."""
    dims = []
    for at in ((0.0, 0.0, 0.0), (1e5, -3e4, 2e4)):
        (stepper,) = started([cloud(1000, (0.1, 0.1, 0.5), 11, at=at)], way, "float64")
        check(stepper)
        dims.append(stepper.lists._cells._dims)
    assert np.abs(dims[0] - dims[1]).max() <= 1 and dims[0].prod() > 100


def test_an_empty_scene_takes_no_cells_from_others(way):
    scenes = [cloud(500, (0.1, 0.1, 0.1), 12), cloud(0, (0.1, 0.1, 0.1), 13), cloud(500, (0.1, 0.1, 0.1), 14)]
    first, empty, last = started(scenes, way)
    assert first.lists._cells._dims.prod() > 30
    check(first)
    check(last)
    assert not listed(empty)


def test_a_column_that_ends_flat_has_cells_that_fit(way):
    """Where there are not cells enough for both, those for how it is now; and once they fit they stay."""
    (stepper,) = started([cloud(3000, (0.05, 0.05, 1.5), 15)], way)
    stepper.batch.set(0, sort_every=1)
    flat = cloud(3000, (0.8, 0.8, 0.01), 16).bodies[0].positions
    for array in (stepper.state.spheres.position, stepper.state.bodies.position):
        values = array.numpy().copy()
        values[:, :3] = flat
        array.assign(values)
    grids = []
    for _ in range(3):
        stepper.rebuild()
        grids.append(stepper.lists._cells.made)
    width, dims = stepper.lists._cells.width(), stepper.lists._cells._dims
    assert np.all(np.sort(dims)[1:] > 0.7 / width)
    assert len(set(grids)) == 1
    found, (sure, perhaps) = listed(stepper), near(stepper)
    assert sure <= found <= perhaps and len(sure) > 10


@pytest.mark.parametrize("kept", [32, 3])
def test_a_sphere_among_more_than_a_search_keeps(way, monkeypatch, kept):
    """The largest has a hundred neighbours; with three kept, all rows are searched for twice."""
    monkeypatch.setattr(neighbors, "KEPT", kept)
    small = cloud(1500, (0.1, 0.1, 0.1), 4, sizes=(0.004, 0.006))
    large = Bodies(positions=np.array([[0.05, 0.05, 0.05]]), sizes=0.06)
    (stepper,) = started([Scene(name="one", duration=1.0, contact=small.contact, bodies=(*small.bodies, large))], way)
    check(stepper)
    neighbours = np.bincount(np.array(list(listed(stepper))).ravel())
    assert neighbours.max() > 64
    stepper.rebuild()
    check(stepper)


def test_there_is_room_for_the_longest_rows_but_not_at_any_price(way, monkeypatch):
    """A buffer grows when that spares every second search, and not for a sphere that would need one still."""
    monkeypatch.setattr(neighbors, "KEPT", 8)
    (stepper,) = started([cloud(500, (0.1, 0.1, 0.1), 1, sizes=(0.009, 0.013))], way)
    longest = np.bincount(np.array(list(listed(stepper))).ravel()).max()
    assert 8 < longest <= neighbors.MOST_KEPT
    monkeypatch.setattr(neighbors, "MOST_KEPT", 8)
    (without,) = started([cloud(500, (0.1, 0.1, 0.1), 1, sizes=(0.009, 0.013))], way)
    assert listed(without) == listed(stepper)
    if not stepper.state.model.features.half_list:
        assert (len(stepper.lists._finds), len(without.lists._finds)) == (64, 8)


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
    check_links(steppers)
    for stepper, scene in zip(steppers, scenes):
        (alone,) = started([scene], way)
        assert listed(alone) == listed(stepper)
        check_links([alone])
    before = listed(steppers[2])
    for factor in (3.0, 0.2):  # farther apart, and so close that the lists need more room
        for array in (steppers[2].state.spheres.position, steppers[2].state.bodies.position):
            values = array.numpy().copy()
            values[:, :3] *= factor
            array.assign(values)
        steppers[2].rebuild()
        check_links(steppers)
        assert (len(listed(steppers[2])) > len(before)) == (factor < 1)


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
    stepper.batch.set(0, sort_every=1)
    stepper.rebuild()
    assert np.all(stepper.lists._cells._dims > before)
    found, (sure, perhaps) = listed(stepper), near(stepper)
    assert sure <= found <= perhaps and len(sure) > 0


def test_a_state_that_is_no_number_does_not_stop_the_cells(way):
    (stepper,) = started([cloud(500, (0.1, 0.1, 0.1), 10)], way)
    position = stepper.state.spheres.position.numpy().copy()
    position[:250, 0] = np.nan
    stepper.state.spheres.position.assign(position)
    stepper.batch.set(0, sort_every=1)
    stepper.rebuild()
    found, (sure, perhaps) = listed(stepper), near(stepper)
    assert sure <= found <= perhaps and len(sure) > 10  # no pair of what is nowhere


@pytest.mark.parametrize("towards", [-1.0, 1.0], ids=["apart", "together"])
def test_lists_last_until_a_sphere_has_gone_half_a_skin(start, towards):
    """Two spheres that each go a little less than half of it keep their lists; with a step more these are anew."""
    skin, dt = 5e-3, 1e-4
    place = np.array([[-0.05, 0, 0], [0.05, 0, 0]])
    speed = 0.5 * skin / (10.5 * dt)
    scene = Scene(
        name="two", duration=1.0, gravity=(0, 0, 0), contact=Contact(friction=0.0, normal_damping_ratio=0.0),
        bodies=(Bodies(positions=place, sizes=0.02, velocities=-towards * speed * np.sign(place)),),
        time_step=TimeStep(fixed=dt),
    )  # fmt: skip
    stepper = start(scene, skin=skin)
    for steps, built_after in ((10, 0), (2, 11)):
        stepper.take(steps)
        moved = -towards * speed * dt * np.sign(place[:, 0])
        built = np.sort(stepper.state.spheres.built.numpy()[:, 0])
        assert built == pytest.approx(np.sort(place[:, 0] + built_after * moved), rel=1e-9)
