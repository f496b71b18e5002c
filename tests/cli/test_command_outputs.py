"""Texts, files and exit codes of commands, while the functions that do the work are replaced."""

import json
from pathlib import Path
from types import SimpleNamespace

import kept
import pytest
from command_modules import CLI, LINE
from made_runs import RUNS
from pumping import command

from warpcrete.cli.option_amounts import THIXOTROPY, growth_of
from warpcrete.cli.run import report
from warpcrete.core.inputs.yaml_files import parsed_yaml
from warpcrete.core.run.ending import Ending, interruption
from warpcrete.core.units import quantity
from warpcrete.geometry.lines import line_of
from warpcrete.studies.lines.result import lines_of
from warpcrete.studies.lines.theory_line import line_by_theory
from warpcrete.studies.study_result import Study
from warpcrete.theory.pipe import CONCRETES


def test_concrete_that_does_not_grow_at_rest_may_be_stated():
    assert growth_of(600.0, 0.0) == 0.0
    assert growth_of(600.0, None) == growth_of(None, None) == THIXOTROPY > 0


def test_the_probability_of_blocking_follows_the_answer(monkeypatch, tmp_path):
    """The file in the folder holds what is printed: the pressure, the rules of practice, and the simulated stones."""
    monkeypatch.chdir(tmp_path)
    Path("site.yaml").write_text(LINE + "largest_stone: 16 mm\n", encoding="utf-8")
    got = {}

    def run_blocking(*arguments, **settings):
        got.update(settings, arguments=arguments, written=Path("here", "line.md").read_text(encoding="utf-8"))
        return SimpleNamespace(lines=("two lines", "3 of 8 runs were blocked"))

    monkeypatch.setattr(CLI["line_blocked"], "run_blocking", run_blocking)
    done = command("line", "site.yaml", "--theory", "--blocking", "8", "--coarse", "2", "--out", "here", "--quiet",
                   "--device", "cpu", "--threads", "1")  # fmt: skip
    assert done.returncode == 0, done.stderr
    line, name, rate, count = got["arguments"]
    assert (len(line.parts), name, count) == (3, "no1", 8) and rate == pytest.approx(30 / 3600)
    assert (got["out"], got["device"], got["processes"], got["elements"].coarse) == (Path("here"), "cpu", 1, 2.0)
    written = Path("here", "line.md").read_text(encoding="utf-8")
    assert f"{written.strip()}\n\nfolder: here" == done.stdout.strip() and written.startswith(got["written"].rstrip())
    assert written.rstrip().endswith("two lines\n3 of 8 runs were blocked") and "two lines" not in got["written"]
    rules = json.loads(Path("here", "blocking.json").read_text(encoding="utf-8"))
    assert rules["narrowest_part"] == 2 and "narrowest part 2, bend" in got["written"]


def test_a_simulated_line_writes_both_methods_and_ends_with_its_checks(monkeypatch, tmp_path):
    """Times of both methods are added; a failed check of either one is told in the exit code."""
    monkeypatch.chdir(tmp_path)
    line = line_of(parsed_yaml(LINE, Path("site.yaml")))
    flow = line_by_theory(line, CONCRETES["no1"], 30 / 3600)
    flow.took, packed = {"a": 2.0, "b": 3.0}, SimpleNamespace(failed={}, elapsed=40.0)
    tables, told = [], []
    module = CLI["line_simulated"]
    monkeypatch.setattr(module, "run_line", lambda *given, **settings: flow)
    monkeypatch.setattr(module, "run_elements", lambda *given, **settings: packed)
    monkeypatch.setattr(module, "element_table_lines", lambda found, others: tables.append(others) or ["a table"])
    given = SimpleNamespace(line=line, name="no1", flow=30 / 3600)
    settings = {"shapes": "spheres", "coarse": None, "seeds": 1, "stiffer": 4.0, "cells": 12, "blocking": None,
                "known": None, "device": "cpu", "threads": 1, "quiet": True, "practice": False}  # fmt: skip
    for method in ("flow", "dem", "both"):
        assert not module.run(given, method, tmp_path / method, {}, None, settings, told.append)
    (by_flow, by_elements, both) = told
    table = tmp_path / "both" / "line-dem.md"
    assert table.read_text(encoding="utf-8") == "a table\n" and not (tmp_path / "flow" / "line-dem.md").exists()
    assert by_flow[:-2] == lines_of(flow, False) and by_elements[:-2] == ["a table"]
    assert both[:-2] == [*by_flow[:-2], "", "a table"]
    assert [said[-1].split("; ")[1] for said in told] == [f"simulations took {t} s" for t in (5, 40, 45)]
    assert list(tables[0]) == ["theory"] and list(tables[1]) == ["flow", "theory"]
    assert tables[1]["flow"] == [each.friction for each in flow.losses]
    assert tables[1]["flow"][::2] == pytest.approx(tables[1]["theory"][::2])  # the bend has a factor
    packed.failed = {"bend": ["balance: 9 %"]}
    assert module.run(given, "both", tmp_path / "failed", {}, None, settings, told.append)


