"""Texts that the command prints about failed checks of a study, and about the defaults of a method."""

from types import SimpleNamespace
from typing import Any

from pumping import command

from warpcrete.cli.study import failed_lines


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


def test_help_states_the_defaults_that_a_method_changes():
    text = " ".join(command("run", "slump", "--method", "suspension", "--help-all").stdout.split())
    assert "With this --method, these defaults differ from the ones above: --" in text
    assert "--aggregate-fraction 0.2" in text.partition("With this --method")[2]
    assert "With this --method" not in command("run", "slump", "--help-all").stdout
