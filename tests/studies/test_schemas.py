"""JSON schemas of input files: as shipped, beside what the reader accepts, and printed by the command."""

import copy
import json
import warnings
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner
from schema_builder import schemas

from warpcrete.cli.main import cli
from warpcrete.cli.schemas import FOLDER
from warpcrete.cli.texts import CALIBRATE_HELP, LINE_HELP
from warpcrete.core.errors import PlausibilityWarning, SceneError
from warpcrete.core.inputs.concretes import concrete, shipped
from warpcrete.core.inputs.text_files import read_mapping
from warpcrete.core.inputs.yaml_files import parsed_yaml, yaml_text
from warpcrete.geometry.lines import SHIPPED as LINES
from warpcrete.geometry.lines import line_of
from warpcrete.mix.ingredients import DENSITIES, density_of
from warpcrete.mix.mix import mix_of
from warpcrete.mix.reading import _check_ingredient
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import task_of

SCHEMAS = schemas()
ROOT = Path(__file__).parents[2]


def errors(kind, value):
    """Return what the schema of a kind of file finds wrong."""
    plain = json.loads(json.dumps(value))
    return [error.message for error in jsonschema.Draft7Validator(SCHEMAS[kind]).iter_errors(plain)]


def example(text):
    """Return the YAML of a help text: the indented lines behind its mark."""
    lines = text.split("\b\n")[1].split("\n\n")[0].splitlines()
    return parsed_yaml("\n".join(line[2:] for line in lines), Path("help"))


def test_the_shipped_schemas_are_those_of_the_declarations():
    assert {path.stem for path in FOLDER.glob("*.json")} == set(SCHEMAS)
    for kind, schema in SCHEMAS.items():
        jsonschema.Draft7Validator.check_schema(schema)
        held = json.loads((FOLDER / f"{kind}.json").read_text(encoding="utf-8"))
        assert held == json.loads(json.dumps(schema)), f"{kind}.json is old: run python tests/studies/test_schemas.py"


def test_what_is_shipped_and_shown_is_valid():
    concretes = Path(FOLDER.parent, "measured", "concretes")
    for name in shipped():
        assert errors("concrete", read_mapping(concretes / f"{name}.yaml", "it")) == [], name
    for name in ("example-scc", "xu-no1"):
        assert errors("mix", read_mapping(concretes / f"{name}.yaml", "it")) == [], name
    assert errors("mix", read_mapping(concretes / "no1.yaml", "it"))  # describes no mix
    for path in LINES.glob("*.yaml"):
        assert errors("line", read_mapping(path, "it")) == [], path
    assert errors("line", example(LINE_HELP)) == []
    assert errors("targets", example(CALIBRATE_HELP)) == []
    kept = sorted((ROOT / "notebooks" / "targets").glob("*.yaml"))
    assert kept
    for path in kept:
        assert errors("targets", read_mapping(path, "it")) == [], path


@pytest.mark.parametrize(
    ("page", "kinds"),
    [
        ("how-to/mix.md", ["mix"]),
        ("how-to/pump-pressure.md", ["line", "mix"]),
        ("theory/lines.md", ["line"]),
        ("how-to/concrete-file.md", ["concrete"]),
        ("how-to/flow-laws.md", ["concrete", "mix"]),
    ],
)
def test_files_in_the_pages_are_valid(page, kinds):
    text = (ROOT / "notebooks" / page).read_text(encoding="utf-8")
    blocks = [part.split("```")[0] for part in text.split("```yaml\n")[1:]]
    found = [parsed_yaml(block, Path(page)) for block in blocks]
    whole = [value for value in found if isinstance(value, dict) and {"mix", "parts", "elements", "flow"} & set(value)]
    assert whole
    for value in whole:
        if "parts" in value or kinds != ["line"]:
            assert any(errors(kind, value) == [] for kind in kinds), (value, [errors(kind, value) for kind in kinds])


