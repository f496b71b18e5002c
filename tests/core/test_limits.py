"""Tests of possible and usual values: every parameter of every scene, options, files, and the words of messages."""

import math
import re
import warnings

import pytest
import trimesh
from click.testing import CliRunner
from pumping import command

from warpcrete import SceneError, scenes
from warpcrete.cli.main import cli
from warpcrete.cli.options import quantity_of
from warpcrete.cli.theory import fields as theory_fields
from warpcrete.core.device.device import checked_threads
from warpcrete.core.errors import PlausibilityWarning, WarpcreteError, between, known_names, suggested
from warpcrete.core.inputs.amounts import UNITS, accepted_units, amount
from warpcrete.core.inputs.limits import LIMITS, check_limit, limit_of
from warpcrete.core.inputs.parameters import Above, CompositeRule, Within, declared_fields
from warpcrete.geometry import meshes
from warpcrete.geometry.lines import line_of
from warpcrete.mix.mix import mix_of
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import task_of
from warpcrete.studies.cases import MAX_CASES, cases_of

PRESSURE = {"scene": "pipe", "quantity": "peak_pressure", "value": 6.2, "uncertainty": "5%"}
FIELDS = {name: declared_fields(module.scene.parameters) for name, module in modules().items()}
IMPOSSIBLE = (1e-300, -1e-300, 1e300, -1e300, 5e-324, 2e-310, -2e-310, 10**30, -(10**30), 10**400, float("nan"),
              float("inf"), -float("inf"), 1e-30, 1e30)  # fmt: skip
"""Numbers that no parameter can have: as large, as small or as many digits as can be, and none."""


def refused(make, *names):
    """Return the message with which something is refused: one line, naming one of the `names`, without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PlausibilityWarning)
        with pytest.raises(WarpcreteError) as caught:
            make()
    text = str(caught.value)
    assert text.isprintable() and len(text) < 1200
    assert not names or text.partition(" = ")[0] in names, text
    return text


@pytest.mark.parametrize("scene", FIELDS)
def test_no_scene_has_an_impossible_number(scene):
    for name, field in FIELDS[scene].items():
        if field.kind in (int, float):
            for value in IMPOSSIBLE:
                refused(lambda name=name, value=value: modules()[scene].scene(**{name: value}), name)


@pytest.mark.parametrize("scene", FIELDS)
def test_every_number_of_a_scene_has_limits(scene):
    """Within them it is made or refused for a reason of its own, without a warning of NumPy's or a long silence."""
    for name, field in FIELDS[scene].items():
        if field.kind is float:
            limit = limit_of(name, field.unit.strip())
            assert limit is not None and limit.why, f"{name}{field.unit}: add its unit to core/limits.py"
            assert field.default is None or not isinstance(field.default, float) or not field.default or (
                limit.low < abs(field.default) < limit.high
            ), name  # fmt: skip
            for value in (limit.low, 10 * limit.low, limit.high / 10, limit.high, -limit.low):
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    warnings.simplefilter("ignore", PlausibilityWarning)
                    try:
                        modules()[scene].scene(**{name: value})
                    except WarpcreteError as error:
                        assert str(error).isprintable()
        if field.kind is str:
            for text in ("a\0b", "x" * 100_000):
                try:
                    modules()[scene].scene(**{name: text})
                except WarpcreteError as error:
                    assert str(error).isprintable() and len(str(error)) < 3000
                else:
                    pytest.fail(f"{scene} {name}: {text[:5]}... was accepted")


def test_scenes_give_no_warning_of_their_defaults():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for module in modules().values():
            module.scene()


def test_negative_zero_is_zero():
    assert str(scenes.tube(slip_thickness=-0.0).parameters["slip_thickness"]) == "0.0"


DIFFERENT = {"gravity"}
"""Parameters with bounds of several kinds: a vessel empties by gravity, a level pipe has none, and elements may
be pumped downwards."""


