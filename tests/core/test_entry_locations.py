"""Tests of the file and line that messages name for a wrong entry of a text file, and of hints at misplaced entries."""

import pytest

from warpcrete import SceneError, scenes
from warpcrete.core.inputs.concretes import concrete
from warpcrete.geometry.lines import read_line
from warpcrete.mix.mix import flow_amounts, read_mix
from warpcrete.mix.points import read_points
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import read_task
from warpcrete.studies.validation.cases import read_cases

LINE = "concrete: no1\ndiameter: 125 mm\n"
MIX = "name: site\nmix:\n  density: 2350 kg/m3\n"
TARGETS = "vary:\n  yield_stress: [10, 100]\ntargets:\n- scene: slump\n  quantity: spread\n  value: 550 mm\n"


def refused(read, path, text):
    """Return the message with which the function `read` refuses a file that contains `text`."""
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        read(path)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("concrete: no1\nparts:\n- diameter: 125 mm\n- straight: 10 m\n",
         "a.yaml, line 3: part 1 = 'diameter': describes the whole line, so it cannot be a part; write 'diameter"),
        (LINE + "parts:\n- straight: 10 m\n  flow: 30 m3/h\n", "a.yaml, line 5: part 1 = 'flow': describes the whole"),
        (LINE + "parts:\n- straight: 10 m\n  factor: 1.2\n",
         "a.yaml, line 4: part 1 = {'straight': '10 m', 'factor': 1.2}: must be one of "),
        (LINE + "parts: 5\n", "a.yaml, line 3: parts = 5: must be a list of one or more parts; write one part per"),
        (LINE + "parts: {straight: 10 m}\n", "a.yaml, line 3: parts = {'straight': '10 m'}: must be a list of one or "
                                             "more parts; begin each part with a dash, as in '- straight: 10 m'"),
        (LINE + "straight: 10 m\n", "a.yaml, line 3: line's key = 'straight': is a part; parts belong into the list "
                                    "'parts'; write '- straight: ...' below 'parts:'"),
        (LINE + "elbow: up\n", "a.yaml, line 3: line's key = 'elbow': is a part; parts belong into the list 'parts'"),
        ("concrete: no1\nparts:\n- straight: 10 m\n", "a.yaml: diameter: is missing; add the diameter of the first "),
        (LINE + "parts:\n- straight:\n    length: 10 m\n    concrete: no1\n",
         "a.yaml, line 6: part 1, straight: key = 'concrete': must be one of length, rise, diameter, factor, "
         "equivalent; write 'concrete: no1' outside the list 'parts', without indentation"),
        (LINE + "parts:\n- straight:\n    length: 10 m\n    rise: 99 bar\n", "a.yaml, line 6: part 1, straight: rise"),
        (LINE + "parts:\n- bend: {up: 90}\n", "a.yaml, line 4: part 1, bend: key = 'up': must be one of to, angle, "
                                               "radius, factor, equivalent; write 'to: up, angle: 90'"),
        (LINE + "parts:\n- bend: up 45\n", "a.yaml, line 4: part 1, bend: to = 'up 45': must be one of up, down, left, "
                                            "right, level, back; write 'bend: {to: up, angle: 45}'"),
        (LINE + "parts:\n- reducer: {from: 125 mm, to: 100 mm}\n", "a.yaml, line 4: part 1, reducer: key = 'from': "
         "must be one of to, length, factor, equivalent; a reducer begins with the diameter of the line; leave out"),
        (LINE + "begin: horizontal\nparts:\n- straight: 1 m\n", "a.yaml, line 3: begin = 'horizontal': must be one of "
                                                               "level, up, down; did you mean 'level'?"),
        (LINE + "largest_stone: 200 mm\nparts:\n- straight: 10 m\n", "a.yaml, line 3: largest_stone = '200 mm': does"),
        (LINE + "parts:\n- straight: 1 m\n- bend: left\n- bend: left\n- bend: left\n- straight: 10 m\n",
         "a.yaml, line 3: parts = [1, 5]: touch each other"),
    ],
)  # fmt: skip
def test_entries_of_a_line(tmp_path, text, expected):
    assert refused(read_line, tmp_path / "a.yaml", text).startswith(expected)


