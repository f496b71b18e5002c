"""The pumping scene by the command: run folder, recordings, bad input, interruptions, viewers."""

import csv
import json
import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import devices
from pumping import INTERRUPTIBLE, TINY, command, open_tube, small_options, wait_until
from test_recordings import columns

from warpcrete import Simulation
from warpcrete.cli.main import cli


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, whole_pictures):
    """A small recorded run by the command, with clumps."""
    folder = tmp_path_factory.mktemp("runs") / "small"
    done = command(
        "run",
        "pipe",
        *small_options(shapes="reference", size_min=10e-3),
        "--out",
        folder,
        "--device",
        "cpu",
        "--network",
        "--pipeline-vertical",
        576,
        "--pipeline-horizontal",
        83,
        "--quiet",
    )
    assert done.returncode == 0, done.stderr
    return folder, done


def test_run_folder_is_complete(recorded):
    folder, done = recorded
    names = {"scene.json", "result.json", "series.csv", "pressure.png", "run.rrd", "scene.usdc"}
    assert {p.name for p in folder.iterdir()} == names
    with (folder / "series.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0][:3] == ["time [s]", "travel [m]", "pressure [Pa]"]
    assert all(column.endswith("]") for column in rows[0])
    pressure = np.array([float(row[2]) for row in rows[1:]])
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert result["peak_pressure"] == {"value": pytest.approx(pressure.max(), rel=1e-6), "unit": "Pa"}
    assert result["finished"] and result["packing"]["solid_fraction"] > 0.55
    estimate = result["pipeline_estimate"]
    assert estimate["total_pressure"]["value"] == pytest.approx(
        576 * estimate["vertical_per_metre"]["value"] + 83 * estimate["horizontal_per_metre"]["value"]
    )
    assert (folder / "pressure.png").read_bytes()[:4] == b"\x89PNG"
    assert "check" in done.stdout and "FAIL" not in done.stdout


@pytest.mark.thorough
def test_scene_json_repeats_the_run(recorded, tmp_path):
    folder, _ = recorded
    again = tmp_path / "again"
    done = command("run", folder / "scene.json", "--out", again, "--no-usd", "--no-rerun", "--quiet")
    assert done.returncode == 0, done.stderr
    assert (again / "series.csv").read_text(encoding="utf-8") == (folder / "series.csv").read_text(encoding="utf-8")


def test_usd_is_valid_and_shows_the_run(recorded):
    from pxr import Gf, Usd, UsdGeom, UsdValidation

    folder, _ = recorded
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in errors] == []
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Run/Aggregates"))
    series = list(csv.reader((folder / "series.csv").open(encoding="utf-8")))
    end = float(series[-1][0]) * stage.GetTimeCodesPerSecond()
    assert stage.GetEndTimeCode() == pytest.approx(end, rel=1e-6)
    times = instancer.GetPositionsAttr().GetTimeSamples()
    assert len(times) >= 10
    bodies = json.loads((folder / "result.json").read_text(encoding="utf-8"))["bodies"]
    first, last = (np.array(instancer.GetPositionsAttr().Get(t)) for t in (times[0], times[-1]))
    assert len(first) == bodies and np.median(last[:, 2] - first[:, 2]) > 0.04
    assert len(instancer.GetPrototypesRel().GetTargets()) == 5  # four clumps and the plug's ball
    # The camera sees the middle of the concrete.
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Run/Camera")).GetCamera(times[0])
    view = camera.frustum
    for point in (first.mean(0), first.min(0), first.max(0)):
        assert view.Intersects(Gf.Vec3d(*map(float, point)))


def test_recording_holds_every_frame(recorded):
    folder, _ = recorded
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(folder / "run.rrd")],
        capture_output=True,
        encoding="utf-8",
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    for entity in (
        "/scene/aggregates",
        "/scene/walls/pipe",
        "/scene/walls/piston",
        "/scene/network/contacts",
        "/scene/network/bonds",
        "/pressure/piston",
        "/energy/kinetic_energy",
    ):
        assert entity in done.stdout, entity
    verified = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(folder / "run.rrd")],
        capture_output=True,
        encoding="utf-8",
        timeout=120,
    )
    assert verified.returncode == 0, verified.stderr