def test_concrete_files_on_the_page_of_flow_laws_are_complete(tmp_path):
    text = (ROOT / "notebooks" / "how-to" / "flow-laws.md").read_text(encoding="utf-8")
    for block, laws in zip(text.split("```yaml\n")[1:], ((1.3, 1.0), (1.3, 0.8)), strict=True):
        (tmp_path / "mix.yaml").write_text(block.split("```")[0], encoding="utf-8")
        concrete = concrete_of(str(tmp_path / "mix.yaml"))
        assert (concrete.flow_index, concrete.slip_flow_index) == laws


CONCRETE = {"elements": {"friction": 0.2, "modulus": "2 MPa"}, "flow": {"density": "2.35 t/m3"}}
MIX = {
    "mix": {
        "density": 2300,
        "spread": "600 mm",
        "sieve": {"4": 0, "16": 1},
        "layer": {"yield_stress": 20, "viscosity": 900},
    }
}
LINE = {"diameter": "125 mm", "flow": "30 m3/h", "parts": [{"straight": "10 m"}, {"bend": {"to": "up", "radius": 0.5}}]}
TARGETS = {
    "vary": {"viscosity": [10, "100 Pa s"]},
    "targets": [{"scene": "slump", "quantity": "spread", "value": "550 mm", "uncertainty": "2%",
                 "parameters": {"concrete": "own", "density": 2350, "yield_stress": 50}}],
}  # fmt: skip
WRONG = [
    ("concrete", CONCRETE, ("elements", "frictoin"), 0.2), ("concrete", CONCRETE, ("elements", "friction"), -1),
    ("concrete", CONCRETE, ("elements", "friction"), "wet"), ("concrete", CONCRETE, ("elements", "modulus"), "2 mm"),
    ("concrete", CONCRETE, ("elements", "bonds"), "yes"), ("concrete", CONCRETE, ("elements", "dashpot"), "none"),
    ("concrete", CONCRETE, ("elements", "modulus"), 1e300), ("concrete", CONCRETE, ("colour",), "grey"),
    ("concrete", CONCRETE, ("flow", "densty"), 2300), ("mix", MIX, ("mix", "spred"), "600 mm"),
    ("mix", MIX, ("mix", "spread"), "600 mn"), ("mix", MIX, ("mix", "sieve", "four"), 0),
    ("mix", MIX, ("mix", "shape"), "crshed"), ("mix", MIX, ("mix", "layer"), {"yield_stress": 20}),
    ("mix", MIX, ("mix", "sizes"), [1]), ("line", LINE, ("diameter",), "125 mn"), ("line", LINE, ("parts",), []),
    ("line", LINE, ("begin",), "north"), ("line", LINE, ("parts", 0), {"elbow": 1}),
    ("line", LINE, ("parts", 1), {"bend": {"to": "uup", "radius": 1}}), ("line", LINE, ("flow",), "1:30"),
    ("line", LINE, ("parts", 0), {"straight": {"long": 1}}), ("targets", TARGETS, ("vary",), {}),
    ("targets", TARGETS, ("vary", "viscosity"), [1]), ("targets", TARGETS, ("vary", "viscositty"), [1, 2]),
    ("targets", TARGETS, ("targets", 0, "scene"), "slmp"), ("targets", TARGETS, ("targets", 0, "quantity"), "colour"),
    ("targets", TARGETS, ("targets", 0, "held_out"), 7), ("targets", TARGETS, ("targets", 0, "parameters", "dens"), 1),
    ("targets", TARGETS, ("targets", 0, "parameters", "density"), "2 m"), ("targets", TARGETS, ("bse",), "no1"),
]  # fmt: skip


def refused(kind, value, folder):
    """Return whether the program refuses what a file holds."""
    try:
        if kind == "line":
            line_of(value)
        elif kind == "targets":
            task_of(value, modules())
        elif kind == "mix":
            mix_of(value["mix"])
        else:
            path = folder / "c.yaml"
            path.write_text(yaml_text(value), encoding="utf-8")
            assert concrete(str(path))
            pipe = modules()["pipe"].scene(concrete=path)
            modules()["tube"].scene(concrete=path, viscosity=30, yield_stress=40, slip_viscosity=900, slip_yield=20)
            assert pipe
    except SceneError:
        return True
    return False


