"""Parts of a line by discrete elements: bores, packing inside them, lines put together."""

import dataclasses
import json
import math
import sys
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import SceneError, Simulation, load, scenes
from warpcrete.cli.main import cli
from warpcrete.dem.packing import pack
from warpcrete.dem.pictures import plot_stations
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.curves import curve_through
from warpcrete.geometry.meshes import enclosed
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.studies.lines.element_line import ElementLine, SeedResult, WallLaw
from warpcrete.studies.lines.elements import Elements, scaled_parameters
from warpcrete.studies.lines.losses import friction, line_of, with_layer_factor
from warpcrete.studies.lines.run import run_line

SMALL = dict(diameter=0.08, straight=0.1, size_min=12e-3, size_max=20e-3, travel=0.04, settle=0.1, gravity=0.0,
             flow=1e-3, plug_ball=14e-3)  # fmt: skip
DEFAULT_PLOT_COLUMNS = {
    "straight": dict(unit="horizontal"),
    "bend": dict(unit="bend-to-vertical", elbow_radius=0.12),
    "reducer": dict(unit="vertical", outlet_diameter=0.06, taper=0.1),
    "bend and reducer": dict(unit="bend-level", elbow_radius=0.12, outlet_diameter=0.06, taper=0.1),
}
AROUND = """
diameter: 80 mm
parts:
  - straight: 0.1
  - bend: {to: up, radius: 0.12, angle: 60}
  - bend: {to: left, radius: 0.12, angle: 45}
  - reducer: {to: 60 mm, length: 0.1}
  - straight: 0.1
"""


def test_a_piston_that_starts_at_its_final_speed_may_be_stated():
    assert scenes.part_dem(**SMALL, ramp=0.0).pipe.ramp == 0.0
    assert scenes.part_dem(**SMALL).pipe.ramp == 0.5 * SMALL["travel"]


def test_volumes_and_surfaces_of_bores():
    """A cone between two cylinders: V = pi h (a^2 + a b + b^2) / 3, its side pi (a + b) sqrt(h^2 + (a - b)^2)."""
    bores = Bores((1.0, 1.4), (0.1, 0.07))
    cone = math.pi * 0.4 * (0.01 + 0.007 + 0.0049) / 3
    assert bores.volume(0.8, 1.7) == pytest.approx(math.pi * (0.2 * 0.01 + 0.3 * 0.0049) + cone, rel=1e-12)
    assert bores.surface(1.0, 1.4) == pytest.approx(math.pi * 0.17 * math.hypot(0.4, 0.03), rel=1e-12)
    halves = bores.spread(np.array([0.0, 0.5, 1.0]), 2.0)
    assert bores.volume(0, halves[1]) == pytest.approx(0.5 * bores.volume(0, 2.0), rel=1e-5)
    assert list(halves[[0, 2]]) == [0, 2]
    with pytest.raises(SceneError, match=r"^bores"):
        Bores((1.0, 0.5), (0.1, 0.1))


def test_a_pipe_that_bends_in_two_planes_is_a_closed_surface_of_its_volume():
    import trimesh

    axis = Axis((0, 0, 0), (1, 0, 0), (Line(0.2), Arc(0.2, 1.0, (0, 0, 1)), Arc(0.15, 1.2, (0, 1, 0)), Line(0.2)))
    _, tangents, normals, sides = axis.frame(np.linspace(0, axis.length, 200))
    for one, other in ((tangents, normals), (tangents, sides), (normals, sides)):
        assert np.abs(np.einsum("ij,ij->i", one, other)).max() < 1e-12
    assert np.abs(np.diff(sides, axis=0)).max() < 0.03  # no jump: 200 places along two arcs of 2.2 rad
    bores = Bores((0.3, 0.5), (0.05, 0.03))
    vertices, faces = bores.mesh(axis, facets=64)
    last = len(vertices) - 64
    around = np.stack([np.arange(64), (np.arange(64) + 1) % 64], axis=1)
    caps = [np.insert(around + first, 2, len(vertices) + k, axis=1) for k, first in enumerate((0, last))]
    closed = np.concatenate([vertices, [vertices[:64].mean(0), vertices[last:].mean(0)]])
    ways = [np.concatenate([faces, one, other[:, ::-1]]) for one, other in (caps, caps[::-1])]
    (mesh,) = [m for m in (trimesh.Trimesh(closed, way) for way in ways) if m.is_winding_consistent]
    assert mesh.is_watertight and -mesh.volume == pytest.approx(bores.volume(0, axis.length), rel=2e-3)


