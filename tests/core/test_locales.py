"""The command where the locale is not UTF-8: whatever names hold, files are whole and the command ends as it should."""

import os
import subprocess
import sys

import pytest

PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
SITE = "name: Brückenpfeiler · 中\ndiameter: 125 mm\nflow: 20 m3/h\nconcrete: {}\nparts:\n  - straight: 10 m\n"
MIX = "name: Größtkorn\nsource: Bücher\nmix: {density: 2300, spread: 600 mm, sizes: [4 mm, 16 mm]}\n"


def command(folder, *words):
    code = "from warpcrete.cli.main import main; main()"
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("LC_", "LANG"))} | PLAIN
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, cwd=folder, env=environment)


@pytest.mark.parametrize("name", [pytest.param("site.yaml", marks=pytest.mark.thorough), "Bögen.yaml"])
def test_names_that_the_terminal_cannot_show_end_nothing(tmp_path, name):
    (tmp_path / "mix.yaml").write_text(MIX, encoding="utf-8")
    text = SITE.format("mix.yaml")
    (tmp_path / name).write_text(text if name == "site.yaml" else text.partition("\n")[2], encoding="utf-8")
    done = command(tmp_path, "line", name, "--theory", "--out", "oü")
    assert done.returncode == 0, done.stderr
    title = "Brückenpfeiler · 中" if name == "site.yaml" else "Bögen"
    text = (tmp_path / "oü" / "line.md").read_text(encoding="utf-8")
    assert f"**{title}**" in text and text.endswith("\n")


@pytest.mark.thorough
def test_a_mix_is_written_in_utf_8_and_errors_are_one_line(tmp_path):
    (tmp_path / "mix.yaml").write_text(MIX, encoding="utf-8")
    done = command(tmp_path, "mix", "mix.yaml", "--out", "plain.yaml")
    assert done.returncode == 0, done.stderr
    assert "Größtkorn" in (tmp_path / "plain.yaml").read_text(encoding="utf-8")
    done = command(tmp_path, "run", "tube", "--concrete", "nö.yaml")
    assert done.returncode == 2 and done.stderr.startswith(b"error: ") and done.stderr.count(b"\n") == 1
