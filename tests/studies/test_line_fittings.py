"""Friction of bends, reducers, hoses and valves: stated, by the table, or simulated, and what is refused."""

import math

import pytest
from click.testing import CliRunner
from plug_lines import FLOW, METRE, line, pumped

from warpcrete import SceneError
from warpcrete.cli.main import cli
from warpcrete.studies.lines.fittings import library_factor
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.run import run_line
from warpcrete.theory.pipe import Concrete

SOFT = Concrete(density=2400.0, viscosity=30.0, yield_stress=60.0, slip_viscosity=1000.0, slip_yield=20.0)
BEND = 0.25 * math.pi * (1 + 0.023 + 0.1 / 0.15 * 0.019)
"""Metres of straight pipe for a bend of radius 0.5 m, by the table of simulated bends."""


@pytest.mark.parametrize(
    ("entry", "kind", "length", "friction"),
    [
        ({"hose": "8 m"}, "hose", 8.0, 2 * 8 * METRE), ({"hose": {"length": 8, "layer": 1}}, "hose", 8.0, 16 * METRE),
        ({"hose": {"length": 8, "factor": 3}}, "hose", 8.0, 24 * METRE),
        ({"valve": "0.4 m"}, "valve", 0.4, 0.4 * METRE),
        ({"valve": {"equivalent": "20 m"}}, "valve", 0.5, 20 * METRE), ({"valve": {}}, "valve", 0.5, 0.5 * METRE),
        ("valve", "valve", 0.5, 0.5 * METRE), ({"valve": None}, "valve", 0.5, 0.5 * METRE),
        ({"bend": "right"}, "bend", 0.25 * math.pi, BEND * METRE),
        ({"bend": {"to": "up", "equivalent": 6}}, "bend", 0.25 * math.pi, 6 * METRE),
        ({"bend": {"to": "up", "factor": "150 %"}}, "bend", 0.25 * math.pi, 0.375 * math.pi * METRE),
        ({"straight": {"length": 10, "factor": 1.2}}, "straight", 10.0, 12 * METRE),
        ({"hose": [[1, 0, 0], [2, 0, 0]]}, "hose", 2.0, 2 * METRE),
    ],
)  # fmt: skip
def test_parts_have_the_friction_that_is_stated_or_modelled(entry, kind, length, friction):
    found = pumped({"straight": 2}, entry)
    part, loss = found.line.parts[1], found.losses[1]
    assert part.kind == kind and part.length == pytest.approx(length)
    assert loss.friction == pytest.approx(friction)
    assert loss.friction == pytest.approx(loss.straight * part.relative * library_factor(part))


def test_a_reducer_with_an_equivalent_length_has_the_friction_of_straight_pipe_of_its_bores():
    plain, stated = (pumped({"reducer": {"to": "100 mm", "length": 1, **more}}) for more in ({}, {"equivalent": 3}))
    assert stated.pressure == pytest.approx(3 * plain.losses[0].straight)
    assert plain.pressure == pytest.approx(plain.losses[0].straight * (1 + 0.047 * 12.5 / 20.8))


def test_the_default_bend_is_at_least_two_diameters_wide():
    assert line_of({"diameter": 0.4, "parts": [{"bend": "left"}]}).parts[0].radius == 0.8
    assert line({"bend": "left"}).parts[0].radius == 0.5


def test_a_valve_without_a_colon_has_a_label_in_us_units():
    found = line_of({"diameter": "5 in", "parts": [{"straight": "10 ft"}, "valve"]})
    assert (found.parts[1].kind, found.parts[1].label) == ("valve", "valve")


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("bend", "write '- bend: up'"), ("straight 10 m", "write '- straight: 10 m'"),
        ("reducer", "write '- reducer: 100 mm'"), ("hose", "write '- hose: 1 m'"), ("elbow", "write 'bend: up', or"),
        ("foo", "for example '- straight"), (3, "for example '- straight"),
    ],
)  # fmt: skip
def test_a_part_without_a_colon_is_corrected(entry, says):
    with pytest.raises(SceneError, match=r"must be one of straight, .*, followed by a colon") as refused:
        line_of({"diameter": "5 in", "parts": [entry]})
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (
            {"bend": {"to": "up", "factor": 2, "equivalent": "6 m"}},
            r"bend: factor = 2: cannot be given together with 'eq",
        ),
        ({"bend": {"to": "up", "factor": 0}}, r"bend: factor = 0\.0: must be in \[0\.1, 100\]"),
        ({"bend": {"to": "up", "factor": "2 m"}}, r"bend: factor = '2 m': must be a number"),
        ({"valve": {"equivalent": -3}}, r"valve: equivalent = -3\.0: must be a finite number above 0 m"),
        ({"valve": {"radius": 1}}, r"valve: key = 'radius': must be one of length, factor, equivalent"),
        ({"hose": {"length": 3, "points": [[1, 0, 0]]}}, r"hose: length = 3: cannot be given together with 'points'"),
        ({"hose": {"layer": 0.5}}, r"hose: points = None: must be a list of points; .*or a length, as in 'hose: 8"),
        ({"hose": "8 kg"}, r"hose: length = '8 kg': must be a number with one of the units m, mm"),
        ({"hose": 0}, r"hose: length = 0\.0: must be a finite number above 0 m"),
        (
            {"straight": {"length": 12, "5 m": None}},
            r"straight: key = '5 m': must be one of .*put an amount with a decim",
        ),
        ({"bend": 45}, r"bend: to = 45: must be one of up, down, left"),
        ({"bend": 90}, r"bend: to = 90: must be .*; write the direction.* as in 'bend: \{to: up, angle: 90\}'"),
        ({"bend": {"angle": 30}}, r"bend: to = None: must be .*; write .* as in 'bend: \{to: up, angle: 30\}'"),
        ({"bend": "rigth"}, r"bend: to = 'rigth': must be one of .*did you mean 'right'\?"),
    ],
)
def test_fittings_that_cannot_be_are_refused_in_one_line(entry, says):
    with pytest.raises(SceneError, match=rf"^part 2, {says}") as caught:
        line({"straight": 2}, entry)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "says"),
    [("horizontal", "write 'straight: 10 m'"), ("vertical", "write 'bend: up' and then 'straight: 10 m'"),
     ("elbow", "write 'bend: up', or"), ("taper", "write 'reducer: "), ("tip", "write 'hose: 5 m'")],
)  # fmt: skip
def test_other_words_for_parts_are_refused_with_the_right_one(kind, says):
    with pytest.raises(SceneError, match=rf"^part 1 = '{kind}': must be one of straight, .*; {says}"):
        line({kind: "5 m"})


