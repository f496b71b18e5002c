"""Tests of concrete in vessels by discrete elements: what is measured of a heap, and scenes."""

import json
import math

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from warpcrete import SceneError, Simulation, scenes
from warpcrete.core.units import number
from warpcrete.dem.laws import BinghamMortar, Contact, RollingResistance
from warpcrete.dem.measure import heaps
from warpcrete.dem.measure import vessel_measures as measures
from warpcrete.dem.pumping.vessels import shear_means
from warpcrete.dem.scene.scene import Vessel
from warpcrete.geometry.prisms import prism, truncated_cone
from warpcrete.standards import FUNNEL, SLUMP

MU_ROLLING = 0.2
LAW_MODULUS = Contact(effective_modulus=1e6, friction=0.8, normal_damping_ratio=0.3, shear_damping_ratio=0.3)
LAW = RollingResistance(contact=LAW_MODULUS, rolling_friction=MU_ROLLING, rolling_damping_ratio=0.3)


def test_heights_and_spreads_are_those_of_the_shape():
    """A cone of small spheres without holes between them; one runaway far off changes nothing."""
    step, height, base = 4e-3, 0.1, 0.2
    x = np.arange(-base, base, step)
    grid = np.stack(np.meshgrid(x, x, np.arange(0.5 * step, height, step), indexing="ij"), -1).reshape(-1, 3)
    inside = np.hypot(grid[:, 0], grid[:, 1]) < base * (1 - grid[:, 2] / height)
    spheres = np.insert(grid[inside], 3, 0.75 * step, axis=1)
    runaway = np.array([[0.7, 0.3, step / 2, step / 2]])
    assert heaps.main_body(spheres).all()
    both = np.concatenate([spheres, runaway])
    kept = heaps.main_body(both)
    assert not kept[-1] and kept[:-1].all()
    body = both[kept]
    assert heaps.spread(body) == pytest.approx(2 * base * (1 - 0.5 * step / height), abs=step)
    assert heaps.height_of_top(body, 0.02) == pytest.approx(height * (1 - 2 / 3 * 0.02 / base), abs=step)
    ring = heaps.height_at(body, (0.09, 0.11), (-0.01, 0.01))
    assert ring == pytest.approx(height / 2, abs=step)
    assert heaps.height_at(body, (0.5, 0.6), (0, 0.1)) == 0.0


def test_cells_that_meet_at_corners_belong_to_one_heap():
    """A row along the diagonal hangs together; one empty cell separates a stray from it."""
    spheres = np.array([[k, k, 0.5, 0.5] for k in (0.5, 0.5, 1.5, 2.5, 4.5)])
    assert heaps.main_body(spheres).tolist() == [True] * 4 + [False]
    assert heaps.main_body(spheres * [-1, 1, 1, 1]).tolist() == [True] * 4 + [False]


