"""The pumping scene: physics, units, walls from files."""

import functools
import math
import sys

import numpy as np
import pytest
import trimesh
from pumping import SMALL, open_tube

import warpcrete
from warpcrete import SceneError, Simulation, scenes
from warpcrete.geometry.axis import Arc, Axis, Line


@functools.cache
def pumped(device, unit):
    """A run of a short pipe, which several tests look at."""
    return Simulation(scenes.pipe(unit=unit, **SMALL), device=device).run()


@pytest.mark.parametrize("unit", ["vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical"])
def test_every_unit_pumps_and_balances_momentum(device, unit):
    run = pumped(device, unit)
    assert run.finished and len(run.series["time"]) > 20
    for name, (passed, found) in sys.modules["warpcrete.scenes.pipe"].check(run).items():
        assert passed, f"{name}: {found}"
    assert run.result["momentum_balance_error"] < 1e-4  # measured 1e-7 straight, 2e-5 in elbows
    assert run.series["travel"][-1] == pytest.approx(0.08, abs=2e-4)
    # The concrete moves with the piston: its front is as far along the pipe.
    speed = np.linalg.norm(run.bodies.velocity, axis=1)
    assert np.median(speed) == pytest.approx(0.3, rel=0.25)


@pytest.mark.thorough
def test_weight_is_the_difference_between_vertical_at_rest_and_horizontal(device):
    # Without friction the piston carries the weight and the plug's pressure, and nothing else.
    run = Simulation(
        scenes.pipe(concrete="zhan-table1", unit="vertical", friction=0.0, bonds=False,
                    **SMALL | {"velocity": 0.02, "ramp": 0.02, "travel": 0.04, "length": 0.1}), device=device,
    ).run()  # fmt: skip
    area = math.pi * 0.04**2
    exact = 1000.0 + run.bodies.mass.sum() * 9.81 / area
    assert run.result["plateau_pressure"]["value"] == pytest.approx(exact, rel=1e-5)  # measured 2e-7


def test_mesh_pipe_agrees_with_analytic_pipe(device):
    mesh = Simulation(scenes.pipe(unit="vertical", wall="mesh", **SMALL), device=device).run()
    plateaus = [run.result["plateau_pressure"]["value"] for run in (pumped(device, "vertical"), mesh)]
    assert plateaus[1] == pytest.approx(plateaus[0], rel=0.03)  # twelve packings: 0.0 to 1.1, one 2.2 %


def test_same_seed_same_bits(device):
    runs = [
        Simulation(
            scenes.pipe(seed=seed, **SMALL | {"travel": 0.005, "length": 0.1, "settle": 0.05}), device=device
        ).run()
        for seed in (0, 0, 1)
    ]
    assert np.array_equal(runs[0].bodies.position, runs[1].bodies.position)
    assert np.array_equal(runs[0].series["pressure"], runs[1].series["pressure"])
    assert not np.array_equal(runs[0].series["pressure"], runs[2].series["pressure"])


def test_plate_plug_and_no_bonds(device):
    run = Simulation(scenes.pipe(plug="plate", bonds=False, **SMALL), device=device).run()
    assert run.finished and run.result["momentum_balance_error"] < 1e-4
    assert run.series["bonds"].max() == 0
    plug = run.series["plug_force_z"]
    # The plate rides the column\'s elastic wave; its mean over 1.5 waves is 0.4 to 0.6 % off (four packings).
    assert plug[-16:].mean() == pytest.approx(1000 * math.pi * 0.04**2, rel=0.012)


def test_hydration_stiffens(device):
    short = SMALL | {"travel": 0.01, "length": 0.1, "settle": 0.1}
    plain = Simulation(scenes.pipe(**short), device=device).run()
    hard = Simulation(scenes.pipe(hydration=0.2, hydration_modulus=1e7, **short), device=device).run()
    loose = Simulation(scenes.pipe(bonds=False, **short | {"travel": 1e-4}), device=device).run()
    concrete = hard.series["bonds"][0] - loose.series["bonds"][0]  # without the plug's own
    assert hard.series["hydrated_bonds"][0] / concrete == pytest.approx(0.2, abs=0.03)
    assert hard.series["hydrated_bonds"][-1] > 0.3 * hard.series["hydrated_bonds"][0]
    assert hard.result["steps"] > 2 * plain.result["steps"]  # pays for its stiffness, plain does not