SHARP = """\
diameter: 125 mm
flow: 20 m3/h
concrete: no1
parts:
  - straight: 10 m
  - bend: {to: left, radius: 0.5 m}
  - reducer: {to: 100 mm, length: 0.1 m}
"""


def test_parts_that_no_table_covers_are_simulated(tmp_path, monkeypatch):
    """The command simulates them without being asked, but not with --theory, and not if the table covers all parts."""
    path, calls = tmp_path / "sharp.yaml", []
    path.write_text(SHARP, encoding="utf-8")
    monkeypatch.setattr("warpcrete.cli.line_simulated.run", lambda *given: calls.append(given[-1]))
    done = CliRunner().invoke(cli, ["line", str(path), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0 and calls == [True], done.output
    assert "note: part 3, 125 to 100 mm, is sharper than all parts in the table" in done.output
    CliRunner().invoke(cli, ["line", str(path), "--simulate", "--out", str(tmp_path / "all")])
    assert calls == [True, False]
    CliRunner().invoke(cli, ["line", str(path), "--device", "cpu", "--out", str(tmp_path / "cpu")])
    assert calls == [True, False, True]
    answer = CliRunner().invoke(cli, ["line", str(path), "--theory"])
    assert "sharper than all parts in the table" in answer.output
    path.write_text(SHARP.replace("0.1 m", "1 m"), encoding="utf-8")
    assert "pressure at the pump" in CliRunner().invoke(cli, ["line", str(path)]).output and len(calls) == 3


@pytest.mark.thorough
def test_other_parts_keep_the_answer_of_the_table(device):
    """Only the sharp reducer is simulated; the pipe and the bend have the friction of the answer by theory."""
    made = line({"straight": 10}, {"bend": "left"}, {"reducer": {"to": 0.1, "length": 0.1}})
    plain = run_line(made, SOFT, FLOW)
    found = run_line(made, SOFT, FLOW, simulate=True, unless_known=True, cells=8, device=device)
    assert [x.friction for x in found.losses[:2]] == [x.friction for x in plain.losses[:2]] and len(found.took) == 1
    assert found.losses[2].friction == pytest.approx(plain.losses[2].friction, rel=0.3)
    assert found.losses[2].friction > found.losses[2].theory


def test_fittings_outside_the_library_are_told():
    """A bend of 0.6 diameters and a blunt reducer; a pipe that widens costs nothing beyond its length."""
    found = pumped({"straight": 1}, {"bend": {"to": "left", "radius": 0.1}}, {"straight": 1},
                   {"reducer": {"to": "100 mm", "length": 0.1}}, {"straight": 1},
                   {"reducer": {"to": "125 mm", "length": 0.1}})  # fmt: skip
    assert [r.split(",")[0] for r in found.remarks()] == ["part 2", "part 4"] and "--simulate" in found.remarks()[0]
    assert [library_factor(x.part) for x in found.losses] == [1, 1.125, 1, 1.452, 1, 1]


@pytest.mark.parametrize("stated", ["factor", "equivalent"])
def test_the_friction_of_a_hose_is_not_stated_beside_its_layer(stated):
    """A hose with the friction of 10 m of pipe has this friction, and no layer changes it."""
    assert pumped({"hose": {"length": 5, "equivalent": 10}}).pressure == pytest.approx(10 * METRE)
    with pytest.raises(SceneError, match=f"hose: {stated} = 10: cannot be given together with 'layer'; leave out"):
        line({"hose": {"length": 5, stated: 10, "layer": 0.8}})


def test_parts_that_fall_are_named_so():
    """A line that starts downwards and turns by 45 degrees falls by 10 sin 45 m in the next 10 m."""
    found = line({"straight": 2}, {"bend": {"to": "level", "angle": 45}}, {"straight": 10}, {"hose": 5}, begin="down")
    assert [part.label for part in found.parts][0::2] == ["straight down", "straight, falls 7.07 m"]
    assert found.parts[3].label == "hose, falls 3.54 m" and found.parts[2].rise == pytest.approx(-10 / math.sqrt(2))
    rising = line({"straight": 2}, {"bend": {"to": "level", "angle": 45}}, {"straight": 10}, begin="up")
    assert rising.parts[2].label == "straight, rises 7.07 m"
