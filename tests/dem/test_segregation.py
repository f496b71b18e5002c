"""Where the aggregate is, of stones placed by hand; what a run says of it."""

from types import SimpleNamespace

import numpy as np
import pytest
from pumping import SMALL, small_run

from warpcrete import SceneError, Simulation, scenes
from warpcrete.dem.measure import segregation
from warpcrete.dem.measure.segregation import QUANTITIES
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.scene import Bodies, Scene
from warpcrete.geometry.axis import Arc, Axis, Line

STRAIGHT = Axis((0, 0, 0), (0, 0, 1), (Line(1.0),))
RADIUS = 0.05


def of(centre, size, axis=STRAIGHT):
    size = np.broadcast_to(np.asarray(size, float), len(centre))
    return segregation.measured(axis, RADIUS, (np.asarray(centre, float), size / 2, np.pi / 6 * size**3, size))


def ring(apart, spacing=0.02, count=50, around=6):
    """Stones along the pipe on a circle `apart` from its axis."""
    z, k = np.meshgrid(spacing * np.arange(count), np.arange(around), indexing="ij")
    angle = 2 * np.pi * k.ravel() / around
    return np.stack([apart * np.cos(angle), apart * np.sin(angle), z.ravel()], axis=1)


def test_points_fill_a_ball_evenly():
    points = segregation.ball_points()
    assert np.abs(points.mean(0)).max() < 0.02
    # Second moments of a ball are 1/5 each.
    assert np.allclose(points.T @ points / len(points), np.eye(3) / 5, atol=0.02)


def test_stones_on_the_axis_are_inside():
    found = of(ring(0.0, around=1), 0.016)
    wanted = np.pi / 6 * 0.016**3 / (np.pi * 0.025**2 * 0.02)
    assert found["aggregate_inner"] == pytest.approx(wanted, rel=0.01)
    assert found["aggregate_outer"] == 0.0
    assert found["aggregate_front"] == pytest.approx(0.25 * wanted, rel=0.02) == found["aggregate_rear"]


def test_stones_at_the_wall_are_outside():
    found = of(ring(0.042), 0.016)
    wanted = 6 * np.pi / 6 * 0.016**3 / (0.75 * np.pi * 0.05**2 * 0.02)
    assert found["aggregate_outer"] == pytest.approx(wanted, rel=0.01) and found["aggregate_inner"] == 0.0


def test_a_stone_across_the_border_counts_on_both_sides():
    # Half of a small sphere on the border lies inside, less what the border's curve takes: 3 r / (16 R) of all.
    small, border = 0.004, 0.025
    found = of(ring(border), small)
    inner, outer = 0.25 * found["aggregate_inner"], 0.75 * found["aggregate_outer"]
    assert inner / (inner + outer) == pytest.approx(0.5 - 3 / 16 * 0.5 * small / border, abs=0.02)


def test_front_and_rear():
    centre = np.concatenate([ring(0.02)[:150], ring(0.04)[150:], ring(0.03)[150:]])
    found = of(centre, 0.01)
    assert found["aggregate_front"] > 1.5 * found["aggregate_rear"]


@pytest.mark.parametrize("count", [5, 10])
def test_few_stones_are_cut_alike_at_both_ends(count):
    found = of(ring(0.0, count=count, around=1), 0.016)
    assert found["aggregate_front"] == pytest.approx(found["aggregate_rear"], rel=1e-9)


def test_a_bend_is_measured_along_its_axis():
    bent = Axis((0, 0, 0), (0, 0, 1), (Arc(0.5, np.pi / 2, (1, 0, 0)),))
    s = np.linspace(0.02, 0.7, 60)
    points, _, normal, side = bent.frame(s)
    centre = np.concatenate([points + 0.04 * (np.cos(a) * normal + np.sin(a) * side) for a in (0.0, 2.1, 4.2)])
    straight = np.concatenate([[[0.04 * np.cos(a), 0.04 * np.sin(a), z] for z in s] for a in (0.0, 2.1, 4.2)])
    one, other = of(centre, 0.012, bent), of(straight, 0.012)
    assert one["aggregate_outer"] == pytest.approx(other["aggregate_outer"], rel=1e-3)
    assert one["aggregate_inner"] == other["aggregate_inner"] == 0.0


