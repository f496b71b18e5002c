"""Attack every command with inputs that are wrong, odd or damaged.

By hand: PYTHONPATH=tests python tests/attack/attack_inputs.py [WORD ...]

Words choose the inputs whose label holds one of them. Each input runs in this process, in a folder of its own, as a
user types it. It must end within ten seconds with the exit code that its table states, with one line that begins with
"error:" where it is refused, without any line but warnings and notes beside it, and without a file that was not there
before.
"""

import io
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

from attack_more_tables import more_attacks
from attack_tables import Attack, attacks
from command_ends import failed_checks

from warpcrete.cli.main import main

LONGEST = 10.0
"""Time that an input may take [s]."""
RUN = ["--spacing", "0.02", "--device", "cpu", "--quiet", "--no-rerun", "--no-usd"]
INLET_RADIUS = ("warning: ", "note: ")


class TooLong(BaseException):
    """An input took too long; nothing in the program may catch this."""


def made_folders(folder: Path) -> None:
    """Make one folder of every kind that the program writes: a run, a cut run, a study, a trade, a line."""
    small = ["--spacing", "0.025", "--duration", "0.05", "--device", "cpu", "--quiet"]
    for words, checks in (
        (["run", "slump", "--duration", "0.1", *RUN, "--out", "whole"], {"at rest"}),
        (["study", "slump", *small, "--processes", "1", "--lift-time", "2", "3", "--out", "study"], {"at rest"}),
        (["trade", "slump", *small, "--repeat", "1", "--budget", "2s", "--out", "trade"], set()),
        (["line", "burj-khalifa", "--theory", "--out", "line"], set()),
    ):
        code, out, said, _ = called(words, folder, 60.0)
        assert code == (3 if checks else 0) and failed_checks(out) == checks, (words, code, out, said)
    call = [sys.executable, "-m", "warpcrete", "run", "slump", "--duration", "9", *RUN, "--checkpoint-every", "0.1"]
    with subprocess.Popen([*call, "--out", "cut"], cwd=folder, stdout=subprocess.DEVNULL) as process:
        while not (folder / "cut" / "checkpoint.npz").is_file():
            time.sleep(0.02)
        process.terminate()  # a shell that runs this in the background lets processes ignore SIGINT
    assert (folder / "cut" / "checkpoint.npz").is_file()


@contextmanager
def streams() -> Iterator[list[str]]:
    """Collect all that is written to stdout and stderr, also by libraries; the list holds both at the end."""
    found: list[str] = []
    kept = [os.dup(number) for number in (1, 2)]
    files = [tempfile.TemporaryFile(dir="/dev/shm") for _ in kept]  # noqa: SIM115
    old = sys.stdout, sys.stderr
    old[0].flush()
    for number, file in zip((1, 2), files):
        os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = (io.TextIOWrapper(io.FileIO(n, "w", closefd=False), "utf-8", write_through=True)
                              for n in (1, 2))  # fmt: skip
    try:
        yield found
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = old
        for number, saved, file in zip((1, 2), kept, files):
            os.dup2(saved, number)
            os.close(saved)
            file.seek(0)
            found.append(file.read().decode("utf-8", "replace"))
            file.close()


def called(words: list[str], folder: Path, longest: float) -> tuple[int | str, str, str, float]:
    """Call the command in a folder; return its exit code, or the exception that left it, both streams and the time."""

    def stop(*_: object) -> None:
        raise TooLong

    before, handlers = os.getcwd(), {number: signal.getsignal(number) for number in (signal.SIGALRM, signal.SIGTERM)}
    code: int | str = 0
    os.chdir(folder)
    sys.argv = ["warpcrete", *words]
    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, longest)
    start = time.monotonic()
    with streams() as said, warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        except TooLong:
            code = "too long"
        except BaseException as error:
            code = f"{type(error).__name__}: {error}"[:300]
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
    for number, handler in handlers.items():
        signal.signal(number, handler)
    os.chdir(before)
    return code, said[0], said[1], time.monotonic() - start


