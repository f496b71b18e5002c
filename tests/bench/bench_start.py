"""Start-up: import, the first step of a run with a cold and with a warm kernel cache.

python tests/bench/bench_start.py --device cpu --repeats 3
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

START = """
import time
begun = time.perf_counter()
from warpcrete.scenes import pipe
from warpcrete import Simulation
simulation = Simulation(pipe({options}), device={device!r})
simulation.prepare()
print("first step after", time.perf_counter() - begun)
"""
SMALL = "length=0.12, diameter=0.08, ramp=0.02, travel=0.002, settle=0.0, size_min=8e-3, size_max=16e-3"

PLAIN = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
"""Environment as a user has it, in which Python keeps the bytecode that it compiles from the sources."""


def timed(code: str, **environment: str) -> tuple[float, str]:
    """Wall time of a fresh Python process [s], and what it printed."""
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True, env=PLAIN | environment
    )
    return time.perf_counter() - begun, done.stdout


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    bare = float(np.median([timed("pass")[0] for _ in range(arguments.repeats)]))
    whole = "import warpcrete; warpcrete.Simulation; warpcrete.scenes"
    rows = {"import warpcrete": "import warpcrete", "with Simulation and scenes": whole}
    print("| what | seconds |\n|---|---|")
    for label, code in rows.items():
        took = float(np.median([timed(code)[0] for _ in range(arguments.repeats)])) - bare
        print(f"| {label} | {took:.2f} |", flush=True)
    code = START.format(options=SMALL, device=arguments.device)
    with tempfile.TemporaryDirectory() as cache:
        took, _ = timed(code, WARP_CACHE_PATH=cache)
        print(f"| to the first step of a small pumping run (packed, bonded), cold kernel cache | {took - bare:.1f} |")
        took = float(np.median([timed(code, WARP_CACHE_PATH=cache)[0] for _ in range(arguments.repeats)]))
        print(f"| the same, warm cache | {took - bare:.1f} |")
    print(f"\n{arguments.device}; medians of {arguments.repeats}; a bare Python takes {bare:.2f} s")


if __name__ == "__main__":
    main()