@pytest.mark.parametrize(
    "course",
    ["straight", *(pytest.param(c, marks=pytest.mark.thorough) for c in ("bend", "reducer")), "bend and reducer"],
)
def test_nothing_lies_outside_the_true_wall_at_the_start(course):
    """Cones and bends included: every centre inside, and as full everywhere."""
    scene: Any = scenes.part_dem(**SMALL | DEFAULT_PLOT_COLUMNS[course])
    bodies, report = pack(scene.fill, contact=scene.contact, seed=0, device="cpu")
    wall = next(wall for wall in scene.walls if wall.name == "pipe")
    assert enclosed(wall, scene.pipe.axis, bodies.position).all() and report.bodies > 150
    s, half = scene.pipe.axis.along(bodies.position), scene.pipe.axis.length / 2
    bores = scene.stations.bores
    parts = [bodies.volume[here].sum() for here in (s < half, s >= half)]
    fractions = np.array(parts) / [bores.volume(0, half), bores.volume(half, 2 * half)]
    assert fractions == pytest.approx(report.solid_fraction, rel=0.04)  # measured up to 1.5 %


@pytest.mark.thorough
@pytest.mark.parametrize("course", DEFAULT_PLOT_COLUMNS)
def test_every_part_is_pushed_through_and_measured(device, course):
    scene = scenes.part_dem(**SMALL | DEFAULT_PLOT_COLUMNS[course] | {"straight": 0.18, "slices": 3.0})
    run = Simulation(scene, device=device).run()
    checks = sys.modules["warpcrete.scenes.part_dem"].check(run)
    # A run of this length compresses the aggregates before a reducer, so less flows out than in.
    if course != "straight":
        assert checks.pop("outflow equals inflow")[0] == ("reducer" not in course)
    for name, (passed, found) in checks.items():
        assert passed, f"{name}: {found}"
    table = run.tables["stations"].columns
    full = np.isfinite(table["pressure"])
    assert np.count_nonzero(full) >= 3
    stress = table["axial_stress"][full]
    assert np.diff(stress).max() < 6e-3 * stress.max()  # It falls, but for single grains at the outlet: +0.46 % there.
    assert np.all((table["solid_fraction"][full] > 0.5) & (table["solid_fraction"][full] < 0.8))
    assert run["momentum_balance_error"] < 1e-3
    assert len(plot_stations(run).axes) == 4
    assert ("middle_loss" in run.result) == (course != "straight") and ("gradient" in run.result) == (
        course == "straight"
    )


@pytest.mark.thorough
def test_a_part_without_slices_measures_no_losses_and_moves_the_same(device):
    """The slices only measure, also in a run that looks for a blockage in a pipe whose width changes."""
    given = SMALL | DEFAULT_PLOT_COLUMNS["reducer"] | {"straight": 0.18, "stop_when_blocked": True}
    run, without = (Simulation(scenes.part_dem(**given, slices=slices), device=device).run() for slices in (3.0, 0.0))
    assert without.result["state_hash"] == run.result["state_hash"]
    assert without["blocked"] == run["blocked"] and without["slowest_advance"] == run["slowest_advance"]
    assert "stations" in run.tables and "stations" not in without.tables and "middle_loss" not in without.result
    with pytest.raises(SceneError, match="slices"):
        scenes.part_dem(**given, slices=-1.0)


@pytest.mark.thorough
def test_a_line_bends_in_two_planes_and_goes_through_a_checkpoint(device, tmp_path):
    (tmp_path / "line.yaml").write_text(AROUND, encoding="utf-8")
    given = dict(SMALL, line=str(tmp_path / "line.yaml"), plug_layers=3)
    for name in ("diameter", "straight"):
        given.pop(name)
    scene = scenes.part_dem(**given)
    whole = Simulation(scene, device=device).run()
    assert whole.finished and whole["momentum_balance_error"] < 1e-3

    def cut(phase, fraction, figures):
        if phase == "running" and fraction > 0.4:
            first.stop_requested = True

    path = tmp_path / "checkpoint.npz"
    first = Simulation(scene, device=device, progress=cut, checkpoint_path=path, checkpoint_every=1e9)
    assert not first.run().finished
    again = Simulation(scene, device=device)
    again.resume(path)
    resumed = again.run()
    assert resumed.result["state_hash"] == whole.result["state_hash"]
    for name, column in whole.tables["stations"].columns.items():
        assert np.array_equal(column, resumed.tables["stations"].columns[name], equal_nan=True), name


