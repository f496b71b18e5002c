"""A line of several parts as one flow: the bits of the unit that it is, what each part loses, refusals."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import SceneError, load, scenes
from warpcrete.cli.main import cli
from warpcrete.core.units import number
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.one_pipe import joined, parameters_from_line
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.mps.part.display import PartDisplay
from warpcrete.mps.part.layout import Frame, bore_distance, part_room
from warpcrete.mps.part.probes import _slope, losses, straight_lines
from warpcrete.mps.part.simulation import PartSimulation
from warpcrete.scenes import modules
from warpcrete.studies.lines.losses import read_line
from warpcrete.studies.lines.run import run_line

COARSE = {"concrete": "no1", "spacing": 0.0125}
TWO_PLANES = """
diameter: 125 mm
flow: 19.8 m3/h
concrete: no1
parts:
  - straight: 0.5 m
  - bend: {to: left, radius: 0.3 m}
  - straight: 0.5 m
  - bend: {to: up, radius: 0.3 m}
  - straight: 0.5 m
"""


def written(folder, parts, diameter=0.1, more=""):
    path = folder / "site.yaml"
    path.write_text(f"diameter: {diameter}\n{more}parts: {parts}\n", encoding="utf-8")
    return str(path)


UNITS = {
    "straight": ("[{straight: 0.4}]", dict(unit="horizontal")),
    "two straights": ("[{straight: 0.15}, {straight: 0.25}]", dict(unit="horizontal")),
    "bend": ("[{straight: 0.2}, {bend: {to: left, radius: 0.25}}, {straight: 0.2}]", dict(unit="bend-level")),
    "reducer": (
        "[{straight: 0.2}, {reducer: {to: 0.08, length: 0.2}}, {straight: 0.2}]",
        dict(unit="horizontal", outlet_diameter=0.08, taper=0.2),
    ),
}


@pytest.mark.parametrize("kind", UNITS)
def test_a_line_is_the_unit_that_it_is(device, tmp_path, kind):
    """The same cells and bits, and all that is measured."""
    parts, unit = UNITS[kind]
    settings = COARSE | {"duration": 0.06, "steadiness": 1e-12}
    line, known = (
        PartSimulation(scenes.part(**settings, **more), device=device).run()
        for more in ({"line": written(tmp_path, parts)}, unit | {"straight": 0.2})
    )
    assert line.result["state_hash"] == known.result["state_hash"]
    curved = kind in ("bend", "reducer")
    names = ("pressure", "upstream_gradient", "downstream_gradient", "pressure_theory", *["middle_loss"] * curved)
    for name in names:
        assert line[name] == pytest.approx(known[name], rel=1e-12), name
    assert ("middle_loss" in known.result) == ("middle_loss" in line.result) == curved
    told = [number(part["loss"]) for part in line.result["parts"]]
    assert sum(told) == pytest.approx(line["pressure"], rel=1.1e-2)  # the last line is not 0 at the end: 1.0 %
    if curved:
        assert [part["loss"] for part in line.result["parts"]] == [part["loss"] for part in known.result["parts"]]
        assert told[1] == pytest.approx(known["middle_loss"], rel=1e-9)
        assert told[0] == pytest.approx(0.2 * known["upstream_gradient"], rel=1e-9)
    if kind == "two straights":
        assert told[0] / told[1] == pytest.approx(0.15 / 0.25, rel=1e-9)


def test_the_line_of_three_metres_is_the_unit_of_its_lengths(tmp_path):
    """Bend and reducer with straights between: axis, bores, cells, and where walls are; so its run is the unit's."""
    parts = ("[{straight: 0.6}, {bend: {to: left, radius: 0.5}}, {straight: 0.6}, "
             "{reducer: {to: 100 mm, length: 0.4}}, {straight: 0.6}]")  # fmt: skip
    settings = {"concrete": "no1", "flow": 0.0055, "gravity": 0.0, "spacing": 0.0125, "time_step": 3e-3}
    line = scenes.part(line=written(tmp_path, parts, "125 mm"), **settings)
    unit = scenes.part(
        unit="bend-level", diameter=0.125, elbow_radius=0.5, straight=0.6, outlet_diameter=0.1, taper=0.4, **settings
    )
    assert line.axis == unit.axis and part_room(line) == part_room(unit)
    s = np.linspace(0, line.axis.length, 1000)
    assert line.bore(s) == pytest.approx(unit.bore(s), rel=1e-12)
    assert line.middle == pytest.approx(unit.middle, rel=1e-12)
    places = np.random.default_rng(0).uniform(-1.2, 0, (1000, 3))
    assert bore_distance(line)(places) == pytest.approx(bore_distance(unit)(places), rel=1e-9)


