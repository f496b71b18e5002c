"""Lines of pipes: what a file says, whether its parts fit, what they lose, and what the command makes of it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import RunFolderError, SceneError, Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.core.inputs.amounts import amount
from warpcrete.core.units import number
from warpcrete.geometry.crossings import distances
from warpcrete.geometry.pipe_line import Part
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.studies.lines import run as line_run
from warpcrete.studies.lines.fittings import library_factor
from warpcrete.studies.lines.losses import line_of, read_line, shipped_lines, straight_friction
from warpcrete.studies.lines.run import _loss_from_run, _scene_of_part, folder_name, run_line
from warpcrete.theory.bands import combined
from warpcrete.theory.pipe import Concrete

SLIPPING = Concrete(density=2400.0, viscosity=1e6, yield_stress=1e9, slip_viscosity=1000.0, slip_yield=50.0)
"""A plug, which slides along the wall: every loss has a closed form."""
SHAPED = {
    "diameter": "125 mm",
    "parts": [
        {"straight": "10 m"},
        {"bend": {"to": "up", "radius": "0.5 m"}},
        {"straight": {"length": 20, "rise": 20}},
        {"bend": {"to": "left", "radius": 0.5, "angle": 90}},
        {"reducer": {"to": "100 mm", "length": 1}},
        {"straight": 5},
    ],
}


@pytest.mark.parametrize(
    ("given", "unit", "value"),
    [
        ("30 m3/h", "m3/s", 30 / 3600), ("12 L/min", "m3/s", 2e-4), ("2l/s", "m3/s", 2e-3), (0.5, "m", 0.5),
        ("125 mm", "m", 0.125), ("5 in", "m", 0.127), ("12.5 bar", "Pa", 1.25e6), ("1e-1 MPa", "Pa", 1e5),
        ("3", "m", 3.0), (".5 km", "m", 500.0), ("90 deg", "degrees", 90.0), ("3.1415927 rad", "degrees", 180.0),
        (np.int64(10), "m", 10.0), (np.float32(0.5), "m", 0.5),
    ],
)  # fmt: skip
def test_amounts_come_in_the_units_that_people_use(given, unit, value):
    assert amount("it", given, unit) == pytest.approx(value, rel=2e-8)


@pytest.mark.parametrize(
    "given", ["30 m3/hor", "thirty", "30 m3/h up", 10**400, [1], True, None, float("nan"), "30 mm"]
)
def test_other_amounts_are_refused(given):
    with pytest.raises(
        SceneError, match=r"^flow = .*: must be a number with one of the units m3/s, m3/h, .* is in m3/s$"
    ):
        amount("flow", given, "m3/s")


def test_parts_that_lose_different_pressures_have_different_run_folders():
    """Folders whose names are equal get numbers, by which a user cannot tell the parts apart."""
    kinds = [{"straight": 1}, {"hose": 2}, {"hose": {"length": 2, "layer": 1.5}}]
    kinds += [{"bend": {"to": "left", "radius": radius, "angle": angle}} for radius in (0.3, 1) for angle in (45, 90)]
    kinds += [{"reducer": {"to": to, "length": length}} for to in (0.1, 0.11) for length in (0.3, 1)]
    parts = [part for diameter in (0.125, 0.15) for kind in kinds
             for part in line_of({"diameter": diameter, "parts": [kind]}).parts]  # fmt: skip
    names = {part.loss_key: folder_name(part) for part in parts}
    assert len(names) == 2 * (2 + 4 + 4) and len(set(names.values())) == len(names)


def test_a_line_goes_where_its_parts_lead():
    """Level along x, up by a bend of 0.5 m and 20 m, left by the next, along y."""
    line = line_of(SHAPED)
    assert [part.diameter for part in line.parts] == [0.125] * 5 + [0.1] and line.parts[4].outlet == 0.1
    assert [part.rise for part in line.parts] == pytest.approx([0, 0.5, 20, 0.5, 0, 0], abs=1e-12)
    assert line.length == pytest.approx(36 + math.pi / 2)
    ends, ways = line.axis.at([line.length])
    assert ends[0] == pytest.approx([10.5, 0.5 + 6, 21.0]) and ways[0] == pytest.approx([0, 1, 0], abs=1e-12)
    down = line_of(
        {"diameter": 0.1, "begin": "down", "parts": [{"straight": 3}, {"bend": {"to": "back", "radius": 1}}]}
    )
    assert down.rise == pytest.approx(-4) and down.axis.at([down.length])[1][0] == pytest.approx([-1, 0, 0], abs=1e-12)


def test_sloping_bends_rise_as_geometry_says():
    """The line bends 30 degrees up, runs 2 m straight, and bends 120 degrees to the right.

    The second bend rises only by the component of its arc along the slope at its start.
    """
    parts = [{"straight": 1}, {"bend": {"to": "up", "radius": 1, "angle": 30}}, {"straight": 2},
             {"bend": {"to": "right", "radius": 2, "angle": 120}}]  # fmt: skip
    line = line_of({"diameter": 0.1, "parts": parts})
    rises = [0, 1 - math.cos(math.pi / 6), 1.0, 2 * math.sin(2 * math.pi / 3) * 0.5]
    assert [part.rise for part in line.parts] == pytest.approx(rises, abs=1e-12)
    assert line.axis.at([line.length])[0][0][2] == pytest.approx(sum(rises))


def test_a_plug_loses_what_its_closed_form_says():
    """4 (tau + eta v) / d a metre; over a cone of linear bore the integrals of 1/d and of 1/d^3."""
    line, flow = line_of(SHAPED), 0.005
    d, e = 0.125, 0.1
    metre = 4 / d * (50 + 1000 * 4 * flow / (math.pi * d**2))
    cone = 4 * 50 * math.log(d / e) / (d - e) + 16 * 1000 * flow / math.pi * (1 / e**2 - 1 / d**2) / (2 * (d - e))
    found = run_line(line, SLIPPING, flow, simulate=False)
    losses = [x.friction for x in found.losses]
    straight = [x.straight for x in found.losses]
    assert straight[:2] == pytest.approx([10 * metre, 0.5 * math.pi / 2 * metre], rel=1e-9)
    assert straight[4] == pytest.approx(cone, rel=1e-9)
    weight = 2400 * 9.81 * 21
    more = (library_factor(x.part) * x.theory for x in found.losses)
    assert found.pressure == pytest.approx(sum(losses) + weight) and losses == pytest.approx(list(more))
    bends, cones, rest = straight[1] + straight[3], straight[4], sum(losses) + weight
    ends = {"slip layer": (sum(losses) / 2 + weight, 2 * sum(losses) + weight),
            "bends": tuple(rest - losses[1] - losses[3] + factor * bends for factor in (1, 3)),
            "reducers": tuple(rest - losses[4] + factor * cones for factor in (1, 2))}  # fmt: skip
    band, expected = found.band(), combined(found.pressure, ends)
    assert (band.low, band.high) == pytest.approx((expected.low, expected.high), rel=1e-9)
    assert found.power == pytest.approx(found.pressure * flow)
    places, course = found.course(lambda x: x.friction + x.weight)
    assert places[-1] == pytest.approx(line.length) and course[0] == pytest.approx(found.pressure) and course[-1] == 0
    assert course[1] == pytest.approx(found.pressure - losses[0])


def test_the_layer_of_a_hose_resists_by_its_factor_at_every_speed():
    """The layer of a plug that slips at v resists by tau + eta v + xi v^2, and the factor multiplies each term."""
    concrete = replace(SLIPPING, slip_quadratic_viscosity=400.0)
    part, flow = Part(1, "hose", 0.1, 6.0, 0.0, 0.1, layer=2.5), 0.005
    speed = flow / (math.pi * 0.05**2)
    friction = 4 * 6.0 / 0.1 * 2.5 * (50 + 1000 * speed + 400 * speed**2)
    assert straight_friction(part, concrete, flow) == pytest.approx(friction, rel=1e-6)


@pytest.mark.parametrize(("angle", "simulated"), [(1.0, 5.0), (3.0, 5.0), (5.0, 5.0), (30.0, 30.0)])
def test_a_slight_bend_loses_its_part_of_one_of_five_degrees(angle, simulated):
    """A bend of less than 5 degrees is simulated with 5 degrees. The loss is scaled by the ratio of the angles."""
    bend = Part(1, "bend", 0.125, 0.4 * math.radians(angle), 0.0, 0.125, radius=0.4, angle=angle)
    name, given = _scene_of_part(bend, SLIPPING, 0.01, 8)
    assert name == "part" and given["angle"] == simulated and given["elbow_radius"] == 0.4
    result = {"middle_loss": {"value": 700.0, "unit": "Pa"}}
    assert _loss_from_run(bend, result) == pytest.approx(700.0 * angle / simulated, rel=1e-12)


def test_concrete_that_runs_down_faster_than_it_is_pumped_pulls_at_nothing():
    """Level, up, level, and 80 m down, which weigh more than they rub: the pump sees only what comes before."""
    round_the_corner = {"bend": {"to": "level", "radius": 0.5}}
    parts = [{"straight": 5}, BEND, {"straight": 5}, round_the_corner, {"straight": 5}]
    down = [*parts, {"bend": {"to": "down", "radius": 0.5}}, {"straight": 80}]
    alone = run_line(line_of({"diameter": 0.15, "parts": parts}), SLIPPING, 0.003, simulate=False)
    found = run_line(line_of({"diameter": 0.15, "parts": down}), SLIPPING, 0.003, simulate=False)
    assert found.pressure == pytest.approx(alone.pressure) and alone.remarks() == []
    _, course = found.course(lambda x: x.friction + x.weight)
    assert course.min() == 0 and course[5] == 0 and course[4] > 0
    assert [remark.split(",")[0] for remark in found.remarks()] == [
        f"concrete flows down part {k} faster than it is pumped" for k in (6, 7)
    ]


def test_bends_go_as_far_as_the_way_that_they_name():
    """Half-way up, on and level again; beyond it is refused, and part of the way needs its angle."""
    half = {"bend": {"to": "up", "radius": 1, "angle": 45}}
    parts = [{"straight": 1}, half, {"straight": 2}, {"bend": {"to": "level", "radius": 1}}, {"straight": 1}]
    line = line_of({"diameter": 0.1, "parts": parts})
    assert line.parts[3].angle == pytest.approx(45) and line.parts[4].rise == pytest.approx(0, abs=1e-12)
    assert line.rise == pytest.approx(2 * math.sqrt(0.5) + 2 * (1 - math.sqrt(0.5)))
    upright = line_of({"diameter": 0.1, "parts": [half, {"bend": {"to": "up", "radius": 1}}, {"straight": 1}]})
    assert upright.parts[1].angle == pytest.approx(45) and upright.parts[2].rise == pytest.approx(1)
    with pytest.raises(
        SceneError, match=r"^part 2, bend: angle = 90\.0: turns .* 'up', which it reaches at 45 degrees"
    ):
        line_of({"diameter": 0.1, "parts": [half, {"bend": {"to": "up", "radius": 1, "angle": 90}}]})


BEND = {"bend": {"to": "up", "radius": 0.5}}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"parts": []}, r"^parts = \[\]: must be a list of one or more parts"),
        ({"diameter": "125 mn"}, r"^diameter = '125 mn': must be a number with one of the units m, mm, cm"),
        ({"diameter": -1}, r"^diameter = -1\.0: must be a finite number above 0 m"),
        ({"speed": 1}, r"^line's key = 'speed': must be one of name, source"),
        ({"begin": ["up"]}, r"^begin = \['up'\]: must be one of level, up, down"),
        ({"begin": "north"}, r"^begin = 'north': must be one of level, up, down"),
        ({"parts": ["straight"]}, r"^part 1 = 'straight': must be one of straight, bend, reducer, hose, valve, bore, "),
        ({"parts": [{"elbow": 1}]}, r"^part 1 = 'elbow': must be one of straight, bend, reducer"),
        ({"parts": [{"straight": {"long": 1}}]}, r"^part 1, straight: key = 'long': must be one of length, rise"),
        ({"parts": [{"straight": 0}]}, r"^part 1, straight: length = 0\.0: must be a finite number above 0 m"),
        ({"parts": [{"straight": 1}, {"straight": {"length": 1, "diameter": "100 mm"}}]},
         r"^part 2, straight: diameter = '100 mm': differs from the diameter .* before it, 0\.125 m; put"),
        ({"parts": [{"straight": {"length": 5, "rise": 5}}]},
         r"^part 1, straight: rise = 5: does not fit: in the direction of the line here, a part of 5 m rises by 0 m"),
        ({"parts": [BEND, BEND]}, r"^part 2, bend: to = 'up': is the direction that the line already"),
        ({"parts": [{"reducer": {"length": 1}}]}, r"^part 1, reducer = .*: has no 'to'"),
        ({"parts": [{"bend": {"radius": 1}}]}, r"^part 1, bend: to = None: must be one of up, down, left"),
        ({"parts": [{"bend": {"to": "up", "radius": 1, "angle": 180}}]}, r"angle = 180\.0: must be in \[1, 135\]"),
        ({"parts": [{"bend": {"to": "up", "radius": "50 mm"}}]}, r"radius = '50 mm': must exceed .*0\.0625 m"),
        ({"parts": [{"reducer": {"to": 0.125, "length": 1}}]}, r"reducer: to = 0\.125: is already the diameter"),
        ({"parts": [{"reducer": {"to": 0.1, "length": 0.01}}]}, r"length = 0\.01: is too short: must .* 0\.0125 m"),
        ({"largest_stone": "110 mm"}, r"^largest_stone = '110 mm': does not pass through part 5.*which is 0\.1 m"),
    ],
)  # fmt: skip
def test_lines_that_cannot_be_are_refused_in_one_line(changed, words):
    with pytest.raises(SceneError, match=words):
        line_of(SHAPED | changed)


def test_a_line_that_meets_itself_is_refused():
    """Three bends to the left and down on its start; with 0.2 m left, a wide pipe still does."""
    left = {"bend": {"to": "left", "radius": 0.5}}
    around = [{"straight": 4}, left, {"straight": 4}, left, {"straight": 3}, left]
    with pytest.raises(SceneError, match=r"^parts = \[1, 7\]: touch each other: the line crosses itself"):
        line_of({"diameter": 0.1, "parts": [*around, {"straight": 4.6}]})
    shorter = [*around, {"straight": 4.3}]
    assert line_of({"diameter": 0.1, "parts": shorter}).length > 0
    with pytest.raises(SceneError, match=r"^parts = \[1, 7\]: touch each other"):
        line_of({"diameter": 0.4, "parts": shorter})
    tight = {"bend": {"to": "left", "radius": 0.07, "angle": 135}}
    with pytest.raises(SceneError, match=r"^parts = \[1, 3\]: touch each other"):
        line_of({"diameter": 0.125, "parts": [{"straight": 5}, tight, tight, {"straight": 5}]})
    around = {"bend": {"to": "left", "radius": 0.063}}
    assert line_of({"diameter": 0.125, "parts": [{"straight": 5}, around, around, {"straight": 5}]}).length > 10


def test_stones_that_may_block_are_told():
    assert line_of(SHAPED | {"largest_stone": "32 mm"}).remarks() == []
    (remark,) = line_of(SHAPED | {"largest_stone": "34 mm"}).remarks()
    assert remark.startswith("stones of 34 mm in a bore of 100 mm may block")


def test_shipped_lines_are_as_the_paper_has_them():
    """Zhan et al. 2019, Eq. 13: 576 m up and 83 along, 582 and 150."""
    assert shipped_lines() == ("burj-khalifa", "shanghai-tower")
    for name, up, along, recorded in (("burj-khalifa", 576, 83, 17.1e6), ("shanghai-tower", 582, 150, 23.4e6)):
        line = read_line(name)
        assert line.recorded == recorded and line.flow == pytest.approx(0.3 * math.pi * 0.075**2, rel=2e-3)
        assert line.rise == up + 0.5 and sum(p.length for p in line.parts if p.rise == 0) == along
    with pytest.raises(
        SceneError, match=r"^line = 'burj': must be the path of a file, or one of burj-khalifa, shanghai-tower"
    ):
        read_line("burj")


@pytest.mark.thorough
def test_parts_are_simulated_once_and_found_again(device, tmp_path, monkeypatch):
    """Two equal bends are one run; what is simulated lies by the closed form; a second line uses the same folder."""
    parts = [{"straight": 2}, BEND, {"straight": 3}, {"bend": {"to": "level", "radius": 0.5}}, {"straight": 1},
             {"reducer": {"to": 0.1, "length": 0.3}}]  # fmt: skip
    line, concrete, flow = line_of({"diameter": 0.125, "parts": parts}), concrete_of("no1"), 0.005
    found = run_line(line, concrete, flow, out=tmp_path / "line", cells=8, simulate=True, device=device)
    assert sorted(path.name for path in (tmp_path / "line" / "parts").iterdir()) == [
        "bend-125-90-0.5-cells-8", "reducer-125-100-0.3-cells-8", "straight-125",
    ]  # fmt: skip
    for loss in found.losses:
        allowed = {"straight": 1e-3, "bend": 0.05, "reducer": 0.13}[loss.part.kind]
        assert loss.friction == pytest.approx(loss.theory, rel=allowed), loss.part.label
        assert loss.friction > 0.999 * loss.theory
    assert found.losses[1].friction == found.losses[3].friction
    record = json.loads((tmp_path / "line" / "line.json").read_text(encoding="utf-8"))
    assert record["pressure"]["value"] == pytest.approx(found.pressure) and len(record["parts"]) == 6
    assert (tmp_path / "line" / "line.png").stat().st_size > 10_000
    assert "| 2 | bend of 90 degrees, radius 0.5 m |" in (tmp_path / "line" / "line.md").read_text(encoding="utf-8")

    def refused(*given, **settings):
        raise AssertionError("is simulated again")

    monkeypatch.setattr(line_run, "part_simulation", refused)
    longer = line_of({"diameter": 0.125, "parts": [{"straight": 50}, *parts[1:]]})
    again = run_line(
        longer, concrete, flow, known=tmp_path / "line", out=tmp_path / "longer", cells=8, simulate=True, device=device
    )
    assert again.took == {} and not (tmp_path / "longer" / "parts").exists()
    metre = found.losses[0].friction / 2
    assert again.pressure - found.pressure == pytest.approx(48 * metre, rel=1e-9)
    with pytest.raises(AssertionError, match="again"):
        run_line(longer, concrete, 2 * flow, known=tmp_path / "line", cells=8, simulate=True, device=device)
    with pytest.raises(RunFolderError, match="line"):
        run_line(longer, concrete, flow, out=tmp_path / "line", simulate=False)
    with pytest.raises(SceneError, match=r"^known = .*longer': is not the folder of a line with simulated parts"):
        run_line(longer, concrete, flow, known=tmp_path / "longer", cells=8, simulate=True)


@pytest.mark.thorough
def test_the_friction_of_short_pipe_before_a_bend_is_that_of_theory_for_concrete_that_is_almost_a_plug(device):
    """The wall stress of this pumped concrete with a slump of 200 mm is 402 Pa, and its yield stress 310 Pa.

    A plug bears a normal stress near its ends, and the slope of the pressure alone would be 2 to 6 % off theory.
    """
    scene = scenes.part(
        concrete="own", density=2368.0, viscosity=62.45, yield_stress=309.5, slip_viscosity=584.7, slip_yield=10.0,
        unit="horizontal", diameter=0.125, straight=0.3125, flow=30 / 3600, gravity=0.0, spacing=0.125 / 12,
    )  # fmt: skip
    found = Simulation(scene, device=device).run().result
    for side in ("upstream", "downstream"):
        off = number(found[f"{side}_gradient"]) / number(found[f"{side}_gradient_theory"]) - 1
        assert abs(off) < 0.008, side  # Measured: 0.0075 ahead of the part's middle, with 12 cells across.


@pytest.mark.thorough
def test_a_part_that_fails_its_check_is_told(tmp_path, monkeypatch):
    """Friction allowed to be off by nothing: in remarks, record, and the exit code, also where the run was known."""
    monkeypatch.setattr(scenes.modules()["part"], "ACCURACY", 1e-9)
    path = tmp_path / "site.yaml"
    path.write_text(
        "diameter: 125 mm\nflow: 20 m3/h\nconcrete: no1\nparts:\n  - bend: {to: up, radius: 0.3 m}\n", encoding="utf-8"
    )
    given = ["line", str(path), "--simulate", "--cells", "8", "--device", "cpu", "--quiet", "--out"]
    for more in ([str(tmp_path / "one")], [str(tmp_path / "two"), "--known", str(tmp_path / "one")]):
        done = CliRunner().invoke(cli, [*given, *more])
        assert done.exit_code == 3
        assert "- check FAILED in bend-125-90-0.3-cells-8: friction upstream: +" in done.output
        assert "deviation from theory; usual cure: a larger --cells\n" in done.output
        record = json.loads((tmp_path / more[0].rsplit("/")[-1] / "line.json").read_text(encoding="utf-8"))
        assert len(record["failed_checks"]["bend-125-90-0.3-cells-8"]) == 2


@pytest.mark.thorough
def test_a_line_put_together_is_the_line_as_a_whole(device):
    """3 m with a bend and a reducer, as one scene and part by part: what is between is the error of straight friction,
    which the line takes from an endless pipe of finer cells."""
    parts = [{"straight": 0.6}, {"bend": {"to": "left", "radius": 0.5}}, {"straight": 0.6},
             {"reducer": {"to": 0.1, "length": 0.4}}, {"straight": 0.6}]  # fmt: skip
    line = line_of({"diameter": 0.125, "parts": parts})
    added = run_line(line, concrete_of("no1"), 0.0055, cells=8, simulate=True, device=device)
    whole = scenes.part(
        concrete="no1", unit="bend-level", diameter=0.125, elbow_radius=0.5, straight=0.6, outlet_diameter=0.1,
        taper=0.4, flow=0.0055, gravity=0.0, spacing=0.1 / 8, time_step=3e-3,
    )  # fmt: skip
    assert whole.axis.length == pytest.approx(line.length)
    found = Simulation(whole, device=device).run().result
    off = number(found["upstream_gradient"]) / number(found["upstream_gradient_theory"]) - 1
    assert 0 < off < 0.02 and found["steady"]
    assert number(found["pressure"]) / added.pressure - 1 == pytest.approx(off, abs=0.003)


def test_the_command_adds_up_a_line(tmp_path):
    path = tmp_path / "site.yaml"
    path.write_text("diameter: 125 mm\nflow: 20 m3/h\nconcrete: no1\nparts:\n  - straight: 10 m\n", encoding="utf-8")
    done = CliRunner().invoke(cli, ["line", str(path), "--theory"])
    assert done.exit_code == 0, done.output
    theory = run_line(read_line(path), concrete_of("no1"), 20 / 3600, simulate=False)
    assert f"pressure at the pump {theory.pressure / 1e5:.4g} bar" in done.output
    other = CliRunner().invoke(cli, ["line", str(path), "--theory", "--flow", "40 m3/h", "--concrete", "no3"])
    more = run_line(read_line(path), concrete_of("no3"), 40 / 3600, simulate=False)
    assert f"{more.pressure / 1e5:.4g} bar" in other.output and more.pressure > theory.pressure
    path.write_text("diameter: 125 mm\nconcrete: no1\nparts:\n  - straight: 10 m\n", encoding="utf-8")
    refused = CliRunner().invoke(cli, ["line", str(path), "--theory"])
    assert refused.exit_code == 2 and "flow: is missing" in refused.output
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "file").write_text("", encoding="utf-8")
    taken = CliRunner().invoke(
        cli, ["line", str(path), "--simulate", "--flow", "20 m3/h", "--out", str(tmp_path / "else")]
    )
    assert "else" in str(taken.exception)
    assert [p.name for p in (tmp_path / "else").iterdir()] == ["file"]


def test_an_interrupted_line_says_how_to_go_on(tmp_path, monkeypatch):
    path, out = tmp_path / "site.yaml", tmp_path / "line"
    path.write_text("diameter: 125 mm\nflow: 20 m3/h\nconcrete: no1\nparts:\n  - straight: 10 m\n", encoding="utf-8")

    def cut(*given, **settings):
        (out / "parts").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr("warpcrete.cli.line_simulated.run_line", cut)
    done = CliRunner().invoke(cli, ["line", str(path), "--simulate", "--out", str(out)])
    assert done.exit_code == 130 and f"continue with the same command and --out {out}" in done.output
    other = CliRunner().invoke(cli, ["line", str(path), "--simulate", "--out", str(out), "--cells", "10"])
    assert "contains the unfinished results of a line with other inputs" in str(other.exception)


def test_two_segments_are_as_far_apart_as_geometry_says():
    one = np.array([[0.0, 0, 0], [1, 0, 0]])
    others = [[[0.5, -1, 2], [0.5, 1, 2]], [[2, 0, 0], [3, 0, 0]], [[2, 1, 0], [2, 5, 0]], [[0.2, 3, 0], [0.8, 3, 0]],
              [[-1, -1, 0], [2, 2, 0]], [[0.9, 2, 0], [0.1, 0.5, 0]]]  # fmt: skip
    found = distances(one, np.array(others, float))
    assert found == pytest.approx([2, 1, math.sqrt(2), 3, 0, 0.5], abs=1e-12)
