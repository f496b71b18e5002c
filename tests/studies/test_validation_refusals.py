"""Measured cases that the program refuses to read or to predict."""

import pytest
from click.testing import CliRunner
from test_validation import written

from warpcrete.cli.main import cli
from warpcrete.core.errors import SceneError
from warpcrete.studies.validation.cases import read_cases
from warpcrete.studies.validation.comparison import compare
from warpcrete.studies.validation.validate import validate

OTHER = """\
sources: {a: b}
cases:
- {id: x, kind: KIND, source: a, mix: {density: 2350, slump: 180 mm}, test: {TEST}, flow: 20 m3/h, measured: 1.2}
"""


@pytest.mark.parametrize("reference", ["hello", "5", "[1]", "{}", ""])
def test_the_other_concrete_of_a_ratio_must_be_described(tmp_path, reference):
    """An empty reference would be the concrete itself."""
    text = OTHER.replace("KIND", "ratio").replace("TEST", f"diameter: 125 mm, reference: {reference}")
    with pytest.raises(SceneError, match=r"line 3: case test: reference = .*: must consist of 'key: value' entries"):
        read_cases(written(tmp_path, text))


@pytest.mark.parametrize(
    ("kind", "test", "says"),
    [
        ("layer", "speed: -1 m/s", "case test: speed = '-1 m/s': must be a finite number above 0 m/s"),
        ("blocking", "bore: -125 mm", "case test: bore = '-125 mm': must be a finite number above 0 m"),
        ("pipe", "diameter: 0 mm", "case test: diameter = '0 mm': must be a finite number above 0 m"),
        ("profile", "diameter: 125 mm", "case measured = 1.2: must be at most 1, because it is a share"),
    ],
)
def test_impossible_amounts_of_a_case_are_refused(tmp_path, kind, test, says):
    text = OTHER.replace("KIND", kind).replace("TEST", test)
    if kind == "layer":
        text = text.replace("1.2}", "1.2 Pa}")
    if kind == "pipe":
        text = text.replace("1.2}", "1.2 kPa/m}")
    if kind == "blocking":
        text = text.replace("1.2}", "1}")
    with pytest.raises(SceneError) as refused:
        read_cases(written(tmp_path, text))
    assert f"line 3: {says}" in str(refused.value)


def test_a_line_that_no_file_describes_is_refused_with_an_example(tmp_path):
    text = OTHER.replace("KIND", "line").replace("TEST", "line: site").replace("1.2}", "9 bar}")
    with pytest.raises(SceneError, match=r"^case test: line = 'site': is described nowhere, .* no section 'lines'; "):
        compare(read_cases(written(tmp_path, text))[0])


def test_a_mix_to_which_no_rule_applies_agrees_with_no_observation(tmp_path):
    """A slump alone states the inputs of no rule, so that the verdict is unknown; stones of 16 mm fit into 125 mm."""
    text = OTHER.replace("KIND", "blocking").replace("TEST", "bore: 125 mm").replace("flow: 20 m3/h, measured: 1.2",
                                                                                     "measured: 0")  # fmt: skip
    found = validate(read_cases(written(tmp_path, text)))
    assert not found.blocking and "states the inputs of no rule against blocking" in found.refused["x"]
    more = text.replace("slump: 180 mm}", "slump: 180 mm, sizes: [4 mm, 16 mm]}").replace("id: x", "id: y")
    (judged,) = validate(read_cases(written(tmp_path, more))).blocking
    assert judged.verdict == "fine" and judged.agrees
    refused = CliRunner().invoke(
        cli, ["validate", "--cases", str(written(tmp_path, text)), "--out", str(tmp_path / "o")]
    )
    assert str(refused.exception).startswith("cases: none was compared") and not (tmp_path / "o").exists()
    assert refused.output.startswith("refused: x: case = 'x': ") and "|" not in refused.output
    both = text + more.partition("cases:\n")[2]
    done = CliRunner().invoke(cli, ["validate", "--cases", str(written(tmp_path, both)), "--quick", "--quiet"])
    assert done.exit_code == 0 and "refused: x: " in done.output and "agree with 1 of 1" in done.output
    kind = CliRunner().invoke(cli, ["validate", "--cases", str(written(tmp_path, both)), "--kind", "slump", "--quick"])
    assert "kind = 'slump': is the kind of no case; the cases have the kinds blocking" in str(kind.exception)