def test_the_report_of_a_run_is_kept(capsys, tmp_path):
    (tmp_path / "checkpoint.npz").touch()
    for finished, folder in ((True, None), (False, tmp_path)):
        run = RUNS["pipe"]().run()
        run.finished, run.folder = finished, folder
        run.result |= {
            "speed": {
                "packing_time": quantity(2.0, "s"),
                "settling_time": quantity(3.0, "s"),
                "wall_time": quantity(40.0, "s"),
                "steps_per_second": quantity(1234.0, "1/s"),
            },
            "provenance": {"device": "cpu"},
            "checks": {"a": {"passed": True, "found": "1"}, "b": {"passed": False, "found": "2"}},
            "ended": (Ending("travel", "it arrived", 10.0) if finished else interruption(10.0)).entry(),
        }
        report(run, [("pipeline", "3 MPa")])
    kept.compare("report-of-a-run", capsys.readouterr().out.replace(str(tmp_path), "FOLDER"))


def test_what_a_validation_and_a_reproduction_print(monkeypatch, tmp_path):
    """A summary or every case, blocking and refusals; the table of a paper, and how to continue what is unfinished."""
    found = SimpleNamespace(
        summary_lines=lambda: ["one line", "for each kind"], table=lambda: "every case",
        comparisons=[1], blocking=[1], blocking_lines=lambda: ["3 of 4 blocked"],
        refused={"smith-1": "no density"},
    )  # fmt: skip
    monkeypatch.setattr(CLI["validate"], "validate", lambda *given, **settings: found)
    short, whole = (command("validate", "--quiet", *words).stdout.splitlines() for words in ((), ("--every",)))
    assert whole == ["every case"] and short[:2] == ["one line", "for each kind"]
    assert short[-3:] == ["", "3 of 4 blocked", "refused: smith-1: no density"]
    found.blocking, found.refused = [], {}
    assert command("validate", "--quiet").stdout.splitlines() == short[:-3]
    found.comparisons, found.refused = [], {"smith-1": "no density"}
    for words in ((), ("--every",)):
        nothing = command("validate", "--quiet", *words)
        assert nothing.returncode == 2 and nothing.stdout.splitlines() == ["refused: smith-1: no density"]
        assert nothing.stderr.startswith("error: cases: none was compared") and nothing.stderr.count("\n") == 1
    (tmp_path / "reproduction.md").write_text("a table\n", encoding="utf-8")
    for finished, code in ((True, 0), (False, 130)):
        made = SimpleNamespace(folder=tmp_path, finished=finished)
        monkeypatch.setattr(CLI["reproduce"], "reproduce", lambda *given, made=made, **settings: made)
        done = command("reproduce", "xu", "--quick", "--quiet", "--device", "cpu")
        lines = ["", "a table", "", f"folder: {tmp_path}", f"continue with: warpcrete reproduce --resume {tmp_path}"]
        assert done.returncode == code and done.stdout.splitlines() == lines[: 4 if finished else 5]


@pytest.mark.parametrize("kind", ["whole", "open", "failed", "lost", "suspect"])
def test_a_study_ends_with_its_exit_code_and_what_to_do(kind, capsys, monkeypatch):
    law, again = {"contact": "linear"}, "warpcrete study --resume here"
    if kind == "lost":
        law, again = {"contact": "sticky:Sticky"}, "warpcrete --trust study --resume here"
    cases = [SimpleNamespace(name=name, varied={"x": name}, parameters=law) for name in "ab"]
    study = Study(Path("here"), "pipe", cases)
    study.results = {"a": {"checks": {}}, "b": {"checks": {}}}
    if kind == "open":
        study.results.pop("b")
    if kind in ("failed", "lost"):
        study.results.pop("b")
        study.failures["b"] = "it burst"
        study.not_at_fault = {"b"} if kind == "lost" else set()
    if kind == "suspect":
        study.results["b"] = {"checks": {"balance": {"passed": False, "found": "5 %"}}}
    monkeypatch.setattr(CLI["study"], "_new_study", lambda *given: study)
    code = 0
    try:
        CLI["study"].run(["pipe", "--quiet"], {})
    except SystemExit as ended:
        code = ended.code
    said = capsys.readouterr().out
    assert code == {"whole": 0, "open": 130, "failed": 1, "lost": 1, "suspect": 3}[kind]
    assert (f"continue with: {again}" in said) == (kind == "open")
    assert (f"repeat b with: {again}" in said) == (kind == "lost")
    assert ("failed: b: it burst" in said) == (kind in ("failed", "lost"))
    assert ("\n  balance, in 1 case (b); the first one: 5 %\n" in said) == (kind == "suspect")
