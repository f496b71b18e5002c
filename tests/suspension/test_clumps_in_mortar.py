"""Clumps, which are rigid bodies of several spheres, in a mortar."""

import numpy as np
import pytest
from test_bodies import products, vectors

from warpcrete.dem.scene.clumps import clump, elongated, reference, union_properties
from warpcrete.suspension.aggregates import Aggregates, Spheres, rotated
from warpcrete.suspension.balance import step_with_balance
from warpcrete.suspension.solve import Tolerances
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow
from warpcrete.verification.suspensions_clumps import doublet

pytestmark = pytest.mark.thorough
WIDTH = RADIUS / 2


def turns(count, seed=0):
    turn = np.random.default_rng(seed).normal(size=(count, 4))
    return turn / np.linalg.norm(turn, axis=1, keepdims=True)


def eight(seed=0, apart=3.0 * RADIUS, density=DENSITY, velocity=None):
    """Return eight clumps of two shapes at the corners of a cube, with random orientations."""
    corners = 0.5 * apart * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    return Aggregates(
        corners, np.full(8, 1.1 * RADIUS), density, velocity, shapes=(doublet(), elongated(1.5)),
        shape=np.arange(8) % 2, turn=turns(8, seed),
    )  # fmt: skip


def flow_of(aggregates, device, precision="float32", cells=(16, 16, 16), **given):
    return mortar_flow(cells, WIDTH, aggregates, device, precision, **given)


@pytest.mark.parametrize("shape", [doublet(), *reference()], ids=lambda shape: shape.name)
def test_samples_cover_the_volume_of_overlapping_spheres_once(device, shape):
    body = Aggregates(np.array([[0.1, 0.2, 0.3]]) * WIDTH, np.array([1.5 * RADIUS]), DENSITY, shapes=(shape,),
                      turn=turns(1, 3))  # fmt: skip
    flow = flow_of(body, device)
    flow.take(1)
    solid = flow.aggregates.cover.solid.numpy().reshape(4, -1).sum(1) / 2**20 * WIDTH**3
    assert solid == pytest.approx(np.full(4, 4 / 3 * np.pi * (1.5 * RADIUS) ** 3), rel=0.02)


def test_shares_of_spheres_add_up_to_the_volume():
    spheres = Spheres(Aggregates(np.zeros((2, 3)), np.array([0.01, 0.02]), DENSITY, shapes=reference(),
                                 shape=np.array([0, 3])))  # fmt: skip
    assert spheres.first.tolist() == [0, 2, 5] and spheres.body.tolist() == [0, 0, 1, 1, 1]
    for number, radius in enumerate((0.01, 0.02)):
        part = slice(*spheres.first[number : number + 2])
        assert spheres.share[part].sum() == pytest.approx(4 / 3 * np.pi * radius**3)
        volume, centroid, inertia = union_properties(spheres.offset[part], spheres.radius[part])
        assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=1e-3)
        assert centroid == pytest.approx(np.zeros(3), abs=1e-4 * radius)
        assert np.diag(inertia) / volume == pytest.approx(spheres.moments[number], rel=1e-3)
    # The spheres of a symmetric pair share its volume equally.
    assert doublet().shares == pytest.approx([0.5, 0.5])


def test_the_reduced_matrix_of_clumps_is_symmetric_and_positive(device):
    flow = flow_of(eight(density=DENSITY + 400), device, "float64")
    flow.take(1)
    assert (flow.aggregates.pairs.lubrication.numpy() > 0).any()
    x, y = vectors(flow, 1), vectors(flow, 2)
    assert products(flow, x, y) == pytest.approx(products(flow, y, x), rel=1e-10)
    assert products(flow, x, x) > 0


def test_power_and_momentum_of_clumps_are_balanced(device):
    """Crowded heavy clumps touch each other; forces between them cancel, and power is conserved."""
    flow = flow_of(
        eight(apart=2.6 * RADIUS, density=DENSITY + 3000), device, "float64", tolerances=Tolerances(coupled=1e-9),
        time_step=0.02, sides=(("wall", "wall"), ("wall", "wall"), ("open", "open")), periodic=True,
    )  # fmt: skip
    touched = 0
    for _ in range(4):
        balance = step_with_balance(flow)
        touched += int((flow.aggregates.pairs.touching.numpy() == 1).sum())
        assert abs(balance.error) < 1e-7
        assert abs(balance.momentum - balance.impulse) < 1e-7 * balance.impulse_scale
    assert touched > 0


