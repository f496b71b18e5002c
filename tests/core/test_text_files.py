"""The reader of input files: YAML 1.2, JSON, CSV and text, and one line for whatever is wrong with a file."""

import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from warpcrete import RunFolderError, SceneError, scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import LONGEST_VALUE, refuse
from warpcrete.core.inputs.text_files import MAXIMUM_SETTINGS_SIZE, check_file, read_mapping, read_rows
from warpcrete.core.inputs.yaml_files import yaml_text
from warpcrete.core.run.files import read_json
from warpcrete.geometry.lines import read_line
from warpcrete.mix.mix import read_mix
from warpcrete.mix.points import read_points
from warpcrete.record.loading import load
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import read_task


def written(folder, content, name="file.yaml"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("010", 10), ("-7", -7), ("0o17", 15), ("0x1f", 31), ("1e5", 1e5), ("1E5", 1e5), (".5", 0.5), ("5.", 5.0),
        ("-1.5e-3", -1.5e-3), ("1:30", "1:30"), ("0_125", "0_125"), ("1_000.0", "1_000.0"), ("0b11", "0b11"),
        ("2020-02-31", "2020-02-31"), ("yes", "yes"), ("no", "no"), ("true", True), ("False", False), ("~", None),
        ("", None), ("'010'", "010"), ("!!str 10", "10"), ("1,5", "1,5"), ("12 mm", "12 mm"), ("<<", "<<"),
    ],
)  # fmt: skip
def test_plain_words_mean_what_yaml_1_2_says(tmp_path, text, value):
    found = read_mapping(written(tmp_path, f"a: {text}\n"), "it")["a"]
    assert found == value and type(found) is type(value)
    assert read_mapping(written(tmp_path, f"%YAML 1.1\n---\na: {text}\n"), "it")["a"] == value


BAD = {
    "a: 1\nb: 2\na: 3\n": "line 3: has the key 'a' twice, first in line 1",
    "a: .inf\n": "line 1: has .inf, which is not a finite number",
    "a: 1\nb: -.INF\n": "line 2: has -.INF",
    "a: .nan\n": "line 1: has .nan",
    "a: 1e999\n": "line 1: has 1e999, which is too large for a number",
    "a: !!int abc\n": "line 1: has the tag !!int before 'abc'",
    "a: !!bool maybe\n": "line 1: has the tag !!bool",
    "a: !!timestamp 2020-02-31\n": "line 1: has the tag !!timestamp",
    "a: !!python/object:os.system ls\n": "line 1: has the tag !!python/object:os.system",
    "\na: " + "9" * 6000: "line 2: has a number of 6000 digits",
    "a: " + "[" * 5000: "is nested too deeply",
    "a: " + "[" * 5000 + "]" * 5000: "is nested too deeply",
    "? [1, 2]\n: 3\n": "line 1: has a key that is not text",
    "{a: 1}: 2\n": "line 1: has a key that is not text",
    "a: &x [1, *x]\n": "line 1: has an alias (*name) that refers to itself",
    "a: [1, 2": "line 1: is not valid YAML: expected ',' or ']'",
    "a:\tb\n\tc: 1\n": "is not valid YAML: found character '\\t'",
    "a: 1\n---\nb: 2\n": "line 2: is not valid YAML",
    "a: !!map [1]\n": "line 1: has the tag !!map before a list",
    "a: *nowhere\n": "line 1: is not valid YAML",
    "- 1\n": "contains a list instead of 'key: value' lines",
    "": "contains nothing",
    "12": "contains a number",
    b"a: \xff\n": "line 1: is not UTF-8 text; save the file as UTF-8",
    b"a: 1\n\xfc: 2\n": "line 2: is not UTF-8 text",
    "a: 1".encode("utf-16"): "is not UTF-8 text",
    b"a: 1\n\x00\n": "line 2: contains a NUL character",
    "a: [" + "1, " * (MAXIMUM_SETTINGS_SIZE // 3) + "1]": "is too large",
    "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n" for old, new in zip("abcde", "bcdef")
    ): "contains more than 50,000 values",
}  # fmt: skip


