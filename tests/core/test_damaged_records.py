"""Records of runs, studies and trades with entries of another kind: one line that names the entry."""

import json

import pytest
from click.testing import CliRunner

from warpcrete import RunFolderError, SceneError
from warpcrete.cli.main import cli
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.core.run.files import RECORD_KINDS, read_record
from warpcrete.geometry.lines import line_of
from warpcrete.mix.mix import mix_of
from warpcrete.studies.study import load_study


@pytest.mark.parametrize("name", RECORD_KINDS)
def test_an_entry_of_another_kind_is_named(tmp_path, name):
    path = tmp_path / "scene.json"
    for record in ({name: 1.5}, {"command": {name: 1.5}}, {"cases": [{name: 1.5}]}):
        path.write_text(json.dumps(record), encoding="utf-8")
        with pytest.raises(
            RunFolderError, match=f"is damaged: its entry '({name}|command|cases)' has the wrong value "
        ):
            read_record(path)


@pytest.mark.parametrize(
    ("file", "record"),
    [
        ("scene.json", {"command": {"threads": None}}),
        ("trade.json", {"device": None}),
        ("trade.json", {"threads": None}),
    ],
)
def test_entries_that_the_program_always_fills_in_are_never_null(tmp_path, file, record):
    (tmp_path / file).write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"is damaged: its entry '(threads|device)' has the wrong value None"):
        read_record(tmp_path / file)
    (tmp_path / "study.json").write_text(json.dumps(record), encoding="utf-8")
    assert read_record(tmp_path / "study.json") == record


def test_cases_and_commands_are_mappings(tmp_path):
    for record, entry in (({"cases": [3]}, "cases"), ({"command": None}, "command")):
        (tmp_path / "study.json").write_text(json.dumps(record), encoding="utf-8")
        with pytest.raises(RunFolderError, match=f"its entry '{entry}' has the wrong value"):
            read_record(tmp_path / "study.json")
    (tmp_path / "study.json").write_text(
        '{"scene": "slump", "cases": [{"name": "1"}], "command": {"threads": 2}}', encoding="utf-8"
    )
    assert read_record(tmp_path / "study.json")["command"] == {"threads": 2}


@pytest.mark.parametrize(("words", "file"), [(["run"], "scene.json"), (["study", "--resume"], "study.json"),
                                             (["trade", "--resume"], "trade.json"),
                                             (["reproduce", "--resume"], "reproduction.json")])  # fmt: skip
def test_every_command_checks_its_record(tmp_path, words, file):
    for name, value in (("scene", []), ("device", -1), ("files", "x"), ("paper", {}), ("units", 3)):
        (tmp_path / file).write_text(
            json.dumps({"scene": "slump", "parameters": {}, "device": "cpu"} | {name: value}), encoding="utf-8"
        )
        done = CliRunner().invoke(cli, [*words, str(tmp_path / file if words == ["run"] else tmp_path)])
        assert isinstance(done.exception, RunFolderError), (name, done.exception)


@pytest.mark.parametrize("name", ["../elsewhere", "/tmp/elsewhere", "..", ""])
def test_cases_of_a_record_lie_inside_its_folder(tmp_path, name):
    case = {"name": name, "varied": {}, "parameters": {}}
    record = {"scene": "slump", "command": {}, "device": "cpu", "precision": "float32", "cases": [case]}
    (tmp_path / "study.json").write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(RunFolderError, match="cannot be the name of a folder"):
        load_study(tmp_path)


def test_names_in_files_hold_nothing_that_a_terminal_obeys():
    line = {"diameter": 0.125, "parts": [{"straight": 1}]}
    assert line_of(line | {"name": "a\x1b[2J\nb"}).name == "a\\x1b[2J b"
    for name in ({"a": 1}, ["a"]):
        with pytest.raises(SceneError, match=r"name = .*: must be text of one line"):
            line_of(line | {"name": name})


def test_unlikely_bends_hoses_and_pipes_of_points_are_told():
    for part in ({"bend": {"to": "up", "radius": 500}}, {"hose": {"points": [[1, 0, 0]], "layer": 80}}):
        with pytest.warns(PlausibilityWarning, match="is unusual"):
            line_of({"diameter": 0.125, "parts": [{"straight": 1}, part]})
    points = {"points": [[0.005, 1e5], [0.01, 2e5]], "diameter": 125, "length": 12}
    with pytest.raises(SceneError, match=r"mix layer: diameter = 125\.0: is impossible.*125 mm\?"):
        mix_of({"density": 2300, "spread": 0.6, "layer": points})