def test_scenes_that_share_a_parameter_have_the_same_rules():
    """A number that means the same, as its help text says, has the same bounds wherever it is declared."""
    alike = {}
    for scene, fields in FIELDS.items():
        for name, field in fields.items():
            if field.kind in (int, float):
                bounds = tuple(rule for rule in field.rules if isinstance(rule, Above | Within))
                alike.setdefault((name, field.help), {})[scene] = bounds
    shared = {key: found for key, found in alike.items() if len(found) > 1}
    assert len(shared) > 60
    assert {name for (name, _), found in shared.items() if len(set(found.values())) > 1} == DIFFERENT


@pytest.mark.parametrize("scene", ["slump", "jring", "funnel", "lbox", "lcpc", "part", "channel", "tube", "stretch"])
@pytest.mark.parametrize(
    ("name", "value"),
    [("slip_thickness", float("nan")), ("slip_thickness", -float("inf")), ("slip_thickness", -1.0), ("density", 1.0),
     ("maximum_iterations", 10**23), ("density", 0.0), ("viscosity", -1.0), ("slip_viscosity", 0.0),
     ("yield_stress", -1.0), ("slip_yield", float("nan")), ("seed", 10**30), ("gravity", float("inf"))],
)  # fmt: skip
def test_flows_refuse_the_same(scene, name, value):
    refused(lambda: getattr(scenes, scene)(**{name: value}), name)


@pytest.mark.parametrize("name", theory_fields())
def test_theory_knows_the_limits(name):
    if theory_fields()[name].kind is not float:
        return
    for value in IMPOSSIBLE:
        refused(lambda value=value: CliRunner().invoke(cli, ["theory", f"--{name.replace('_', '-')}={value!r}"],
                                                       catch_exceptions=False), name)  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [["theory", "--flow"], ["theory", "--pressure"], ["theory", "--rest"], ["theory", "--segregation"],
     ["theory", "--rise"],
     ["line", "burj-khalifa", "--theory", "--flow"], ["line", "burj-khalifa", "--theory", "--rest"],
     ["line", "burj-khalifa", "--theory", "--layer-factor"]],
    ids=" ".join,
)  # fmt: skip
def test_options_know_the_limits(arguments):
    for value in IMPOSSIBLE:
        words = [*arguments[:-1], f"{arguments[-1]}={value!r}"]
        found = CliRunner().invoke(cli, words)
        assert found.exit_code != 0 and (isinstance(found.exception, WarpcreteError) or found.exit_code == 2), words


MEANT = [
    ("flow", 35.0, "m3/s", "35 m3/h or 35 yd3/h?"), ("diameter", 125.0, "m", "125 mm?"),
    ("density", 2.35, "kg/m3", "2.35 t/m3?"), ("slump", 8.0, "m", "8 mm or 8 in?"),
    ("pressure", 1e12, "Pa", ""), ("size_max", 16.0, "m", "16 mm?"), ("velocity", 300.0, "m/s", "300 cm/s?"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "unit", "meant"), MEANT)
def test_an_impossible_number_is_refused_with_the_unit_that_was_meant(name, value, unit, meant):
    text = refused(lambda: check_limit(name, value, unit), name)
    assert "is impossible: must be" in text and text.endswith(meant or ")") and LIMITS[name].why in text


@pytest.mark.parametrize(("name", "unit", "says"), [("frames", "1/s", "frames per"),
                                                    ("checkpoint_every", "s", "a checkpoint every"),
                                                    ("budget", "s", "trade-off studies take")])  # fmt: skip
def test_the_reason_of_a_limit_is_about_the_setting(name, unit, says):
    """The reasons of the limits of all rates and all times are about concrete: its shear rate and its setting."""
    assert says in refused(lambda: check_limit(name, 1e9, unit), name)


@pytest.mark.parametrize(("name", "value", "unit", "_"), MEANT)
def test_no_unit_is_suggested_for_a_negative_number(name, value, unit, _):
    assert "did you mean" not in refused(lambda: check_limit(name, -value, unit), name)


def test_the_range_of_a_seed_begins_at_zero():
    for wrong in (-1, -(10**23)):
        assert re.search(r"(at least|from) 0( to 9223372036854775807)?$", refused(lambda w=wrong: scenes.pipe(seed=w)))


