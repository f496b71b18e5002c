"""Random places of spheres without overlaps."""

from types import SimpleNamespace

import numpy as np
import pytest

from warpcrete.core.device.interrupts import StopAtSample
from warpcrete.suspension.placing import CLEARANCE, _radii, close_pairs, random_places

RADIUS = 0.01


def cube(across):
    """Corners and wall distance of a room with walls at four sides; `across` is its width in diameters."""
    high = np.full(3, across * RADIUS)
    return -high, high, lambda x: (high - np.abs(x))[:, :2].min(1)


def places(fraction, across, seed=0, spread=0.0):
    low, high, distance = cube(across)
    rng = np.random.default_rng(seed)
    mean = 4 / 3 * np.pi * RADIUS**3
    radii = RADIUS * rng.uniform(1 - spread, 1 + spread, round(fraction * float(np.prod(high - low)) / mean))
    return random_places(radii, low, high, distance, rng, periodic=True), radii


def gaps(centres, radii, period):
    """Gaps of all pairs, each divided by the mean of both radii."""
    i, j, d = close_pairs(centres, 3 * radii.max(), period)
    return (np.linalg.norm(d, axis=1) - radii[i] - radii[j]) / (0.5 * (radii[i] + radii[j]))


@pytest.mark.parametrize("period", [0.0, 2.0])
def test_close_pairs_are_those_of_a_search_of_all_pairs(period):
    x = np.random.default_rng(0).uniform(-1, 1, (300, 3))
    i, j, d = close_pairs(x, 0.3, period)
    every = x - x[:, None]
    if period:
        every[..., 2] -= period * np.round(every[..., 2] / period)
    a, b = np.nonzero(np.triu(np.linalg.norm(every, axis=2) < 0.3, 1))
    assert sorted(zip(i, j, strict=True)) == sorted(zip(a, b, strict=True))
    assert d == pytest.approx(every[i, j], abs=1e-12)


@pytest.mark.parametrize("fraction, across, spread", [(0.1, 4, 0.0), (0.45, 4, 0.0), (0.5, 6, 0.0), (0.45, 6, 0.3)])
def test_spheres_keep_their_gaps_to_each_other_and_to_walls(fraction, across, spread):
    centres, radii = places(fraction, across, spread=spread)
    low, high, distance = cube(across)
    assert gaps(centres, radii, high[2] - low[2]).min() > CLEARANCE * (1 - 1e-9)
    assert np.all(distance(centres) > (1 + CLEARANCE) * radii * (1 - 1e-9))
    assert np.all((centres[:, 2] >= low[2]) & (centres[:, 2] < high[2]))


def test_a_thousand_spheres_reach_half_of_the_volume():
    centres, radii = places(0.5, 10)
    assert len(radii) > 900 and gaps(centres, radii, 20 * RADIUS).min() > CLEARANCE * (1 - 1e-9)


@pytest.mark.parametrize(("wanted", "placed"), [(10.4, 10), (10.6, 11), (0.95, 1), (1.08, 1)])
def test_the_number_of_aggregates_is_rounded_to_the_nearest(wanted, placed):
    """The concrete has the volume of 100 aggregates."""
    scene = SimpleNamespace(simulated_fraction=0.01 * wanted, sieve=None, diameters=(2 * RADIUS, 2 * RADIUS))
    radii = _radii(scene, 100 * 4 / 3 * np.pi * RADIUS**3, np.random.default_rng(0))
    assert radii.tolist() == [RADIUS] * placed


def test_places_depend_on_the_seed_only():
    first, again, other = (places(0.3, 4, seed)[0] for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_pushing_apart_does_not_leave_the_spheres_in_narrow_gaps():
    """After the random moves, the pairs at small gaps are as frequent as in a fluid of hard spheres.

    Carnahan and Starling's value at contact is (1 - f / 2) / (1 - f)^3 for the volume fraction f. It gives the mean
    number of neighbours in a thin shell. The expected number refers to the fraction far from walls, so it is a range.
    """
    counts = []
    for seed in range(4):
        centres = places(0.3, 10, seed)[0]
        high = 10 * RADIUS
        inner = np.abs(centres[:, :2]).max(1) < 0.7 * high
        i, j, _ = close_pairs(centres, 2.12 * RADIUS, 2 * high)
        counts.append((inner[i].sum() + inner[j].sum()) / inner.sum())
        density = inner.sum() / (2 * high * (1.4 * high) ** 2) * 4 / 3 * np.pi * (1.01 * RADIUS) ** 3
    shell = 24 * density * (2.12 / 2.02 - 1) * (1 - density / 2) / (1 - density) ** 3
    assert np.mean(counts) == pytest.approx(shell, rel=0.15)


def test_spheres_that_do_not_fit_have_no_places():
    assert places(0.62, 4)[0] is None
    low, high, distance = cube(0.9)
    assert random_places(np.array([RADIUS]), low, high, distance, np.random.default_rng(0)) is None


@pytest.mark.parametrize("begin", [0.0, 0.37, -0.11])
def test_places_keep_off_a_wall_wherever_the_repeated_space_begins(begin):
    """A disc across the space, at a quarter of the period, is a wall; a shift of all places would cross it."""
    low, high = np.array([-0.04, -0.04, begin]), np.array([0.04, 0.04, begin + 0.12])
    radii = np.full(12, RADIUS)

    def distance(x: np.ndarray) -> np.ndarray:
        along = (x[:, 2] - begin - 0.03 + 0.06) % 0.12 - 0.06
        return np.minimum((high - np.abs(x))[:, :2].min(1), np.abs(along) - 0.002)

    x = random_places(radii, low, high, distance, np.random.default_rng(2), periodic=True)
    assert x is not None and np.all((x[:, 2] >= low[2]) & (x[:, 2] < high[2]))
    assert np.all(distance(x) >= RADIUS) and gaps(x, radii, 0.12).min() > 0


def test_a_request_to_stop_ends_the_placing_of_aggregates():
    """A study hears Ctrl-C at the next sample, and placing many aggregates may take minutes before the first one."""
    with StopAtSample([SimpleNamespace(finishing=False, stop_requested=False)]) as stop:
        stop.requested = True
        with pytest.raises(KeyboardInterrupt):
            places(0.2, 5)
        stop.simulations[0].finishing = True
        assert places(0.2, 5)[0] is not None