@pytest.mark.parametrize("content", BAD, ids=lambda content: repr(content[:24]))
def test_whatever_is_wrong_with_a_file_is_one_line_with_its_place(tmp_path, content):
    path = written(tmp_path, content)
    for read, field in (
        (lambda: read_mapping(path, "it"), "it"),
        (lambda: scenes.pipe(concrete=path), "concrete"),
        (lambda: read_mix(path), "concrete"),
        (lambda: read_line(path), "line"),
        (lambda: read_task(path, modules()), "targets"),
    ):
        with pytest.raises(SceneError) as refused:
            read()
        text = str(refused.value)
        assert BAD[content] in text and text.startswith(f"{field} = ") and "file.yaml" in text
        assert text.isprintable() and len(text) < 1000


def test_json_is_read_as_strictly(tmp_path):
    for text, says in (
        ('{"flow": {"density": 1, "density": 2}}', "has the key 'density' twice"),
        ('{"a": NaN}', "NaN is not a number"),
        ('{\n"a": 1,\n}', "line 3: is not valid JSON"),
        ('{"a": ' + "9" * 5000 + "}", "contains a number of 5000 digits"),
        ('{"a": ' + "[" * 100_000, "is nested too deeply"),
        ("[1]", "contains a list"),
    ):
        with pytest.raises(SceneError, match=says):
            read_mapping(written(tmp_path, text, "c.json"), "concrete")
    path = written(tmp_path, b"\xef\xbb\xbf" + json.dumps({"elements": {"friction": 0.2}}).encode(), "c.json")
    assert scenes.pipe(concrete=path).contact.friction == 0.2


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    assert read_mapping(written(tmp_path, b"\xef\xbb\xbfa: \xc3\xbc\n"), "it") == {"a": "ü"}


def test_tabs_at_the_ends_of_lines_mean_nothing_and_other_tabs_are_named(tmp_path):
    assert read_mapping(written(tmp_path, "a: 1 \t\r\nb:\t\n  - c \t \n\t\nd: 'e f'\t"), "it") == {
        "a": 1, "b": ["c"], "d": "e f",
    }  # fmt: skip
    # Other separators of lines stay as well.
    assert read_mapping(written(tmp_path, "a: 'e\u2028f'\t\rb: g\t"), "it") == {"a": "e\u2028f", "b": "g"}
    with pytest.raises(SceneError, match=r"line 2.*write spaces instead of tabs"):
        read_mapping(written(tmp_path, "a:\n\t- 1\n"), "it")


def special_files(folder):
    os.mkfifo(folder / "fifo.yaml")
    (folder / "folder.yaml").mkdir()
    (folder / "loop.yaml").symlink_to(folder / "loop.yaml")
    sparse = folder / "huge.yaml"
    sparse.touch()
    os.truncate(sparse, 10**12)
    return {
        "/dev/full": "it is a device", str(folder / "fifo.yaml"): "it is a pipe", str(sparse): "is too large",
        str(folder / "folder.yaml"): "it is a directory", str(folder / "loop.yaml"): "cannot be read",
        "nowhere.yaml": "cannot be read", "a\0b.yaml": "contains a NUL character",
        "x" * 100_000 + ".yaml": "cannot be read",
    }  # fmt: skip


@pytest.mark.linux
def test_only_regular_files_of_a_sensible_size_are_opened(tmp_path):
    for name, says in special_files(tmp_path).items():
        for read in (read_mapping, read_rows, check_file):
            with pytest.raises(SceneError) as refused:
                read(Path(name), "it")
            assert says in str(refused.value) and len(str(refused.value)) < 3 * LONGEST_VALUE


