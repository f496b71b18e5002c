"""The limit of stability for every contact law."""

import copy
import math

import numpy as np
import pytest
from conftest import verification

from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.verification import stability

test_stability = verification(stability)


def test_growth_compares_the_first_and_the_last_fifth(monkeypatch):
    """The energy is made up: it rises by 1 % between two looks, of which there are one hundred."""
    pair, given = stability.bonded_pair(), iter(1.01 ** np.arange(200))
    monkeypatch.setattr(stability, "_energy", lambda model, state: next(given))
    found = stability.growth(pair, placed_bodies(pair), 0.5, "cpu", "float64", pair.bonds)
    assert found == pytest.approx(1.01**80, rel=1e-12)
    given = iter(2.0 ** np.arange(200))
    assert stability.growth(pair, placed_bodies(pair), 0.5, "cpu", "float64", pair.bonds) == math.inf


def test_a_bonded_pair_is_stable_below_the_estimate_and_not_far_above(device):
    pair = stability.bonded_pair()
    found = [stability.growth(pair, placed_bodies(pair), each, device, "float64", pair.bonds) for each in (0.8, 6.0)]
    # Friction and the bond's dashpots take a part of the energy.
    assert 0.5 < found[0] <= 1.01 and found[1] == math.inf


def test_limits_are_the_largest_fractions_without_growth(monkeypatch):
    """The growth is made up: it begins above 1.6 times the estimate without bonds and at the smallest with bonds."""
    looked, packings, pack = [], {}, stability.pack

    def shared(fill, **settings):
        """Pack each shape once."""
        shape = fill.templates[0].name
        if shape not in packings:
            packings[shape] = pack(fill, **settings)
        return copy.deepcopy(packings[shape][0]), packings[shape][1]

    def growth(scene, table, fraction, device, precision, bonds):
        looked.append((scene, table, fraction, device, precision, bonds))
        return 1.9 if (bonds is None and fraction < 1.7) or fraction == 5.0 else 2.1

    monkeypatch.setattr(stability, "growth", growth)
    monkeypatch.setattr(stability, "pack", shared)
    rows = stability.limits("cpu", "float32")
    assert [row.ours for row in rows] == [0.0, *[1.6] * 7, 0.0]
    assert [row.passed for row in rows] == [False, *[True] * 7, False]
    assert len(looked) == 9 * len(stability.FRACTIONS) and list(stability.LIMITS.curves) == [
        row.quantity.split(":")[0] for row in rows
    ]
    for scene, table, _, device, precision, bonds in looked:
        assert (device, precision, scene.bonds) == ("cpu", "float32", bonds)
        assert scene.name == "pair" or (len(table) > 60 and table.velocity.std() > 0.04 and table.spin.std() > 8)
