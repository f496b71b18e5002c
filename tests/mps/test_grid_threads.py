"""Threads that share a flow on a grid, and solves that skip the rows without concrete."""

from contextlib import nullcontext

import numpy as np
import pytest
from contention import results_under_contention
from test_free_flows import slump
from test_grid_flows import periodic, stages_through

from warpcrete import scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.run.provenance import arrays_hash
from warpcrete.kernels.mps.grid.columns import LANES
from warpcrete.mps.free.layout import free_layout
from warpcrete.mps.grid import flow as grid_flow
from warpcrete.mps.grid import systems
from warpcrete.mps.grid.flow import GridFlow
from warpcrete.mps.grid.state import GridState
from warpcrete.mps.grid.systems import CHUNKS
from warpcrete.mps.pipe_grid import pipe_layout

SCENES = {
    "about an axis": lambda: slump(lift_time=1.0),
    "pipe": lambda: periodic("tube", concrete="no1", rest=60.0, thixotropy=0.5, spacing=10e-3, length=0.08),
    "in space": lambda: scenes.lbox(spacing=0.025, column_height=0.3, length=0.4, column_width=0.1, width=0.2),
}


@pytest.fixture(autouse=True)
def threads_of_few_cells(monkeypatch):
    monkeypatch.setattr(grid_flow, "CELLS_PER_THREAD", 1)
    monkeypatch.setattr(systems, "SMALLEST", {"cpu": 0, "gpu": 0})


def flow_of(kind, threads, device="cpu"):
    scene = SCENES[kind]()
    layout = pipe_layout(scene) if kind == "pipe" else free_layout(scene)
    return GridFlow(GridState(scene, layout, find_device(device), "float32"), threads=threads)


@pytest.mark.parametrize("kind", SCENES)
def test_any_number_of_threads_gives_the_same_bits(kind):
    hashes = set()
    for threads in (1, 2, 3):
        flow = flow_of(kind, threads)
        assert flow.threads == threads == len(flow.step)
        flow.take(12)
        hashes.add(arrays_hash(flow.state_arrays()))
    assert len(hashes) == 1


@pytest.mark.parametrize("kind", SCENES)
def test_vector_instructions_transfer_particles_like_a_gpu(kind):
    """Cells with none, a few, and more particles than fit in one vector give the sums of one particle after another.

    Both ways add up the same products, in another order. Measured on velocities of about 1: 3.7e-6 at most.
    """
    fields = []
    for way in (nullcontext, divide_work_like_gpu):
        with way():
            flow = flow_of(kind, 1)
            particles, rng = flow.particles, np.random.default_rng(3)
            x = particles.position.numpy()
            crowded = x[0] + rng.uniform(0.3, 0.7, (3 * LANES, x.shape[1])) * flow.state.layout.spacing
            x = x + rng.uniform(-0.7, 0.7, x.shape) * flow.state.layout.spacing
            x[: len(crowded)] = crowded
            particles.position.assign(x)
            particles.mass.assign(particles.mass.numpy() * rng.uniform(0.5, 1.5, len(x)))
            particles.velocity.assign(rng.uniform(-1, 1, x.shape))
            particles.gradient.assign(rng.uniform(-9, 9, (*x.shape, x.shape[1])))
            stages_through(flow, "gather")
            counts = flow.mesh.count.numpy()
            assert counts.max() > 2 * LANES and np.any(counts[counts > 0] < LANES)
            fields.append([getattr(flow.mesh, name).numpy() for name in ("fill", "velocity")])
    assert np.ptp(fields[0][1]) > 1
    for one, other in zip(*fields, strict=True):
        assert one == pytest.approx(other, abs=6e-6)


def test_one_thread_that_does_the_work_of_all_computes_the_same(monkeypatch):
    """While other processes want the cores; to the bit, whenever it begins and ends."""

    def state_hash():
        flow = flow_of("about an axis", 2)
        flow.take(40)
        return arrays_hash(flow.state_arrays())

    assert len(results_under_contention(monkeypatch, state_hash)) == 1


def test_threads_are_limited_by_cells_and_chunks(monkeypatch):
    flow = flow_of("about an axis", 100)
    assert flow.threads == CHUNKS
    monkeypatch.setattr(grid_flow, "CELLS_PER_THREAD", flow.state.slots // 2)
    assert flow_of("about an axis", 100).threads == 2


@pytest.mark.parametrize(
    ("kind", "way"),
    [("about an axis", nullcontext), ("in space", nullcontext), ("about an axis", divide_work_like_gpu)],
)
def test_solves_skip_rows_without_concrete(device, kind, way):
    """Fill these rows with not-a-number, which must not change a bit of the flow."""
    hashes = []
    for spoilt in (False, True):
        with way():
            flow = one_step(flow_of(kind, 1, device), spoilt)
        assert all(each["iterations"] > 0 for name, each in flow.outcomes().items() if name != "density")
        hashes.append(arrays_hash(flow.state_arrays()))
    assert hashes[0] == hashes[1] and np.isfinite(flow.mesh.velocity.numpy()).all()


def one_step(flow, spoilt):
    """Take one step of a new flow; if `spoilt`, rows without an unknown hold not-a-number when the solves begin."""
    for stage in flow.step[0]:
        stage()
        if spoilt and stage.name in ("momentum", "divergence"):
            system = flow.viscous if stage.name == "momentum" else flow.projection
            unused = system.matrix.free.numpy() != 0
            assert 0.05 < unused[: system.rows].mean() < 0.95
            unused[system.rows :] = True  # Coarser levels have not been formed yet.
            for name in ("residual", "product", "direction", "even", "odd"):
                values = getattr(system.arrays, name).numpy()
                rows = system.rows if len(values) % len(unused) else len(unused)
                values[np.resize(unused[:rows], len(values))] = np.nan
                getattr(system.arrays, name).assign(values)
    return flow


@pytest.mark.parametrize("way", [nullcontext, divide_work_like_gpu])
def test_solves_list_the_rows_with_concrete(way):
    with way():
        flow = flow_of("in space", 1)
        flow.take(3)
    for system in (flow.viscous, flow.projection):
        begin, used = system.matrix.begin.numpy(), system.matrix.used.numpy()
        free = system.matrix.free.numpy() == 0
        assert begin[1] - begin[0] > 100 and begin[-1] == np.count_nonzero(free)
        for level in range(len(begin) - 1):
            rows = np.flatnonzero(free[system.first[level] : system.first[level + 1]]) + system.first[level]
            assert np.array_equal(used[begin[level] : begin[level + 1]], rows)
