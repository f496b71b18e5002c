"""Failures outside the physics and their messages: failed checks, disks, folders, processes and a user's files."""

import dataclasses
import errno
import hashlib
import importlib.util
import json
import os
import subprocess
import sys

import numpy as np
import psutil
import pytest
import trimesh
from click.testing import CliRunner
from pumping import alive, command, small_options, wait_until

import warpcrete
from warpcrete import Simulation, scenes
from warpcrete.cli import cli
from warpcrete.core.device.device import default_threads, find_device
from warpcrete.core.errors import DiskFullError, RunFolderError, SceneError
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.core.run.provenance import processor_features, provenance
from warpcrete.core.run.recorder import Recorder
from warpcrete.geometry.meshes import enclosed
from warpcrete.record.notebook import show
from warpcrete.record.run_folder import TableRecorder

TINY = dict(
    diameter=0.06, length=0.06, travel=0.004, ramp=0.002, settle=0.0, size_min=8e-3, size_max=12e-3, plug="plate"
)

SHORT_FLOW = dict(diameter=0.1, length=0.1, spacing=10e-3)


def tiny_options(**changes):
    return [word for name, value in (TINY | changes).items() for word in (f"--{name.replace('_', '-')}", str(value))]


def invoke(*words):
    return CliRunner().invoke(cli, [str(word) for word in words])


# Exit codes.


