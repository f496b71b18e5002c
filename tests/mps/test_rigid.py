"""Grains that are rigid inside the solve for velocities, and what keeps sheared columns from swinging at a wall."""

import itertools

import numpy as np
import pytest
from flows import flow_of, neighbours, step, two_phase_flow
from scipy.linalg import lstsq

from warpcrete import scenes
from warpcrete.mps.simulation import FluidSimulation
from warpcrete.mps.stages import step_parts


def rigid_motions(flow):
    """Columns: what each particle does, component by component, in every motion that mortar and grains can make."""
    x, first = flow.particles.position.numpy().astype(float), flow.state.grains.first
    n, d = x.shape
    columns = []
    for begin, end in itertools.pairwise(first):
        arm = x[begin:end] - x[begin:end].mean(0)
        for a in range(d):
            columns.append(np.zeros((n, d)))
            columns[-1][begin:end, a] = 1
        for a, b in itertools.combinations(range(d), 2):
            columns.append(np.zeros((n, d)))
            columns[-1][begin:end, a], columns[-1][begin:end, b] = -arm[:, b], arm[:, a]
    free = np.eye(n * d)[first[-1] * d :].T
    return np.hstack([np.array(columns).reshape(len(columns), -1).T, free])


def matrix_of(flow):
    """The viscous equations, dense, component by component."""
    d = flow.particles.position.numpy().shape[1]
    rows = neighbours(flow)
    found = np.diag(flow.matrix.diagonal.numpy().astype(float))
    found[rows[:, 0].astype(int), rows[:, 1].astype(int)] -= rows[:, 2]
    found = np.kron(found, np.eye(d))
    across = flow.particles.position.numpy().copy()
    across[:, -1] = 0
    outward = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    for i, drag in enumerate(flow.matrix.drag.numpy()):
        at = slice(i * d, i * d + d)
        found[at, at] += drag * (np.eye(d) - np.outer(outward[i], outward[i]))
    return found


def viscous_stages(flow):
    """Everything of a step up to the equations for velocities."""
    (part,) = step_parts(flow)
    for stage in (*part.geometry(), *part.wall_scale(), *part.momentum(), *part.bodies()):
        stage()
    return part


@pytest.mark.thorough
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_solve_finds_the_best_of_all_rigid_motions(device, dimensions, monkeypatch):
    """Against the same equations, dense, in the coordinates of grains' velocities and spins."""
    monkeypatch.setattr("warpcrete.mps.stages.VELOCITY_ERROR", 1e-12)
    flow = two_phase_flow(device, dimensions, length=0.15 if dimensions == 2 else 0.1)
    rng = np.random.default_rng(3)
    part = viscous_stages(flow)
    force = 1e6 * rng.standard_normal(flow.particles.velocity.numpy().shape)
    flow.viscous.residual.assign(force)
    before = flow.particles.velocity.numpy().copy()
    solve, *_ = [s for s in part.viscosity() if s.name == "solve"]
    solve()
    found = (flow.particles.velocity.numpy() - before).ravel()
    motions = rigid_motions(flow)
    matrix = matrix_of(flow)
    # Least squares, as particles in a row may not turn about it.
    expected = motions @ lstsq(motions.T @ matrix @ motions, motions.T @ force.ravel(), 1e-12, lapack_driver="gelsy")[0]
    assert np.abs(expected).max() > 1e-3
    assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


def test_pairs_within_a_grain_exchange_nothing_and_others_what_is_mortar(device):
    """Twice the mortar's viscosity from mortar to grain: half of the distance is rigid."""
    flow = two_phase_flow(device)
    viscous_stages(flow)
    rows, group = neighbours(flow), flow.state.grains.group
    i, j = rows[:, 0].astype(int), rows[:, 1].astype(int)
    entry = np.concatenate([np.arange(c) for c in flow.lists.near_count.numpy()])
    place = entry * flow.count + i if flow.parallel else i * flow.lists.near_capacity + entry
    inverse, viscosity = flow.fields.inverse_number.numpy(), flow.fields.viscosity.numpy()
    laplacian = flow.fields.pair_weight.numpy()[place] * (inverse[i] + inverse[j])
    both = 2 * viscosity[i] * viscosity[j] / (viscosity[i] + viscosity[j])
    grain_i, grain_j, same = group[i] >= 0, group[j] >= 0, (group[i] == group[j]) & (group[i] >= 0)
    expected = np.where(grain_i & grain_j, 2 * both, both)
    expected = np.where(grain_i & ~grain_j, 2 * viscosity[j], np.where(~grain_i & grain_j, 2 * viscosity[i], expected))
    expected = np.where(same, 0, expected) * laplacian
    assert same.any() and (grain_i & ~grain_j).any() and (grain_i & grain_j & ~same).any()
    assert rows[:, 2] == pytest.approx(expected, rel=1e-9)


