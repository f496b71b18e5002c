"""Kill commands at random moments, then go on with them.

By hand: PYTHONPATH=tests python tests/attack/attack_kills.py [KILLS] [SEED] [COMMAND ...]

Each command runs once undisturbed. Then it is started again and again, killed once to three times (SIGKILL, SIGTERM,
SIGINT or SIGHUP), continued, and compared: the same bits, no file or process left over, nothing in the temporary
directory, and no run that has a checkpoint begun anew. By hand; a kill takes some 20 s.
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path

import numpy as np
import psutil
from command_ends import assert_ended
from pumping import INTERRUPTIBLE, TINY

PIPE = [word for name, value in (TINY | {"settle": 0.1, "travel": 0.03}).items()
        for word in (f"--{name.replace('_', '-')}", str(value))]  # fmt: skip
CPU = ["--device", "cpu", "--quiet"]
OFTEN = ["--checkpoint-every", "0.1"]
ENDLESS = ["--ends", "periodic", "--spacing", "0.0125"]
COMMANDS = {
    "pipe": ["run", "pipe", *PIPE, *CPU, *OFTEN],
    "tube": ["run", "tube", "--spacing", "0.0125", "--length", "0.1", "--duration", "0.05", *CPU, *OFTEN, "--paraview"],
    "slump": ["run", "slump", "--spacing", "0.02", "--duration", "0.5", *CPU, *OFTEN],
    "study": ["study", "pipe", *PIPE, "--velocity", "0.3", "0.4", "0.5", *CPU, *OFTEN, "--rerun"],
    "calibrate": ["calibrate", "{targets}", "--trials", "4", "--batch", "4", "--repeat", "1", *CPU],
    "trade": ["trade", "tube", *ENDLESS, "--budget", "10s", "--knob", "spacing", *CPU],
    "line": ["line", "{line}", "--simulate", *CPU],
}
TARGETS = """\
vary:
  viscosity: [10, 100]
targets:
  - {scene: slump, parameters: {concrete: own, density: 2350, yield_stress: 80, spacing: 0.02, duration: 0.5},
     quantity: spread, value: 0.25, uncertainty: 5%}
"""
LINE = """\
diameter: 125 mm
flow: 20 m3/h
concrete: no1
parts:
  - straight: 10 m
  - reducer: {to: 100 mm, length: 0.5 m}
  - straight: 5 m
