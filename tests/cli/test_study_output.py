"""Texts that the command prints about failed checks of a study, and about the defaults of a method."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from pumping import command

from warpcrete.cli.study import failed_lines, report
from warpcrete.core.run.method import Quantity
from warpcrete.dem.measure.quantities import ON_PLATEAU, QUANTITIES
from warpcrete.studies.study_result import Case, Study


def test_each_failed_check_of_a_study_has_a_line_with_its_cure():
    found = "+5 %; usual cure: a smaller --spacing"
    checks = {"friction": {"passed": False, "found": found}, "volume": {"passed": False, "found": "2 %"}}
    study: Any = SimpleNamespace(
        cases=list("abcd"), suspect={"a": ["friction"], "b": ["friction", "volume"], "c": ["friction"]},
        results={case: {"checks": checks} for case in "abc"},
    )  # fmt: skip
    assert failed_lines(study) == [
        "FAILED: checks of 3 of 4 cases; do not use their results",
        f"  friction, in 3 cases (a, b and 1 more); the first one: {found}",
        "  volume, in 1 case (b); the first one: 2 %",
    ]


def test_a_study_says_when_a_case_has_a_value_that_another_lacks(capsys):
    level = Quantity("plateau_pressure", "Pa", lambda known: None, compared=True, only_if="the pressure is level")
    cases = [Case(name, {"seed": number}, {}) for number, name in enumerate("ab")]
    study = Study(Path("here"), "pipe", cases, (level,))
    study.results = {name: {"plateau_pressure": {"value": 1e4, "unit": "Pa"}, "checks": {}} for name in "ab"}
    note = "note: a case has a value of plateau only if the pressure is level"
    report(study)
    assert note not in capsys.readouterr().out
    del study.results["b"]["plateau_pressure"]
    report(study)
    assert note in capsys.readouterr().out


def test_a_study_without_any_plateau_says_why_and_shows_the_mean_at_the_end(capsys):
    """The other quantities of the method, such as those of an L-box, cannot occur in a pipe and have no note."""
    quantities = [each for each in QUANTITIES if each.compared]
    other = Quantity("t200", "s", lambda known: None, compared=True, only_if="the front is 200 mm away from the gate")
    study = Study(Path("here"), "pipe", [Case("a", {"seed": 0}, {})], [*quantities, other])
    study.results = {"a": {name: {"value": 1e4, "unit": "Pa"} for name in ("peak_pressure", "end_pressure")}}
    report(study)
    said = capsys.readouterr().out
    assert "| seed | peak [kPa] | end [kPa] | runs |" in said
    assert f"note: a case has a value of plateau only if {ON_PLATEAU}" in said and said.count("note: ") == 1


def test_help_states_the_defaults_that_a_method_changes():
    text = " ".join(command("run", "slump", "--method", "suspension", "--help-all").stdout.split())
    assert "With this --method, these defaults differ from the ones above: --" in text
    assert "--aggregate-fraction 0.2" in text.partition("With this --method")[2]
    assert "With this --method" not in command("run", "slump", "--help-all").stdout
