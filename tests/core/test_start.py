"""Start of the program: the list of scenes needs no Warp, and each set of compiler flags is prepared first."""

import inspect
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from warpcrete import scenes
from warpcrete.core.device import launching
from warpcrete.core.inputs.scene_titles import scene_titles


def test_titles_read_from_the_files_are_those_of_the_modules():
    titles = scene_titles(Path(scenes.__path__[0]))
    assert titles == {name: inspect.getdoc(m).partition("\n")[0] for name, m in scenes.modules().items()}


def test_the_list_of_scenes_is_printed_without_importing_warp():
    code = ("import sys; sys.argv = ['warpcrete', 'list']\nfrom warpcrete.cli import main\n"
            "try:\n    main()\nfinally:\n    assert 'warp' not in sys.modules")  # fmt: skip
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert len(done.stdout.splitlines()) == len(scenes.modules())


def module(parameters, flags=None):
    kernel = SimpleNamespace(adj=SimpleNamespace(args=[None] * parameters))
    return SimpleNamespace(kernels={"kernel": kernel}, options={"cpu_compiler_flags": flags})


def test_one_module_of_each_set_of_flags_is_compiled_before_all_others():
    long, medium, short, other = module(9), module(7), module(3), module(1, "-O3")
    ordered = launching._in_order([(short, 1), (other, 1), (medium, 1), (long, 1)])
    assert [each for each, _ in ordered] == [long, other, medium, short]


NOTHING = """
import warp as wp
from warpcrete.core.device.device import find_device
from warpcrete.core.device.launching import load
from warpcrete.kernels.common.barrier import barrier
load([barrier], find_device("cpu"))
"""


@pytest.mark.thorough
@pytest.mark.posix
def test_precompiled_headers_stay_in_the_kernel_cache_and_serve_the_next_process(tmp_path, monkeypatch):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", NOTHING], capture_output=True, encoding="utf-8", check=True)
        assert done.stderr == ""  # Clang would report headers that it rejects.
        (headers,) = tmp_path.glob("*/wp_headers_*/*.pch")
        written = headers.stat().st_mtime_ns
        for compiled in tmp_path.glob("*/wp_*barrier*"):  # The next process compiles the kernel again.
            for file in compiled.iterdir():
                file.unlink()
            compiled.rmdir()
    assert headers.stat().st_mtime_ns == written
