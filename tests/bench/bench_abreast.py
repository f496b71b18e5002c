"""Flows side by side on a GPU: how long so many take, over one alone.

    python tests/bench/bench_abreast.py --flows 1 8 64 --repeats 3

Prints a table: wall time of the runs, without placing, compiling and the first steps, over that of one.
"""

import argparse
import time

import warp as wp

import warpcrete
from warpcrete import scenes
from warpcrete.core.device.device import find_device
from warpcrete.mps.common.stepping import run_abreast

CASES = {
    "channel, piston, 5 mm": lambda k: scenes.channel(duration=0.1, flow=1.5e-3 * (1 + 0.002 * k)),
    "channel, periodic, 5 mm": lambda k: scenes.channel(ends="periodic", duration=0.1, flow=1.5e-3 * (1 + 0.002 * k)),
    "tube, periodic, 5 mm": lambda k: scenes.tube(ends="periodic", spacing=5e-3, duration=0.1,
                                                  flow=1.5e-3 * (1 + 0.002 * k)),
    "bend, 10 mm": lambda k: scenes.part(duration=0.2, steadiness=1e-12, flow=1.5e-3 * (1 + 0.002 * k)),
}  # fmt: skip


def measured(make, count: int, device: str) -> float:
    """Wall time of so many runs together [s]."""
    simulations = [warpcrete.Simulation(make(k), device=device) for k in range(count)]
    for simulation in simulations:
        simulation.prepare()
        simulation.flow.take(20)  # graphs of the usual sizes
    wp.synchronize()
    begun = time.perf_counter()
    outcomes = run_abreast(simulations, [None] * count, lambda phase, fraction: None)
    for outcome in outcomes:
        if isinstance(outcome, BaseException):
            raise outcome
    return time.perf_counter() - begun


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flows", type=int, nargs="+", default=[1, 8, 64])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--device", default=None)
    given = parser.parse_args()
    device = find_device(given.device)
    print(f"{device.name}, best of {given.repeats}")
    print("| flow | " + " | ".join(f"{n}: s (over one)" for n in given.flows) + " |")
    print("| --- |" + " --- |" * len(given.flows))
    for name, make in CASES.items():
        best = [min(measured(make, n, str(device)) for _ in range(given.repeats)) for n in given.flows]
        print(f"| {name} | " + " | ".join(f"{t:.2f} ({t / best[0]:.1f})" for t in best) + " |", flush=True)


if __name__ == "__main__":
    main()