def test_entries_of_a_line_in_json_name_the_file(tmp_path):
    text = '{"diameter": "125 mm", "parts": 5}'
    assert refused(read_line, tmp_path / "a.json", text).startswith("a.json: parts = 5: must be a list")
    text = '{"diameter": "125 mm", "parts": [{"straigt": "5 m"}]}'
    assert refused(read_line, tmp_path / "a.json", text).startswith("a.json: part 1 = 'straigt': must be one of")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (MIX + "  mortar:\n    density: 2100 kg/m3\n    viscosty: 3 Pa s\n", "a.yaml, line 6: mix mortar: key = 'visc"),
        (MIX + "  concrete:\n    yield_stress: -5 Pa\n", "a.yaml, line 5: mix concrete: yield_stress = '-5 Pa': must"),
        (MIX, "a.yaml: mix = 'density': contains no entry from which the yield stress"),
        ("mix:\n  slump: 180 mm\n", "a.yaml: mix density: must be stated in a mix without 'parts'"),
        ("source: none\n", "a.yaml: concrete = "),
    ],
)  # fmt: skip
def test_entries_of_a_mix(tmp_path, text, expected):
    said = refused(read_mix, tmp_path / "a.yaml", text)
    assert said.startswith(expected) or ("a.yaml" in said and expected.startswith("a.yaml: concrete"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("base: no11\n", "a.yaml, line 1: concrete base = 'no11': must be one of"),
        ("name: a\nmix: no1\n", "a.yaml, line 2: mix = 'no1': must consist of 'key: value' lines; write 'base: no1'"),
        ("base: no1\nflow:\n  viscosity: -3 Pa s\n", "a.yaml, line 3: concrete flow viscosity = '-3 Pa s': must be a"),
        ("base: no1\nflow:\n  yield: 3 Pa\n", "a.yaml, line 3: concrete flow = 'yield': is an unknown parameter"),
        (MIX + "  sizes: 4-16 mm\n", "a.yaml, line 4: mix sizes = '4-16 mm': is a range; write [4 mm, 16 mm]"),
    ],
)  # fmt: skip
def test_entries_of_a_concrete(tmp_path, text, expected):
    assert refused(lambda path: scenes.tube(concrete=str(path)), tmp_path / "a.yaml", text).startswith(expected)


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_entries_of_a_base_name_the_file_of_the_base(tmp_path, suffix):
    """Messages about an entry name the file that states it, which is any file of the chain of bases."""
    base = {"yaml": "base: no1\nflow:\n  {}\n", "json": '{{"base": "no1",\n "flow": {{"{}}}}}'}[suffix]
    wrong = {"yaml": "{}: -3", "json": '{}": -3'}[suffix]
    (tmp_path / "derived.yaml").write_text(f"base: a.{suffix}\nflow: {{density: 2350}}\n", encoding="utf-8")
    place = "a.yaml, line 3" if suffix == "yaml" else "a.json"

    def read(_):
        return scenes.tube(concrete=str(tmp_path / "derived.yaml"))

    for key, says in (("vicosity", "concrete flow = 'vicosity': is an unknown"), ("viscosity", "concrete flow visc")):
        said = refused(read, tmp_path / f"a.{suffix}", base.format(wrong.format(key)))
        assert said.startswith(f"{place}: {says}")
    own = "base: a.yaml\nelements:\n  density: 2400\n  frition: 0.2\n"
    (tmp_path / "a.yaml").write_text("base: no1\nelements: {friction: 0.1}\n", encoding="utf-8")
    said = refused(lambda path: scenes.pipe(concrete=str(path)), tmp_path / "own.yaml", own)
    assert said.startswith("own.yaml, line 4: concrete elements = 'frition'")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("base: no1\nelements:\n  friction: wet\n", "a.yaml, line 3: friction = 'wet': must be a number"),
        ("base: no1\nelements:\n  size_max: 20 mm\n  friction: -1\n", "a.yaml, line 4: friction = -1.0: must be"),
        ("base: no1\nelements:\n  density: 2.35\n", "a.yaml, line 3: density = 2.35: is impossible"),
        (MIX + "  slump: 18 cm\nelements:\n  friction: 1 kg\n", "a.yaml, line 6: friction = '1 kg': must be a number"),
        (MIX + "  slump: 18 cm\nflow:\n  viscosity: 40 Pa\n", "a.yaml, line 6: concrete flow viscosity = '40 Pa'"),
        (MIX + "  slump: 18 cm\nflow:\n  yield_factor: -1\n", "a.yaml, line 6: concrete flow yield_factor = -1.0"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::warpcrete.core.errors.PlausibilityWarning")
def test_values_of_elements_and_of_mixes_with_a_flow(tmp_path, text, expected):
    assert refused(lambda path: scenes.pipe(concrete=str(path)), tmp_path / "a.yaml", text).startswith(expected)


@pytest.mark.parametrize("name", ["part", "part-dem", "tube", "channel", "slump", "funnel", "lbox", "jring"])
def test_values_of_a_concrete_name_their_file_in_every_scene(tmp_path, name):
    """Scenes with several sources of parameters, such as a part of a line, keep the file and line of each."""
    module = scenes.modules()[name].scene
    section, key = ("elements", "friction") if name == "part-dem" else ("flow", "viscosity")
    text = f"base: no1\n{section}:\n  {key}: -1\n"
    expected = rf"^a.yaml, line 3: (concrete flow )?{key} = -1"
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=expected):
        module(concrete=str(tmp_path / "a.yaml"))


