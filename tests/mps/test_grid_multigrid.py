"""The multigrid preconditioner of flows on a grid."""

from contextlib import nullcontext

import numpy as np
import pytest
from test_free_flows import slump
from test_grid_flows import periodic

from warpcrete import scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.device.launching import parameter_names
from warpcrete.kernels.common.control import FAILED, HALTED
from warpcrete.mps.free.layout import free_layout
from warpcrete.mps.grid import systems
from warpcrete.mps.grid.flow import GridFlow
from warpcrete.mps.grid.state import GridState
from warpcrete.mps.grid.systems import cycle, kinship, level_shapes
from warpcrete.mps.pipe_grid import pipe_layout


@pytest.fixture(autouse=True)
def several_levels_on_small_grids(monkeypatch):
    monkeypatch.setattr(systems, "SMALLEST", {"cpu": 0, "gpu": 0})


def pool(spacing):
    """A small L-box whose gate is open, in space."""
    return scenes.lbox(
        spacing=spacing, column_height=0.2, opening=0.1, length=0.3, column_width=0.1, width=0.1, lift_time=0.0
    )


SCENES = {
    "about an axis": (lambda: slump(lift_time=1.0), free_layout),
    "closed pipe": (lambda: periodic("tube", concrete="no1", spacing=10e-3, length=0.08), pipe_layout),
    "in space": (lambda: pool(0.0125), free_layout),
}


def flow_of(kind, precision="float64"):
    make, layout_of = SCENES[kind] if isinstance(kind, str) else (lambda: kind, free_layout)
    scene = make()
    return GridFlow(GridState(scene, layout_of(scene), find_device("cpu"), precision), threads=1)


def solve_stages(flow):
    """Run a step up to each solve, and yield its system, the stage of the solve and the flow."""
    flow._step = None
    systems = [flow.viscous, flow.projection]
    for stage in flow.step[0]:
        if stage.name == "solve" and systems:
            yield systems.pop(0), stage
        stage()


def arguments(stage):
    return dict(zip(parameter_names(stage.kernel), stage.arguments, strict=True))


def begin(flow):
    """Let a flow that has reached its goal take stages of another step."""
    flags = flow.flags.numpy().copy()
    flags[int(HALTED)] = 0
    flow.flags.assign(flags)


def assembled(system):
    """The matrix of the finest level as a dense array, over the rows with unknowns, and these rows."""
    matrix, rows = system.matrix, system.rows
    used = np.flatnonzero(matrix.free.numpy()[:rows] == 0)
    place = np.full(rows, -1)
    place[used] = np.arange(len(used))
    near = matrix.near.numpy().reshape(-1, matrix.near_capacity)
    coefficient, count = matrix.coefficient.numpy().reshape(-1, matrix.near_capacity), matrix.near_count.numpy()
    dense = np.diag(matrix.diagonal.numpy()[used].astype(float))
    for row, i in enumerate(used):
        for k in range(count[i]):
            dense[row, place[near[i, k]]] -= coefficient[i, k]
    return dense, used


def preconditioned(flow, system, stage, used, right):
    """The preconditioner times a vector: the first search direction of a solve with this residual."""
    kept = system.arrays.residual.numpy().copy(), flow.flags.numpy().copy()
    residual = np.zeros_like(kept[0])
    residual[used] = right
    system.arrays.residual.assign(residual)
    named = arguments(stage)
    x, stop = named["x"], system.arrays.stop_norm.numpy().copy()
    solution = x.numpy().copy()
    system.arrays.stop_norm.fill_(0.0)
    one = type(stage)(stage.kernel, 1, {**named, "maximum": 1, "tolerance": 0.0}, flow.device)
    one()
    found = system.arrays.direction.numpy()[used].copy()
    for array, value in ((system.arrays.residual, kept[0]), (flow.flags, kept[1]), (x, solution),
                         (system.arrays.stop_norm, stop)):  # fmt: skip
        array.assign(value)
    return found