def test_a_grain_shears_the_mortar_between_wall_and_its_own_half_spacing(device):
    """The compliance is the velocity difference that the wall stress causes, divided by that stress.

    Before any shear, all particles have the same viscosity.
    """
    flow = two_phase_flow(device)
    viscous_stages(flow)
    radius, spacing = flow.state.scene.radius, flow.state.layout.spacing
    grain, viscosity = flow.state.grains.group >= 0, flow.fields.viscosity.numpy()
    assert np.ptp(viscosity) < 1e-9 * viscosity[0]
    inside = radius - np.abs(flow.particles.position.numpy()[:, 0]) - np.where(grain, 0.5 * spacing, 0.0)
    near = np.clip(inside, 1e-3 * spacing, radius)
    assert (near[grain] < 1.1 * spacing).sum() > 5 and (near[~grain] < 0.6 * spacing).sum() > 5
    expected = near * (1 - 0.5 * near / radius) / viscosity
    assert flow.fields.compliance.numpy() == pytest.approx(expected, rel=1e-9)


def test_a_step_moves_and_turns_grains_relative_to_the_piston(device):
    """Positions count from the piston. A grain moves by its mean velocity less that of the piston, and by the mean of
    the displacements without velocity; it turns with its spin, and its particles keep their distances."""
    flow = two_phase_flow(device)
    before = flow.particles.position.numpy().copy()
    step(flow)
    after, velocity, aside = (
        each.numpy() for each in (flow.particles.position, flow.particles.velocity, flow.fields.extra_displacement)
    )
    dt, spacing, piston = flow.scene.time_step, flow.state.layout.spacing, np.array([0.0, flow.scene.velocity])
    moved = before + dt * (velocity - piston) + aside
    inside = (np.abs(moved[:, 0]) < flow.scene.radius - 0.3 * spacing) & (moved[:, 1] > 0.3 * spacing)
    mortar = flow.state.grains.group < 0
    assert after[mortar & inside] == pytest.approx(moved[mortar & inside], abs=1e-12)
    clear, turned = 0, 0.0
    for begin, end in itertools.pairwise(flow.state.grains.first):
        own = slice(begin, end)
        if not inside[own].all():
            continue
        middle, arm = moved[own].mean(0), before[own] - before[own].mean(0)
        spun = velocity[own] - velocity[own].mean(0)
        # In a plane, the spin w about y gives an arm (x, z) the velocity (w z, -w x).
        angle = dt * np.sum(spun[:, 0] * arm[:, 1] - spun[:, 1] * arm[:, 0]) / np.sum(arm**2)
        c, s = np.cos(angle), np.sin(angle)
        assert after[own] == pytest.approx(middle + arm @ np.array([[c, -s], [s, c]]), abs=1e-12)
        clear, turned = clear + 1, max(turned, abs(angle))
    assert clear > 5 and turned > 1e-6


def test_a_grain_that_would_enter_the_piston_or_a_wall_is_moved_back(device):
    """One grain begins where its lowest particle would be in the piston, and another one where a particle would be
    beyond the wall."""
    flow = two_phase_flow(device)
    spacing, first, middle = flow.state.layout.spacing, flow.state.grains.first, flow.grains.middle.numpy().copy()
    place = flow.particles.position.numpy()
    lowest = np.minimum.reduceat(place[: first[-1], 1], first[:-1])
    low, wide = (int(k) for k in np.argsort(lowest)[[0, -1]])
    middle[low, 1] -= lowest[low]
    middle[wide, 0] += 2 * flow.scene.radius
    flow.grains.middle.assign(middle)
    after = step(flow).particles.position.numpy()
    assert after[first[low] : first[low + 1], 1].min() == pytest.approx(0.25 * spacing, rel=1e-9)
    assert after[first[wide] : first[wide + 1], 0].max() == pytest.approx(flow.scene.radius - 0.25 * spacing, rel=1e-9)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_nothing_is_free_under_a_hole_in_the_inside(device, dimensions):
    """However wide: fluid stands on its other side."""
    flow = flow_of(device, dimensions=dimensions, spacing=5e-3 if dimensions == 2 else 10e-3)
    place, l0 = flow.particles.position.numpy().copy(), flow.state.layout.spacing
    middle = np.zeros(dimensions)
    middle[-1] = 0.15
    near = np.all(np.abs(place - middle) < 1.6 * l0, axis=1)
    assert near.sum() > 8
    place[near, -1] += 0.1
    flow.particles.position.assign(place)
    flow.build()
    step(flow)
    free = flow.matrix.free.numpy() != 0
    assert free.any() and flow.particles.position.numpy()[free, -1].min() > 0.25


def test_a_sheared_column_does_not_swing_at_its_wall(device):
    """Half of this flow is shear; pressures used to swing from step to step beside particles pushed to the wall."""
    scene = scenes.channel(
        concrete="own", viscosity=20.0, yield_stress=0.0, slip_viscosity=200.0, slip_yield=0.0, density=2400.0,
        gravity=0.0, duration=0.6, sample_interval=0.02,
    )  # fmt: skip
    run = FluidSimulation(scene, device=device).run()
    assert run.finished
    assert np.abs(run.series["force_balance_error"][-20:]).max() < 0.05
    assert run.series["wall_stress"][-20:].mean() == pytest.approx(scene.theory().wall_stress, rel=0.03)


@pytest.mark.slow
def test_two_phases_flow_for_seconds(device):
    """Half a metre with grains that hardly leave room for mortar at the wall: forces balance all the while."""
    run = FluidSimulation(
        scenes.channel(concrete="no3", spacing=2.5e-3, aggregates=True, duration=2.5, sample_interval=0.05),
        device=device,
    ).run()
    assert run.finished and np.abs(run.series["force_balance_error"]).max() < 0.05
    assert np.abs(run.series["volume_error"]).max() < 0.01