BAD = [
    (["--diameter", "-0.1"], "diameter = -0.1"),
    (["--diameter", "nan"], "diameter = nan"),
    (["--size-max", "0.2"], "size_max = 0.2"),
    (["--size-min", "-1"], "size_min = -1.0"),
    (["--unit", "sideways"], "unit = 'sideways'"),
    (["--velocity", "0"], "velocity = 0.0"),
    (["--friction", "-1"], "friction = -1.0"),
    (["--shapes", "cubes"], "shapes = 'cubes'"),
    (["--sizes", "5:0,20"], "sizes = '5:0,20'"),
    (["--wall", "missing.stl"], "missing.stl': cannot be read"),
    (["--hydration", "1.5"], "hydration"),
    (["--time-step", "0.01"], "time_step = 0.01"),
    (["--unit", "bend-to-horizontal", "--travel", "2"], "travel = 2.0"),
    (["--solid-fraction", "0.99"], "solid_fraction = 0.99"),
    (["--device", "tpu"], "device = 'tpu'"),
    (["--frames", "0"], "frames = 0.0"),
    (["--diameter", "wide"], "diameter"),
    (["--no-such-option"], "no-such-option"),
    (["--seed", "-3"], "seed = -3"),
    (["--hydration", "0.2", "--hydration-rounds", "1", "--time-step", "5e-5"], "time_step = 5e-05"),
    (["--live", "nowhere"], "live = 'nowhere'"),
    (["--sizes", "5:0,nan:0.4,20:1"], "openings"),
    (["--plug-pressure", "1e6"], "packing pressure"),
    (["--unit", "C", "--pipeline-vertical", "100"], "unit = 'bend-to-horizontal'"),
    (["--plug", "none", "--plug-ball", "-3"], "plug_ball = -3.0"),
    (["--elbow-radius", "0.03", "--unit", "C", "--travel", "0.01"], "elbow_radius = 0.03"),
]


@pytest.mark.parametrize(("options", "words"), BAD, ids=[" ".join(b[0]) for b in BAD])
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, options, words, monkeypatch):
    folder = tmp_path / "run"
    small = small_options(**TINY | {"plug": "balls", "length": 0.06}) if "--sizes" not in options else []
    monkeypatch.chdir(tmp_path)
    done = command("run", "pipe", *small, "--out", folder, "--quiet", *options)
    assert done.returncode == 2
    lines = [line for line in done.stderr.splitlines() if not line.startswith("note:")]
    assert len(lines) == 1 and lines[0].startswith("error: ") and words in lines[0]
    assert not list(tmp_path.iterdir())


def test_bad_files_and_folders(tmp_path):
    hole = open_tube(tmp_path / "hole.stl", hole=True)
    garbage = tmp_path / "garbage.stl"
    garbage.write_bytes(os.urandom(500))
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "notes.txt").touch()
    before = sorted(tmp_path.iterdir())
    for options, words in (
        (["--wall", hole, "--out", tmp_path / "run"], "has gaps along the axis"),
        (["--wall", garbage, "--out", tmp_path / "run"], "garbage.stl"),
        (["--out", taken], "exists already"),
    ):
        done = command("run", "pipe", *small_options(), *options, "--quiet")
        lines = [line for line in done.stderr.splitlines() if not line.startswith("note:")]
        assert done.returncode == 2 and len(lines) == 1 and words in lines[0], done.stderr
    for target in ("nothing", tmp_path / "scene.json"):
        done = command("run", target)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_no_gpu_where_one_is_asked_for(tmp_path):
    none, words = ("cuda:99", "must be one of cpu, cuda:0") if "cuda:0" in devices() else ("cuda", "no usable CUDA GPU")
    done = command("run", "pipe", *small_options(), "--device", none, "--out", tmp_path / "run")
    lines = [line for line in done.stderr.splitlines() if not line.startswith("note:")]
    assert done.returncode == 2 and len(lines) == 1 and f"device = {none!r}: {words}" in lines[0]
    assert not (tmp_path / "run").exists()


def test_ctrl_c_before_the_run_says_that_nothing_is_saved(tmp_path, monkeypatch):
    def stop(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Simulation, "begin", stop)
    found = CliRunner().invoke(cli, ["run", "pipe", *small_options(**TINY), "--out", str(tmp_path / "run")])
    assert found.exit_code and "nothing is saved; repeat the command" in found.output


@pytest.mark.thorough
@pytest.mark.posix
def test_ctrl_c_keeps_what_was_written(tmp_path):
    folder = tmp_path / "run"
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            INTERRUPTIBLE,
            "run",
            "pipe",
            *small_options(**TINY | {"travel": 10.0}),
            "--out",
            str(folder),
            "--device",
            "cpu",
            "--quiet",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )
    table = folder / "series.csv"
    assert wait_until(lambda: table.exists() and len(table.read_text(encoding="utf-8").splitlines()) > 5, 300)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=240)
    assert process.returncode == 130, errors
    assert "interrupted" in output and "Traceback" not in errors
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert result["finished"] is False and result["steps"] > 0
    from pxr import Usd

    assert Usd.Stage.Open(str(folder / "scene.usdc")).GetEndTimeCode() > 0
    assert (folder / "pressure.png").exists() and (folder / "run.rrd").stat().st_size > 1000
    checked = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(folder / "run.rrd")], capture_output=True
    )
    assert checked.returncode == 0


