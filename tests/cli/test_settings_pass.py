"""Every option of a command reaches the function that does the work, under its own name and with its own value."""

import importlib
import json
from pathlib import Path

import pytest
from command_modules import CLI, LINE
from pumping import command

import warpcrete
from warpcrete import scenes

REACHED = 7
"""Exit code of a command whose work is replaced."""


@pytest.fixture
def reached(monkeypatch, tmp_path):
    """Replace a function of a command's module by one that notes what it got, and ends the command."""
    monkeypatch.chdir(tmp_path)

    def of(module, name, *words):
        got = {}

        def noted(*arguments, **settings):
            got.update(settings, arguments=arguments)
            raise SystemExit(REACHED)

        with monkeypatch.context() as patched:
            patched.setattr(CLI[module], name, noted)
            done = command(*words)
        assert done.returncode == REACHED, done.stderr
        got.pop("progress", None)
        return got

    return of


def record(folder, name, **more):
    Path(folder).mkdir(exist_ok=True)
    made = {"provenance": {"warpcrete": warpcrete.__version__}, "scene": "channel"} | more
    Path(folder, name).write_text(json.dumps(made), encoding="utf-8")


def test_settings_of_a_study(reached):
    channel = scenes.modules()["channel"]
    words = [
        "study",
        "channel",
        "--flow",
        "1e-3",
        "2e-3",
        "--spacing",
        "10mm",
        "--out",
        "here",
        "--repeat",
        "3",
        "--one-at-a-time",
        "--device",
        "cpu",
        "--precision",
        "float64",
        "--processes",
        "2",
        "--frames",
        "5",
        "--checkpoint-every",
        "9",
        "--usd",
        "--quiet",
    ]
    got = reached("study", "run_study", *words)
    assert got.pop("arguments") == ("channel", channel, {"flow": [1e-3, 2e-3]})
    assert got == dict(
        base={"spacing": 0.01},
        out=Path("here"),
        repeat=3,
        one_at_a_time=True,
        device="cpu",
        precision="float64",
        processes=2,
        scheduler=None,
        workers=None,
        frames="5",
        checkpoint_every="9",
        rerun=False,
        usd=True,
        paraview=False,
        units={"spacing": "mm"},
    )
    bare = reached("study", "run_study", "study", "channel", "--flow", "1e-3", "2e-3", "--quiet")
    assert bare["checkpoint_every"] == 60.0 and bare["repeat"] == 1 and bare["precision"] == "float32"
    assert bare["out"].name.startswith("study") and bare["frames"] is None and bare["base"] == {}
    assert bare["one_at_a_time"] is False and bare["device"] is None and bare["processes"] is None
    record("old", "study.json")
    got = reached("study", "resume_study", "study", "--resume", "old", "--processes", "4", "--quiet")
    assert got == {"arguments": (Path("old"), channel), "processes": 4, "scheduler": None, "workers": None}


def test_settings_of_a_trade(reached):
    channel = scenes.modules()["channel"]
    words = [
        "trade",
        "channel",
        "--spacing",
        "0.01",
        "--budget",
        "1.5min",
        "--out",
        "here",
        "--repeat",
        "3",
        "--device",
        "cpu",
        "--threads",
        "2",
        "--knob",
        "tolerance",
        "spacing",
        "--quantity",
        "pressure",
        "--quiet",
    ]
    got = reached("trade", "run_trade", *words)
    assert got == dict(
        arguments=("channel", channel),
        base={"spacing": 0.01},
        out=Path("here"),
        repeat=3,
        quantities=["pressure"],
        knobs=["tolerance", "spacing"],
        device="cpu",
        threads=2,
        budget=90.0,
        scheduler=None,
        workers=None,
    )
    bare = reached("trade", "run_trade", "trade", "channel", "--quiet")
    assert bare["budget"] == 1200.0 and bare["repeat"] is None and bare["knobs"] is None and bare["threads"] is None
    record("old", "trade.json")
    got = reached("trade", "resume_trade", "trade", "--resume", "old", "--budget", "2h", "--quiet")
    assert got == {"arguments": (Path("old"), channel), "budget": 7200.0, "scheduler": None, "workers": None}


def test_settings_of_a_calibration(reached):
    words = [
        "calibrate",
        "targets.yaml",
        "--out",
        "here",
        "--trials",
        "9",
        "--repeat",
        "2",
        "--seed",
        "4",
        "--device",
        "cpu",
        "--precision",
        "float64",
        "--processes",
        "3",
        "--quiet",
    ]
    got = reached("calibrate", "run_calibration", *words)
    assert got == dict(
        arguments=(Path("targets.yaml"), scenes.modules()),
        out=Path("here"),
        trials=9,
        repeat=2,
        seed=4,
        device="cpu",
        precision="float64",
        processes=3,
    )
    record("old", "calibration.json")
    got = reached(
        "calibrate",
        "resume_calibration",
        "calibrate",
        "--resume",
        "old",
        "--trials",
        "5",
        "--processes",
        "2",
        "--quiet",
    )
    assert got == dict(arguments=(Path("old"), scenes.modules()), trials=5, processes=2)