@pytest.mark.linux
@pytest.mark.parametrize(
    "arguments",
    [["line"], ["mix"], ["theory", "--concrete"], ["theory", "--fit"], ["run", "pipe", "--wall"],
     ["run", "pipe", "--concrete"], ["run", "part", "--wall"], ["run", "part", "--line"], ["calibrate"],
     ["explain", "pipe", "--concrete"], ["study", "pipe", "--concrete"]],
    ids=" ".join,
)  # fmt: skip
def test_every_command_opens_files_by_the_one_reader(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outs = {"calibrate": ["--out", "out"]}.get(arguments[0], [])
    for name, says in special_files(tmp_path).items():
        if "\0" in name or (name == "/dev/full" and arguments[-1] in ("--concrete", "mix")):
            continue  # no argument of a command can hold NUL; a concrete's file has an ending
        if says == "is too large" and "--wall" in arguments:
            continue  # meshes may be larger
        error = CliRunner().invoke(cli, [*arguments, name, *outs]).exception
        assert isinstance(error, SceneError) and says in str(error), (name[:50], error)
        assert not (tmp_path / "out").exists() and not (tmp_path / "runs").exists()


CSV = {
    "flow [m3/h],pressure [bar]\n10,3,10\n20,4,5\n": "line 2: has 3 values where the header names 2 columns; write",
    "flow [m3/h],pressure [bar]\n10,3\n20\n": "line 3: has 1 values where the header names 2 columns; write one value",
    "flow [m3/h],flow [l/s],pressure [bar]\n10,3,1\n20,4,1\n": "has the column 'flow' twice; remove or rename one",
    "flow [m3/h];pressure [bar]\n10,3;1,5\n20\n": "line 3: has 1 values where the header names 2 columns",
    "flow [m3/h];pressure [bar]\n1,5;10,3;30;\n": "has 4 values where the header names 2 columns; leave out the "
    "surplus values, or name their columns",
    "flow [m3/h];pressure [bar]\n1,5;10,3;\n": "line 2: has 3 values where the header names 2 columns; leave out the "
    "semicolon at the end",
    "flow [m3/h],pressure [bar]\n10,3,\n20,4\n": "header names 2 columns; leave out the comma at the end",
    "flow [m3/h];pressure [bar]\n1,234;3\n20;4\n": "line 2: flow = '1,234 m3/h': must be a number",
    "flow [m3/h];Flow (l/s);pressure [bar]\n10;3;1\n20;4;1\n": "has the column 'flow' twice; remove or rename one",
    'flow [m3/h],pressure [bar]\n"1,234",3\n20,4\n': "line 2: flow = '1,234 m3/h': must be a number",
    "": "contains no rows",
    "\n\n": "contains no rows",
    'flow [m3/h],pressure [bar]\n"10,3\n': "is not valid CSV",
    "flow [m3/h],pressure [bar]\n35000,3\n20,4\n": "line 2: flow = '35000 m3/h'",
    "flow,pressure\n35,3\n20,4\n": "is impossible: must be 1e-12 to 1 m3/s",
}


@pytest.mark.parametrize("text", CSV, ids=repr)
def test_tables_of_another_shape_are_refused(tmp_path, text):
    with pytest.raises(SceneError) as refused:
        read_points(written(tmp_path, text, "points.csv"))
    assert CSV[text] in str(refused.value)


def test_tables_of_a_spreadsheet_with_semicolons_have_decimal_commas(tmp_path):
    text = "Note;Flow (m3/h);Pressure (bar)\r\n;36,5;10,25\r\na, b;72;20\r\n"
    flows, pressures = read_points(written(tmp_path, text, "points.csv"))
    assert (flows, pressures) == (pytest.approx([36.5 / 3600, 0.02]), pytest.approx([1.025e6, 2e6]))


def test_tables_are_read_with_their_units_and_line_ends(tmp_path):
    text = b"\xef\xbb\xbfnote,flow [m3/h],pressure [bar]\r\n\r\n,36,10\r\nb,72,20\r\n"
    assert read_points(written(tmp_path, text, "points.csv")) == [pytest.approx([0.01, 0.02]), [1e6, 2e6]]


def test_errors_in_a_line_name_file_and_line(tmp_path):
    head = "diameter: 125 mm\nflow: 20 m3/h\nparts:\n  - straight: 10 m\n"
    for text, says in (
        (head + "  - bend: {to: uup, radius: 0.5}\n", "line 5: part 2, bend: to = 'uup': .*did you mean 'up'"),
        (head + "  - straight:\n      length: 1,234 m\n", "line 6: part 2, straight: length = '1,234 m'.*decimal"),
        (head.replace("20 m3/h", "1:30"), r"file.yaml, line 2: flow = '1:30': must be a number"),
        (head.replace("125 mm", "0_125"), r"file.yaml, line 1: diameter = '0_125'"),
        (head + "flwo: 3\n", "file.yaml, line 5: line's key = 'flwo': .*did you mean 'flow'"),
        (head + "flow: 40 m3/h\n", "line 5: has the key 'flow' twice, first in line 2"),
    ):
        with pytest.raises(SceneError, match=says):
            read_line(written(tmp_path, text))
    assert read_line(written(tmp_path, head.replace("10 m\n", "010\n"))).length == 10.0


def test_errors_in_a_mix_and_in_targets_name_file_and_line(tmp_path):
    mix = "mix:\n  density: 2300\n  spread: 600 mm\n  sieve: {4: 0, 1600000: 1}\n"
    with pytest.raises(SceneError, match=r"line 4: mix sieve: opening = '1\.6e\+06 mm': must be at most 300 mm"):
        read_mix(written(tmp_path, mix))
    targets = "vary: {viscosity: [10, 100]}\ntargets:\n  - scene: slump\n    quantity: sprad\n    value: 550 mm\n"
    with pytest.raises(
        SceneError, match=r"line 4: quantity = 'sprad': is not a result of any scene; did you mean 'spread'\?"
    ):
        read_task(written(tmp_path, targets + "    uncertainty: 5%\n"), modules())
    found, _ = read_task(written(tmp_path, targets.replace("sprad", "spread") + "    uncertainty: 2 cm\n"), modules())
    assert (found.targets[0].value, found.targets[0].uncertainty) == (0.55, 0.02)


def test_what_is_written_is_read_again(tmp_path):
    data = {"b": 1, "a": {"x": 1e5, "y": 2e-7, "t": "010", "u": "0_125", "k": "1:30", "n": "null"}, "ü": ["1e5", True]}
    text = yaml_text(data)
    assert read_mapping(written(tmp_path, text), "it") == data and list(data) == ["b", "a", "ü"]
    assert text.index("b:") < text.index("a:")


def test_files_of_a_run_are_read_by_the_same_reader(tmp_path):
    for content, says in ((b"{", "line 1: is not valid JSON"), (b"\xff", "not UTF-8"),
                          (b"[]", "does not contain a JSON object"),
                          (b"[" * 100_000, "nested too deeply")):  # fmt: skip
        path = written(tmp_path, content, "result.json")
        with pytest.raises(RunFolderError, match=says):
            read_json(path)
    written(tmp_path, "{", "scene.json")
    with pytest.raises(RunFolderError, match=r"scene\.json': cannot be read"):
        load(tmp_path)


LONG = {"text": "x" * 100_000, "list": ["y" * 1000] * 1000, "key": {"k" * 10_000: 1}, "number": 10**5000,
        "numbers": [10**5000]}  # fmt: skip


@pytest.mark.parametrize("value", LONG.values(), ids=list(LONG))
def test_messages_quote_a_part_of_what_is_long(value):
    with pytest.raises(SceneError) as refused:
        refuse("field\n" + "f" * 10_000, value, "is wrong\n", "mend it")
    assert len(str(refused.value)) < 4 * LONGEST_VALUE and str(refused.value).isprintable()


def test_deeply_nested_values_are_quoted_too():
    nested: list = []
    for _ in range(100_000):
        nested = [nested]
    with pytest.raises(SceneError, match="diameter = <list>: must be a number"):
        scenes.pipe(diameter=nested)
    while nested:  # one by one, as Python's own clearing is recursive
        nested = nested.pop()
