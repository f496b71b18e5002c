"""Clumps at random places, and sieve curves of which the cells resolve a part."""

import numpy as np
import pytest

import warpcrete
from warpcrete import scenes
from warpcrete.dem.scene.clumps import templates
from warpcrete.dem.scene.sizes import SieveCurve
from warpcrete.geometry.rotation import random_orientations
from warpcrete.methods import method_of
from warpcrete.suspension.aggregates import Aggregates, Spheres, rotated
from warpcrete.suspension.nearby import CLEARANCE, close_pairs
from warpcrete.suspension.placing_clumps import placed_clumps, turned
from warpcrete.suspension.stretch.layout import stretch_layout

RADIUS, SIDE = 0.01, 0.08
CURVE = "4:0,10:0.3,16:1"
PIPE = {
    "concrete": "own", "density": 2200.0, "viscosity": 20.0, "yield_stress": 0.0, "diameter": 0.1, "length": 0.06,
    "spacing": 0.0025, "aggregate_fraction": 0.3, "gravity": 0.0, "duration": 0.02,
}  # fmt: skip


@pytest.mark.parametrize(("name", "fraction"), [("reference", 0.35), ("shape-2.5", 0.3), ("shape-4.5", 0.2)])
@pytest.mark.parametrize("periodic", [False, True])
def test_clumps_find_places_without_overlaps(name, fraction, periodic):
    shapes, rng, half = templates(name), np.random.default_rng(0), 0.5 * SIDE
    count = int(fraction * SIDE**3 / (4 / 3 * np.pi * RADIUS**3))

    def distance(x):
        return (half - np.abs(x))[:, : 2 if periodic else 3].min(1)

    unplaced = Aggregates(np.zeros((count, 3)), np.full(count, RADIUS), 2600.0, shapes=shapes,
                          shape=rng.integers(len(shapes), size=count))  # fmt: skip
    placed = placed_clumps(unplaced, np.full(3, -half), np.full(3, half), distance, rng, periodic)
    assert placed is not None and placed.turn is not None
    spheres = Spheres(placed)
    centres = spheres.centres(placed.centre, placed.turn)
    assert np.all(distance(centres) >= (1 + 0.99 * CLEARANCE) * spheres.radius)
    i, j, d = close_pairs(centres, 2.1 * spheres.radius.max(), SIDE if periodic else 0.0)
    other = spheres.body[i] != spheres.body[j]
    gaps = np.linalg.norm(d, axis=1) - (1 + 0.49 * CLEARANCE) * (spheres.radius[i] + spheres.radius[j])
    assert other.any() and np.all(gaps[other] > 0)


def test_rotations_agree_with_quaternions():
    rng = np.random.default_rng(0)
    turn, angle, x = random_orientations(50, rng), rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    # A rotation by a vector: Rodrigues' formula.
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    e, y = angle / size, rotated(turn, x)
    expected = (
        y * np.cos(size) + np.cross(e, y) * np.sin(size) + e * np.sum(e * y, 1, keepdims=True) * (1 - np.cos(size))
    )
    assert rotated(turned(turn, angle), x) == pytest.approx(expected, abs=1e-12)
    assert turned(turn, np.zeros((50, 3))) == pytest.approx(turn, abs=1e-12)


def test_a_cut_sieve_curve_keeps_the_coarse_part():
    curve = SieveCurve.from_text(CURVE, "sizes", "")
    cut = curve.above(8e-3)
    part = 1 - 0.3 * np.log(8 / 4) / np.log(10 / 4)
    assert curve.retained(8e-3) == pytest.approx(part)
    assert cut.openings == pytest.approx((8e-3, 10e-3, 16e-3))
    assert cut.passing == pytest.approx((0.0, (part - 0.7) / part, 1.0))
    assert curve.above(1e-3) is curve and curve.retained(20e-3) == 0.0 and curve.retained(1e-3) == 1.0


def test_a_sieve_curve_is_simulated_as_far_as_cells_resolve_it():
    scene = scenes.stretch(**PIPE, aggregate_sizes=CURVE)
    assert scene.diameters == pytest.approx((7.5e-3, 16e-3))
    aggregates = stretch_layout(scene)[1]
    assert 2 * aggregates.radius.min() > 7.5e-3 and 2 * aggregates.radius.max() < 16e-3
    part = 1 - 0.3 * np.log(7.5 / 4) / np.log(10 / 4)
    volume = 4 / 3 * np.pi * np.sum(aggregates.radius**3)
    assert volume == pytest.approx(part * 0.3 * np.pi * 0.05**2 * 0.06, rel=0.01)


def test_narrow_clumps_need_finer_cells():
    with pytest.raises(warpcrete.SceneError, match=r"spacing = 0.0025: is too coarse: the smallest aggregate"):
        scenes.stretch(**PIPE, aggregate_smallest=9e-3, aggregate_largest=9e-3, aggregate_shapes="shape-2.5")
    with pytest.raises(warpcrete.SceneError, match=r"spacing = 0.0025: is too coarse: aggregates below 0.0075 m count"):
        scenes.stretch(**PIPE, aggregate_sizes="2:0,7:1")
    with pytest.raises(warpcrete.SceneError, match="aggregate_sizes = '5;0': must be 'uniform' or a sieve curve"):
        scenes.stretch(**PIPE, aggregate_sizes="5;0")


@pytest.mark.thorough
def test_a_pipe_with_clumps_of_a_sieve_curve_runs(device):
    given = PIPE | {"spacing": 0.003125, "aggregate_fraction": 0.2}
    scene = scenes.stretch(**given, aggregate_sizes="10:0,16:0.5,20:1", aggregate_shapes="shape-1.5")
    run = warpcrete.Simulation(scene, device=device).run()
    found = run.result["aggregates"]
    assert found["stated_fraction"] == 0.2
    assert found["fraction"] == pytest.approx(scene.simulated_fraction, rel=0.03)
    lines = dict(method_of(run.scene).report(run))
    assert "of the stated aggregates; those below" in lines["simulated"]
    assert run.result["flow"]["value"] > 0 and run.result["smallest_gap"] > -0.05


@pytest.mark.thorough
def test_clumps_with_friction_go_on_from_a_checkpoint_with_the_same_bits(device):
    given = PIPE | {"spacing": 0.003125, "aggregate_smallest": 0.018, "aggregate_largest": 0.018, "gradient": 2e5,
                    "aggregate_fraction": 0.3, "aggregate_shapes": "reference", "friction": 0.3, "roughness": 0.1,
                    "sample_interval": 0.0025, "courant": 1.0}  # fmt: skip

    def simulation(duration):
        return warpcrete.Simulation(scenes.stretch(**given | {"duration": duration}), device=device)

    whole = simulation(0.01).run()
    first = simulation(0.005)
    first.run()
    state = first.state_dict()
    second = simulation(0.01)
    second.load_state_dict(state)
    assert second.flow.steps > 0 and second.flow.aggregates.pairs.last_count.numpy().sum() > 0
    assert second.run().result["state_hash"] == whole.result["state_hash"]
