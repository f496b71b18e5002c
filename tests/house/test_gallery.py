"""The gallery: its page, its pictures, and the commands and lines of Python that made them."""

import ast
import importlib.util
import re
import shlex
import sys
from pathlib import Path

import pytest
from pumping import command

from warpcrete.cli.study import parsed
from warpcrete.record.recorders import RECORDERS
from warpcrete.scenes import modules

GALLERY = Path(__file__).parents[2] / "notebooks" / "gallery"


def script():
    """Return the module that makes the pictures."""
    spec = importlib.util.spec_from_file_location("gallery_make", GALLERY / "make.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # Dataclasses look their module up.
    sys.path.insert(0, str(GALLERY))  # A script finds the modules beside it.
    spec.loader.exec_module(module)
    sys.path.remove(str(GALLERY))
    return module


MAKE = script()
ENTRIES = {entry.name: entry for entry in MAKE.ENTRIES}


def test_there_are_twenty_pictures_and_no_others():
    assert len(ENTRIES) >= 20 and len({entry.title for entry in MAKE.ENTRIES}) == len(ENTRIES)
    assert {path.stem for path in GALLERY.glob("*.png")} == set(ENTRIES)


def test_the_page_is_what_the_script_writes_and_shows_every_picture():
    text = (GALLERY / "index.md").read_text(encoding="utf-8")
    assert text == MAKE.page()
    assert re.findall(r"\]\((\w+)\.png\)", text) == list(ENTRIES)


@pytest.mark.parametrize("name", ENTRIES)
def test_a_picture_is_small(name):
    from PIL import Image

    path = GALLERY / f"{name}.png"
    with Image.open(path) as picture:
        assert picture.format == "PNG" and picture.width <= MAKE.WIDTH and picture.height <= MAKE.HIGHEST
    assert path.stat().st_size <= MAKE.MOST_BYTES


@pytest.mark.parametrize("name", [n for n, entry in ENTRIES.items() if not entry.code.startswith("warpcrete ")])
def test_lines_of_python_are_few_and_leave_a_figure(name):
    code = ENTRIES[name].code
    assert len(code.splitlines()) <= 6
    names = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)]
    assert any(node.id == "figure" and isinstance(node.ctx, ast.Store) for node in names)


@pytest.mark.parametrize("name", [n for n, entry in ENTRIES.items() if entry.code.startswith("warpcrete ")])
def test_a_command_parses(name):
    """Options of studies, trades and calibrations are checked here, because their parsers accept any with --help."""
    words = shlex.split(ENTRIES[name].code.replace("\\\n", ""))[1:]
    assert words[-2:] == ["--out", "OUT"]
    if words[0] in ("study", "trade", "calibrate"):
        subject, options = parsed(words[1:])
        told = command(words[0], "--help").stdout
        recorders = {kind.name for kind in RECORDERS}
        own = {name for name in options if f"--{name}" not in told} - recorders
        if words[0] == "calibrate":
            assert (GALLERY.parents[1] / subject).is_file() and not own
        else:
            assert subject in modules()
            assert {name.replace("-", "_") for name in own} <= set(modules()[subject].scene.fields({}))
    else:
        done = command(*words, "--help")
        assert done.returncode == 0, done.stderr
        done = command(*words, "--no-such-option", "--help")
        assert done.returncode == 2, done.stderr