GOOD_NAMES = (*DENSITIES, "Cement", "GGBS", "SP", "PP", "CEM I 42.5 N", "fly ash", "silica fume", "#57 stone",
              "sand 0/4", "gravel 4/16", "Type I/II", "crushed limestone 8/16", "steel fibres", "Glenium 51",
              "pigment")  # fmt: skip
BAD_NAMES = ("cment", "Cemnet", "cementt", "wter", "waater", "Sadn", "sandd", "grvel", "gravle", "superplastcizer",
             "limestome", "admixtrue", "Total", "batch weight", "w/c", "unit weight", "Slump", "air", "sizes", "c",
             "xx", "FA")  # fmt: skip


def ingredient_is_refused(name):
    """Return whether the program refuses the name of an ingredient."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PlausibilityWarning)
            _check_ingredient(name, 5)
            density_of(name)
    except SceneError:
        return True
    return False


@pytest.mark.parametrize("name", [*GOOD_NAMES, *BAD_NAMES])
def test_schema_and_program_agree_on_names_of_ingredients(name):
    wrong = errors("mix", {"mix": {"parts": {name: "340 kg/m3"}}})
    assert bool(wrong) == ingredient_is_refused(name) == (name in BAD_NAMES), wrong
    assert bool(errors("concrete", {"mix": {"parts": {name: 340}}})) == (name in BAD_NAMES)


def test_the_schema_never_refuses_a_name_that_the_program_accepts():
    """Every misspelling by one letter is tried, with one letter of the alphabet at each place."""
    valid = jsonschema.Draft7Validator(SCHEMAS["mix"]["properties"]["mix"]["properties"]["parts"]["propertyNames"])
    letters = "aeghiklnorst"
    for word in DENSITIES:
        for k in range(len(word)):
            other = letters[(k + len(word)) % len(letters)]
            for name in (word[:k] + word[k + 1 :], word[:k] + other + word[k + 1 :], word[:k] + other + word[k:]):
                assert not name or valid.is_valid(name) or ingredient_is_refused(name), name
                assert valid.is_valid(name) != ingredient_is_refused(name) or len(word) < 5 or k == 0, name


def test_editors_complete_the_names_of_ingredients():
    parts = SCHEMAS["mix"]["properties"]["mix"]["properties"]["parts"]["properties"]
    assert set(parts) == set(DENSITIES) and parts["cement"]["description"] == "powder, 3100 kg/m3"


@pytest.mark.parametrize("kind", SCHEMAS)
def test_what_is_right_is_valid(kind, tmp_path):
    right = {"concrete": CONCRETE, "mix": MIX, "line": LINE, "targets": TARGETS}[kind]
    assert errors(kind, right) == [] and not refused(kind, right, tmp_path)


@pytest.mark.parametrize(("kind", "right", "place", "value"), WRONG, ids=lambda each: repr(each)[:40])
def test_what_is_wrong_is_neither_valid_nor_read(kind, right, place, value, tmp_path):
    changed = copy.deepcopy(right)
    found = changed
    for key in place[:-1]:
        found = found[key]
    found[place[-1]] = value
    assert errors(kind, changed) and refused(kind, changed, tmp_path)


def test_the_command_prints_a_schema_and_its_path():
    run = CliRunner().invoke
    for kind in SCHEMAS:
        path = run(cli, ["schema", kind, "--path"]).output.strip()
        assert run(cli, ["schema", kind]).output == Path(path).read_text(encoding="utf-8")
    assert "did you mean 'line'?" in str(run(cli, ["schema", "lines"]).exception)
    assert run(cli, ["schema"]).exit_code == 2


def test_parameters_of_a_contact_law_are_allowed_beside_its_name():
    target = {"scene": "pipe", "quantity": "pressure", "value": 1e4, "uncertainty": "5%"}
    task = {
        "vary": {"friction": [0.1, 0.5]},
        "targets": [target | {"parameters": {"contact": "laws:Own", "contact_glue": 3.0}}],
    }
    assert errors("targets", task) == []
    task["targets"][0]["parameters"] = {"contcat_glue": 3.0}
    assert errors("targets", task)


if __name__ == "__main__":
    for name, schema in SCHEMAS.items():
        (FOLDER / f"{name}.json").write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")
