"""Concretes by name and from files: what they set, for both methods, and what is refused."""

import dataclasses
import json
from dataclasses import replace

import pytest
from pumping import SMALL, command

from warpcrete import SceneError, Simulation, scenes
from warpcrete.core.inputs.concretes import concrete, shipped
from warpcrete.dem.laws import Contact, LubricationLayer
from warpcrete.dem.pumping.parameters import PipeParameters
from warpcrete.dem.scene.concretes import COVERAGE
from warpcrete.studies.study import run_study

PIPE = scenes.pipe.module


def written(folder, text, name="mine.yaml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_table_1_is_what_the_scene_has_by_itself():
    literal = PipeParameters()
    for name, value in concrete("zhan-table1").elements.items():
        assert getattr(literal, name) == value, name


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_concrete_makes_a_pipe(name):
    assert scenes.pipe(concrete=name).parameters["concrete"] == name
    assert concrete(name).source


def test_the_default_is_table_1_with_a_layer_on_walls():
    scene, literal = scenes.pipe(), scenes.pipe(concrete="zhan-table1")
    (law,) = scene.contacts.values()
    fitted = concrete("zhan").elements
    assert law == LubricationLayer(
        contact=replace(literal.contact, friction=fitted["wall_friction"]), viscosity=fitted["layer_viscosity"]
    )
    assert literal.contacts == {} and literal.contact == Contact()
    assert scene.published == literal.published is not None
    assert scenes.pipe(layer_viscosity=100.0).published is None
    assert any("on the ends of units A and B" in remark for remark in scene.remarks)
    assert not any("calibrated" in remark for remark in literal.remarks)


def test_what_is_given_goes_before_the_concrete():
    assert scenes.pipe(layer_viscosity=5.0).parameters["layer_viscosity"] == 5.0
    assert scenes.pipe(bonds=False).bonds is None  # of the concrete's bonds nothing is left to mean something


def test_a_concrete_of_which_only_the_flow_is_known_has_its_layer_and_density():
    scene, flow = scenes.pipe(concrete="no2"), concrete("no2").flow
    (law,) = scene.contacts.values()
    assert law.viscosity * COVERAGE == pytest.approx(flow["slip_viscosity"], rel=1e-12)
    assert law.yield_stress * COVERAGE == pytest.approx(flow["slip_yield"], rel=1e-12)
    assert law.contact.friction == 0.0
    assert scene.fill.bulk_density == flow["density"]
    assert scenes.pipe(concrete="no2", density=2600.0).fill.bulk_density is None
    assert scene.published is None


def test_bulk_density_is_that_of_the_filled_pipe(device):
    scene = scenes.pipe(bulk_density=2354.0, plug="plate", **SMALL | {"travel": 1e-3, "settle": 0.0})
    bodies = Simulation(scene, device=device).run().bodies
    assert bodies.mass.sum() == pytest.approx(2354.0 * scene.fill.container.volume, rel=1e-6)


def test_a_file_of_ones_own(tmp_path):
    path = written(tmp_path, "base: zhan\nsource: site\nelements:\n  modulus: 2e5\n  healing: true\nflow:\n"
                             "  density: 2300\n  viscosity: 30\n  yield_stress: 4E1\n  slip_viscosity: 1000\n"
                             "  slip_yield: 20\n")  # fmt: skip
    pipe, tube, slump = (make(concrete=path) for make in (scenes.pipe, scenes.tube, scenes.slump))
    assert (pipe.contact.effective_modulus, pipe.bonds.healing) == (2e5, True)
    assert pipe.parameters["layer_viscosity"] == concrete("zhan").elements["layer_viscosity"]  # of its base
    assert tube.concrete == dataclasses.replace(slump.concrete) and tube.concrete.yield_stress == 40.0
    path.unlink()  # a record holds all that the file said
    assert scenes.pipe(**pipe.parameters).contact == pipe.contact
    assert scenes.tube(**tube.parameters).concrete == tube.concrete
    assert scenes.slump(**slump.parameters).concrete == slump.concrete


def test_a_base_beside_the_file(tmp_path):
    written(tmp_path, "elements: {friction: 0.2, modulus: 3e5}", "ours.yaml")
    path = written(tmp_path, "base: ours.yaml\nelements: {friction: 0.3}")
    assert (scenes.pipe(concrete=path).contact.friction, scenes.pipe(concrete=path).contact.effective_modulus) == (
        0.3, 3e5)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "cannot be read"),
        ("- a\n- b", "contains a list"),
        ("a: [", "is not valid YAML"),
        ("name: x", "defines no properties"),
        ("elements: 3", "must hold 'name: value' lines"),
        ("elements: {frictoin: 0.1}", "concrete elements = 'frictoin': is an unknown parameter"),
        ("elements: {diameter: 0.1}", "concrete elements = 'diameter': is an unknown parameter"),
        ("elements: {friction: -1}", "friction = -1.0"),
        ("elements: {friction: wet}", "friction = 'wet': must be a number"),
        ("colour: grey\nelements: {friction: 0.1}", "has the unknown key 'colour'"),
        ("base: zahn", "concrete base = 'zahn': must be one of"),
        ("base: mine.yaml\nelements: {friction: 0.1}", "chain of more than 10 files"),
        ("flow: {density: 2300}", "slip_viscosity, slip_yield': missing"),
    ],
)
def test_wrong_files_are_refused_in_one_line(tmp_path, text, says):
    path = written(tmp_path, text) if text is not None else tmp_path / "none.yaml"
    with pytest.raises(SceneError) as refused:
        scenes.pipe(concrete=path)
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_a_chain_of_bases_has_at_most_ten_files(tmp_path):
    for number in range(11):
        base = f"base: {number - 1}.yaml\n" if number else "name: first\n"
        (tmp_path / f"{number}.yaml").write_text(f"{base}elements: {{friction: 0.{number + 1}}}\n", encoding="utf-8")
    assert concrete(str(tmp_path / "9.yaml")).elements == {"friction": 0.10}
    with pytest.raises(SceneError, match="chain of more than 10 files"):
        concrete(str(tmp_path / "10.yaml"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("elements: {friction: 0.1}", "must have a section 'mix' or 'flow'"),
        ("flow: {density: 2300, viscosity: 30}", "has no value for slip_viscosity, slip_yield, yield_stress"),
        ("flow: {density: heavy}", "concrete flow density = 'heavy': must be a number"),
        ("flow: {densty: 2300}", "concrete flow = 'densty': is an unknown parameter"),
    ],
)
def test_files_without_a_flow_are_refused_by_flows(tmp_path, text, says):
    with pytest.raises(SceneError) as refused:
        scenes.tube(concrete=written(tmp_path, text))
    assert says in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.thorough