def test_forces_of_neighbours_cancel_with_their_torques(device):
    """The forces between clumps have neither a resultant nor a resultant torque about the origin."""
    aggregates = eight(apart=2.5 * RADIUS)
    flow = flow_of(aggregates, device, "float64")
    flow.take(1)
    bodies, solve = flow.aggregates.bodies, flow.coupled
    rng = np.random.default_rng(1)
    bodies.velocity.assign(rng.normal(size=(8, 3)))
    bodies.spin.assign(rng.normal(size=(8, 3)) / RADIUS)
    into = solve._vector()
    # The kernels of a finished run do nothing until this flag is cleared.
    flow.flags.zero_()
    pairs = flow.aggregates.pairs
    other = pairs.other.numpy()
    # Leave out walls, which may take up momentum.
    for name in ("lubrication", "hold"):
        values = getattr(pairs, name).numpy()
        getattr(pairs, name).assign(np.where(other < 0, 0.0, values))
    solve._launch(solve.pairs.load, 8, longest=0.1, forces=into)
    force = into.linear.numpy()
    torque = into.angular.numpy() - bodies.gyration.numpy() + np.cross(aggregates.centre, force)
    assert np.abs(force).max() > 0 and np.abs(torque).max() > 0
    assert force.sum(0) == pytest.approx(np.zeros(3), abs=1e-12 * np.abs(force).sum())
    assert torque.sum(0) == pytest.approx(np.zeros(3), abs=1e-12 * np.abs(torque).sum())


def test_a_contact_beside_the_centre_turns_a_clump(device):
    """A clump that sinks with one end onto a ledge turns about this end, as its other end sinks further."""
    ledge = (lambda x: np.maximum(np.abs(x[:, 0] + 4 * WIDTH) - 2 * WIDTH, x[:, 2] + 2.2 * WIDTH), 1)
    body = Aggregates(np.zeros((1, 3)), np.array([2 ** (1 / 3) * RADIUS]), DENSITY + 3000, shapes=(doublet(),))
    flow = flow_of(body, device, walls=[ledge], time_step=0.05)
    flow.take(6)
    bodies = flow.aggregates.bodies
    axis = rotated(bodies.turn.numpy().astype(float), np.array([[1.0, 0.0, 0.0]]))[0]
    assert axis[2] < -0.02 and bodies.spin.numpy()[0, 1] > 0
    assert flow.aggregates.smallest_gap() > -0.05


def test_a_clump_resumes_with_the_same_bits(device):
    found = []
    flow = flow_of(eight(density=DENSITY + 500), device)
    flow.take(2)
    kept = flow.state_dict()
    flow.take(2)
    again = flow_of(eight(seed=5, density=DENSITY + 500), device)
    again.load_state_dict(kept)
    again.take(2)
    for each in (flow, again):
        bodies = each.aggregates.bodies
        found.append([getattr(bodies, name).numpy() for name in ("centre", "velocity", "spin", "turn")])
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))


def test_a_clump_of_one_sphere_moves_like_a_sphere(device):
    """A clump of two equal spheres at the same place takes the kernels of clumps, but has the shape of a sphere."""
    double = clump("double", np.zeros((2, 3)), np.ones(2))
    speeds = []
    for shapes in ({}, {"shapes": (double,)}):
        body = Aggregates(np.array([[0.1, 0.2, 0.3]]) * WIDTH, np.array([RADIUS]), DENSITY + 500, **shapes)
        flow = flow_of(body, device, "float64", tolerances=Tolerances(coupled=1e-8))
        flow.take(2)
        speeds.append(flow.aggregates.bodies.velocity.numpy()[0])
    assert speeds[1] == pytest.approx(speeds[0], rel=1e-4, abs=1e-6 * np.abs(speeds[0]).max())
