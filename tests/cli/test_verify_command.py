"""The `warpcrete verify` command, and the rows that it shows."""

import importlib
import math
import pkgutil

from pumping import command

from warpcrete import verification
from warpcrete.verification import Case, Row, cases, summary, table
from warpcrete.verification.extremes import Outcome


def test_rows_pass_within_their_tolerance_only():
    assert Row("x", 1.009, 1.0, 0.01).passed and not Row("x", 1.011, 1.0, 0.01).passed
    assert Row("x", 0.009, 0.0, 0.01, scale=1.0).passed and not Row("x", 0.5, 0.0, 0.01, scale=10.0).passed
    assert not Row("x", math.nan, 1.0, 10.0).passed


def test_tables_name_every_figure_and_what_is_off():
    case = Case("pull", "theory", lambda device, precision: [], "bonds")
    rows = [Row("load", 1.0, 1.0, 0.1, "N"), Row("stretch", 2.0, 1.0, 0.1, "m")]
    assert table([(case, rows)]).count("**FAIL**") == 1 and "1 N" in table([(case, rows)])
    assert "1 of 2 **FAIL**" in summary([(case, rows)])


def test_names_are_unique():
    names = [case.name for case in cases()]
    assert len(names) == len(set(names)) > 15


def test_verify_writes_a_table_and_a_figure(tmp_path, whole_pictures):
    done = command("verify", "--device", "cpu", "--only", "oblique-impact", "--out", tmp_path / "v")
    assert done.returncode == 0, done.stderr
    assert "tangential restitution" in done.stdout and "source of the expected value" in done.stdout
    assert (tmp_path / "v" / "verification.md").read_text(encoding="utf-8").count("| oblique impact |") == 2
    assert (tmp_path / "v" / "verification.png").stat().st_size > 20_000
    again = command("verify", "--only", "oblique", "--out", tmp_path / "v")
    assert again.returncode == 2 and "exists already" in again.stderr


def test_cases_that_fail_count_besides_extremes_that_hold(monkeypatch):
    """Count failed figures and extreme scenes that are out of bounds; each of them alone ends with an error."""
    case = next(case for case in cases() if "oblique" in case.name)
    good, bad = Row("load", 1.0, 1.0, 0.1), Row("load", 2.0, 1.0, 0.1)
    held, burst = (Outcome("cup", "", deepest, 0.0, 100) for deepest in (0.5, 2.0))
    command_module = importlib.import_module("warpcrete.cli.verify")
    monkeypatch.setattr(command_module.flow_extremes, "matrix", lambda *_: [])
    for row, outcome, failed in ((good, held, 0), (bad, held, 1), (good, burst, 1), (bad, burst, 2)):
        monkeypatch.setattr(command_module.verification, "run_cases", lambda *_, row=row, **__: [(case, [row])])
        monkeypatch.setattr(command_module.edge, "matrix", lambda *_, outcome=outcome: [outcome])
        done = command("verify", "--device", "cpu", "--only", "oblique", "--extremes")
        assert done.returncode == (1 if failed else 0), done.stderr
        assert ("FAILED" in done.stdout) == (failed > 0) and (f"FAILED: {failed} results" in done.stdout or not failed)


def test_verify_refuses_what_it_does_not_know():
    done = command("verify", "--only", "nonsense")
    assert (
        done.returncode == 2 and "matches no case; use part of one of these names: elastic normal impact" in done.stderr
    )
    done = command("verify", "--device", "cuda:99")
    assert done.returncode == 2 and "Traceback" not in done.stderr


def test_every_module_with_cases_is_verified():
    """A module of the package that has cases must be part of the table of results."""
    modules = [importlib.import_module(f"warpcrete.verification.{each.name}")
               for each in pkgutil.iter_modules(verification.__path__)]  # fmt: skip
    listed = {case.name for module in modules for case in getattr(module, "CASES", ())}
    assert {case.name for case in cases()} == listed