def test_a_study_keeps_what_a_concrete_said(tmp_path):
    path = written(tmp_path, "elements: {friction: 0.2}")
    coarse = SMALL | dict(
        size_min=0.012, size_max=0.03, length=0.2, travel=2e-3, settle=0.0, plug="plate", concrete=path
    )
    folder = tmp_path / "study"
    study = run_study("pipe", PIPE, {"bonds": [True, False]}, base=coarse, out=folder, device="cpu", rerun=False)
    cases = json.loads((folder / "study.json").read_text(encoding="utf-8"))["cases"]
    assert [case["parameters"]["friction"] for case in cases] == [0.2, 0.2]
    assert not study.failures


def test_the_command_takes_a_file(tmp_path):
    path = written(
        tmp_path, "flow: {density: 2300, viscosity: 30, yield_stress: 40, slip_viscosity: 1000, slip_yield: 2}"
    )
    done = command("theory", "--concrete", path)
    assert done.returncode == 0, done.stderr
    first, other = (command("theory", "--concrete", path, *more).stdout for more in ((), ("--viscosity", "300")))
    assert first != other  # an option goes before the file
    done = command("explain", "pipe", "--concrete", tmp_path / "not.yaml")
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "not.yaml" in done.stderr


def test_a_flow_section_with_units_also_gives_elements(tmp_path):
    path = tmp_path / "a.yaml"
    head = "flow: {density: 2350 kg/m3, viscosity: 30 Pa s, yield_stress: 90 Pa, slip_viscosity: 600 Pa s/m, "
    head += "slip_yield: "
    path.write_text(head + "40 Pa, slip_flow_index: 1, yield_factor: 2}\n", encoding="utf-8")
    kept = scenes.pipe(concrete=path).parameters
    assert kept["bulk_density"] == 2350 and kept["layer_yield"] == pytest.approx(2 * 40 / COVERAGE)
    assert kept["layer_viscosity"] == pytest.approx(600 / COVERAGE)
    for more, says in (("yield_factor: 0", "yield_factor = 0.0: must be a finite number above 0"),
                       ("densty: 3", "densty': is an unknown parameter")):  # fmt: skip
        path.write_text(head + f"40 Pa, {more}}}\n", encoding="utf-8")
        for make in (scenes.pipe, scenes.tube):
            with pytest.raises(SceneError, match=says):
                make(concrete=path)
