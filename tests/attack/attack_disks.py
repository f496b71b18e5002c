"""Fill disks of twenty sizes under runs, give them room, and go on.

By hand, as root: PYTHONPATH=tests python tests/attack/attack_disks.py [SCENE ...] [KIB ...].

Each run writes into a tmpfs of its own. When that is full, the command must end within ten seconds with one line; with
more room, --resume must complete the folder, with the bits of a run that always had room.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from command_ends import assert_ended
from pumping import TINY

SIZES = [16, 24, 32, 40, 48, 64, 80, 96, 112, 128, 160, 200, 256, 320, 400, 512, 700, 1000, 1600, 3000]
"""Sizes of the disks [KiB]."""
ROOM = "40m"
BLOCK = 4096
"""Bytes that a disk has that is not full."""
LONGEST = 10.0
"""Time from a full disk to the end of the command [s]."""
RUNS = {
    "slump": ["--spacing", "0.02", "--duration", "0.3"],
    "pipe": [word for name, value in TINY.items() for word in (f"--{name.replace('_', '-')}", str(value))],
}
CHECKS = {"slump": ("at rest",), "pipe": ()}
"""Checks that these short runs fail."""
CODE = (  # one that hangs shows where
    "import faulthandler; faulthandler.dump_traceback_later(100, exit=True); from warpcrete.cli import main; main()"
)


def command(*words: object, disk: Path | None = None) -> tuple[subprocess.CompletedProcess, float]:
    """Run the command; returns also the time from the moment when the disk was full to its end [s]."""
    call = [sys.executable, "-c", CODE, "run", *map(str, words), "--quiet"]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(call, stdout=out, stderr=err, env=environment)
        full = time.monotonic()
        while process.poll() is None:
            if disk is None or shutil.disk_usage(disk).free >= BLOCK:
                full = time.monotonic()
            time.sleep(0.05)
        spent = time.monotonic() - full
        said = [file.seek(0) or file.read() for file in (out, err)]
    return subprocess.CompletedProcess(call, process.returncode, *said), spent


def contents(folder: Path) -> tuple[list[str], str, bytes]:
    """Names of the files of a run, the hash of its end, and its series."""
    names = sorted(path.name for path in folder.iterdir())
    return (
        names,
        json.loads((folder / "result.json").read_text(encoding="utf-8"))["state_hash"],
        (folder / "series.csv").read_bytes(),
    )


def check_recordings(folder: Path) -> None:
    """Raise where a recording cannot be read."""
    from pxr import Usd
    from rerun.chunk import RrdReader

    assert RrdReader(str(folder / "run.rrd")).stream().to_chunks()
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    assert stage.GetPrimAtPath("/Run") and stage.GetEndTimeCode() > 0


def attack(scene: str, size: int, disk: Path, whole: tuple) -> str:
    """Fill a disk of so many KiB, then give it room; returns what the command said of the full disk."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "none", disk], check=True)
    try:
        folder = disk / "run"
        first = (scene, *RUNS[scene], "--out", folder, "--device", "cpu", "--checkpoint-every", 0.1)
        done, spent = command(*first, disk=disk)
        said = [line for line in done.stderr.splitlines() if not line.startswith("note:")]
        if done.returncode == (3 if CHECKS[scene] else 0):
            assert not said and contents(folder) == whole, said
            return "it fits"
        assert done.returncode == 2 and len(said) == 1 and said[0].startswith("error: "), done.stderr
        assert not re.search(r"\x1b|Traceback", done.stderr + done.stdout), done.stderr
        assert spent < LONGEST, f"it took {spent:.1f} s to end"
        kept = re.search(r"checkpoint at t = (\S+) s is saved", said[0])
        assert bool(kept) == (folder / "checkpoint.npz").is_file(), said[0]
        subprocess.run(["mount", "-o", f"remount,size={ROOM}", disk], check=True)
        again = ("--resume", folder) if (folder / "scene.json").is_file() else first
        done, _ = command(*again)
        assert_ended(done, *CHECKS[scene])
        assert contents(folder) == whole, (contents(folder)[0], whole[0])
        check_recordings(folder)
        return f"{spent:.1f} s, {said[0]}"
    finally:
        subprocess.run(["umount", disk], check=True)


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        disk = Path(place) / "disk"
        disk.mkdir()
        failed = 0
        sizes = [int(word) for word in sys.argv[1:] if word.isdigit()] or SIZES
        for scene, options in RUNS.items():
            if not set(RUNS).isdisjoint(sys.argv) and scene not in sys.argv:
                continue
            settings = (*options, "--device", "cpu", "--checkpoint-every", 0.1)
            for name in ("warm", scene):  # the first may compile
                done, _ = command(scene, *settings, "--out", Path(place) / name / scene)
                assert_ended(done, *CHECKS[scene])
            whole = contents(Path(place) / scene / scene)
            for size in sizes:
                try:
                    print(f"{scene} {size} KiB: {attack(scene, size, disk, whole)}", flush=True)
                except Exception as error:
                    failed += 1
                    print(f"{scene} {size} KiB: FAILED: {error!r}", flush=True)
        raise SystemExit(min(failed, 1))


if __name__ == "__main__":
    main()