def test_the_spread_of_an_oval_heap_is_the_mean_over_all_directions():
    """The heap ends at the farthest point of each ray that a sphere covers, here by sampling points of the rays."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(-10, 11) * 0.1, np.arange(-10, 11) * 0.1))
    place = np.stack([x, y], 1)[x**2 + (y / 0.4) ** 2 < 1]
    spheres = np.column_stack([place, np.zeros(len(place)), np.full(len(place), 0.06)])
    angle, along = 2 * np.pi * np.arange(heaps.DIRECTIONS) / heaps.DIRECTIONS, np.arange(0, 1.1, 2e-3)
    points = along[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)[:, None]
    apart = np.min([np.hypot(*np.moveaxis(points - each, -1, 0)) for each in place], axis=0)
    reach = np.where(apart < 0.06, along, 0.0).max(1)
    assert reach.max() > 2 * reach.min()
    assert heaps.spread(spheres) == pytest.approx(2 * reach.mean(), abs=3e-3)


def test_light_is_seen_through_what_no_grain_darkens():
    one = np.array([[0.0, 0.0, 0.1, 0.01]])
    dark = heaps.shadow(one, 0.02, 0.03, 5e-4)
    assert dark == pytest.approx(math.pi * 0.01**2 / (0.04 * 0.06), rel=1e-2)
    assert heaps.shadow(one[:0], 0.02, 0.03, 1e-3) == 0.0


def test_light_is_seen_through_an_outlet_that_is_wider_than_deep():
    """Cover half of an outlet of 40 by 60 mm: the half towards one of its short sides, with fine spheres."""
    sizes = {"top_width": 0.3, "outlet_width": 0.04, "breadth": 0.06, "cone_height": 0.2, "outlet_height": 0.1}
    vessel = Vessel(test=FUNNEL, opened=0.0, rest_speed=1e-3, dimensions=sizes)
    x, y = np.meshgrid(np.arange(-0.019, 0.02, 0.002), np.arange(0.001, 0.03, 0.002))
    spheres = np.stack([x.ravel(), y.ravel(), 0 * x.ravel() + 0.05, 0 * x.ravel() + 0.0015], 1)
    row = measures.measured(vessel, spheres, 0 * spheres)
    assert row["screen"] == pytest.approx(0.5, abs=1e-12) and row["inside"] == 1.0


def test_rest_is_a_second_of_slowness_after_the_gate():
    mould = {"top_diameter": 0.1, "base_diameter": 0.2, "mould_height": 0.3}
    vessel = Vessel(test=SLUMP, opened=1.0, rest_speed=1e-3, dimensions=mould)
    rows = [{"time": 0.1 * n, "fastest": 1e-4} for n in range(20)]
    assert not measures.at_rest(vessel, rows)  # 1.9 s
    rows.append({"time": 2.05, "fastest": 1e-4})
    assert measures.at_rest(vessel, rows)
    rows[-5]["fastest"] = 2e-3
    assert not measures.at_rest(vessel, rows)


def test_grains_without_friction_may_be_stated():
    given = scenes.modules()["slump-dem"].scene.parameters
    assert given(friction=0.0).grain_friction == 0.0 < given().grain_friction


def test_solids_are_closed_and_have_their_volume():
    cone = truncated_cone(0.1, 0.05, 0.3)
    assert cone.trimesh().is_watertight
    assert cone.trimesh().volume == pytest.approx(math.pi * 0.1 * (0.01 + 0.005 + 0.0025), rel=1e-9)
    # The V-funnel holds 0.065 x 0.075 x 0.15 and (0.065 + 0.515) / 2 x 0.45 x 0.075.
    funnel = scenes.funnel_dem().fill.container.mesh
    assert funnel.is_watertight and funnel.volume == pytest.approx(0.065 * 0.075 * 0.15 + 0.29 * 0.45 * 0.075, rel=1e-9)
    box = prism(((0, 0), (1, 0), (1, 2), (0, 2)), 3, (0.5, 1))
    assert box.trimesh().volume == pytest.approx(6) and len(box.without(0)) == 14


def test_mortar_of_a_concrete_adds_up_to_its_stresses():
    """Mean over directions: |D n|^2 - (n D n)^2 is 1/10, (n D n)^2 is 1/15, in a simple shear of rate 1."""
    slides, square, closes = shear_means()
    assert (square, closes) == pytest.approx((1 / 10, 1 / 15), rel=1e-4) and slides == pytest.approx(0.2966, abs=1e-3)
    law = scenes.slump_dem(law="mortar", yield_stress=300.0, solid_fraction=0.66).contact
    assert isinstance(law, BinghamMortar)
    twice = scenes.slump_dem(law="mortar", yield_stress=600.0, solid_fraction=0.66).contact
    assert twice.yield_stress == pytest.approx(2 * law.yield_stress)


SMALL = dict(
    top_diameter=0.08, base_diameter=0.12, mould_height=0.12, size_min=12e-3, size_max=18e-3, lift_time=0.2,
    friction=0.5, settle=0.4,
)  # fmt: skip


@pytest.mark.thorough
def test_a_cone_with_rolling_resistance_stands_and_one_without_runs_away(device):
    """The same cone, twice: what holds it is rolling resistance; its outcomes have units and its checks pass."""
    found = {}
    for law in ("rolling", "linear"):
        more = dict(rolling_friction=0.4) if law == "rolling" else {}
        scene = scenes.slump_dem(law=law, duration=2.5, plate_grip=2.0, **SMALL, **more)
        found[law] = Simulation(scene, device=device, threads=1).run()
    stands, runs = found["rolling"].result, found["linear"].result
    assert stands["at_rest"] and stands["rest_speed"]["value"] < 1e-3 and stands["rest_speed"]["unit"] == "m/s"
    assert 0 < stands["slump"]["value"] < 0.8 * runs["slump"]["value"] < 0.12
    assert stands["spread"]["value"] < 0.8 * runs["spread"]["value"] or runs["strays"] > 0.2
    module = scenes.modules()["slump-dem"]
    failed = [name for name, (good, _) in module.check(found["rolling"]).items() if not good]
    assert failed == []


def test_bodies_weigh_what_the_concrete_does(device):
    scene = scenes.slump_dem(law="rolling", bulk_density=2300.0, **SMALL)
    simulation = Simulation(scene, device=device, threads=1)
    simulation.prepare()
    assert simulation.state.total_mass == pytest.approx(2300.0 * scene.fill.container.volume, rel=1e-5)


def test_bars_of_a_ring_leave_the_gaps_of_the_standard():
    """EN 12350-12: 16 bars of 18 mm on a circle of 300 mm leave 41 mm, 12 leave 59 mm, each to 1 mm."""
    for count, gap in ((16, 0.041), (12, 0.059)):
        bars = next(wall for wall in scenes.jring_dem(bars=count).walls if wall.name == "bars")
        mesh = trimesh.Trimesh(bars.vertices, bars.faces, process=False)
        parts = mesh.split()
        assert len(parts) == count and mesh.is_watertight
        assert mesh.volume == pytest.approx(count * math.pi * 0.009**2 * 0.125, rel=1e-9)
        centres = np.array([part.center_mass for part in parts])
        assert np.hypot(*centres[:, :2].T) == pytest.approx(0.15, rel=1e-9)
        apart = np.linalg.norm(centres[:, None] - centres, axis=2) + np.eye(count)
        assert apart.min() - 0.018 == pytest.approx(gap, abs=1e-3)


def test_heights_of_a_step_are_read_on_both_its_sides():
    """A floor of spheres, higher within 0.1 m of the middle."""
    x, y = (0.005 * each.ravel() for each in np.meshgrid(np.arange(-50, 51), np.arange(-50, 51)))
    height = np.where(np.hypot(x, y) < 0.1, 0.06, 0.02)
    spheres = np.stack([x, y, height, 0 * x + 0.01], 1)
    inside, outside = heaps.height_around(spheres, 0.0, 0.05), heaps.height_around(spheres, 0.15, 0.175)
    assert inside - outside == pytest.approx(0.04, abs=2e-4)
    assert heaps.height_of_top(spheres, 0.05) == inside
    assert heaps.height_around(spheres, 0.4, 0.45) == 0


def test_bars_hold_back_grains_that_are_wider_than_their_gaps(device):
    """The same grains, twice: they stay within gaps of 8 mm, where they stand higher, and leave through 56 mm."""
    ring = dict(ring_diameter=0.2, bar_diameter=0.02, law="linear", duration=1.2)
    found = [Simulation(scenes.jring_dem(bars=bars, **ring, **SMALL), device=device, threads=1).run().result
             for bars in (22, 8)]  # fmt: skip
    spread, step, strays = ([number(each[name]) for each in found] for name in ("spread", "blocking_step", "strays"))
    assert spread[0] < 0.22 and strays[0] == 0
    assert spread[1] > 0.3 or strays[1] > 0.2
    assert step[0] > 0.02 and step[1] < 0.5 * step[0]


@pytest.mark.parametrize("name", ["slump-dem", "jring-dem", "funnel-dem", "lbox-dem", "lcpc-dem"])
def test_a_scene_is_made_again_from_its_parameters(name):
    from warpcrete.core.inputs.fingerprints import fingerprint

    make = scenes.modules()[name].scene
    for law in ("linear", "bonds", "mortar", "rolling"):
        first = make(law=law, seed=3)
        again = make(**json.loads(json.dumps(dict(first.parameters))))
        assert fingerprint(first) == fingerprint(again) and first.name == name


@pytest.mark.parametrize(
    ("name", "given", "grip"),
    [
        ("funnel-dem", {"law": "mortar"}, 1.0),
        ("funnel-dem", {"law": "mortar", "plate_grip": 0.5}, 0.5),
        ("lbox-dem", {"law": "mortar"}, 0.0),
        ("funnel-dem", {"law": "mortar", "mould_grip": 0.0}, 0.0),
        ("slump-dem", {"law": "mortar"}, 0.0),
        ("funnel-dem", {"law": "rolling"}, 0.0),
    ],
)
def test_walls_that_mortar_flows_along_hold_it_unless_said(name, given, grip):
    """A funnel that does not hold its mortar empties in the same two seconds whatever the viscosity."""
    made = scenes.modules()[name].scene(**given)
    wall = made.contacts["aggregate", "mould"]
    assert wall == made.contact.gripped(grip)
    if given["law"] == "mortar":
        assert wall.yield_stress == grip * made.contact.yield_stress
    assert any("slides" in remark for remark in made.remarks) == (grip == 0)


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("slump-dem", {"law": "glue"}, r"^law = 'glue': must be one of linear, bonds, mortar, plastic, rolling$"),
        ("slump-dem", {"size_max": 0.05}, r"^size_max = 0\.05: is too large: at least four grains .*; use 0\.025 m"),
        ("slump-dem", {"size_min": 0.02}, r"^size_max = 0\.016: must be at least size_min = 0\.02 m"),
        (
            "slump-dem",
            {"law": "linear", "rolling_friction": 0.3},
            r"^rolling_friction = 0\.3: has no effect unless 'law'",
        ),
        ("slump-dem", {"mould_grip": 3.0}, r"^mould_grip = 3\.0: must not exceed plate_grip = 2"),
        ("slump-dem", {"lift_time": 0.0}, r"^lift_time = 0\.0: must be a finite number above 0 s$"),
        ("funnel-dem", {"size_max": 0.04}, r"^size_max = 0\.04: is too large: at least two grains .*; use 0\.0325"),
        (
            "jring-dem",
            {"bars": 60},
            r"^bars = 60: must leave gaps between bars of 0\.018 m on a ring of 0\.3 m; use 52",
        ),
        (
            "jring-dem",
            {"ring_diameter": 0.2},
            r"^ring_diameter = 0\.2: is too small: a grain of the size .* use 0\.25 m or more$",
        ),
        ("jring-dem", {"bars": 2}, r"^bars = 2: "),
        (
            "lbox-dem",
            {"length": 0.15},
            r"^length = 0\.15: must exceed 'column_width' = 0\.1 m by at least 0\.1 m; use 0\.4 m or more$",
        ),
        (
            "lbox-dem",
            {"column_height": 0.1},
            r"^column_height = 0\.1: must exceed 'opening' = .* m by at least 0\.05 m",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(name, given, words):
    with pytest.raises(SceneError, match=words):
        scenes.modules()[name].scene(**given)


def test_a_scene_has_a_name_by_method():
    assert scenes.by_method("slump", "dem") == scenes.by_method("slump-dem", "dem") == "slump-dem"
    assert scenes.by_method("lbox-dem", "mps") == "lbox" and scenes.by_method("pipe", "dem") == "pipe"
    with pytest.raises(SceneError, match=r"^method = 'dem': must be one of mps, suspension for scene 'tube'"):
        scenes.by_method("tube", "dem")
    with pytest.raises(SceneError, match="the method of a flow is called 'mps'"):
        scenes.by_method("part", "flow")


def test_the_command_takes_a_method():
    from warpcrete.cli.main import cli

    helped = CliRunner().invoke(cli, ["run", "slump", "--method", "dem", "--help-all"])
    assert helped.exit_code == 0 and "--rolling-friction" in helped.output
    helped = CliRunner().invoke(cli, ["run", "slump", "--method=mps", "--help-all"])
    assert helped.exit_code == 0 and "--regularisation" in helped.output
