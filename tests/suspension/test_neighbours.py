"""Neighbours of spheres, compared with a search of all pairs."""

import numpy as np
import pytest

from warpcrete.kernels.suspension.pairs import CAPACITY, LOOKED_AT
from warpcrete.mps.grid.geometry import OPEN_SIDE, WALL
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.verification.suspensions import DENSITY, mortar_flow

WIDTH = 0.005


@pytest.mark.parametrize("cells, periodic", [((20, 20, 20), False), ((20, 20, 20), True), ((8, 8, 6), True)])
def test_the_neighbours_are_those_of_a_search_of_all_pairs(device, cells, periodic):
    """Each sphere has all spheres within two cells as neighbours, in the order of their numbers, also over the ends."""
    rng = np.random.default_rng(4)
    size = np.array(cells) * WIDTH
    count = int(0.05 * size.prod() / 0.01**3)
    radius = rng.uniform(1.6, 2.4, count) * WIDTH
    centre = rng.uniform(-0.5, 0.5, (count, 3)) * (size - [0.02, 0.02, 0.0 if periodic else 0.02])
    sides = ((WALL, WALL), (WALL, WALL), (OPEN_SIDE, OPEN_SIDE) if periodic else (WALL, WALL))
    flow = mortar_flow(
        cells, WIDTH, Aggregates(centre, radius, DENSITY), device, "float64", sides=sides, periodic=periodic
    )
    for stage in flow._before:
        stage()
    distance = centre - centre[:, None]
    if periodic:
        distance[..., 2] -= size[2] * np.round(distance[..., 2] / size[2])
    gap = np.linalg.norm(distance, axis=2) - (radius + radius[:, None])
    pairs = flow.aggregates.pairs
    found = pairs.other.numpy().reshape(count, int(CAPACITY))
    for b in range(count):
        near = [o for o in range(count) if o != b and gap[b, o] < LOOKED_AT * WIDTH]
        others = found[b, : pairs.count.numpy()[b]]
        assert others[others >= 0].tolist() == near
        assert pairs.gap.numpy().reshape(count, -1)[b, : len(near)] == pytest.approx(gap[b, near])
