"""The `warpcrete warm` command, which compiles kernels before the first run."""

import os
import subprocess
import sys

import pytest
from pumping import command

from warpcrete import scenes


def test_wrong_scenes_and_devices_are_refused_before_anything_is_compiled(monkeypatch):
    def compiled(*rest, **settings):
        raise AssertionError("compiled in spite of a wrong name")

    monkeypatch.setattr("warpcrete.cli.warm.explain", compiled)
    for words, message in (
        (("tube", "tub"), "'tub'"), (("tube", "--device", "cuda:99"), "cuda:99"),
    ):  # fmt: skip
        done = command("warm", *words)
        assert done.returncode == 2 and message in done.stderr and done.stderr.startswith("error: "), done.stderr


def test_each_named_scene_is_forecast_on_the_device_without_a_cache(monkeypatch):
    """A cached forecast would compile nothing, and another device or scene would compile other kernels."""
    calls = []
    monkeypatch.setattr("warpcrete.cli.warm.explain", lambda *given, **settings: calls.append((given, settings)))
    done = command("warm", "tube", "pipe", "--device", "cpu")
    assert done.returncode == 0, done.stderr
    assert [given[0].name for given, _ in calls] == [scenes.tube().name, scenes.pipe().name]
    assert [settings for _, settings in calls] == 2 * [{"device": "cpu", "cache": False}]
    first, second, last = done.stdout.splitlines()
    assert first.split()[:2] == ["tube", "mps"] and second.split()[:2] == ["pipe", "dem"]
    assert 0 <= float(first.split()[2]) < 60 and last.startswith("kernels for cpu are ready")


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