@contextmanager
def viewer(*words):
    """A Rerun process without a window; what its starter begins ends with it."""
    silent = dict(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    process = subprocess.Popen([sys.executable, "-m", "rerun", *words], start_new_session=True, **silent)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):  # it has ended
            os.killpg(process.pid, signal.SIGTERM)
        process.wait(30)


@contextmanager
def reserved_port():
    """A port that nothing listens on, and that no other process can take meanwhile."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        yield one.getsockname()[1]


@contextmanager
def viewer_at_free_port(*words, ready):
    """A viewer at a port for which `ready(port)` holds; another port if a process was quicker to take the first."""
    for _ in range(5):
        with reserved_port() as port:
            pass
        with viewer(*words, "--port", str(port)) as process:
            if wait_until(lambda: process.poll() is not None or ready(port), 90) and process.poll() is None:
                yield port
                return
    pytest.fail("no viewer began to listen")


@pytest.mark.posix
@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # what has arrived so far
def test_live_recording_reaches_a_running_viewer(tmp_path):
    # A server without a window stands for the viewer; what it got is fetched back over the network.
    def listening(port):
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    def frames(path):
        entity = "/scene/aggregates"
        try:
            (places,) = [found for name, found in columns(path, entity).items() if "positions" in name]
        except (RuntimeError, ValueError, OSError):  # not there yet, or half written
            return []
        return places

    saved = tmp_path / "live.rrd"
    with viewer_at_free_port("--serve-grpc", ready=listening) as port:
        url = f"rerun+http://127.0.0.1:{port}/proxy"
        short = small_options(**TINY | {"travel": 0.005, "ramp": 0.002, "settle": 0.0})
        done = command("run", "pipe", *short, "--out", tmp_path / "run", "--live", url, "--quiet", "--device", "cpu")
        assert done.returncode == 0, done.stderr
        wanted = frames(tmp_path / "run" / "run.rrd")
        assert len(wanted) > 1
        with viewer_at_free_port(url, "--save", str(saved), ready=lambda _: len(frames(saved)) >= len(wanted)):
            pass
    for live, recorded in zip(frames(saved), wanted, strict=True):
        assert np.array(live) == pytest.approx(np.array(recorded))


@pytest.mark.thorough
def test_absent_viewer_does_not_hold_up_the_run(tmp_path):
    folder = tmp_path / "run"
    short = small_options(**TINY | {"travel": 0.005, "ramp": 0.002, "settle": 0.0})
    with reserved_port() as port:
        url = f"rerun+http://127.0.0.1:{port}/proxy"
        # This process waits half a second for the viewer instead of four.
        code = "from warpcrete.record import rerun_stream as stream; stream.PATIENCE = 0.5; "
        code += "from warpcrete.cli import main; main()"
        words = ["run", "pipe", *short, "--device", "cpu", "--out", folder, "--live", url, "--no-usd", "--quiet"]
        done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, encoding="utf-8", timeout=300)
    assert done.returncode == 0, done.stderr
    checked = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(folder / "run.rrd")], capture_output=True
    )
    assert checked.returncode == 0 and (folder / "result.json").exists()


@pytest.mark.parametrize(
    ("option", "given", "says"),
    [
        ("--pipeline-vertical", "3 kg", "pipeline_vertical = '3 kg': must be a number with one of the units m, mm"),
        ("--pipeline-horizontal", "50 %", "pipeline_horizontal = '50 %': must be a number with one of the units m, mm"),
        ("--frames", "3 m", "frames = '3 m': must be a number with the unit 1/s"),
        ("--checkpoint-every", "5 %", "checkpoint_every = '5 %': must be a number with one of the units s, ms, min, h"),
        ("--pipeline-vertical", "-60 ft", "pipeline_vertical = '-60 ft': must be finite and at least 0 m"),
        ("--checkpoint-every", "-2 min", "checkpoint_every = '-2 min': must be finite and at least 0 s"),
    ],
)
def test_options_of_every_run_take_amounts_with_units(option, given, says, tmp_path):
    done = command("run", "pipe", option, given, "--out", tmp_path / "run")
    assert done.returncode == 2 and done.stderr.startswith(f"error: {says}"), done.stderr
