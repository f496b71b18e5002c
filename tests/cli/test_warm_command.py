"""The `warpcrete warm` command, which compiles kernels before the first run."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
import warp as wp
from pumping import command

from warpcrete import scenes
from warpcrete.cli import warm
from warpcrete.core.device.kernel_files import note_use


class Module(SimpleNamespace):
    """Stand-in for a module of Warp, of which only the files of the compiled code matter."""

    __hash__ = object.__hash__


def test_wrong_scenes_and_devices_are_refused_before_anything_is_compiled(monkeypatch):
    def compiled(*rest, **settings):
        raise AssertionError("compiled in spite of a wrong name")

    monkeypatch.setattr("warpcrete.cli.warm.explain", compiled)
    for words, message in (
        (("tube", "tub"), "'tub'"), (("tube", "--device", "cuda:99"), "cuda:99"),
        (("pipe", "tube", "--contact", "linear"), "--contact: is not a parameter of this scene"),
        (("pipe", "--contact", "lineal"), "contact = 'lineal'"),
        (("pipe", "--bonds", "true", "tube"), "must be a single value"),
        (("slump", "lbox", "--method", "dem"), "--method: applies to one scene; leave out 'lbox', or write the full"),
        (("--contact", "linear"), "--contact: needs the name of a scene before it"),
    ):  # fmt: skip
        done = command("warm", *words)
        assert done.returncode == 2 and message in done.stderr and done.stderr.startswith("error: "), done.stderr


def test_a_changed_file_at_any_depth_of_the_program_is_other_code(tmp_path, monkeypatch):
    """Kernels and scenes lie beside the package in a checkout."""
    files = [
        tmp_path / place for place in ("warpcrete/dem/laws/linear.py", "kernels/common/types.py", "scenes/lbox.py")
    ]
    for file in files:
        file.parent.mkdir(parents=True)
        file.write_text("1", encoding="utf-8")
    monkeypatch.setattr(warm, "__file__", str(tmp_path / "warpcrete" / "cli" / "warm.py"))
    for name, folder in (("kernels", "kernels"), ("scene_package", "scenes")):
        monkeypatch.setattr(warm, name, SimpleNamespace(__file__=tmp_path / folder / "__init__.py"))
    found = [warm._code_hash()]
    for file in files:
        file.write_text("2", encoding="utf-8")
        found.append(warm._code_hash())
    assert len(set(found)) == 4 and found[-1] == warm._code_hash()


def test_a_scene_that_is_ready_is_not_measured_again(tmp_path, monkeypatch):
    compiled, cache = [], tmp_path / "kernels"
    files = {name: cache / f"wp_{name}" / f"{name}.o" for name in ("shared", "tube", "channel", "slump")}

    def explain(scene, **settings):
        """Compile or load a kernel that all scenes use and one of this scene, like a run on the CPU."""
        name = scene.name.split()[0]
        compiled.append(name)
        for kernel in ("shared", name):
            files[kernel].parent.mkdir(parents=True, exist_ok=True)
            files[kernel].write_bytes(b"code")
            note_use(Module(execs={(None, 1): SimpleNamespace(binary_path=str(files[kernel]))}))

    monkeypatch.setattr("warpcrete.cli.warm.explain", explain)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(cache))
    said = command("warm", "tube", "channel", "--device", "cpu").stdout
    # A line when each scene begins, and one when it is done.
    assert compiled == ["tube", "channel"] and said.count("begins") == 2 and "ready: an earlier" not in said
    said = command("warm", "tube", "channel", "--device", "cpu").stdout
    assert len(compiled) == 2 and said.count("ready: an earlier") == 2 and said.endswith("without compiling\n")
    # The record of a scene lists the kernels that it uses: not those of other scenes.
    (record,) = cache.glob("warpcrete-channel-*.txt")
    assert record.read_text(encoding="utf-8").split() == ["wp_channel/channel.o", "wp_shared/shared.o"]
    # Another scene, other code, another processor or a lost kernel need a new look.
    command("warm", "slump", "--device", "cpu")
    assert compiled[2:] == ["slump"]
    for name, value in (("_code_hash", lambda: "other"), ("provenance", lambda *settings: {"processor": "an abacus"})):
        with monkeypatch.context() as patched:
            patched.setattr(f"warpcrete.cli.warm.{name}", value)
            command("warm", "tube", "--device", "cpu")
    assert compiled[2:] == ["slump", "tube", "tube"]
    # The scene that comes first compiles the shared kernel for both.
    for lost, again in (("channel", "channel"), ("shared", "tube")):
        del compiled[:]
        files[lost].unlink()
        command("warm", "tube", "channel", "--device", "cpu")
        assert compiled == [again]


def test_each_named_scene_is_forecast_on_the_device_without_a_cache(tmp_path, monkeypatch):
    """A cached forecast would compile nothing, and another device or scene would compile other kernels."""
    calls = []
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr("warpcrete.cli.warm.explain", lambda *given, **settings: calls.append((given, settings)))
    done = command("warm", "tube", "pipe", "--device", "cpu")
    assert done.returncode == 0, done.stderr
    assert [given[0].name for given, _ in calls] == [scenes.tube().name, scenes.pipe().name]
    assert [settings for _, settings in calls] == 2 * [{"device": "cpu", "cache": False}]
    _, first, _, second, last = done.stdout.splitlines()
    assert first.split()[:2] == ["tube", "mps"] and second.split()[:2] == ["pipe", "dem"]
    assert 0 <= float(first.split()[2]) < 60 and last.startswith("kernels for cpu are ready")


def test_parameters_and_contact_laws_are_compiled_each_time(tmp_path, monkeypatch):
    """The code of a user's law may have changed, so no record of an earlier call can hold for it."""
    laws = []
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr("warpcrete.cli.warm.explain", lambda scene, **more: laws.append(type(scene.contact).__name__))
    words = ["--contact", "rolling", "--device", "cpu"]
    for names in (["pipe"], ["slump", "--method", "dem"], ["pipe", "funnel-dem"]):
        done = command("warm", *names, *words)
        assert done.returncode == 0, done.stderr
    assert laws == 4 * ["RollingResistance"] and not list(tmp_path.iterdir())


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
    # Nothing else has used this cache, so the record lists all kernels in it.
    (record,) = tmp_path.rglob("warpcrete-channel-*.txt")
    assert {os.path.basename(line) for line in record.read_text(encoding="utf-8").splitlines()} == before
    after, _ = modules_after("run", "channel", "--duration", "0.02", "--quiet")
    assert after == before
    assert "ready: an earlier call" in modules_after("warm", "channel")[1]