def test_short_stretches_are_told():
    told = [
        scenes.part_dem(**SMALL | DEFAULT_PLOT_COLUMNS["bend"] | {"straight": length}).remarks for length in (0.1, 0.3)
    ]
    assert "too short to measure" in told[0][-1] and not any("too short" in text for text in told[1])


@pytest.mark.parametrize(
    "changes, told",
    [
        (dict(outlet_diameter=0.02), r"^size_max = 0\.02: must be below the pipe's diameter, 0\.02 m"),
        (dict(unit="bend-level", elbow_radius=0.03), r"^elbow_radius = 0\.03: must exceed the pipe's radius"),
        (dict(ramp=0.1), r"^ramp = 0\.1: must not exceed the travel, 0\.04 m"),
        (dict(taper=0.2), r"^taper = 0\.2: has no effect unless 'outlet_diameter' is given"),
        (dict(line="burj-khalifa"), r"^diameter = 0\.08: has no effect unless 'line' is left out"),
        (dict(unit="up"), r"^unit = 'up': must be one of vertical"),
    ],
)
def test_parts_that_cannot_be_are_refused_in_one_line(changes, told):
    with pytest.raises(SceneError, match=told):
        scenes.part_dem(**SMALL | changes)


@pytest.mark.parametrize(
    "parts, told",
    [
        ("[{bend: {to: up, radius: 0.2}}, {straight: 1}]", "with a straight part, but part 1 is a bend"),
        ("[{straight: 0.2}, {bend: {to: left, radius: 0.2}}, {bend: {to: left, radius: 0.2}}, {straight: 1}]",
         "crosses the plane of its inlet again"),
    ],
)  # fmt: skip
def test_lines_that_cannot_be_pushed_through_are_refused(tmp_path, parts, told):
    (tmp_path / "line.yaml").write_text(f"diameter: 0.1\nparts: {parts}\n", encoding="utf-8")
    with pytest.raises(SceneError, match=told):
        scenes.part_dem(line=str(tmp_path / "line.yaml"))


def test_a_line_is_put_together_from_its_end():
    """Walls that take a + b sigma: the pressure grows as an exponential, a bend of ratio two as twice its length."""
    parts = [{"straight": 1}, {"bend": {"to": "left", "radius": 0.5}}, {"straight": 2}]
    line = line_of({"diameter": 0.1, "parts": parts})
    a, b = 100.0, 0.03
    law = WallLaw(0.1, a, b, 1e3, 1e9)
    columns = {"axial_stress": np.array([1e3, 3e3, np.nan]), "wall_stress": np.array([130, 190, 0.0])}
    fitted = WallLaw.of(0.1, columns, 1e5)
    assert (fitted.start, fitted.slope, fitted.measured) == pytest.approx((100.0, 0.03, 3e3))
    packed = SeedResult({0.1: law}, {line.parts[1].loss_key: 2.0}, 1500.0)
    found = packed.course(line)
    length = 1 + 2 + math.pi / 2 * 0.5 * 2
    exact = a / b * (math.exp(4 * b / 0.1 * length) - 1)
    assert sum(map(sum, found)) == pytest.approx(exact, rel=0.02)
    assert all(weight == 0 for _, weight in found)
    flat = SeedResult({0.1: WallLaw(0.1, a - 10 * b, b, 5.0, 10.0)}, {}, 1500.0)
    upright = line_of({"diameter": 0.1, "begin": "up", "parts": [{"straight": 2}]})
    ((friction, weight),) = flat.course(upright)
    assert friction == pytest.approx(4 * a / 0.1 * 2, rel=1e-4) and weight == pytest.approx(1500 * 9.81 * 2)


def test_no_pressure_of_a_falling_line_is_below_zero():
    """The column breaks where concrete runs down: nothing there helps the pump, and the walls take their least."""
    down = [{"bend": {"to": "down", "radius": 0.5}}, {"straight": 20}, {"bend": {"to": "level", "radius": 0.5}}]
    line, level = (
        line_of({"diameter": 0.1, "parts": parts}) for parts in ([{"straight": 10}, *down], [{"straight": 10}])
    )
    packed = SeedResult({0.1: WallLaw(0.1, 100.0, 0.03, 1e3, 1e9)}, {}, 1500.0)
    assert packed.course(line)[0] == packed.course(level)[0]
    assert packed.course(line)[2][0] == pytest.approx(4 * 100 / 0.1 * 20)
    (alone,) = packed.course(level)
    assert packed.pressure(line) == pytest.approx(sum(alone)) == packed.pressure(level)
    found = ElementLine(line, "no1", 0.01, [packed, packed], [])
    assert found.pressures == [packed.pressure(line)] * 2


