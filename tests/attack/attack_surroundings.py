"""Run a small scene in odd surroundings: closed or full streams, other environments, read-only folders, odd names.

By hand, on Linux: PYTHONPATH=tests python tests/attack/attack_surroundings.py [WORD ...]

Words choose the cases whose label holds one of them. Every case must end with the exit code that its table states. A
run that may start must leave a complete folder; a refused run prints one line and leaves nothing.
"""

import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

RUN = "run slump --spacing 0.025 --duration 0.05 --device cpu --quiet --no-rerun --no-usd"
FILES = {"scene.json", "result.json", "series.csv"}
DONE, REFUSED = (3,), (2,)
"""Exit codes: the small run ends before the concrete is at rest, so one of its checks fails."""
LONGEST = 300
"""Time that a case may take [s]; the first one may compile kernels."""
BOUND = "setpriv --inh-caps -dac_override,-dac_read_search --bounding-set -dac_override,-dac_read_search"
"""Command that takes away root's right to write everywhere."""
NAMES = (
    "with space", "ümläut 中", "a" * 255, "-dash", "--out", "tab\tname", "new\nline", "quote'\"", "$HOME", "*?", "~",
    "%s%d", "{x}", "a;b", "#h", "\u202e", "\x1b[31m", "a\\b", ".hidden", "trail. ",
    b"bad\xff".decode("utf-8", "surrogateescape"),
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Command in a shell, and how it must end; `{run}` stands for a small run into the folder `out`."""

    label: str
    line: str
    codes: tuple[int, ...] = DONE
    environment: dict[str, str | None] = field(default_factory=dict)
    """Variables that are set, or removed where the value is None."""
    folder: str = "out"
    lines: int | None = None
    """Number of lines on stderr without notes and warnings; None for any number."""


def cases() -> list[Case]:
    """Return all cases."""
    streams = ("2>&-", ">&-", "<&-", ">&- 2>&-", ">&- 2>&- <&-", "2>/dev/full", "2> >(true)", "| true", "| head -1")
    found = [Case(f"streams {each}", "{run} " + each) for each in streams]
    found += [
        Case("refused with stderr closed", "{warpcrete} run nothing 2>&-", REFUSED, folder="", lines=0),
        Case("refused with stderr full", "{warpcrete} run nothing 2>/dev/full", REFUSED, folder="", lines=0),
        Case("list into a full disk", "{warpcrete} list >/dev/full", REFUSED, folder="", lines=1),
        Case("study with all streams closed", "{study} >&- 2>&- <&-", folder="out/001-lift_time=1"),
        Case("study into a broken pipe", "{study} 2>&1 | true", folder="out/001-lift_time=1"),
        Case("removed working folder", "mkdir gone; cd gone; rmdir ../gone; {run}", REFUSED, folder="", lines=1),
        Case("read-only folder", f"mkdir ro; chmod 555 ro; {BOUND} {{warpcrete}} {RUN} --out ro/x", REFUSED, folder="",
             lines=1),
    ]  # fmt: skip
    for name in ("HOME", "XDG_CACHE_HOME", "WARP_CACHE_PATH"):
        line = f"mkdir ro; chmod 555 ro; {name}=$PWD/ro {BOUND} {{warpcrete}} {RUN} --out out"
        found.append(Case(f"read-only {name}", line, REFUSED, {"XDG_CACHE_HOME": None}, "", 1))
    for variables in (
        {"HOME": None}, {"TMPDIR": "/nope"}, {"COLUMNS": "20"}, {"COLUMNS": "-5"}, {"COLUMNS": "x"}, {"NO_COLOR": "1"},
        {"PYTHONIOENCODING": "latin-1"}, {"PYTHONIOENCODING": "utf-16"}, {"PYTHONOPTIMIZE": "2"}, {"TZ": "Foo/Bar"},
        {"PYTHONWARNINGS": "error"}, {"LC_ALL": "xx_YY.foo"}, {"MPLBACKEND": "QtAgg", "DISPLAY": None},
        {"MPLBACKEND": "nope"}, {"PATH": "/nope"},
    ):  # fmt: skip
        lines = None if "utf-16" in variables.values() else 0
        found.append(Case(f"environment {variables}", "{run}", environment=variables, lines=lines))
    found += [Case(f"name {name!r}", f"{{warpcrete}} {RUN} {shlex.quote('--out=' + name)}", folder=name, lines=0)
              for name in NAMES]  # fmt: skip
    return found


def faults(case: Case, place: Path) -> list[str]:
    """Run a case in an empty folder; return what is wrong with its end."""
    warpcrete = f"{shlex.quote(sys.executable)} -m warpcrete"
    study = f"{warpcrete} study {RUN.removeprefix('run ').partition(' --no')[0]} --lift-time 1 2 --out out"
    line = case.line.replace("{run}", f"{warpcrete} {RUN} --out out").replace("{study}", study)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])} | case.environment
    environment = {name: value for name, value in environment.items() if value is not None}
    words = ["/bin/bash", "-o", "pipefail", "-c", line.replace("{warpcrete}", warpcrete)]
    done = subprocess.run(
        words, cwd=place, env=environment, capture_output=True, timeout=LONGEST, errors="backslashreplace"
    )
    said = [each for each in done.stderr.splitlines() if not each.startswith(("note:", "warning:", "/bin/bash:"))]
    found = [] if done.returncode in (*case.codes, *((1,) if "|" in case.line else ())) else [f"exit {done.returncode}"]
    if "Traceback" in done.stderr or (case.lines is not None and len(said) != case.lines):
        found.append(f"says {done.stderr[-300:]!r}")
    names = {path.name for path in (place / case.folder).iterdir()} if (place / case.folder).is_dir() else set()
    if case.folder and not names >= FILES:
        found.append(f"the folder holds {sorted(names)}")
    if not case.folder and any(path.name not in ("ro", "gone") for path in place.iterdir()):
        found.append(f"left {sorted(path.name for path in place.iterdir())}")
    return found


def main(words: list[str]) -> int:
    """Try all cases, and print what is wrong; return 1 if anything is."""
    chosen = [case for case in cases() if not words or any(word in case.label for word in words)]
    wrong = 0
    for case in chosen:
        with tempfile.TemporaryDirectory() as name:
            try:
                found = faults(case, Path(name))
            except subprocess.TimeoutExpired:
                found = ["hangs"]
        wrong += bool(found)
        print(f"{'WRONG' if found else 'ok':6s}{case.label!r:.60}  {'; '.join(found)}", flush=True)
    print(f"{wrong} of {len(chosen)} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
