"""Start of the program: the list of scenes needs no Warp."""

import inspect
import subprocess
import sys
from pathlib import Path

from warpcrete import scenes
from warpcrete.core.inputs.scene_titles import scene_titles


def test_titles_read_from_the_files_are_those_of_the_modules():
    titles = scene_titles(Path(scenes.__path__[0]))
    assert titles == {name: inspect.getdoc(m).partition("\n")[0] for name, m in scenes.modules().items()}


def test_the_list_of_scenes_is_printed_without_importing_warp():
    code = ("import sys; sys.argv = ['warpcrete', 'list']\nfrom warpcrete.cli import main\n"
            "try:\n    main()\nfinally:\n    assert 'warp' not in sys.modules")  # fmt: skip
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert len(done.stdout.splitlines()) == len(scenes.modules())