@pytest.mark.thorough
def test_line_by_elements_runs_each_kind_once_and_takes_it_again(tmp_path):
    (tmp_path / "line.yaml").write_text(
        "diameter: 80 mm\nflow: 10 m3/h\nconcrete: zhan\nparts:\n  - straight: 0.4\n"
        "  - bend: {to: up, radius: 0.12}\n  - straight: 0.2\n",
        encoding="utf-8",
    )
    command = ["line", str(tmp_path / "line.yaml"), "--method", "dem", "--device", "cpu", "--quiet"]
    command += ["--coarse", "1.35"]
    first = CliRunner().invoke(cli, [*command, "--out", str(tmp_path / "one")], catch_exceptions=False)
    record = json.loads((tmp_path / "one" / "line-dem.json").read_text(encoding="utf-8"))
    assert first.exit_code == 0 and not record["failed_checks"], first.output
    assert len(record["wall_time"]) == 3 and len(record["parts"]) == 3
    assert [part["blocked_seeds"] for part in record["parts"]] == [0, 0, 0] and "- not blocked" in first.output
    friction = [part["friction"]["value"] for part in record["parts"]]
    weight = [part["weight"]["value"] for part in record["parts"]]
    assert min(friction) > 0 and weight[0] == 0 and weight[2] > 0
    assert record["pressure"]["value"] == pytest.approx(sum(friction) + sum(weight))
    part = load(next((tmp_path / "one" / "parts").glob("straight-80-pressed*")))
    assert "axial_stress" in part.tables["stations"].columns
    again = CliRunner().invoke(cli, [*command, "--out", str(tmp_path / "two"), "--known", str(tmp_path / "one")])
    second = json.loads((tmp_path / "two" / "line-dem.json").read_text(encoding="utf-8"))
    # Tables hold nine digits.
    assert second["pressure"]["value"] == pytest.approx(record["pressure"]["value"], rel=1e-7), again.output
    assert second["wall_time"] == {}


@pytest.mark.parametrize(("bore", "factor"), [(0.2, 3.0), (0.08, 1.2), (0.05, 1.0)])
def test_stones_are_enlarged_to_three_tenths_of_the_bore_but_never_shrunk(bore, factor):
    """Scale stones of 12 to 20 mm. A stone of 20 mm keeps its size in a bore of 50 mm, of which 0.3 are 15 mm."""
    own = {"unit": "horizontal", "diameter": 0.3, "size_min": 12e-3, "size_max": 20e-3}
    found = scaled_parameters(own, bore, Elements())
    assert found["size_max"] == pytest.approx(factor * 20e-3) and found["size_min"] == pytest.approx(factor * 12e-3)


def test_line_by_elements_refuses(tmp_path):
    (tmp_path / "line.yaml").write_text(
        "diameter: 0.1\nflow: 0.002\nconcrete: zhan\nparts: [{straight: 1}]\n", encoding="utf-8"
    )
    for more, told in (
        (["--seeds", "0"], "seeds = 0"),
        (["--coarse", "0.5"], "coarse = 0.5"),
        (["--concrete", "nothing"], "concrete = 'nothing'"),
        (["--coarse", "6"], "size_max = 0.12: must be below the pipe's diameter"),
        (["--theory"], "--theory: cannot be combined with '--method dem' or '--method both'"),
    ):
        command = ["line", str(tmp_path / "line.yaml"), "--method", "dem", "--out", str(tmp_path / "out"), *more]
        done = CliRunner().invoke(cli, command)
        assert done.exit_code != 0 and told in str(done.exception) + done.output, done.output
        assert not (tmp_path / "out").exists()


def test_a_hose_through_points_of_a_circle_is_that_circle():
    angle = np.array([0.0, 0.2, 0.7, 0.8, 1.2])  # chords of any length
    points = 2.0 * np.stack([np.sin(angle), 0 * angle, 1 - np.cos(angle)], axis=1)
    pieces = curve_through(points, np.array([1.0, 0.0, 0.0]))
    axis = Axis((0, 0, 0), (1, 0, 0), tuple(pieces))
    assert axis.length == pytest.approx(2.4, rel=1e-9) and all(isinstance(piece, Arc) for piece in pieces)
    assert axis.at(axis.length)[0][0] == pytest.approx(points[-1], abs=1e-9)
    twisted = np.array([[0, 0, 0], [1, 0.1, 0.2], [2, 0.5, 0.1], [2.5, 1.2, -0.6]], dtype=float)
    axis = Axis((0, 0, 0), (1, 0, 0), tuple(curve_through(twisted, np.array([1.0, 0.0, 0.0]))))
    # It passes every point, though its arcs lie in many planes.
    assert np.linalg.norm(axis.nearest(twisted) - twisted, axis=1).max() < 1e-9