def test_pipe_from_an_stl_file(tmp_path, device):
    path = open_tube(tmp_path / "pipe.stl", hole=False)
    run = Simulation(scenes.pipe(wall=str(path), **SMALL | {"travel": 0.02}), device=device).run()
    assert run.finished and run.result["momentum_balance_error"] < 1e-4
    thick = trimesh.creation.annulus(r_min=0.04, r_max=0.045, height=0.5, sections=64)
    thick.apply_translation([0, 0, 0.2])
    thick.apply_scale(1000)
    thick.export(tmp_path / "thick.stl")
    scenes.pipe(wall=str(tmp_path / "thick.stl"), wall_scale=0.001, **SMALL)
    with pytest.raises(
        warpcrete.SceneError, match=r"has gaps along the axis: 15 of 15 cross-sections are open .*0\.001 for mil"
    ):
        scenes.pipe(wall=str(tmp_path / "thick.stl"), **SMALL)


UP, ALONG = (0, 0, 1), (1, 0, 0)

DIRECTIONS = {
    "vertical": (UP, UP), "horizontal": (ALONG, ALONG),
    "bend-to-horizontal": (UP, ALONG), "bend-to-vertical": (ALONG, UP),
    "A": (UP, UP), "B": (ALONG, ALONG), "C": (UP, ALONG), "D": (ALONG, UP),
}  # fmt: skip


@pytest.mark.parametrize("unit", DIRECTIONS)
def test_every_unit_leads_where_its_name_says(unit):
    scene = scenes.pipe(unit=unit, **SMALL)
    axis, (begin, end) = scene.pipe.axis, DIRECTIONS[unit]
    _, tangents = axis.at([0.0, axis.length])
    assert tangents[0] == pytest.approx(begin, abs=1e-12) and tangents[1] == pytest.approx(end, abs=1e-12)
    piston = next(wall for wall in scene.walls if wall.name == "piston")
    assert piston.normal == pytest.approx(begin, abs=1e-12)
    motion = piston.motion
    start = np.array(motion.velocity) + np.cross(motion.spin, np.array(piston.point) - np.array(motion.pivot))
    assert start == pytest.approx(0.3 * np.array(begin), abs=1e-12)
    assert scene.gravity == (0.0, 0.0, -9.81)


def test_elbow_axis_goes_through_its_pieces():
    axis = Axis((0, 0, 0), (0, 0, 1), (Arc(0.5, math.pi / 2, (1, 0, 0)), Line(0.3)))
    points, tangents = axis.at([0.0, 0.5 * math.pi / 4, 0.5 * math.pi / 2, axis.length])
    assert points[1] == pytest.approx([0.5 * (1 - math.sqrt(0.5)), 0, 0.5 * math.sqrt(0.5)])
    assert points[2] == pytest.approx([0.5, 0, 0.5]) and points[3] == pytest.approx([0.8, 0, 0.5])
    assert tangents[3] == pytest.approx([1, 0, 0], abs=1e-12)


@pytest.mark.parametrize("before, after", [((Line(0.3),), (Line(0.4),)), ((), (Line(0.4),)), ((Line(0.3),), ())])
def test_the_arc_length_of_points_beside_an_axis(before, after):
    axis = Axis((0, 0, 0), (0, 0, 1), (*before, Arc(0.5, math.pi / 2, (1, 0, 0)), *after))
    s = np.linspace(-0.2, axis.length + 0.3, 60)
    points, _, normal, side = axis.frame(s)
    offset = 0.04 * np.cos(3 * s)[:, None] * normal + 0.05 * np.sin(2 * s)[:, None] * side
    np.testing.assert_allclose(axis.along(points + offset), s, atol=1e-12)
    np.testing.assert_allclose(axis.nearest(points + offset), points, atol=1e-12)


def test_layers_of_the_plug():
    parameters = sys.modules["warpcrete.scenes.pipe"].scene.parameters
    assert parameters().layers == 2 and parameters(unit="C").layers == 6 and parameters(plug_layers=3).layers == 3
    assert parameters(unit="D", diameter=0.1).front == pytest.approx(1.0 + 4 * 0.01)
    scene = scenes.pipe(unit="C", plug_layers=4)
    one = scenes.pipe(unit="C", plug_layers=1)
    assert len(scene.bodies[0].positions) == 4 * len(one.bodies[0].positions)
    with pytest.raises(SceneError, match="plug_layers = 2: has no effect unless 'plug' is balls"):
        scenes.pipe(plug="none", plug_layers=2)


@pytest.mark.slow
def test_a_thin_plug_tips_over_in_a_bend_and_the_usual_one_does_not(device):
    module = sys.modules["warpcrete.scenes.pipe"]
    # The plug tips while the concrete settles. Only the travel differs from the given scene.
    bend = dict(unit="C", travel=0.02, ramp=0.01)
    thin, usual = (
        module.check(Simulation(scenes.pipe(**bend | more), device=device).run())["plug holds"]
        for more in (dict(plug_layers=2), {})
    )
    assert not thin[0] and usual[0] and usual[1].startswith("0 of ")
