"""Measure the time of each kernel of a step, of an estimate of the stable step and of a rebuild on a GPU, one by one.

    python tests/bench/bench_kernels.py --sizes 10000 100000 1000000 --kinds spheres clumps
    python tests/bench/bench_kernels.py --cases 24

Scenes of `bench_speed.py`, or case A in a batch as in `bench_batch.py`. Prints tables: medians of the launches [us], by
CUDA's events, so with some 2 us for each launch; threads of a block and registers of a thread. In a graph walls run
beside spheres, and launches overlap.
"""

import argparse
import ctypes
import time
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np
import warp as wp
from bench_batch import prepared
from bench_speed import make, ready

from warpcrete.core.device.device import find_device
from warpcrete.core.device.launching import Stage
from warpcrete.dem.engine.launch_planner import NEVER
from warpcrete.dem.engine.stages import step_stages
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.kernels.common.control import ESTIMATED, FAILED, GOAL, HALTED, LATE, STALE, STEPS

REGISTERS = 4
"""CU_FUNC_ATTRIBUTE_NUM_REGS."""


def registers(stage: Stage) -> int | str:
    """Return the number of registers of a thread, or "-" if the driver does not tell it."""
    try:
        handle = stage.kernel.module.load(stage.device, stage.block).get_kernel_hooks(stage.kernel).forward
        found = ctypes.c_int()
        ctypes.CDLL("libcuda.so.1").cuFuncGetAttribute(ctypes.byref(found), REGISTERS, ctypes.c_void_p(handle))
        return found.value
    except (AttributeError, OSError):
        return "-"


def timed(stages: Iterable[Stage]) -> list[tuple[Stage, float]]:
    """Stages, launched one after the other, and what each took [us]."""
    some = list(stages)
    wp.timing_begin(cuda_filter=wp.TIMING_KERNEL)
    for stage in some:
        stage()
    return [(stage, 1e3 * result.elapsed) for stage, result in zip(some, wp.timing_end(), strict=True)]


def table(title: str, passes: Iterable[list[tuple[Stage, float]]]) -> None:
    """Print the median of each stage over the passes."""
    found: dict[Any, list[float]] = defaultdict(list)
    for one in passes:
        for stage, took in one:
            found[stage].append(took)
    print(f"\n{title}\n\n| kernel | threads | block | registers | launches | us |\n|---|---|---|---|---|---|")
    for stage, took in found.items():
        dim = stage.dim if isinstance(stage.dim, int) else int(np.prod(stage.dim))
        print(
            f"| {stage.name} | {dim} | {stage.block} | {registers(stage)} | {len(took)} | {np.median(took):.1f} |",
            flush=True,
        )


def step(stepper: Stepper, count: int = 41):
    """Passes of a step, in which no scene of the batch halts."""
    batch = stepper.batch
    stages = [stage for stage in step_stages(batch)[0] if stage.dim]
    for stage in stages:
        stage.record()
    flags = batch.flags.numpy()
    flags[:, [int(each) for each in (HALTED, STALE, FAILED, LATE)]] = 0
    flags[:, int(GOAL)], flags[:, int(ESTIMATED)] = NEVER, flags[:, int(STEPS)]
    running = wp.array(flags, dtype=wp.int32, device=batch.device)
    rows = batch.rows.copy()
    rows["until"], rows["interval"] = np.inf, NEVER
    batch.scenes.row.assign(rows)
    for turn in range(count):
        wp.copy(batch.flags, running)
        yield timed(stage for stage in stages if turn % stage.every == 0)


def estimate(stepper: Stepper, count: int = 9):
    """Passes of an estimate for all scenes of the batch."""
    stages = stepper.stable_step.kernels()
    for stage in stages:
        stage.record()
    stepper.stable_step._estimate_wanted.fill_(1)
    for _ in range(count):
        yield timed(stages)


def rebuilds(stepper: Stepper, count: int = 4) -> None:
    """Print how long a rebuild takes in all, as a run has it."""
    took = []
    for _ in range(count + 2):  # parts are graphs from the second time on
        wp.synchronize()
        begun = time.perf_counter()
        stepper.rebuild()
        wp.synchronize()
        took.append(1e3 * (time.perf_counter() - begun))
    print(f"\nA rebuild of the lists, ms: {', '.join(f'{each:.2f}' for each in took[2:])}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--sizes", type=int, nargs="*", default=[])
    parser.add_argument("--kinds", nargs="*", default=["spheres"])
    parser.add_argument("--cases", type=int, nargs="*", default=[])
    arguments = parser.parse_args()
    device = find_device(arguments.device)
    if not device.is_cuda:
        raise SystemExit("kernels are timed by CUDA's events: give a GPU as --device")
    for size in arguments.sizes:
        for kind in arguments.kinds:
            stepper = ready(make(kind, size), arguments.device, "float32", 1)
            stepper.take(300)
            report(f"{size} {kind}", stepper)
            del stepper
    for cases in arguments.cases:
        report(f"{cases} cases", prepared(cases, arguments.device)[0].stepper)
    print(f"\n{device.name}, float32; medians of the launches that are told")


def report(title: str, stepper: Stepper) -> None:
    """All tables of one batch."""
    spheres = stepper.batch.sphere_count
    rebuilds(stepper)
    table(f"{title}, {spheres} spheres: a step", step(stepper))
    table(f"{title}: an estimate of the stable step", estimate(stepper))


if __name__ == "__main__":
    main()
