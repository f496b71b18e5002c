"""Flows by the command: run folders, repeats, studies, refusals; and what their recorders write."""

import csv
import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from pumping import INTERRUPTIBLE, command, wait_until

from warpcrete import scenes
from warpcrete.cli.main import cli, main
from warpcrete.cli.scene_commands import help_text
from warpcrete.core.errors import SceneError
from warpcrete.scenes import modules

COMMAND = [sys.executable, "-c", INTERRUPTIBLE]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, whole_pictures):
    """A finished run of a channel with two phases."""
    out = tmp_path_factory.mktemp("flow") / "run"
    done = command("run", "channel", "--aggregates", "--spacing", 5e-3, "--duration", 0.05, "--frames", 100,
                   "--colour", "phase", "--device", "cpu", "--out", out, "--quiet")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "theory, plane: 9.423" in done.stdout and "FAIL" not in done.stdout
    return out


def test_run_folder_is_complete(folder):
    assert {p.name for p in folder.iterdir()} == {
        "scene.json", "result.json", "series.csv", "flow.png", "run.rrd", "scene.usdc",
    }  # fmt: skip
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert result["finished"] and result["particles"] == 1200 and result["aggregates"]["grains"] > 50
    assert result["pressure"]["unit"] == "Pa" and abs(result["pressure_error"]) < 0.03
    rows = list(csv.reader((folder / "series.csv").open(encoding="utf-8")))
    assert rows[0][:3] == ["time [s]", "travel [m]", "pressure [Pa]"] and "aggregate_inner [1]" in rows[0]
    assert len(rows) == 12
    assert (folder / "flow.png").read_bytes()[:4] == b"\x89PNG"


def test_usd_holds_the_particles_at_every_frame(folder):
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    points = UsdGeom.Points(stage.GetPrimAtPath("/Run/Concrete"))
    codes = points.GetPointsAttr().GetTimeSamples()
    assert codes == pytest.approx(np.arange(0, 51, 10), abs=1e-6)
    first, last = (np.array(points.GetPointsAttr().Get(code)) for code in (codes[0], codes[-1]))
    assert first.shape == (1200, 3) and np.all(first[:, 1] == 0)
    travel = 1500e-6 / (np.pi * 0.05**2) * 0.05
    assert (last - first)[:, 2].mean() == pytest.approx(travel, rel=0.02)
    assert np.abs(last[:, 0]).max() < 0.05
    colours = np.array(points.GetDisplayColorAttr().Get(codes[0]))
    assert len(np.unique(colours, axis=0)) > 2  # mortar, and grains that differ
    assert UsdGeom.Mesh(stage.GetPrimAtPath("/Run/Walls/pipe")).GetPointsAttr().Get()


def test_a_run_is_repeated_from_its_folder(folder, tmp_path):
    done = command("run", folder / "scene.json", "--no-rerun", "--no-usd", "--colour", "pressure", "--out",
                   tmp_path / "again", "--quiet")  # fmt: skip
    assert done.returncode == 0, done.stderr
    one, two = (
        json.loads((f / "result.json").read_text(encoding="utf-8"))["state_hash"] for f in (folder, tmp_path / "again")
    )
    assert one == two