def test_impossible_constants_of_a_flow(tmp_path):
    text = "base: no1\nflow:\n  viscosity: 1e20 Pa s\n"
    said = refused(lambda path: scenes.tube(concrete=str(path)), tmp_path / "a.yaml", text)
    assert said.startswith("a.yaml, line 3: viscosity = '1e20 Pa s': is impossible")


def test_points_may_repeat_their_unit(tmp_path):
    (tmp_path / "a.csv").write_text("flow [m3/h],pressure [bar]\n30 m3/h,20 bar\n40,2.5 MPa\n", encoding="utf-8")
    flows, pressures = read_points(tmp_path / "a.csv")
    assert flows == pytest.approx([30 / 3600, 40 / 3600]) and pressures == pytest.approx([2e6, 2.5e6])


def test_constants_of_a_flow(tmp_path):
    def read(path):
        return flow_amounts(concrete(str(path)))

    own = "base: no1\nflow:\n  density: 2350 kg/m3\n"
    said = refused(read, tmp_path / "a.yaml", own + "  viscosty: 30 Pa s\n")
    assert said.startswith("a.yaml, line 4: concrete flow = 'viscosty': is an unknown parameter")
    said = refused(read, tmp_path / "a.yaml", own + "  viscosity: 30 Pa\n")
    assert said.startswith("a.yaml, line 4: concrete flow viscosity = '30 Pa': must be a number")
    said = refused(lambda path: scenes.tube(concrete=str(path)), tmp_path / "a.yaml", own + "  viscosty: 30\n")
    assert said.startswith("a.yaml, line 4: concrete flow = 'viscosty'")


def test_entries_of_targets(tmp_path):
    def read(path):
        return read_task(path, modules())

    said = refused(read, tmp_path / "a.yaml", TARGETS + "  uncertanty: 5%\n")
    assert said.startswith("a.yaml, line 7: target 1 = 'uncertanty': is not a key of a target")
    assert refused(read, tmp_path / "a.yaml", "vary: 5\n").startswith("a.yaml, line 1: vary = 5: must list one or")
    said = refused(read, tmp_path / "a.yaml", "vary: {yield_stress: [1, 2]}\ntargets: 5\n")
    assert said.startswith("a.yaml, line 2: targets = 5: must be a list")
    said = refused(read, tmp_path / "a.yaml", TARGETS + "  uncertainty: 5%\n  yield_stress: 50\n")
    assert said.startswith("a.yaml, line 8: target 1 = 'yield_stress': is not a key of a target; it is a parameter of")
    said = refused(read, tmp_path / "a.yaml", TARGETS + "  uncertainty: 5 Pa\n")
    assert said.startswith("a.yaml, line 7: target 1 uncertainty = '5 Pa': must be a number")
    assert refused(read, tmp_path / "a.yaml", "targets: []\n").startswith("a.yaml: vary = None: must list one or")
    right = TARGETS + "  uncertainty: 5%\n  parameters: {seed: 1}\n  held_out: false\n"
    for place, (old, new, says) in enumerate((
        ("scene: slump", "scene: slumps", "target 1 scene = 'slumps': must be one of"),
        ("quantity: spread", "quantity: width", "quantity = 'width': is not a result of any scene"),
        ("550 mm", "[550 mm]", "target 1 value = ['550 mm']: must be a finite number"),
        ("5%", "0", "target 1 uncertainty = 0: must be a number above 0"),
        ("{seed: 1}", "seed", "target 1 parameters = 'seed': must consist of 'name: value' pairs"),
        ("false", "maybe", "target 1 held_out = 'maybe': must be true or false"),
    )):  # fmt: skip
        said = refused(read, tmp_path / "a.yaml", right.replace(old, new))
        assert said.startswith(f"a.yaml, line {4 + place}: {says}")


def test_entries_of_measured_cases(tmp_path):
    assert refused(read_cases, tmp_path / "a.yaml", "cases: 5\n").startswith("a.yaml, line 1: cases = 5: must be a")