def test_large_stones_outside_small_ones_inside():
    centre = np.concatenate([ring(0.042), ring(0.01)])
    size = np.repeat([0.014, 0.006], 300)
    found = of(centre, size)
    assert found["large_outer"] == pytest.approx(1.0, abs=1e-9) and found["large_inner"] == 0.0
    assert found["mixing"] == pytest.approx(0.0, abs=1e-9)
    turned = of(np.concatenate([ring(0.01), ring(0.042)]), size)
    assert turned["large_outer"] == 0.0 and turned["large_inner"] == pytest.approx(1.0, abs=1e-9)
    mixed = of(centre, np.random.default_rng(1).permutation(size))
    assert mixed["mixing"] == pytest.approx(1.0, abs=0.03)
    assert of(centre, 0.01)["mixing"] == 1.0  # of one size


def test_rings_of_the_mixing_index_have_equal_areas():
    """Large stones fill the inner third of the area, which is one ring, or all of it but its outer half."""
    random = np.random.default_rng(2)
    s, area = random.uniform(0, 1, 3000), random.uniform(0, 1, 3000)
    assert segregation.mixing(s, np.sqrt(area), area < 1 / 3) == pytest.approx(0.0, abs=1e-12)
    # Half of the stones of the middle ring are large, those of the others all or none.
    assert segregation.mixing(s, np.sqrt(area), area < 1 / 2) == pytest.approx(1 / 3, abs=0.03)


def test_spheres_of_a_clump_share_its_volume(start):
    template = clumps.reference()[2]
    bodies = Bodies(positions=ring(0.02, count=10), sizes=0.012, template=template)
    plug = Bodies(positions=[[0, 0, 0.5]], sizes=0.02, group="plug")
    stepper = start(Scene(name="pipe", duration=1.0, bodies=(bodies, plug)))
    _, _, volume, size = segregation.stones_of(stepper.state)
    assert len(volume) == 60 * len(template.radii)
    assert volume.sum() == pytest.approx(60 * np.pi / 6 * 0.012**3) and np.all(size == pytest.approx(0.012))


def test_a_run_tells_it(device):
    plain = small_run(device)
    run = Simulation(scenes.pipe(**SMALL, segregation=True), device=device).run()
    assert run.result["state_hash"] == plain.result["state_hash"] and "mixing" not in plain.series
    # Stones keep away from the wall, whose half of the radius has three quarters of the area.
    assert -0.3 < run["segregation_at_start"] < 0 and 0.9 < run["mixing"] < 1.1
    whole = 0.25 * run["aggregate_inner"] + 0.75 * run["aggregate_outer"]
    assert whole == pytest.approx(0.5 * (run["aggregate_front"] + run["aggregate_rear"]), rel=1e-9)
    start = 0.25 * run.series["aggregate_inner"][0] + 0.75 * run.series["aggregate_outer"][0]
    # Its loose ends are left out, and it has settled: 5.6 to 6.1 % more by three packings.
    assert start == pytest.approx(1.06 * run.packing.solid_fraction, rel=0.02)


def test_segregation_needs_a_pipe():
    with pytest.raises(SceneError, match=r"^segregation = True: needs a pipe"):
        Scene(name="none", duration=1.0, segregation=True)


def test_segregation_is_the_difference_of_the_halves_over_their_mean():
    """The inner half of the radius is a quarter of the cross-section, the outer half three quarters."""
    series = {"aggregate_inner": np.array([0.3, 0.1]), "aggregate_outer": np.array([0.3, 0.5])}
    found = {each.name: each.of(SimpleNamespace(series=series)) for each in QUANTITIES}
    assert found["segregation_at_start"] == 0.0
    assert found["segregation"] == pytest.approx(0.4 / (0.25 * 0.1 + 0.75 * 0.5))