def test_each_part_gets_what_it_loses(tmp_path):
    """The pressure falls by 20 kPa/m in straights, 60 kPa/m in the bend, and 40 kPa/m in the cone after the bend."""
    parts = ("[{straight: 0.4}, {bend: {to: left, radius: 0.25}}, {reducer: {to: 0.08, length: 0.2}}, "
             "{straight: 0.2}, {straight: 0.3}]")  # fmt: skip
    scene = scenes.part(line=written(tmp_path, parts), **COARSE)
    arc = 0.25 * math.pi / 2
    assert [section.kind for section in scene.sections] == ["straight", "bend", "reducer", "straight", "straight"]
    assert scene.middle == pytest.approx((0.4, 0.6 + arc)) and len(scene.axis.pieces) == 3
    s = np.arange(0.005, scene.axis.length, 0.01)
    places = np.array([0, 0.4, 0.4 + arc, 0.6 + arc, 1.1 + arc])
    lost = np.array([20.0, 60.0, 40.0, 20.0]) * np.diff(places)
    ahead = lost.sum() - np.interp(s, places, np.concatenate([[0], np.cumsum(lost)]))
    exact = [*lost[:3], 20 * 0.2, 20 * 0.3]
    assert losses(scene, s, ahead) == pytest.approx(exact, rel=1e-2)  # the mean over a slice, where no straight begins
    assert losses(scene, s, ahead)[3:] == pytest.approx(exact[3:], rel=1e-9)


def test_straight_pieces_in_a_row_are_one():
    arc = Arc(0.2, 1.0, (0, 0, 1))
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(0.2), Line(0.3), arc, Line(0.1), Line(0.2), Line(0.4)))
    pieces = joined(axis).pieces
    assert pieces[:2] == (Line(0.5), arc) and [piece.length for piece in pieces[2:]] == pytest.approx([0.7])
    assert joined(axis).at(1.1)[0] == pytest.approx(axis.at(1.1)[0])


def test_bends_of_one_plane_are_computed_by_half(tmp_path):
    """Also where the way out is the way in: an S, which lies in the plane of its bends."""
    parts = "[{straight: 0.3}, {bend: {to: left, radius: 0.25}}, {bend: {to: right, radius: 0.25}}, {straight: 0.3}]"
    swung = parts.replace("to: right", "to: up")
    flat, other = (scenes.part(line=written(tmp_path, each), **COARSE) for each in (parts, swung))
    assert flat.is_half and not other.is_half and flat.axis.is_plane
    assert abs(Frame(flat).axes[1, 2]) == pytest.approx(1.0)  # the mirror is level
    rooms = [part_room(scene) for scene in (flat, other)]
    assert rooms[0].origin[1] == 0 and rooms[1].origin[1] < -0.05
    for scene, room in zip((flat, other), rooms):
        s = np.linspace(0.02, scene.axis.length - 0.02, 100)
        points, _, normal, side = scene.axis.frame(s)
        for r, inside in ((0.049, True), (0.051, False)):
            places = Frame(scene).to_grid(
                points + r * (np.cos(3 * s)[:, None] * normal + np.sin(3 * s)[:, None] * side)
            )
            assert np.array_equal(bore_distance(scene)(places) > 0, np.full(100, inside))
            places[:, 1] = abs(places[:, 1]) if scene.is_half else places[:, 1]
            high = np.array(room.origin) + np.array(room.cells) * room.width
            assert np.all((places > room.origin) & (places < high)) or not inside


@pytest.mark.slow
def test_a_line_in_two_planes_loses_what_its_parts_do(device, tmp_path):
    """The whole line and its separate parts differ by the error of coarse cells in the friction of straight pipe.

    For the separate parts, the friction of straight pipe is computed with finer cells.
    """
    path = tmp_path / "site.yaml"
    path.write_text(TWO_PLANES, encoding="utf-8")
    whole = PartSimulation(scenes.part(line=str(path), spacing=0.125 / 8, time_step=3e-3), device=device).run()
    added = run_line(read_line(path), concrete_of("no1"), 19.8 / 3600, cells=8, simulate=True, device=device)
    assert all(good for good, _ in modules()["part"].check(whole).values())
    weight = 2400.0 * 0
    for part, loss in zip(whole.result["parts"], added.losses, strict=True):
        weight += loss.weight
        assert part["what"] == loss.part.label
        assert number(part["loss"]) == pytest.approx(loss.friction, rel=0.035)  # measured 0.3 to 2.8 %
    assert whole["pressure"] - weight == pytest.approx(added.pressure - weight, rel=0.02)  # 1.3 %
    table = whole.tables["stations"].columns
    assert table["pressure"][0] - table["friction_ahead"][0] == pytest.approx(weight, rel=1e-6)