"""
RECORDS = {"run": "scene.json", "study": "study.json", "calibrate": "calibration.json", "trade": "trade.json"}
LEFT_OVER = re.compile(r"partial|\.lock$|checkpoint\.npz$|run-\d+\.rrd$|asked\.json$")
TOO_LONG = 600
CHECKS = {"tube": ("balance of forces",), "slump": ("at rest",)}
"""Checks that these tiny runs fail; the other commands fail none."""


class Attack:
    """Commands in a folder, their processes known by a variable that all of them inherit."""

    def __init__(self, place: Path, seed: int) -> None:
        self.place, self.random = place, random.Random(seed)
        self.mark = uuid.uuid4().hex
        self.temporary = place / "tmp"
        self.temporary.mkdir()
        (place / "targets.yaml").write_text(TARGETS, encoding="utf-8")
        (place / "line.yaml").write_text(LINE, encoding="utf-8")
        self.whole: dict[str, dict[str, str]] = {}
        self.took: dict[str, float] = {}

    def start(self, words: list[str]) -> subprocess.Popen:
        environment = os.environ | {
            "PYTHONPATH": str(Path(__file__).parents[2]), "TMPDIR": str(self.temporary), "WARPCRETE_ATTACK": self.mark,
        }  # fmt: skip
        return subprocess.Popen(
            [sys.executable, "-c", INTERRUPTIBLE, *words], env=environment, cwd=self.place, start_new_session=True,
            encoding="utf-8",
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    def words(self, name: str, folder: Path) -> list[str]:
        places = {"targets": self.place / "targets.yaml", "line": self.place / "line.yaml"}
        return [*(word.format(**places) for word in COMMANDS[name]), "--out", str(folder)]

    def reference(self, name: str) -> None:
        """Run a command undisturbed; where it compiles kernels first, a second attack kills at better moments."""
        folder = self.place / f"{name}-whole"
        begun = time.monotonic()
        process = self.start(self.words(name, folder))
        out, err = process.communicate(timeout=TOO_LONG)
        assert_ended(subprocess.CompletedProcess([], process.returncode, out, err), *CHECKS.get(name, ()))
        self.took[name] = time.monotonic() - begun
        self.whole[name] = hashes(folder)

    def kill(self, name: str, number: int) -> str:
        """Kill a command once to three times, go on with it, and compare."""
        folder = self.place / f"{name}-{number}"
        words, story, code = self.words(name, folder), [], 3 if name in CHECKS else 0
        reached: dict[str, float] = {}
        for _ in range(self.random.choice((1, 1, 2, 3))):
            process = self.start(words)
            delay = self.random.uniform(0.2, 0.95) * self.took[name]
            how = self.random.choice((signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP))
            try:
                process.wait(delay)
            except subprocess.TimeoutExpired:
                process.send_signal(how)
            out, err = process.communicate(timeout=TOO_LONG)
            story.append(f"{how.name} after {delay:.1f} s: {process.returncode}")
            assert "Traceback" not in err, (story, err)
            self.no_process(story)
            before, reached = reached, times(folder)
            lost = [key for key, value in before.items() if reached.get(key, value) < value]
            assert not lost, (story, before, reached)
            words = self.next_words(name, folder)
            if process.returncode == code:  # it was faster
                break
        for _ in range(3):  # a trade may want more time
            process = self.start(words)
            out, err = process.communicate(timeout=TOO_LONG)
            assert "Traceback" not in err, (story, err)
            if process.returncode == code or "finished" in err or "exists already" in err:
                break
            words = self.next_words(name, folder)
        story.append(f"then {process.returncode}")
        assert process.returncode == code or "finished" in err or "exists already" in err, (story, out, err)
        self.no_process(story)
        here, whole = hashes(folder), self.whole[name]
        if name == "trade":  # which settings are tried depends on time
            here, whole = ({key: value for key, value in each.items() if key in here and key in whole}
                           for each in (here, whole))  # fmt: skip
        assert here == whole, (story, here, whole)
        left = [str(path) for path in folder.rglob("*") if LEFT_OVER.search(path.name)]
        left += [path.name for path in self.temporary.iterdir()]
        assert not left, (story, left)
        if name != "trade":
            assert names(folder) == names(self.place / f"{name}-whole"), (story, names(folder))
        shutil.rmtree(folder)
        return "; ".join(story)

    def next_words(self, name: str, folder: Path) -> list[str]:
        """Return the command that goes on: --resume where there is a record, else the same again."""
        kind = COMMANDS[name][0]
        record = RECORDS.get(kind)
        if record is None or not (folder / record).is_file() or (self.random.random() < 0.3 and kind == "run"):
            return self.words(name, folder)
        return [kind, "--resume", str(folder), "--quiet"]

    def no_process(self, story: list[str]) -> None:
        """Raise if a process of an attack still lives, once they had time to end."""
        end = time.monotonic() + 10
        while left := [p.pid for p in psutil.process_iter() if self.mark in environment_of(p)]:
            assert time.monotonic() < end, (story, left)
            time.sleep(0.1)


def environment_of(process: psutil.Process) -> str:
    try:
        return process.environ().get("WARPCRETE_ATTACK", "") if process.status() != psutil.STATUS_ZOMBIE else ""
    except psutil.Error:
        return ""


def hashes(folder: Path) -> dict[str, str]:
    """Hash of the end of every run below a folder, by its place."""
    return {
        str(path.parent.relative_to(folder)): json.loads(path.read_text(encoding="utf-8")).get("state_hash", "")
        for path in folder.rglob("result.json")
    }


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def times(folder: Path) -> dict[str, float]:
    """Return the simulated time [s] from which each run below a folder would go on, by the run's place.

    A run with a checkpoint goes on from it; a run without one has ended. A result.json can be ahead of the checkpoint,
    because a checkpoint takes effect only after all results are written. A run that was interrupted before its first
    row has a result.json without a time.
    """
    found = {}
    for path in folder.rglob("result.json"):
        result = json.loads(path.read_text(encoding="utf-8"))
        if "simulated_time" in result:
            found[str(path.parent)] = result["simulated_time"]["value"]
    for path in folder.rglob("checkpoint.npz"):
        found[str(path.parent)] = checkpoint_time(path)
    return found


def checkpoint_time(path: Path) -> float:
    """Return the time of the last row in a checkpoint [s], the first column; 0 before the first row."""
    with np.load(path, allow_pickle=False) as arrays:
        tables = [arrays[name] for name in arrays.files if name.rpartition("/")[2] == "rows"]
    return float(tables[0][-1, 0]) if tables and len(tables[0]) else 0.0


def main() -> None:
    kills, seed, *chosen = [*sys.argv[1:], *("60", "0")[len(sys.argv[1:]) :]]
    chosen = chosen or list(COMMANDS)
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        attack = Attack(Path(place), int(seed))
        for name in chosen:
            attack.reference(name)
            print(f"{name}: {len(attack.whole[name])} runs in {attack.took[name]:.1f} s", flush=True)
        for number in range(int(kills)):
            name = chosen[number % len(chosen)]
            try:
                print(f"{number + 1} {name}: {attack.kill(name, number)}", flush=True)
            except Exception as error:
                failed += 1
                print(f"{number + 1} {name}: FAILED: {error!r}", flush=True)
                shutil.rmtree(attack.temporary)
                attack.temporary.mkdir()
    print(f"{failed} of {kills} failed")
    raise SystemExit(min(failed, 1))


if __name__ == "__main__":
    main()
