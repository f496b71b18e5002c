"""A study of many cases on one and on several workers of Dask: a worker is a GPU, or a core.

    python tests/bench/bench_cluster.py --device cuda --cases 64 --workers 1 2
    python tests/bench/bench_cluster.py --cases 4 --travel 0.01 --workers 1 2

Whole runs of the default pumping scene with so many seeds, through the command, folders and reports included; prints
the time of each study, from the second start of its kernels on, and whether all hold the same bits.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from warpcrete.core.device.device import find_device


def study(folder: Path, cases: int, arguments, *more: str) -> float:
    """Run a study; returns the time that the command took [s]."""
    command = [sys.executable, "-c", "from warpcrete.cli import main; main()", "study", "pipe", "--quiet"]
    command += ["--repeat", str(cases), "--device", arguments.device, "--out", str(folder), *more]
    if arguments.travel:
        command += ["--travel", str(arguments.travel)]
    begun = time.perf_counter()
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    took = time.perf_counter() - begun
    if done.returncode not in (0, 3):  # 3: all have ended, a check of one has failed
        raise SystemExit(f"{' '.join(command[3:])}: {done.stderr[-2000:]}")
    return took


def hashes(folder: Path) -> list[str]:
    """Return the hashes of the cases' last states, in the order of the cases."""
    found = sorted(folder.glob("**/result.json"))
    return [json.loads(path.read_text(encoding="utf-8"))["state_hash"] for path in found]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cases", type=int, default=4)
    parser.add_argument("--travel", type=float, help="of the piston [m]; as the scene has it, if left out")
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    arguments = parser.parse_args()
    print("| workers | study [s] | over the first |\n|---|---|---|")
    first, bits = 0.0, []
    with tempfile.TemporaryDirectory() as parent:
        study(Path(parent) / "warm", 2, arguments)
        for count in (0, *arguments.workers):
            folder = Path(parent) / f"{count}"
            scheduler = ("--scheduler", "local", "--workers", str(count)) if count else ()
            took = study(folder, arguments.cases, arguments, *scheduler)
            first = first or took
            bits.append(hashes(folder))
            print(f"| {count or 'none, without Dask'} | {took:.1f} | {first / took:.2f} |", flush=True)
    same = all(each == bits[0] for each in bits) and len(bits[0]) == arguments.cases
    print(f"\n{arguments.cases} cases on {find_device(arguments.device).name}; same bits: {'yes' if same else 'NO'}")


if __name__ == "__main__":
    main()