def test_the_command_takes_flow_and_concrete_from_the_file(tmp_path):
    """A flow and a concrete given as parameters override those in the file. A run's record keeps the run's values."""
    given = {"diameter": 0.1, "more": "flow: 9 m3/h\nconcrete: no2\n"}
    path = written(tmp_path, "[{straight: 0.3}, {straight: 0.1}]", **given)
    out = str(tmp_path / "run")
    command = ["run", "part", "--line", path, "--spacing", "0.0125", "--gravity", "0", "--duration", "0.06"]
    done = CliRunner().invoke(cli, [*command, "--device", "cpu", "--quiet", "--out", out])
    assert "part 1" in done.output and "part 2" in done.output, done.output
    run = load(out)
    assert run.scene.flow == pytest.approx(9 / 3600) and run.scene.concrete.name == "no2"
    table = run.tables["stations"]
    assert table.units["pressure"] == "Pa" and np.all(np.diff(table.columns["pressure"]) < 0)
    assert np.array_equal(table.columns["pressure"], table.columns["friction_ahead"])
    scene = scenes.part(line=path, flow=1e-3, concrete="no3", spacing=0.0125)
    assert scene.flow == 1e-3 and scene.concrete.name == "no3"
    # A run's record has both: the file may say something else by then.
    written(tmp_path, "[{straight: 0.3}, {straight: 0.1}]", more="flow: 1 m3/h\n")
    assert scenes.part(**run.scene.parameters).flow == pytest.approx(9 / 3600)
    elements = scenes.part_dem(line=path, travel=0.05)
    assert elements.parameters["flow"] == pytest.approx(1 / 3600)


@pytest.mark.parametrize(
    "parts, more, words",
    [
        ("[{bend: {to: up, radius: 0.2}}, {straight: 1}]", {}, "with a straight part, but part 1 is a bend; add a"),
        ("[{straight: 1}, {hose: {points: [[1, 0, 0]]}}]", {}, "with a straight part, but part 2 is a hose"),
        ("[{straight: 0.05}, {bend: {to: up, radius: 0.2}}, {straight: 1}]", {}, "^straight = 0.05: is too short"),
        ("[{straight: 1}, {hose: {points: [[1, 0, 0]], layer: 0.8}}, {straight: 1}]", {},
         r"^part 2, hose: layer = 0\.8: must be 1, because .* layer in all parts; leave out 'layer'"),
        ("[{straight: 0.3}, {bend: {to: left, radius: 0.055}}, {bend: {to: left, radius: 0.055}}, {straight: 0.2}, "
         "{bend: {to: down, radius: 0.2}}, {straight: 0.3}]", {},
         r"^parts = \[1, 4\]: come within 0\.03\d* m of each other; change the course of the line, or use"),
        ("[{straight: 1}, {bend: {to: left, radius: 0.2}}, {bend: {to: left, radius: 0.2}}, {straight: 0.3}]", {},
         "crosses the plane of its outlet before its end"),
        ("[{straight: 0.3}, {bend: {to: left, radius: 0.2}}, {bend: {to: left, radius: 0.2}}, {straight: 0.6}, "
         "{bend: {to: left, radius: 0.2}}, {straight: 0.8}]", {}, "crosses the plane of its inlet again"),
        ("[{straight: 1}, {reducer: {to: 0.05, length: 0.2}}, {straight: 1}]", {},
         r"^spacing = 0\.0125: is too coarse: at least 6 .* narrowest bore, 0\.05 m; use 0\.00454 .* 11 cells"),
        ("[{straight: 1}]", {"diameter": 0.08}, r"^diameter = 0\.08: has no effect unless 'line' is left out"),
        ("[{straight: 1}]", {"wall": "x.stl"}, r"^wall = '.*x\.stl': has no effect unless 'line' is left out"),
        ("[{straight: 1}]", {"slip_thickness": 0.06, "slip_viscosity": 900.0}, "^slip_thickness = 0.06"),
    ],
)  # fmt: skip
def test_lines_that_are_no_one_flow_are_refused_in_one_line(tmp_path, parts, more, words):
    with pytest.raises(SceneError, match=words) as caught:
        scenes.part(line=written(tmp_path, parts), **COARSE | more)
    assert "\n" not in str(caught.value)


