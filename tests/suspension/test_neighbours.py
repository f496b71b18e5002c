"""Neighbours of spheres, compared with a search of all pairs, and contacts of neighbours in checkpoints."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from warpcrete.kernels.suspension.pairs import CAPACITY, LOOKED_AT
from warpcrete.mps.grid.geometry import OPEN_SIDE, WALL
from warpcrete.suspension.aggregates import CONTACT_ARRAYS, STATE_ARRAYS, Aggregates, BodyState
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


def test_contacts_with_friction_are_stored_and_restored():
    """A checkpoint holds three contacts of one sphere and the only one of another, and no entries beyond them."""
    entries, counts, random = 3 * int(CAPACITY), [3, 0, 1], np.random.default_rng(4)

    def bodies():
        arrays = [
            {name: wp.array(random.random(size), dtype=float, device="cpu") for name in names}
            for names, size in ((STATE_ARRAYS, 3), (CONTACT_ARRAYS, entries))
        ]
        count = wp.array(counts, dtype=int, device="cpu")
        return SimpleNamespace(kind=SimpleNamespace(friction=True), bodies=SimpleNamespace(**arrays[0]),
                               pairs=SimpleNamespace(last_count=count, **arrays[1]))  # fmt: skip

    first, second = bodies(), bodies()
    second.pairs.last_count.zero_()
    own = {name: getattr(second.pairs, name).numpy().copy() for name in CONTACT_ARRAYS}
    stored = BodyState.state_dict(first)
    BodyState.load_state_dict(second, stored)
    held = np.array([0, 1, 2, 2 * int(CAPACITY)])
    others = np.setdiff1d(np.arange(entries), held)
    assert second.pairs.last_count.numpy().tolist() == counts
    for name in CONTACT_ARRAYS:
        before, after = getattr(first.pairs, name).numpy(), getattr(second.pairs, name).numpy()
        assert np.array_equal(stored[name], before[held]) and np.array_equal(after[held], before[held])
        assert np.array_equal(after[others], own[name][others])
    for name in STATE_ARRAYS:
        assert np.array_equal(getattr(second.bodies, name).numpy(), getattr(first.bodies, name).numpy())
