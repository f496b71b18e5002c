"""Cost of a time step on a three-dimensional grid, by resolution: an L-box, and spheres in a sheared mortar.

    python tests/bench/bench_grid.py lbox --device cuda --spacings 8 5 3.5
    python tests/bench/bench_grid.py spheres --device cuda --wide 8 16 25 --fraction 0.4

The first table is of an L-box without aggregates while its concrete flows, after `--until` seconds. The second is of
spheres at random places in a box, four cells across a sphere, with `--wide` spheres along each axis. Both print the
number of cells, the median time of a step in several repeats of `--steps` steps, the time from the first launch to the
end of the first step (which contains the compilation of kernels that are not in the cache), the iterations of the
solves, and the memory that the flow occupies.
"""

import argparse
import time

import numpy as np
import warp as wp

from warpcrete import Simulation, scenes
from warpcrete.core.device.footprint import footprint
from warpcrete.verification.suspensions_many import suspension

COLUMNS = "cells | aggregates | first step [s] | a step [ms] | fastest [ms] | iterations | memory [MB]"


def seconds(flow, steps: int) -> float:
    """Return the time that a number of steps takes [s]."""
    wp.synchronize_device(flow.device)
    start = time.perf_counter()
    flow.take(steps)
    wp.synchronize_device(flow.device)
    return time.perf_counter() - start


def row(flow, first: float, steps: int, repeats: int) -> None:
    """Print one line of a table."""
    times = [seconds(flow, steps) / steps for _ in range(repeats)]
    solves = " ".join(f"{name} {found['iterations']:.0f}" for name, found in flow.outcomes().items())
    bodies = getattr(flow, "aggregates", None)
    median, fastest = 1e3 * np.median(times), 1e3 * min(times)
    count = 0 if bodies is None else bodies.count
    print(f"| {flow.state.slots:,} | {count:,} | {first:.2f} | {median:.2f} | {fastest:.2f} | {solves} | "
          f"{footprint(flow=flow)['flow'] / 1e6:.0f} |", flush=True)  # fmt: skip


def kernels(flow, steps: int) -> None:
    """Print how the time that a GPU spends in kernels is divided among them."""
    wp.timing_begin(cuda_filter=wp.TIMING_KERNEL | wp.TIMING_MEMCPY | wp.TIMING_MEMSET, synchronize=True)
    flow.take(steps)
    spent: dict[str, list[float]] = {}
    for result in wp.timing_end(synchronize=True):
        spent.setdefault(result.name, []).append(result.elapsed)
    print(f"    {sum(map(sum, spent.values())) / steps:8.3f} ms per step in all kernels and copies")
    for name, times in sorted(spent.items(), key=lambda item: -sum(item[1]))[:20]:
        print(f"    {sum(times) / steps:8.3f} ms per step, {len(times) / steps:7.1f} launches: {name}", flush=True)


def lbox(args) -> None:
    """Print the table of an L-box."""
    for spacing in args.spacings:
        scene = scenes.lbox(spacing=spacing * 1e-3, duration=10.0)
        simulation = Simulation(scene, device=args.device, precision=args.precision)
        simulation.begin()
        flow = simulation.flow
        first = seconds(flow, 1)
        while flow.time < args.until:
            flow.take(10)
        row(flow, first, args.steps, args.repeats)
        if args.kernels:
            kernels(flow, args.steps)


def spheres(args) -> None:
    """Print the table of spheres in a sheared mortar."""
    for wide in args.wide:
        flow = suspension(args.fraction, 0, args.device, args.precision, wide=wide, long=wide, rate=args.rate)
        first = seconds(flow, 1)
        row(flow, first, args.steps, args.repeats)
        if args.kernels:
            kernels(flow, args.steps)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=("lbox", "spheres"))
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", default="float32", choices=("float32", "float64"))
    parser.add_argument("--spacings", type=float, nargs="+", default=[25.0], help="cells of the L-box [mm]")
    parser.add_argument("--until", type=float, default=0.3, help="time at which measuring begins [s]")
    parser.add_argument("--wide", type=int, nargs="+", default=[4], help="spheres along an axis of the box")
    parser.add_argument("--fraction", type=float, default=0.4, help="volume fraction of the spheres")
    parser.add_argument("--rate", type=float, default=10.0, help="shear rate of the spheres' mortar [1/s]")
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--kernels", action="store_true", help="also the time of each kernel, on a GPU")
    args = parser.parse_args()
    name = wp.get_device(args.device).name
    print(f"{args.case}, {args.device} ({name}), {args.precision}, {args.repeats} repeats of {args.steps} steps\n")
    print(f"| {COLUMNS} |\n|{'---|' * len(COLUMNS.split(' | '))}")
    (lbox if args.case == "lbox" else spheres)(args)


if __name__ == "__main__":
    main()