def test_a_failed_check_is_the_last_word_and_an_exit_code_of_its_own(tmp_path):
    """Two stones are no concrete, and a concrete with such stones is not pumped."""
    done = command(
        "run", "pipe", "--size-min", 0.10, "--size-max", 0.11, "--no-bonds", "--plug", "plate", "--travel", "0.01",
        "--ramp", "0.005", "--length", "0.4", "--settle", 0, "--device", "cpu", "--out", tmp_path / "run", "--quiet",
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert done.stdout.splitlines()[-1].startswith("FAILED: 1 of ")
    assert "(enough aggregates); do not trust this run" in done.stdout.splitlines()[-1]
    assert "0.4" in done.stderr  # of the diameter, noted before the run
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    assert result["finished"] and not result["checks"]["enough aggregates"]["passed"]
    assert result["checks"]["finished"]["passed"]


def test_a_sound_run_exits_with_zero(tmp_path):
    done = invoke("run", "pipe", *tiny_options(), "--device", "cpu", "--out", tmp_path / "run", "--quiet")
    assert done.exit_code == 0, done.output
    assert "FAIL" not in done.output and "plateau pressure     none" in done.output


# Files and folders.

LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
from warpcrete.cli import main
main()
"""


def recorded_tiny_run(out, *more):
    """Words of the command for a short run that writes much."""
    return ["run", "pipe", *tiny_options(travel=0.05), "--frames", "2000", "--sample-interval", "5e-4",
            "--device", "cpu", "--out", str(out), "--quiet", "--checkpoint-every", "0", *more]  # fmt: skip


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Compile all that a full disk would not have room for."""
    done = invoke(*recorded_tiny_run(tmp_path_factory.mktemp("compiled") / "run"))
    assert done.exit_code == 0, done.output


@pytest.mark.posix
@pytest.mark.thorough
@pytest.mark.parametrize(("limit", "file"), [(3_000, "series.csv"), (60_000, "run.rrd"), (60_000, "scene.usdc")])
def test_a_full_disk_is_one_line_that_names_the_file(tmp_path, limit, file, compiled):
    """Files that may not grow stand for a disk that is full; what is on disk by then stays."""
    recorders = {"series.csv": ["--no-rerun", "--no-usd"], "run.rrd": ["--no-usd"], "scene.usdc": ["--no-rerun"]}[file]
    words = recorded_tiny_run(tmp_path / "run", *recorders)
    done = subprocess.run([sys.executable, "-c", LIMITED, str(limit), *words], capture_output=True, encoding="utf-8",
                          timeout=200)  # fmt: skip
    lines = [line for line in done.stderr.splitlines() if not line.startswith("note:")]
    assert done.returncode == 2 and len(lines) == 1, done.stderr
    assert file in lines[0] and "cannot be written" in lines[0] and "no checkpoint was saved" in lines[0]
    assert (tmp_path / "run" / "scene.json").is_file()
    assert not list((tmp_path / "run").glob("*partial*")) and not list((tmp_path / "run").glob("*.partial"))


@pytest.mark.posix
def test_a_folder_that_cannot_be_made_is_refused_before_anything_is_packed(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    packed = []
    monkeypatch.setattr("warpcrete.dem.simulation.pack", lambda *given, **settings: packed.append(given))
    for out in (tmp_path / "file" / "run", "/proc/run"):
        done = invoke("run", "pipe", "--out", out, "--device", "cpu", "--quiet")
        assert isinstance(done.exception, RunFolderError) and f"out = '{out}'" in str(done.exception)
    assert not packed
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    nested = tmp_path / "a" / "b" / "run"
    done = invoke("run", "pipe", *tiny_options(), "--diameter", "-1", "--out", nested, "--device", "cpu")
    assert isinstance(done.exception, SceneError) and not (tmp_path / "a").exists()


def tube_of(path, stations, radii, shift=lambda z: 0.0):
    """An STL of rings of 48 corners along z."""
    points, faces = [], []
    for z, r in zip(stations, radii):
        angle = 2 * np.pi * np.arange(48) / 48
        points.append(np.stack([r * np.cos(angle) + shift(z), r * np.sin(angle), np.full(48, z)], axis=1))
    for k in range(len(stations) - 1):
        for a in range(48):
            b = (a + 1) % 48
            faces += [[48 * k + a, 48 * k + b, 48 * (k + 1) + a], [48 * k + b, 48 * (k + 1) + b, 48 * (k + 1) + a]]
    trimesh.Trimesh(np.concatenate(points), faces, process=False).export(path)
    return path


@pytest.mark.thorough
def test_a_reducer_is_packed_inside_its_own_wall(tmp_path):
    """150 to 140 mm: a cylinder of the wanted diameter would stand out of it."""
    z = np.linspace(-0.05, 0.6, 14)
    radii = np.interp(z, [0, 0.45], [0.075, 0.070])
    path = tube_of(tmp_path / "taper.stl", z, radii)
    scene = scenes.pipe(wall=str(path), length=0.3, travel=0.01, ramp=0.005, settle=0.05)
    simulation = Simulation(scene, device="cpu")
    simulation.prepare()
    wall = next(wall for wall in scene.walls if wall.name == "pipe")
    position = simulation.state.table().position
    assert enclosed(wall, scene.pipe.axis, position).all() and len(position) > 200
    size = simulation.state.table().size
    clear = np.interp(position[:, 2], z, radii) * np.cos(np.pi / 48) - np.hypot(position[:, 0], position[:, 1])
    assert np.all(clear > 0.2 * size)  # not merely their centres
    run = simulation.run()
    passed = sys.modules["warpcrete.scenes.pipe"].check(run)
    assert passed["all aggregates inside"][0] and passed["momentum balance"][0], passed


def test_words_about_meshes_say_what_is_wrong_with_them(tmp_path):
    z = np.linspace(-0.05, 1.7, 40)
    bent = tube_of(tmp_path / "s.stl", z, np.full(40, 0.075), shift=lambda z: 0.2 * np.sin(2 * z))
    with pytest.raises(SceneError, match=r"has gaps along the axis: \d+ of \d+ cross-sections are open"):
        scenes.pipe(wall=str(bent))
    for name, contents in (("noise.stl", os.urandom(800)), ("empty.stl", b""), ("words.stl", b"solid nothing\n")):
        (tmp_path / name).write_bytes(contents)
        with pytest.raises(SceneError) as caught:
            scenes.pipe(wall=str(tmp_path / name))
        assert name in str(caught.value) and "charset" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_checkpoint_that_is_cut_short_is_called_damaged(tmp_path):
    simulation = Simulation(scenes.pipe(**TINY), device="cpu")
    simulation.prepare()
    simulation.save(tmp_path / "c.npz")
    whole = (tmp_path / "c.npz").read_bytes()
    for kept in (0, 10, len(whole) // 2, len(whole) - 3):
        (tmp_path / "c.npz").write_bytes(whole[:kept])
        with pytest.raises(RunFolderError, match=r"c\.npz") as caught:
            Simulation(scenes.pipe(**TINY), device="cpu").resume(tmp_path / "c.npz")
        assert "pickle" not in str(caught.value)
    with pytest.raises(RunFolderError, match="is a directory, but a checkpoint is a file"):
        Simulation(scenes.pipe(**TINY), device="cpu").begin(tmp_path)


# Options that would be ignored, names, and what is shown.


@pytest.mark.parametrize(
    ("scene", "options", "words"),
    [
        ("tube", ["--mortar-viscosity", 90], "mortar_viscosity = 90.0: has no effect unless 'aggregates' is on"),
        ("pipe", ["--no-bonds", "--bond-modulus", 5], "bond_modulus = 5.0: has no effect unless 'bonds' is on"),
        ("pipe", ["--facets", 32], "facets = 32: has no effect unless 'wall' is mesh"),
        ("pipe", ["--hydration-modulus", 1e6], "hydration_modulus = 1000000.0: has no effect unless 'hydration' is"),
        ("pipe", ["--wall-scale", 0.001], "wall_scale = 0.001: has no effect unless 'wall' is a file"),
        ("pipe", ["--plug", "none", "--plug-pressure", 5], "plug_pressure = 5.0: has no effect unless 'plug' is"),
        ("pipe", ["--sizes", "5:0,20:1", "--size-max", 0.03], "size_max = 0.03: has no effect unless 'sizes' is"),
        ("tube", ["--time-step", 10], "time_step = 10.0: must be shorter, because the piston moves"),
        ("pipe", ["--velocity", 1e9], "velocity = 1000000000.0: must be in"),
        ("pipe", ["--pipeline-other", "there"], "pipeline_other = 'there': needs the lengths of the whole pipeline"),
        ("pipe", ["--unit", "C", "--plug", "plate"], "plug = 'plate': must not be a plate in a bend"),
    ],
)
def test_what_would_be_ignored_or_is_said_twice_is_refused(tmp_path, scene, options, words):
    done = invoke("run", scene, *options, "--device", "cpu", "--out", tmp_path / "run")
    assert done.exit_code != 0 and words in str(done.exception), done.exception
    assert not list(tmp_path.iterdir())


def test_a_pipe_unit_may_have_its_letter_in_the_paper_and_names_of_version_0_1_are_refused():
    assert scenes.pipe(unit="d").pipe.name == scenes.pipe(unit="D").pipe.name == "bend-to-vertical"
    for name, value in (("radius", 0.06), ("mix", "no2"), ("most_iterations", 9), ("aggregate_share", 0.2)):
        with pytest.raises(SceneError, match=name):
            scenes.tube(**{name: value})
    for given in ({"unit": "elbow-down"}, {"shapes": "reference", "shares": "2,1,1,1"}):
        with pytest.raises(SceneError, match=list(given)[-1]):
            scenes.pipe(**given)


def test_theory_answers_where_some_form_flows_and_has_no_flow_at_rest():
    shown = invoke("theory", "--pressure", 9000)
    rows = {line.split()[0]: line.split() for line in shown.output.splitlines()[3:-1]}
    assert shown.exit_code == 0 and "nothing flows below 9207.82 Pa" in " ".join(rows["pipe"])
    assert float(rows["plane"][1]) == pytest.approx(8.5931e-4, rel=1e-4)
    assert "nothing flows below" in str(invoke("theory", "--pressure", 7000).exception)
    still = [line.split() for line in invoke("theory", "--flow", 0).output.splitlines()[3:-1]]
    assert [(float(row[1]), float(row[4])) for row in still] == [(0.0, 0.0)] * 4


def test_names_and_short_words_for_people(monkeypatch):
    assert {"Simulation", "Run", "Scene", "FluidScene", "scenes", "SceneError"} <= set(dir(warpcrete))
    assert set(warpcrete.__all__) <= set(dir(warpcrete))
    simulation = Simulation(scenes.pipe(**TINY), device="cpu")
    run = simulation.run()
    flow = Simulation(scenes.channel(spacing=20e-3), device="cpu")
    flowed = flow.run()
    for thing in (run, flowed, run.scene, flowed.scene, simulation, flow, run.bodies):
        assert len(repr(thing)) < 250 and "\n" not in repr(thing), repr(thing)[:300]
    assert "finished" in repr(run) and "peak_pressure" in run._repr_html_() and "<table>" in flowed._repr_html_()
    for done in (run, flowed):
        assert type(show(done)).__name__ == "Figure"
    find = importlib.util.find_spec
    for spec, recording in (({"rerun_notebook": None}, "run.rrd"), ({"rerun_notebook": object()}, None)):
        with monkeypatch.context() as patched:
            patched.setattr(importlib.util, "find_spec", lambda name, *rest, s=spec: s.get(name, find(name, *rest)))
            assert type(show(flowed, recording)).__name__ == "Figure"


def test_results_say_which_processor_and_flags_their_bits_belong_to():
    run = Simulation(scenes.channel(spacing=20e-3, duration=5e-3), device="cpu").run()
    found = run.result["provenance"]
    assert found["processor"] and "march" in found["compiler_flags"] and found["warp"]
    assert found["threads"] == default_threads()


@pytest.mark.parametrize(
    ("text", "features"),
    [
        # The order of the features does not matter, and only the first processor counts.
        ("processor\t: 0\nvmx flags\t: no\nflags\t\t: sse2 avx\n\nprocessor\t: 1\nflags\t: mmx", "avx sse2"),
        ("processor\t: 0\nFeatures\t: fp asimd\n", "asimd fp"),
        ("processor\t: 0\n", None),
        (None, None),
    ],
)
def test_results_identify_the_processor_by_its_features(tmp_path, monkeypatch, text, features):
    monkeypatch.setattr("warpcrete.core.run.provenance.CPU_INFO", tmp_path / "cpuinfo")
    if text is not None:
        (tmp_path / "cpuinfo").write_text(text, encoding="utf-8")
    hashed = hashlib.sha256(features.encode()).hexdigest()[:16] if features else ""
    assert processor_features.__wrapped__() == hashed
    monkeypatch.setattr("warpcrete.core.run.provenance.processor_features", processor_features.__wrapped__)
    found = provenance(find_device("cpu"), "float32", 0)
    assert found.get("processor_features", "") == hashed and "threads" not in found


def test_what_the_pressure_is_made_with_belongs_to_a_scene(tmp_path):
    """A checkpoint of another area, pipe or published value is one of another scene."""
    scene = scenes.pipe(**TINY)
    simulation = Simulation(scene, device="cpu")
    simulation.prepare()
    simulation.save(tmp_path / "c.npz")
    for change in (
        {"pressure": dataclasses.replace(scene.pressure, area=2 * scene.pressure.area)},
        {"pipe": dataclasses.replace(scene.pipe, ramp=0.1)},
        {"remarks": ("another",)},
    ):
        other = dataclasses.replace(scene, **change)
        assert fingerprint(other) != fingerprint(scene)
        with pytest.raises(RunFolderError, match="belongs to another scene"):
            Simulation(other, device="cpu").resume(tmp_path / "c.npz")


def test_walls_move_again_after_a_settling_that_was_cut():
    simulation = Simulation(scenes.pipe(**TINY | dict(settle=0.2)), device="cpu")

    def cut(phase, fraction, figures):
        if phase == "settling":
            assert simulation.stepper.batch.rows[0]["held"] == 1
            raise RuntimeError("cut")

    simulation._progress = cut
    with pytest.raises(RuntimeError, match="cut"):
        simulation.prepare()
    assert simulation.stepper.batch.rows[0]["held"] == 0


# Processes.


@pytest.mark.thorough
def test_workers_end_with_a_study_that_is_killed(tmp_path):
    study = subprocess.Popen(
        [sys.executable, "-c", "from warpcrete.cli import main; main()", "study", "pipe", "--velocity", "0.2", "0.3",
         *small_options(travel=5.0), "--processes", "2", "--device", "cpu", "--out", str(tmp_path / "study"),
         "--quiet"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        assert wait_until(lambda: len(list((tmp_path / "study").glob("*/series.csv"))) == 2, 120)
        workers = psutil.Process(study.pid).children(recursive=True)
        assert len(workers) >= 2
        study.kill()
        study.wait(10)
        assert wait_until(lambda: not any(map(alive, workers)), 20), [w for w in workers if alive(w)]
    finally:
        study.kill()


class Broken(Recorder):
    """Cannot write its last words."""

    def finish(self, simulation, run):
        raise RunFolderError("no room")


def test_a_run_that_could_not_be_written_is_not_finished(tmp_path):
    """A study repeats a run that is not finished, and such a run can be resumed."""
    recorders = [TableRecorder(tmp_path / "run"), Broken()]
    path = tmp_path / "run" / "checkpoint.npz"
    simulation = Simulation(scenes.pipe(**TINY), device="cpu", recorders=recorders, checkpoint_path=path)
    with pytest.raises(RunFolderError, match="no room"):
        simulation.run()
    assert json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))["finished"] is False
    assert path.is_file()


def test_nothing_half_written_stays_with_a_finished_run(tmp_path):
    path = tmp_path / "checkpoint.npz"
    (tmp_path / ".warpcrete-partial-checkpoint.npz").write_bytes(b"half")
    Simulation(scenes.pipe(**TINY), device="cpu", checkpoint_path=path).run()
    assert not list(tmp_path.iterdir())


def test_a_repeated_run_has_as_many_threads(tmp_path):
    bare = ("--no-rerun", "--no-usd", "--quiet")
    once = invoke("run", "pipe", *tiny_options(), "--threads", 1, "--precision", "float64", *bare, "--device", "cpu",
                  "--out", tmp_path / "a")  # fmt: skip
    again = invoke("run", tmp_path / "a" / "scene.json", *bare, "--out", tmp_path / "b")
    assert once.exit_code == again.exit_code == 0, again.output
    records = [json.loads((tmp_path / name / "scene.json").read_text(encoding="utf-8")) for name in "ab"]
    assert all(record["command"]["threads"] == 1 and record["precision"] == "float64" for record in records)
    results = [json.loads((tmp_path / name / "result.json").read_text(encoding="utf-8")) for name in "ab"]
    assert results[0]["state_hash"] == results[1]["state_hash"]
    assert results[0]["provenance"]["precision"] == "float64"


def test_what_failed_before_it_began_can_be_let_go():
    simulation = Simulation(scenes.pipe(**TINY | dict(time_step=0.01)), device="cpu")
    with pytest.raises(SceneError, match="time_step"):
        simulation.prepare()
    simulation.release()
    simulation.release()


def test_a_method_must_bring_what_a_simulation_needs():
    with pytest.raises(TypeError, match=r"Half does not define .*prepare"):
        type("Half", (Simulation,), {"scene_type": int})
    assert all(kind.__name__ != "Half" for kind in Simulation.kinds)


def test_a_wall_with_a_crack_is_refused_by_its_name(tmp_path):
    z = np.linspace(-0.05, 0.6, 14)
    path = tube_of(tmp_path / "crack.stl", z, np.interp(z, [0, 0.45], [0.075, 0.070]))
    mesh = trimesh.load(path)
    mesh.update_faces(np.arange(len(mesh.faces)) != 500)
    mesh.export(path)
    with pytest.raises(SceneError, match=r"crack\.stl.* is not closed: 3 edges between its ends belong"):
        scenes.pipe(wall=str(path), length=0.3, travel=0.01, ramp=0.005)


class FramesOnDisk(Recorder):
    """Recorder that holds frames in memory until a checkpoint; `disk` stands for the disk."""

    expendable = True

    def __init__(self, disk: list[float], full_at_write: int | None = None) -> None:
        self.disk, self.full_at_write, self.memory, self.writes = disk, full_at_write, [], 0

    def resume(self, simulation, state):
        del self.disk[state["frames"] :]

    def frame(self, simulation):
        self.memory.append(simulation.stepper.time)

    def checkpoint(self, simulation):
        return {"frames": len(self.disk) + len(self.memory)}

    def write(self, simulation):
        self.writes += 1
        if self.full_at_write is not None and self.writes >= self.full_at_write:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.disk += self.memory
        self.memory = []

    def finish(self, simulation, run):
        self.write(simulation)


@pytest.mark.parametrize("full_at_write", [1, 3, 5])  # four checkpoints, then the end of the run
def test_a_recording_that_met_a_full_disk_has_every_frame_when_the_run_goes_on(tmp_path, full_at_write):
    def simulation(*recorders):
        scene = scenes.tube(**SHORT_FLOW, duration=0.01, sample_interval=0.002)
        return Simulation(scene, device="cpu", recorders=recorders, frame_interval=0.002,
                          checkpoint_path=tmp_path / "checkpoint.npz", checkpoint_every=0.0)  # fmt: skip

    uncut: list[float] = []
    assert simulation(FramesOnDisk(uncut)).run().finished and len(uncut) == 6
    disk: list[float] = []
    with pytest.raises(DiskFullError):
        simulation(FramesOnDisk(disk, full_at_write)).run()
    assert len(disk) < 6
    again = simulation(FramesOnDisk(disk))
    again.begin(tmp_path / "checkpoint.npz")
    assert again.run().finished
    assert disk == uncut