def test_a_hose_is_one_part_of_a_flow(tmp_path):
    """Its arcs are the axis', it is told as a whole, and theory has it as straight pipe of its length."""
    parts = "[{straight: 0.3}, {hose: {points: [[0.5, 0, 0], [1.0, 0.2, 0], [1.5, 0.3, 0.2]]}}, {straight: 0.3}]"
    scene = scenes.part(line=written(tmp_path, parts), **COARSE)
    line = read_line(tmp_path / "site.yaml")
    assert [section.kind for section in scene.sections] == ["straight", "hose", "straight"]
    assert scene.sections[1].end - scene.sections[1].begin == pytest.approx(line.parts[1].length)
    assert scene.friction_loss(0, scene.axis.length) == pytest.approx(scene.theory(0.0).pressure * scene.axis.length)
    assert not scene.is_half


def test_the_room_of_a_long_line_holds_its_turns(tmp_path):
    """Where it turns is as far as it goes: between places that lie apart the wall of the room would close the bore."""
    parts = "[{straight: 25}, {bend: {to: left, radius: 0.15}}, {bend: {to: left, radius: 0.15}}, {straight: 30}]"
    scene = scenes.part(concrete="no1", spacing=0.0125, line=written(tmp_path, parts))
    room, frame = part_room(scene), Frame(scene)
    points, tangents = scene.axis.at(np.linspace(0, scene.axis.length, 100_000))
    reach = scene.widest * np.sqrt(np.maximum(1 - (tangents @ frame.axes.T) ** 2, 0.0))
    places = frame.to_grid(points)
    assert np.all((places - reach).min(0)[[0, 2]] > np.array(room.origin)[[0, 2]] + room.width[0])
    top = np.array(room.origin) + np.array(room.cells) * np.array(room.width)
    assert np.all((places + reach).max(0)[:2] < top[:2] - room.width[0])


def test_the_file_of_a_line_gives_whatever_is_not_given_beside_it(tmp_path):
    path = tmp_path / "line.yaml"
    path.write_text("{flow: 36 m3/h, concrete: no2, diameter: 0.125, parts: [{straight: 3}]}", encoding="utf-8")
    both = {"flow": pytest.approx(0.01), "concrete": "no2"}
    for given, found in (({}, both), ({"flow": 1.0}, both), ({"concrete": "no1"}, both),
                         ({"flow": 1.0, "concrete": "no1"}, {})):  # fmt: skip
        assert parameters_from_line({"line": str(path), **given}) == found
    assert parameters_from_line({"line": None}) == parameters_from_line({}) == {}


def test_slopes_beside_cells_without_concrete_are_those_to_the_other_neighbour():
    values = np.array([0.0, 1.0, 4.0, 9.0, 16.0, 25.0, 36.0])
    known = np.array([True, True, True, True, False, True, False])
    for shape, axis in (((7, 1), 0), ((1, 7), 1)):
        slope = _slope(values.reshape(shape), known.reshape(shape), axis).ravel()
        assert slope[known].tolist() == [1.0, 2.0, 4.0, 5.0, 0.0]


def test_lines_are_fitted_to_pressures_a_radius_away_from_bends_and_ends():
    """Pressures nearer than that are wrong by 500 Pa; the pipe narrows from a radius of 50 mm to one of 40 mm."""
    scene: Any = SimpleNamespace(
        middle=(1.0, 1.5), axis=SimpleNamespace(length=3.0), bore=lambda s: 0.05 if s < 1.2 else 0.04
    )
    s = np.arange(0.005, 3.0, 0.01)
    near = (s < 0.05) | ((s > 0.95) & (s < 1.54)) | (s > 2.96)
    pressure = np.where(s < 1.2, 6e3 - 2000 * s, 4.5e3 - 1500 * s) + 500.0 * near
    upstream, downstream = straight_lines(scene, s, pressure)
    assert upstream == pytest.approx([-2000, 6e3], rel=1e-9) and downstream == pytest.approx([-1500, 4.5e3], rel=1e-9)
    scene.middle = (1.4, 1.4)  # A straight pipe is halved, and has no bend from which to keep away.
    upstream, downstream = straight_lines(scene, s, 6e3 - 2000 * s + 500.0 * ((s < 0.05) | (s > 2.96)))
    assert upstream == pytest.approx(downstream, rel=1e-9) and upstream == pytest.approx([-2000, 6e3], rel=1e-9)
    short = straight_lines(scene, s[:7], pressure[:7])
    assert np.isnan(short).all()


def test_the_colours_reach_the_speed_in_the_narrow_end_of_a_reducer():
    """The scale ends at 1.5 times the mean speed there: the plug of this concrete is not faster."""
    scene = scenes.part(concrete="no1", unit="horizontal", diameter=0.125, outlet_diameter=0.08, flow=2e-3)
    label, low, high = PartDisplay.scale(SimpleNamespace(_scene=scene, colouring="speed"))
    assert (label, low) == ("speed [m/s]", 0.0)
    assert high == pytest.approx(1.5 * 2e-3 / (math.pi * 0.04**2), rel=1e-12)