def prepared(attack: Attack, folder: Path, made: Path) -> None:
    """Put an input's files into its folder: text, bytes, a copy of a folder, or what its kind says."""
    for name, content in attack.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if callable(content):
            content(path, made)
        elif isinstance(content, bytes):
            path.write_bytes(content)
        elif content == "socket":
            with socket.socket(socket.AF_UNIX) as made_socket:
                made_socket.bind(str(path))
        else:
            path.write_bytes(content.encode())


def listed(folder: Path) -> dict[str, bytes | None]:
    """Return every file below a folder with its content."""
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def faults(attack: Attack, code: int | str, out: str, err: str, spent: float, new: list[str]) -> list[str]:
    """Return what is wrong with the answer to an input."""
    found = []
    lines = err.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    strange = [line for line in lines if not line.startswith(("error: ", *INLET_RADIUS))]
    if code not in attack.codes:
        found.append(f"exit code {code}, not {' or '.join(map(str, attack.codes))}")
    if strange:
        found.append(f"strange lines: {strange[:2]}")
    if code == 2 and len(errors) != 1:
        found.append(f"{len(errors)} lines of errors")
    if any(not each.isprintable() for each in (*lines, *out.splitlines())):
        found.append("prints characters of control")
    if not re.search(attack.says, out + err):
        found.append(f"does not say {attack.says!r}")
    if code == 2 and any(len(line) > 1500 for line in lines):
        found.append("a very long line")
    if new:
        found.append(f"left or changed {new[:3]}")
    if spent > LONGEST:
        found.append(f"took {spent:.0f} s")
    return found


def tried(attack: Attack, made: Path) -> tuple[list[str], str]:
    """Return the faults of one input, and what the command said."""
    with tempfile.TemporaryDirectory(prefix="attack-") as name:
        folder, temporary = Path(name) / "here", Path(name) / "tmp"
        folder.mkdir()
        temporary.mkdir()
        prepared(attack, folder, made)
        before = listed(folder)
        kept, tempfile.tempdir = tempfile.tempdir, str(temporary)
        try:
            code, out, err, spent = called(shlex.split(attack.words), folder, LONGEST + 5)
        finally:
            tempfile.tempdir = kept
        after = listed(folder)
        new = [path for path in after if after[path] != before.get(path, b"") or path not in before]
        new = [path for path in new if not any(path == may or path.startswith(may + "/") for may in attack.leaves)]
        new += [f"no more {path}" for path in before if path not in after and not attack.leaves]
        new += [f"{path} in the temporary folder" for path in listed(temporary)]
        return faults(attack, code, out, err, spent, new), (err or out)[-300:].strip()


def run(chosen: list[str]) -> int:
    """Try all inputs, print what is wrong and a table of counts; return 1 if anything is wrong."""
    counts: dict[str, list[int]] = {}
    verbose = "-v" in chosen
    chosen = [word for word in chosen if word != "-v"]
    with tempfile.TemporaryDirectory(prefix="attack-made-") as name:
        made = Path(name)
        made_folders(made)
        for attack in chain(attacks(), more_attacks()):
            label = f"{attack.kind}: {attack.label}"
            if chosen and not any(word in label for word in chosen):
                continue
            wrong, said = tried(attack, made)
            count = counts.setdefault(attack.kind, [0, 0])
            count[0] += 1
            count[1] += bool(wrong)
            if wrong or verbose:
                print(
                    f"{'WRONG' if wrong else 'ok'} {label!r:.150}\n   {'; '.join(wrong)}\n   {said!r:.700}", flush=True
                )
    print(f"\n{'inputs of':24s} {'tried':>6s} {'wrong':>6s}")
    for kind, (count, bad) in counts.items():
        print(f"{kind:24s} {count:6d} {bad:6d}")
    total, bad = (sum(each) for each in zip(*counts.values()))
    print(f"{'all':24s} {total:6d} {bad:6d}")
    return int(bad > 0)


if __name__ == "__main__":
    raise SystemExit(run(sys.argv[1:]))
