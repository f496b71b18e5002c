"""Compare what commands without a simulation print and write with stored texts and numbers (see `kept`)."""

import json
from pathlib import Path

import kept
import pytest
from pumping import command

import warpcrete

LINE = """
diameter: 125 mm
flow: 30 m3/h
concrete: no1
largest_stone: 16 mm
pump: {pressure: 85 bar, flow: 90 m3/h, power: 110 kW}
parts:
  - straight: 10 m
  - hose: {points: [[0.5, 0, 0], [1, 0.2, 0], [1.5, 0.3, 0.2]]}
  - straight: 1 m
  - bend: {to: up, radius: 0.5 m}
  - straight: {length: 20 m}
  - reducer: {to: 100 mm, length: 1 m}
  - bend: {to: level, angle: 45}
  - valve: {equivalent: 20 m}
  - hose: {length: 4 m, factor: 2.5}
  - straight: 5 m
"""
TAPS = """part,flow [m3/h],pressure [bar]
1,20,17.2
1,30,20.9
1,40,25.1
4,20,13.9
4,30,16.8
7,30,9.1
"""
PUMPED = """flow [m3/h],pressure [bar]
10,2.1
20,3.2
30,4.6
40,5.4
"""
PARTS = """
name: dense
source: a site
mix:
  parts: {cement: 340 kg/m3, limestone: 190 kg/m3, water: 175 kg/m3, sand: 810 kg/m3, gravel: 820 kg/m3}
  aggregate: 820 kg/m3
  aggregate_density: 2650 kg/m3
  sieve: {4: 0, 8: 0.45, 16: 1}
  shape: rounded
  voids: 24 %
  fine_sand: 18 %
  spread: 650 mm
  t500: 3.5 s
"""
SLUMP = """
mix:
  density: 2350 kg/m3
  aggregate: 36 %
  sizes: [4 mm, 16 mm]
  shape: 1.6
  slump: 180 mm
"""
MEASURED = """
mix:
  density: 2350 kg/m3
  aggregate: 360 l/m3
  sieve: {4: 0, 8: 0.4, 16: 1}
  shape: crushed
  mortar: {yield_stress: 20 Pa, viscosity: 8 Pa s, uncertainty: 15 %}
  viscometer: [[5, 210], [20, 660], [40, 1180]]
  layer: {points: pumped.csv, diameter: 125 mm, length: 12 m}
"""
HERSCHEL = """
mix:
  density: 2300 kg/m3
  aggregate: 40 %
  sieve: {4: 0, 8: 0.4, 16: 1}
  concrete: {yield_stress: 60 Pa, viscosity: 30 Pa s, flow_index: 1.3, uncertainty: 10 %}
  layer: {tribometer: [[0.2, 110], [0.4, 190], [0.6, 262]]}
"""
FILES = {
    "site.yaml": LINE,
    "taps.csv": TAPS,
    "pumped.csv": PUMPED,
    "parts.yaml": PARTS,
    "slump.yaml": SLUMP,
    "measured.yaml": MEASURED,
    "herschel.yaml": HERSCHEL,
}
FORMULA = ["--theory"]
COMMANDS = {
    "theory": [
        ["theory"],
        [
            "theory",
            "--flow",
            "10 m3/h",
            "--flow",
            "35 m3/h",
            "--pressure",
            "2 bar",
            "--diameter",
            "0.125",
            "--rise",
            "0",
            "--length",
            "12",
        ],
        ["theory", "--flow-index", "1.4", "--quadratic-viscosity", "0", "--rest", "10 min"],
        ["theory", "--concrete", "no3", "--quadratic-viscosity", "3", "--pressure", "9000"],
        ["theory", "--concrete", "no3", "--pressure", "100"],
        ["theory", "--fit", "pumped.csv", "--diameter", "0.125", "--length", "12", "--rise", "0"],
        ["theory", "--concrete", "parts.yaml", "--flow", "20 m3/h", "--rest", "1 h"],
    ],
    "mix": [["mix", f"{name}.yaml", "--bore", "80 mm"] for name in ("parts", "slump", "measured", "herschel")],
    "line": [
        ["line", "site.yaml", *FORMULA],
        ["line", "site.yaml", *FORMULA, "--practice", "--rest", "20 min", "--layer-factor", "0.8"],
        [
            "line",
            "site.yaml",
            *FORMULA,
            "--concrete",
            "measured.yaml",
            "--flow",
            "20 m3/h",
            "--rest",
            "10 min",
            "--thixotropy",
            "0.2 Pa/s",
        ],
        ["line", "site.yaml", *FORMULA, "--concrete", "parts.yaml", "--pump-pressure", "20 bar", "--flow", "60 m3/h"],
        ["line", "burj-khalifa", *FORMULA],
        ["line", "shanghai-tower", *FORMULA, "--practice"],
        [
            "line",
            "--slump",
            "180mm",
            "--stone",
            "20mm",
            "--diameter",
            "125mm",
            "--length",
            "190m",
            "--rise",
            "20m",
            "--flow",
            "30m3/h",
            *FORMULA,
        ],
        [
            "line",
            "--spread",
            "600mm",
            "--stone",
            "8mm",
            "--diameter",
            "100mm",
            "--length",
            "60m",
            "--flow",
            "10m3/h",
            *FORMULA,
        ],
        ["line", "site.yaml", "--fit", "taps.csv"],
    ],
    "list": [["list"]],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Make a folder with the files that the commands read, and work in it."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(words):
    """Return the output and the exit code of a command."""
    done = command(*words)
    return f"$ {' '.join(words)}\n{done.stdout}{done.stderr}exit code {done.returncode}"


@pytest.mark.parametrize("kind", COMMANDS)
def test_what_a_command_prints_is_kept(folder, kind):
    kept.compare(f"command-{kind}", "\n".join(answer(words) for words in COMMANDS[kind]))


def test_what_the_command_line_writes_is_kept(folder):
    words = ["line", "site.yaml", *FORMULA, "--concrete", "parts.yaml", "--rest", "20 min", "--practice"]
    assert command(*words, "--out", "out").returncode == 0
    record = json.loads(Path("out/line.json").read_text(encoding="utf-8"))
    record.pop("provenance", None)
    kept.compare("line-record", record)
    kept.compare("line-table", Path("out/line.md").read_text(encoding="utf-8"))
    assert command("mix", "measured.yaml", "--out", "written.yaml").returncode == 0
    kept.compare("mix-written", Path("written.yaml").read_text(encoding="utf-8"))


REFUSED = """
run
run chanel
run channel --flaw 1
run channel --flow 35
run channel --out finished
run channel --frames 0 --out new
run channel --frames 1e9 --out new
run channel --checkpoint-every -1 --out new
run channel --threads 0 --out new
run channel --colour blue --out new
run channel --network --out new
run channel --pipeline-vertical 3 --out new
run channel --pipeline-other finished --out new
run channel --trade finished --out new
run channel --accuracy much --out new
run channel --accuracy 5% --trade finished --out new
run pipe --accuracy 5% --trade finished --out new
run pipe --pipeline-vertical -3 --out new
run pipe --pipeline-vertical 3 --travel 0.1 --out new
run pipe --pipeline-vertical 3 --unit bend-to-vertical --out new
run pipe --pipeline-vertical 3 --pipeline-other finished --out new
run --resume finished
run --resume nowhere
run --resume other
run --resume modified
run --resume strange
run --resume finished channel
run finished/scene.json --flow 2
run strange/scene.json --out new
study
study chanel --flow 1
study channel --flow 1e-3 2e-3 --flow 3e-3
study channel --quiet=1 --flow 1e-3
study channel --flow 1e-3 --processes 0
study channel --flow 1e-3 --precision half
study channel more --flow 1e-3
study channel --out one two
study --resume finished
study --resume finished --flow 1e-3
study --resume study channel
study --resume study
trade
trade channel --budget 5
trade channel --budget 5h --knob
trade channel --budget 90s --knob spacings --out new
trade channel --spacing 0.01 0.02
trade --resume finished
trade --resume finished channel
calibrate
calibrate slump.yaml --out new
calibrate slump.yaml --precision half
calibrate slump.yaml --flow 3
calibrate --resume finished
calibrate slump.yaml --resume finished
calibrate --resume finished --trials 3
explain
explain channel --fresh 3
explain channel --flow 1e-3 2e-3
explain channel --device
verify --only nothing
verify --out finished --only pipe
validate --kind nothing
validate --out finished
validate --cases slump.yaml
reproduce
reproduce nobody
reproduce zhan --resume finished
reproduce --resume finished
reproduce zhan --only nothing --out new
view nowhere
view finished
schema nothing
mix nowhere.yaml
mix slump.yaml --out slump.yaml
mix slump.yaml --bore 3
mix pumped.csv
line
line nowhere.yaml
line site.yaml --flow 35
line site.yaml --theory --simulate
line site.yaml --theory --cells 20
line site.yaml --theory --seeds 3
line site.yaml --theory --method dem
line site.yaml --fit pumped.csv
line site.yaml --blocking 0 --theory
line site.yaml --slump 180mm
line site.yaml --rest 10
line site.yaml --thixotropy 0.2
line --slump 180mm --diameter 125mm --flow 30m3/h
line --slump 180mm --diameter 125mm --length 10m --flow 30m3/h --blocking 3
line --slump 180mm --spread 600mm --diameter 125mm --length 10m --flow 30m3/h
theory --flow 100
theory --pressure 3 --flow 1e-3 --fit pumped.csv
theory --fit site.yaml
theory --diameter 125
theory --rest -1
--quiet run channel
--resume finished
""".strip().splitlines()


def test_what_is_refused_is_kept(folder):
    """A wrong command ends in one line, with the exit code of wrong use, and leaves nothing behind."""
    scene = {"scene": "channel", "parameters": {"flow": 1e-3}, "device": "cpu", "precision": "float32", "files": {}}
    for name, record, result in (
        ("finished", scene, {"finished": True, "unit": "vertical"}),
        ("other", None, None),
        ("modified", scene | {"modified": {"flow": "1 is 2"}}, None),
        ("strange", scene | {"scene": "chute"}, None),
        ("study", None, None),
    ):
        Path(name).mkdir()
        version = {"provenance": {"warpcrete": warpcrete.__version__}}
        if record is not None:
            Path(name, "scene.json").write_text(json.dumps(record | version), encoding="utf-8")
        if result is not None:
            Path(name, "result.json").write_text(json.dumps(result), encoding="utf-8")
    Path("study/study.json").write_text(json.dumps({"scene": "chute", "cases": []} | version), encoding="utf-8")
    before = sorted(path for path in Path().rglob("*"))
    answers = []
    for words in REFUSED:
        said = answer(words.split()).replace(str(folder), "FOLDER")
        answers.append(said if len(said) < 1500 else f"{said[:400]} ... {said[-200:]}")
        assert sorted(path for path in Path().rglob("*")) == before, said
    kept.compare("command-refusals", "\n".join(answers))