def test_a_hose_counts_its_length_its_bends_and_its_layer():
    points = [[1, 0, -0.2], [2, 0.5, -1], [2.2, 1.5, -1.5]]
    line = line_of({"diameter": 0.1, "parts": [{"straight": 1}, {"hose": {"points": points, "layer": 0.5}}]})
    hose = line.parts[1]
    assert hose.rise == -1.5 and 1.0 < hose.relative_loss < 1.125 and hose.length > 3.0
    assert line.axis.at(line.axis.length)[0][0] == pytest.approx([3.2, 1.5, -1.5], abs=1e-9)
    concrete = concrete_of("no1")
    straight = dataclasses.replace(hose, relative_loss=1.0, layer=1.0)
    plain = friction(straight, concrete, 0.002)
    assert friction(hose, concrete, 0.002) < hose.relative_loss * plain
    assert friction(hose, with_layer_factor(concrete, 2.0), 0.002) == pytest.approx(
        hose.relative_loss * plain, rel=1e-9
    )
    found = run_line(line, concrete, 0.002, simulate=False)
    assert found.losses[1].weight == pytest.approx(-1.5 * 9.81 * concrete.density)


def test_only_the_bends_of_a_hose_take_more_than_a_straight_pipe():
    """Sum the extra losses of the arcs of a hose that runs straight ahead for some way and then bends."""
    points = [[1, 0, 0], [2, 0, 0], [3, 0.4, 0], [3.6, 1.4, 0]]
    line = line_of({"diameter": 0.1, "parts": [{"straight": 1}, {"hose": {"points": points}}]})
    pieces, hose = line.axis.pieces[1:], line.parts[1]
    assert isinstance(pieces[0], Line) and pieces[0].length == pytest.approx(0.5)
    arcs = [piece for piece in pieces if isinstance(piece, Arc)]
    assert hose.length == pytest.approx(sum(piece.length for piece in pieces)) and arcs
    more = [np.interp(0.1 / arc.radius, (0.0, 0.15, 0.3, 0.6), (0.0, 0.023, 0.042, 0.125)) * arc.length for arc in arcs]
    assert (hose.relative_loss - 1) * hose.length == pytest.approx(sum(more), rel=1e-9)


@pytest.mark.parametrize(
    "said, told",
    [
        ({"points": [[0, 1, 0], [0, 2, 0]]}, "begin at an angle of 90 degrees to the direction of the line"),
        ({"points": [[1, 0, 0], [1.1, 0.02, 0], [1.15, 0.12, 0], [1.15, 1, 0]]}, "bend the hose to a radius of"),
        ({"points": [[1, 0, 0], [1.01, 0, 0]]}, "half a diameter, 0.05 m, apart"),
        ({"points": [[1, 0]]}, "must each have three coordinates"),
        ({"points": "there"}, "must be a list of points"),
        ({"points": [[1, 0, "2 bar"]]}, "must be a number with one of the units m"),
        ({"points": [[1, 0, 0]], "layer": 0}, "layer = 0"),
    ],
)
def test_hoses_that_do_not_fit_are_refused(said, told):
    with pytest.raises(SceneError, match=told):
        line_of({"diameter": 0.1, "parts": [{"straight": 1}, {"hose": said}]})


def test_a_hose_that_meets_the_line_is_refused():
    points = [[1, 0.2, 0], [1.5, 1, 0], [1, 1.8, 0], [0, 1, 0], [-0.5, -0.5, 0]]
    with pytest.raises(SceneError, match="the line crosses itself"):
        line_of({"diameter": 0.1, "parts": [{"straight": 2}, {"hose": {"points": points}}]})


def test_shapes_from_files_are_written_down_whole(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    import trimesh

    trimesh.creation.icosphere(1).export("stone.stl")
    scene = scenes.part_dem(**SMALL | DEFAULT_PLOT_COLUMNS["straight"] | {"shapes": "stone.stl", "shape_spheres": 4})
    assert scene.parameters["shapes"] == str(tmp_path / "stone.stl"), "to be found from elsewhere, too"