def test_settings_of_a_run(reached):
    words = [
        "run",
        "pipe",
        "--velocity",
        "0.4",
        "--out",
        "here",
        "--device",
        "cpu",
        "--precision",
        "float64",
        "--threads",
        "1",
        "--frames",
        "20",
        "--checkpoint-every",
        "7",
        "--no-usd",
        "--paraview",
        "--colour",
        "speed",
        "--network",
        "--bind",
        "127.0.0.2",
        "--quiet",
    ]
    got = reached("run", "Simulation", *words)
    (scene,) = got.pop("arguments")
    out = got.pop("out")
    assert scene.name == "pipe" and scene.pipe.velocity == 0.4
    assert {key: got[key] for key in ("device", "precision", "threads", "frame_interval", "checkpoint_every")} == {
        "device": "cpu",
        "precision": "float64",
        "threads": 1,
        "frame_interval": 0.05,
        "checkpoint_every": 7.0,
    }
    assert (out.path, out.recordings, out.colour, out.network, out.live, out.bind, out.resumed) == (
        Path("here"),
        ["rerun", "paraview"],
        "speed",
        True,
        False,
        "127.0.0.2",
        False,
    )
    assert out.pipeline == {"pipeline_vertical": None, "pipeline_horizontal": None, "pipeline_other": None}
    got = reached(
        "run",
        "Simulation",
        "run",
        "pipe",
        "--out",
        "here",
        "--quiet",
        "--pipeline-vertical",
        "3",
        "--pipeline-horizontal",
        "5",
    )
    assert got["out"].recordings == ["rerun", "usd"] and got["frame_interval"] is None
    assert got["out"].pipeline["pipeline_vertical"] == 3.0 and got["out"].pipeline["pipeline_horizontal"] == 5.0
    (recorder,) = got["recorders"]
    assert (recorder.height, recorder.distance, recorder.other) == (3.0, 5.0, None)
    # An interrupted run continues with the settings that it began with, but with no more threads than there are.
    settings = {
        "frames": 8.0,
        "colour": "speed",
        "network": True,
        "rerun": False,
        "usd": True,
        "paraview": False,
        "pipeline_vertical": None,
        "pipeline_horizontal": None,
        "pipeline_other": None,
        "checkpoint_every": 3.0,
        "threads": 1000,
    }
    record(
        "begun",
        "scene.json",
        scene="pipe",
        parameters={"velocity": 0.2},
        files={},
        device="cpu",
        precision="float64",
        command=settings,
    )
    got = reached("run", "Simulation", "run", "--resume", "begun", "--quiet")
    (scene,), out = got["arguments"], got["out"]
    assert scene.pipe.velocity == 0.2 and got["frame_interval"] == 0.125 and got["checkpoint_every"] == 3.0
    assert got["threads"] == CLI["run"].default_threads() and got["precision"] == "float64" and got["device"] == "cpu"
    assert (out.path, out.recordings, out.colour, out.network, out.resumed) == (
        Path("begun"),
        ["usd"],
        "speed",
        True,
        True,
    )


def test_settings_of_a_line(reached):
    Path("site.yaml").write_text(LINE, encoding="utf-8")
    words = ["line", "site.yaml", "--quiet", "--device", "cpu", "--threads", "1", "--out", "here"]
    got = reached("line_simulated", "run_line", *words, "--simulate", "--cells", "14", "--rest", "600", "--known", ".")
    line, concrete, flow = got.pop("arguments")
    stop = got.pop("stop")
    assert len(line.parts) == 3 and concrete.name == "no1" and flow == pytest.approx(30 / 3600)
    assert (stop.rest, stop.growth, stop.band is not None) == (600.0, 0.5, True)
    assert {key: got[key] for key in ("simulate", "unless_known", "cells", "device", "threads", "known", "out")} == {
        "simulate": True,
        "unless_known": False,
        "cells": 14,
        "device": "cpu",
        "threads": 1,
        "known": Path("."),
        "out": Path("here"),
    }
    got = reached(
        "line_simulated",
        "run_elements",
        *words,
        "--method",
        "dem",
        "--concrete",
        "zhan",
        "--seeds",
        "3",
        "--shapes",
        "reference",
        "--coarse",
        "2",
        "--stiffer",
        "7",
    )
    elements = got["elements"]
    assert got["arguments"][1] == "zhan" and got["device"] == "cpu" and got["threads"] == 1
    assert (elements.seeds, elements.shapes, elements.coarse, elements.stiffer) == (3, "reference", 2.0, 7.0)


def test_settings_of_answers(reached):
    got = reached(
        "validate", "validate", "validate", "--kind", "slump", "--kind", "line", "--quick", "--device", "cpu", "--quiet"
    )
    assert got == dict(arguments=(None,), kinds=("slump", "line"), quick=True, device="cpu")
    got = reached(
        "reproduce",
        "reproduce",
        "reproduce",
        "zhan",
        "--quick",
        "--seeds",
        "2",
        "--only",
        "units",
        "--known",
        ".",
        "--out",
        "here",
        "--device",
        "cpu",
        "--processes",
        "3",
        "--quiet",
    )
    assert got == dict(
        arguments=("zhan",),
        out=Path("here"),
        quick=True,
        seeds=2,
        only=("units",),
        known=(Path("."),),
        device="cpu",
        processes=3,
    )
    got = reached(
        "explain",
        "explain",
        "explain",
        "channel",
        "--spacing",
        "0.01",
        "--fresh",
        "--device",
        "cpu",
        "--threads",
        "1",
        "--trade",
        "x",
    )
    assert got.pop("arguments")[0].spacing == 0.01
    assert got.pop("announce") is importlib.import_module("warpcrete.cli.explain")._announce
    assert got == {"cache": False, "device": "cpu", "threads": 1, "trade": Path("x")}
