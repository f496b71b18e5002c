"""The `warpcrete warm` command, which compiles kernels before the first run."""

import os
import subprocess
import sys

import pytest
from pumping import command


def test_wrong_scenes_and_devices_are_refused_before_anything_is_compiled(monkeypatch):
    def compiled(*rest, **settings):
        raise AssertionError("compiled in spite of a wrong name")

    monkeypatch.setattr("warpcrete.studies.tradeoffs.explain.explain", compiled)
    for words, message in (
        (("tube", "tub"), "'tub'"), (("tube", "--device", "cuda:99"), "cuda:99"),
    ):  # fmt: skip
        done = command("warm", *words)
        assert done.returncode == 2 and message in done.stderr and done.stderr.startswith("error: "), done.stderr


@pytest.mark.thorough
def test_a_run_after_warming_compiles_nothing(tmp_path):
    """Warm one scene with an empty kernel cache, then run it with other numbers."""
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path / "kernels")}

    def modules_after(*words):
        done = subprocess.run([sys.executable, "-m", "warpcrete", *words, "--device", "cpu"], cwd=tmp_path,
                              env=environment, capture_output=True, encoding="utf-8")  # fmt: skip
        assert done.returncode == 0, done.stderr
        return {path.name for path in (tmp_path / "kernels").rglob("*.o")}, done.stdout

    before, said = modules_after("warm", "channel")
    assert len(before) > 10 and "channel" in said and "are ready" in said
    after, _ = modules_after("run", "channel", "--duration", "0.02", "--quiet")
    assert after == before