@pytest.mark.parametrize("kind", ["about an axis", "in space"])
def test_the_preconditioner_is_symmetric_and_positive_definite(kind):
    flow = flow_of(kind)
    flow.take(12)
    begin(flow)
    rng = np.random.default_rng(1)
    for system, stage in solve_stages(flow):
        assert len(system.first) > 3
        dense, used = assembled(system)
        assert np.allclose(dense, dense.T, rtol=1e-12, atol=1e-12 * dense.max()) and np.linalg.eigvalsh(dense)[0] > 0
        basis = np.linalg.qr(rng.normal(size=(len(used), 40)))[0]
        images = np.stack([preconditioned(flow, system, stage, used, v) for v in basis.T], 1)
        inner = basis.T @ images
        assert np.allclose(inner, inner.T, rtol=1e-9, atol=1e-10 * abs(inner).max())
        assert np.linalg.eigvalsh(inner)[0] > 0


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_solutions_have_the_residual_that_the_solve_reports(kind, precision):
    """The pressure of a full pipe is determined up to a constant only; its matrix gets a residual of its own."""
    flow = flow_of(kind, precision)
    flow.take(12)
    begin(flow)
    found = 0
    for system, stage in solve_stages(flow):
        dense, used = assembled(system)
        if kind == "closed pipe" and system is flow.projection:
            assert abs(dense.sum(1)).max() < 1e-5 * dense.max()
            residual = np.zeros(system.first[-1])
            residual[used] = dense @ np.random.default_rng(1).normal(size=len(used))
            system.arrays.residual.assign(residual)
        right = system.arrays.residual.numpy()[used].astype(float)
        x = arguments(stage)["x"]
        start = x.numpy()[used].astype(float)
        stage()
        change = x.numpy()[used].astype(float) - start
        left = np.linalg.norm(right - dense @ change)
        iterations, before, after = system.arrays.outcome.numpy()[:3]
        assert 0 < iterations < 25 and before == pytest.approx(np.linalg.norm(right), rel=1e-5) and after < before
        rounding = (3e-6 if precision == "float32" else 1e-14) * np.linalg.norm(abs(dense) @ (abs(start) + abs(change)))
        assert left == pytest.approx(after, rel=1e-3, abs=rounding)
        # The step solves once more, from this solution, and must find nothing to do.
        system.arrays.residual.zero_()
        found += 1
    assert found == 2


def iterations(spacing, precision="float32"):
    flow = flow_of(pool(spacing), precision)
    found = []
    while flow.time < 0.05:
        flow.take(1)
        outcome = flow.outcomes()
        if flow.time > 0.02:
            found.append([outcome["viscosity"]["iterations"], outcome["pressure"]["iterations"]])
    return np.mean(found, axis=0)


@pytest.mark.thorough
def test_iterations_hardly_grow_with_resolution():
    """Steps are the shorter the finer the cells, by less than the square of the width: the viscous number grows."""
    coarse, fine = iterations(0.0125), iterations(0.00625)
    assert all(fine < 1.5 * coarse) and all(coarse < (20, 10)), (coarse, fine)


@pytest.mark.slow
def test_iterations_grow_by_less_than_a_half_to_cells_of_3_mm():
    coarse, fine = iterations(0.0125), iterations(0.003)
    assert all(fine < 1.5 * coarse), (coarse, fine)


def test_the_diagonal_alone_gives_the_same_flow(monkeypatch):
    """Within the tolerance of the velocity solve, because that of the pressure is tight here."""
    found = []
    for smallest in (0, 10**9):
        monkeypatch.setattr(systems, "SMALLEST", {"cpu": smallest, "gpu": smallest})
        flow = flow_of(slump(lift_time=1.0, tolerance=1e-8))
        assert (len(flow.viscous.first) == 2) == (smallest > 0)
        flow.take(3)
        found.append((flow.state.faces("velocity"), flow.outcomes()))
    (one, few), (other, many) = found
    allowed = 1e-6 * flow.state.layout.speed * flow._size
    assert np.linalg.norm(one - other) < allowed < 0.1 * np.linalg.norm(one)
    assert 2 * few["pressure"]["iterations"] < many["pressure"]["iterations"]


def test_every_row_has_one_parent_of_its_own_axis():
    shapes = level_shapes((7, 4, 9))
    assert shapes[1] == (4, 2, 5) and np.prod(shapes[-1]) <= 32
    first = np.cumsum([0, *(3 * np.prod(each) for each in shapes)])
    parent, child = kinship(shapes, 3, first)
    child = child.reshape(-1, 8)
    for level in range(len(shapes) - 1):
        rows = np.arange(first[level], first[level + 1])
        above = parent[rows]
        assert ((first[level + 1] <= above) & (above < first[level + 2])).all()
        size, above_size = np.prod(shapes[level]), np.prod(shapes[level + 1])
        assert np.array_equal((rows - first[level]) // size, (above - first[level + 1]) // above_size)
        assert all(row in child[one - first[1]] for row, one in zip(rows, above, strict=True))
    assert np.count_nonzero(child >= 0) == first[-2] and (parent[first[-2] :] == -1).all()


def test_a_cycle_ends_in_the_array_from_which_the_solve_reads():
    for levels, visits, steps in ((2, 1, 1), (3, 2, 1), (5, 1, 2)):
        found = cycle(levels, visits, steps)
        kinds = [operation for operation, *_ in found]
        assert kinds.count(1) == kinds.count(2) and found[0][1:3] == (0, 1) and found[-1][:3] == (0, 0, 1)
    assert cycle(1, 1, 1) == []


def test_like_gpu_the_solution_is_the_same():
    """A GPU's cycle differs, so solutions agree within the tolerance of the solves only."""
    speeds = []
    for like_gpu in (False, True):
        with divide_work_like_gpu() if like_gpu else nullcontext():
            flow = flow_of("about an axis")
            flow.take(3)
            assert not flow.flags.numpy()[int(FAILED)]
            speeds.append(flow.state.faces("velocity"))
    scale = 1e-6 * flow.state.layout.speed * flow._size
    assert np.linalg.norm(speeds[0] - speeds[1]) < 10 * scale and np.abs(speeds[0]).max() > 0
