"""Coupled solve of mortar, spheres and pressure: its number of iterations, search directions and new contacts."""

import numpy as np
import pytest

from warpcrete.suspension import solve
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.suspension.solve import Tolerances
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow

WIDTH = RADIUS / 2


def heap(device, precision="float32", **given):
    """A box with eight heavy spheres at gaps of a tenth of a cell, which fall onto each other and the floor."""
    places = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), -1).reshape(8, 3)
    centres = places * (RADIUS + 0.05 * WIDTH) - [0.0, 0.0, 3.9 * WIDTH - 0.05 * WIDTH]
    # The upper layer is shifted, so that each of its spheres rests on several of the lower ones.
    centres[centres[:, 2] > centres[:, 2].mean(), :2] += 0.3 * RADIUS
    spheres = Aggregates(centres, np.full(8, RADIUS), DENSITY + 8000)
    return mortar_flow((12, 12, 16), WIDTH, spheres, device, precision, **{"time_step": 0.1} | given)


def test_touching_spheres_need_few_iterations(device):
    """The first step starts from rest and finds contacts late, so it has two solves; the others have one."""
    flow, counts, contacts = heap(device), [], 0
    for _ in range(6):
        flow.take(1)
        counts.append(flow.coupled.outer)
        contacts += np.count_nonzero(flow.aggregates.pairs.touching.numpy())
    assert contacts > 10
    # Measured: 26, and 12 to 14 in the other steps.
    assert counts[0] <= 30 and max(counts[1:]) <= 18
    assert flow.coupled.error <= 1e-4


def test_contacts_that_are_certain_early_do_not_change_the_result(device, monkeypatch):
    """Without an early look for contacts, more iterations give the same velocities within the solver's tolerance."""
    found, counts = [], []
    for error in (solve.ROUGH_ERROR, 1e-8):
        monkeypatch.setattr(solve, "ROUGH_ERROR", error)
        flow, count = heap(device, "float64", tolerances=Tolerances(coupled=1e-7)), 0
        for _ in range(4):
            flow.take(1)
            count += flow.coupled.outer
        found.append(flow.aggregates.bodies.velocity.numpy())
        counts.append(count)
    assert np.abs(found[0] - found[1]).max() < 1e-5 * np.abs(found[1]).max()
    # Measured: 122 and 155 iterations.
    assert counts[0] < 0.9 * counts[1]


def test_the_known_directions_keep_their_effects_when_pairs_touch(device):
    """After new contacts, each stored effect is the product of the changed matrix and its direction."""
    flow = heap(device, "float64")
    flow.set_goal(steps=2)
    flow.begin_goal()
    flow.take_step()
    coupled, directions = flow.coupled, flow.coupled.directions
    flow.aggregates.pairs.touching.zero_()
    for number in range(directions.known):
        coupled._multiply(*directions[number])
    before = directions[1][1].linear.numpy().copy()
    # Spheres that approach each other by half a radius within the step overlap at its end.
    speed = np.zeros((8, 3))
    speed[:4, 0] = 0.5 * RADIUS / 0.1
    coupled.solution.linear.assign(speed - flow.aggregates.bodies.velocity.numpy())
    assert coupled._new_contacts()
    product = coupled._vector()
    for number in range(directions.known):
        change, effect = directions[number]
        coupled._multiply(change, product)
        expected = product.linear.numpy()
        assert effect.linear.numpy() == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert np.abs(directions[1][1].linear.numpy() - before).max() > 0