@pytest.mark.parametrize("part", [{"straight": {"length": 1, "diameter": -3}}, {"straight": {"length": -3}},
                                  {"reducer": {"to": -3}}, {"bend": {"to": "up", "radius": -3}}])  # fmt: skip
def test_sizes_of_parts_are_positive(part):
    """The refusal is the only message: no unit is suggested, no size is called unusual, and no reducer is asked for."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(WarpcreteError, match=r"= -3\.0: must (be a finite number above 0 m$|exceed the radius)"):
            line_of({"diameter": 0.125, "parts": [part]})


@pytest.mark.parametrize(
    ("ends", "unit", "says"),
    [((-math.inf, 5.0), "m", "finite and at most 5 m"), ((-math.inf, 5.0), "", "finite and at most 5"),
     ((2.0, math.inf), "m", "finite and at least 2 m"), ((2.0, 5.0), "m", "in [2, 5] m"),
     ((-math.inf, math.inf), "m", "a finite number in m"), ((-math.inf, math.inf), "", "a finite number")],
)  # fmt: skip
def test_a_refusal_names_the_finite_ends_of_a_range(ends, unit, says):
    assert refused(lambda: between("x", math.nan, *ends, unit)) == f"x = nan: must be {says}"


def test_bare_numbers_are_taken_for_what_they_were_meant():
    line = {"diameter": 0.125, "flow": 35, "parts": [{"straight": 10}]}
    assert "35 m3/h or 35 yd3/h?" in refused(lambda: line_of(line), "flow")
    assert "125 mm?" in refused(lambda: line_of({"diameter": 125, "parts": [{"straight": 10}]}), "diameter")
    assert "125 mm?" in refused(lambda: scenes.tube(diameter=125), "diameter")
    assert "35 m3/h or 35 yd3/h?" in refused(lambda: scenes.tube(flow=35), "flow")
    assert "250 mm?" in refused(
        lambda: line_of({"diameter": 0.125, "parts": [{"reducer": {"to": 250, "length": 1}}]}), "part 1, reducer: to"
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: scenes.tube(diameter=3.0, flow=0.01, spacing=0.1, length=3.0, time_step=0.1, sample_interval=0.1),
         "diameter = 3 m: is unusual: concrete pipes have diameters of 0.05 to 0.2 m"),
        (lambda: line_of({"diameter": 0.05, "flow": 0.03, "parts": [{"straight": 10}]}),
         "flow = 0.03: makes the concrete flow at 15.3 m/s, which is unusual"),
        (lambda: scenes.pipe(velocity=20.0), "velocity = 20 m/s: is unusual"),
        (lambda: line_of({"diameter": 0.125, "recorded": 20, "parts": [{"straight": 10}]}),
         "recorded = 20 Pa: is unusual: concrete pumps deliver 3e6 to 5e7 Pa (30 to 500 bar); did you mean 20 bar or"),
        (lambda: line_of({"diameter": 0.125, "recorded": 200, "parts": [{"straight": 10}]}),
         "did you mean 200 bar or 200 psi?"),
        (lambda: task_of({"vary": {"friction": [0.1, 0.3]}, "targets": [PRESSURE]}, modules()),
         "peak_pressure of pipe = 6.2 Pa: is unusual: concrete pumps deliver 3e6 to 5e7 Pa (30 to 500 bar); did you"),
        (lambda: scenes.tube(flow=0.1, time_step=1e-4, sample_interval=1e-3),
         "flow = 0.1: makes the concrete flow at 12.7 m/s"),
        (lambda: mix_of(MIX | {"parts": PARTS | {"sand": 700}}),
         "mix parts: fill 0.929 m3 of a cubic metre, which leaves 7.1 % of air"),
        (lambda: mix_of(MIX | {"parts": PARTS | {"Dynamon": 3}}), "mix parts: 'Dynamon' is not a known ingredient"),
    ],
)  # fmt: skip
def test_the_unlikely_is_warned_of(make, says):
    with pytest.warns(PlausibilityWarning) as caught:
        make()
    assert any(says in str(each.message) for each in caught), [str(each.message) for each in caught]


MIX = {"concrete": {"yield_stress": 60, "viscosity": 40}}
PARTS = {"cement": 340, "limestone": 190, "water": 175, "sand": 810, "gravel": 820}


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"cment": 10}, r"^mix parts = 'cment': is not a known ingredient; did you mean 'cement'\?"),
        ({"sand": 400}, r"fill 0\.815 m3 of a cubic metre without air; list all ingredients"),
        ({"sand": 1100}, r"fill 1\.080 m3 of a cubic metre without air"),
        ({"cement": 1e-30}, r"^mix parts: cement = 1e-30: must be in \[0\.01, 5000\] kg/m3"),
        ({"cement": "340 kg"}, r"^mix parts: cement = '340 kg': must be a number with one of the units kg/m3"),
    ],
)
def test_parts_that_make_no_cubic_metre_are_refused(more, says):
    with pytest.raises(SceneError, match=says):
        mix_of(MIX | {"parts": PARTS | more})


def test_stated_air_belongs_to_the_cubic_metre():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mix_of(MIX | {"parts": PARTS, "air": "3 %"})
        mix_of(MIX | {"parts": PARTS | {"sand": 700}, "air": "7 %"})
    with pytest.raises(SceneError, match=r"fill 1\.120 m3 instead of 1 m3, including 15 % of air"):
        mix_of(MIX | {"parts": PARTS, "air": "15 %"})


def test_a_missing_sieve_curve_is_told(tmp_path):
    path = tmp_path / "mix.yaml"
    path.write_text("mix:\n  density: 2300\n  spread: 600 mm\n", encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # The remark suffices for a command that simulates nothing.
        assert "the mix has no sieve curve" in CliRunner().invoke(cli, ["mix", str(path)]).output
    with pytest.warns(PlausibilityWarning, match="mix has no sieve curve, so its aggregate has the default"):
        repeated = scenes.pipe(concrete=path).parameters
    with pytest.warns(PlausibilityWarning, match="has no sieve curve"):
        scenes.part_dem(concrete=path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for more in ({"concrete": "zhan"}, {"concrete": path, "size_max": 0.016}, {"concrete": "xu-no1"}):
            scenes.pipe(**more)
        path.unlink()
        assert scenes.pipe(**repeated).parameters == repeated


def test_every_unit_has_a_limit_and_every_limit_a_unit():
    assert {limit.unit for limit in LIMITS.values()} - {""} <= set(UNITS)
    assert {name for name in LIMITS if name in UNITS} == set(UNITS) - {"1", "m3/m3"}


def numbers_of(scene):
    """Return all declared numbers of a scene by name, with those of every contact law and other object it accepts."""
    fields = dict(FIELDS[scene])
    for field in FIELDS[scene].values():
        for rule in field.of_kind(CompositeRule):
            for short in rule.short_names():
                fields |= {key: each for key, each in rule.fields(field, short).items() if key not in fields}
    return {name: field for name, field in fields.items() if field.kind is float}


@pytest.mark.parametrize("scene", FIELDS)
def test_every_number_takes_its_own_unit_and_only_ratios_take_per_cent(scene):
    for name, field in numbers_of(scene).items():
        unit = field.unit.strip()
        for written, factor in accepted_units(field.units).items():
            value = field.converted(f"3 {written}" if written != "1" else "3", name)
            assert value == pytest.approx(3 * factor, rel=1e-14)
            assert quantity_of(f"3 {written}" if written != "1" else "3", field, name) == value
        assert field.converted(f"3 {unit}".strip(), name) == 3.0
        if unit in ("", "1", "m3/m3"):
            assert field.converted("50 %", name) == 0.5
            continue
        refused(lambda field=field, name=name: field.converted("50 %", name), name)
        refused(lambda field=field, name=name: quantity_of("50 %", field, name), name)
        refused(lambda field=field, name=name: field.converted("3 parsecs", name), name)


def test_a_number_without_unit_is_a_ratio():
    """A help text that names a unit without brackets would make its number a ratio, which takes per cent."""
    for scene in FIELDS:
        for name, field in numbers_of(scene).items():
            if not field.unit:
                assert not re.search(r"\b(in|of) (m|mm|s|Pa|kPa|N|kg|degrees|Hz)\b", field.help), f"{scene} {name}"


def test_parameters_take_amounts_with_units():
    with_units = scenes.tube(flow="30 m3/h", diameter="125 mm", length="40 cm")
    assert with_units.parameters == scenes.tube(flow=30 / 3600, diameter=0.125, length=0.4).parameters
    assert scenes.tube(diameter="100 mm").parameters["diameter"] == 0.1
    assert scenes.pipe(modulus="0.2 MPa", friction="5 %").contact.effective_modulus == 2e5
    with pytest.raises(SceneError, match=r"diameter = '125 mn': must be a number with one of the units m, mm, cm"):
        scenes.tube(diameter="125 mn")


def test_commands_take_amounts_with_units(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke
    plain = run(cli, ["theory", "--flow", repr(35 / 3600), "--diameter", "0.125", "--rest", "600"])
    units = run(cli, ["theory", "--flow", "35m3/h", "--diameter", "125 mm", "--rest", "10min"])
    assert plain.exit_code == 0 and units.output == plain.output
    assert run(cli, ["line", "burj-khalifa", "--theory", "--flow", "20m3/h", "--rest", "1 h"]).exit_code == 0
    assert "must be a number with one of the units m, mm" in str(
        run(cli, ["run", "tube", "--diameter", "5 kg"]).exception
    )
    assert "spacing = '5 cm'" in str(run(cli, ["run", "tube", "--spacing", "5 cm"]).exception)
    assert "spacing = '5cm'" in str(run(cli, ["study", "tube", "--spacing", "5cm", "6cm"]).exception)
    assert "spacing = '5 cm'" in str(run(cli, ["explain", "tube", "--spacing", "5 cm"]).exception)


def test_cases_of_a_study_are_counted_before_they_are_made():
    for more in (dict(repeat=10**9), dict(repeat=MAX_CASES + 1)):
        refused(lambda more=more: cases_of({}, {"a": [1.0]}, **more), "repeat")
    many = list(range(10**4))
    refused(lambda: cases_of({}, {"a": many, "b": many, "c": many}), "a")
    assert len(cases_of({}, {"a": many})) == len(many)


def test_long_columns_are_refused_before_they_are_laid_out():
    assert "particles, but at most" in refused(lambda: scenes.tube(length=9e3), "length")
    assert "at most" in refused(lambda: line_of({"diameter": 0.1, "parts": [{"straight": 1}] * 2001}), "parts")


def test_places_beyond_all_lines_are_refused_without_a_warning(tmp_path):
    parts = [{"straight": 1}, {"hose": {"points": [[1e300, 0, 0]]}}]
    refused(lambda: line_of({"diameter": 0.1, "parts": parts}), "part 2, hose: points")
    mesh = tmp_path / "far.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1e30 0\nf 1 2 3\n", encoding="utf-8")
    text = refused(lambda: scenes.pipe(wall=str(mesh)), "wall")
    assert "has a vertex 1e+30 m from the origin, but at most 10000 m are allowed" in text
    assert "elbow" not in refused(lambda: scenes.part(straight=1e300), "straight")


def test_meshes_of_too_many_triangles_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "MAX_FACES", 12)
    assert len(meshes.load(trimesh.creation.box(), "wall").faces) == 12
    monkeypatch.setattr(meshes, "MAX_FACES", 11)
    assert "has 12 triangles, but at most 11 are allowed" in refused(
        lambda: meshes.load(trimesh.creation.box(), "wall"), "wall"
    )
    monkeypatch.setattr(trimesh, "load_mesh", lambda path: pytest.fail("a large STL file is counted before it is read"))
    (tmp_path / "large.stl").write_bytes(bytes(80) + (12).to_bytes(4, "little") + bytes(600))
    assert "has 12 triangles" in refused(lambda: meshes.load(tmp_path / "large.stl", "wall"), "wall")


def test_lists_in_a_line_may_be_as_long_as_their_limits(monkeypatch):
    monkeypatch.setattr("warpcrete.geometry.lines.MOST_PARTS", 3)
    monkeypatch.setattr("warpcrete.geometry.course.MOST_POINTS", 2)
    points = [[1, 0, 0], [2, 0.1, 0], [3, 0.3, 0]]
    straight, hose = {"straight": "1 m"}, {"hose": {"points": points[:2]}}
    assert len(line_of({"diameter": 0.1, "parts": [straight, hose, straight]}).parts) == 3
    for parts, words in (
        ([straight, hose, straight, straight], "parts = '4 parts': must be at most 3 parts"),
        ([{"hose": {"points": points}}], "hose: points = '3 points': must be at most 2 points"),
    ):
        with pytest.raises(SceneError, match=words):
            line_of({"diameter": 0.1, "parts": parts})


def test_the_nearest_word_is_suggested():
    assert suggested("diametre", ["diameter", "length"]) == "did you mean 'diameter'?"
    assert suggested("wall-friction", ["wall_friction"]) == "did you mean 'wall_friction'?"
    assert suggested("xyz", ["diameter"]) == suggested(5, ["diameter"]) == ""
    assert known_names("a", ["b", "c"]) == "must be one of b, c"
    assert known_names("lenght", ["length", *map(str, range(20))]) == "did you mean 'length'?"
    for make, says in (
        (
            lambda: scenes.pipe(diametre=0.1),
            "parameter = 'diametre': is not a parameter of scene pipe; did you mean 'diameter'?",
        ),
        (lambda: scenes.pipe(concrete="zahn"), "did you mean 'zhan'?"),
        (lambda: scenes.tube(concrete="n01"), "did you mean 'no1'?"),
        (lambda: scenes.pipe(unit="vertcal"), "did you mean 'vertical'?"),
        (lambda: amount("flow", "30 m3/hrs", "m3/s"), "did you mean 'm3/hr'?"),
        (lambda: mix_of({"density": 2300, "spred": 0.6}), "did you mean 'spread'?"),
        (lambda: line_of({"diamter": 0.1}), "did you mean 'diameter'?"),
    ):
        assert says in refused(make)


@pytest.mark.parametrize("words", [["theory", "--flow", "0.11"], ["run", "tube", "--diameter", "125"]], ids=" ".join)
def test_the_command_says_it_in_one_line(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = command(*words)
    (line,) = done.stderr.splitlines()
    if words[0] == "theory":
        assert done.returncode == 0 and line.startswith("warning: flow = 0.11: makes the concrete flow at 14 m/s")
    else:
        assert done.returncode == 2 and line.startswith("error: diameter = 125.0: is impossible") and "125 mm?" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "scene, given, words",
    [
        ("part", {"unit": "horizontal", "angle": 45}, "angle = 45.0: has no effect unless 'unit' is a bend"),
        ("part", {"unit": "vertical", "elbow_radius": 1}, "elbow_radius = 1.0: has no effect unless 'unit' is a bend"),
        ("part_dem", {"unit": "horizontal", "angle": 45}, "angle = 45.0: has no effect unless 'unit' is a bend"),
        ("lbox", {"bar_diameter": 0.02}, "bar_diameter = 0.02: has no effect unless 'bars' is 2 or 3"),
    ],
)
def test_dimensions_of_what_is_not_there_give_a_warning(scene, given, words):
    with pytest.warns(PlausibilityWarning, match=f"^{re.escape(words)}"):
        getattr(scenes, scene)(**given)


def test_threads_are_at_least_one_and_at_most_the_cores(monkeypatch):
    monkeypatch.setattr("warpcrete.core.device.device.os.cpu_count", lambda: 4)
    assert [checked_threads(count) for count in (1, 4)] == [1, 4]
    for wrong in (-1, 0, 5, 2.5, math.nan, math.inf):
        with pytest.raises(SceneError, match=rf"^threads = {wrong}: must be a whole number from 1 to 4,"):
            checked_threads(wrong)