@pytest.mark.posix
@pytest.mark.thorough
def test_an_interrupted_flow_goes_on(tmp_path):
    out, whole = tmp_path / "cut", tmp_path / "whole"
    options = ["run", "channel", "--spacing", "5e-3", "--duration", "0.15", "--checkpoint-every", "0.01", "--device",
               "cpu", "--threads", "1", "--quiet"]  # fmt: skip
    run = subprocess.Popen([*COMMAND, *options, "--out", str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    series = out / "series.csv"
    assert wait_until(lambda: series.is_file() and len(series.read_text(encoding="utf-8").splitlines()) > 12, 240), (
        "no rows came"
    )
    assert run.poll() is None, "it was faster"
    run.send_signal(signal.SIGINT)
    words = run.communicate(timeout=120)[0].decode()
    assert run.returncode == 130 and "continue with" in words
    assert not json.loads((out / "result.json").read_text(encoding="utf-8"))["finished"]
    done = command("run", "--resume", out, "--quiet")
    assert done.returncode == 0, done.stderr
    assert command(*options, "--out", whole).returncode == 0
    assert series.read_text(encoding="utf-8") == (whole / "series.csv").read_text(encoding="utf-8")
    one, two = (json.loads((f / "result.json").read_text(encoding="utf-8"))["state_hash"] for f in (out, whole))
    assert one == two


@pytest.mark.thorough
def test_a_study_of_flows(tmp_path):
    out = tmp_path / "sweep"
    done = command("study", "channel", "--spacing", 20e-3, 10e-3, "--device", "cpu", "--out", out, "--quiet")
    # Twenty millimetres are too coarse for the slip, and the study says so.
    assert done.returncode == 3, done.stderr
    headline, reason = done.stdout.splitlines()[-2:]
    assert headline == "FAILED: checks of 1 of 2 cases; do not use their results"
    assert reason.startswith("  slip velocity, in 1 case (001-spacing=0.02); the first one: ")
    assert "slip velocity [cm/s]" in done.stdout and "2 of 2 cases done" in done.stdout
    rows = list(csv.DictReader((out / "study.csv").open(encoding="utf-8")))
    assert [float(row["spacing [m]"]) for row in rows] == [20e-3, 10e-3]
    assert abs(float(rows[1]["slip_velocity_error [1]"])) < abs(float(rows[0]["slip_velocity_error [1]"]))
    assert (out / "study.png").is_file() and len(list(out.glob("00*/flow.png"))) == 2


def test_a_failing_flow_harms_no_other_of_its_study(tmp_path):
    """Both run in one process, so that the failed run could harm the other one."""
    out = tmp_path / "sweep"
    done = command("study", "channel", "--spacing", 20e-3, "--maximum-iterations", 3, 2000, "--device", "cpu", "--out",
                   out, "--processes", 1, "--quiet")  # fmt: skip
    assert done.returncode == 1 and "1 of 2 cases done, 1 failed" in done.stdout
    assert "failed: 001-maximum_iterations=3" in done.stdout and "did not converge in 3 iterations" in done.stdout
    assert json.loads((out / "002-maximum_iterations=2000" / "result.json").read_text(encoding="utf-8"))["finished"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--pressure", "7000"], "nothing flows below"),
        (["--spacing", "0.3"], "particles across the pipe"),
        (["--colour", "size"], "colour = 'size'"),
        (["--network"], "network"),
        (["--pipeline-vertical", "10"], "pipeline = "),
        (["--concrete", "own"], "has no value for density, slip_viscosity, slip_yield, viscosity, yield_stress"),
        (["--viscosity", "0"], "viscosity = 0.0"),
    ],
)
@pytest.mark.parametrize("scene", ["channel", "tube"])
def test_bad_input_leaves_nothing(tmp_path, scene, options, words):
    out = tmp_path / "run"
    result = CliRunner().invoke(cli, ["run", scene, "--device", "cpu", "--out", str(out), *options])
    assert result.exit_code != 0 and words in str(result.exception)
    assert not out.exists()


def test_a_solve_that_fails_ends_the_run_with_its_history(tmp_path):
    done = command("run", "channel", "--spacing", 5e-3, "--maximum-iterations", 3, "--device", "cpu", "--out",
                   tmp_path / "run", "--quiet")  # fmt: skip
    assert done.returncode == 1
    assert "the viscosity solve did not converge in 3 iterations" in done.stderr and "; its residual is " in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list((tmp_path / "run").glob("*partial*"))
    assert json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))["finished"] is False


def test_help_of_scenes_has_no_errors_of_python():
    for module in modules().values():
        text = help_text(module.scene.description)
        assert "Raises" not in text and "SceneError" not in text
        assert text.startswith(module.scene.description[:40])
    told = help_text(
        "Do it.\n\nSee :func:`~warpcrete.core.units.shown`. Raises\n:class:`SceneError` for none.\n\nMore."
    )
    assert told == "Do it.\n\nSee :func:`~warpcrete.core.units.shown`.\n\nMore."


def test_theory_takes_the_slip_viscosity_of_a_thick_layer_from_the_paper_as_runs_do():
    """Xu, Li & Jiang 2021, Table 3: 885 Pa s/m for concrete no. 1 and a layer of 4 mm, 893 for one of no thickness."""
    for thickness, viscosity in (("0", 893), ("4e-3", 885)):
        found = CliRunner().invoke(cli, ["theory", "--concrete", "no1", "--slip-thickness", thickness])
        assert f"slip layer {viscosity} Pa s/m" in found.output
    unknown = CliRunner().invoke(cli, ["theory", "--concrete", "no1", "--slip-thickness", "3e-3"])
    assert unknown.exit_code and "slip_thickness = 0.003" in str(unknown.exception)


@pytest.mark.parametrize(
    "words, told",
    [
        (["run", "tube", "--radius", "0.05"], "No such option '--radius'; use '--diameter', which has replaced it"),
        (["theory", "--mix", "no1"], "No such option '--mix'; use '--concrete', which has replaced it"),
        (["study", "tube", "--radius", "0.05", "0.06"], "did you mean --diameter?"),
        (["run", "part", "--velocity", "0.5"], "use '--flow', which is the mean velocity times the area of the bore"),
        (["run", "pipe", "--flow", "30m3/h"], "use '--velocity', which is the flow divided by the area of the bore"),
        (["study", "pipe", "--flow", "30m3/h"], "did you mean --velocity, which is the flow divided by the area"),
        (["study", "tube", "--threads", "2"], "--processes, the number of cases that run at once, each on one thread?"),
        (["warm", "tube", "--threads", "2"], "this scene; 'warpcrete run SCENE --help-all' lists its parameters"),
        (["run", "tube", "--processes", "2"], "use '--threads', the number of threads of the run"),
        (["run", "part", "--flow", "0.5m/s"], "this is a velocity; multiply it by the area of the bore, 0.785 times"),
        (["run", "pipe", "--velocity", "30 m3/h"], "this is a flow; divide it by the area of the bore, 0.785 times"),
    ],
)
def test_a_former_or_related_name_is_refused_with_the_right_one(words, told, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["warpcrete", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2 and told in capsys.readouterr().err


def test_a_scene_function_names_the_present_name_of_a_parameter():
    with pytest.raises(SceneError, match=r"parameter = 'radius': .*did you mean 'diameter'"):
        scenes.tube(radius=0.05)
    with pytest.raises(SceneError, match=r"parameter = 'velocity': .*did you mean 'flow', which is the mean velocity"):
        scenes.tube(velocity=0.5)
