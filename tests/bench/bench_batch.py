"""Batches of paper-sized pumping cases: time of one, of many side by side, and of the paper's whole parametric study.

    python tests/bench/bench_batch.py --device cuda --sizes 1 8 32 128 --steps 2000
    python tests/bench/bench_batch.py --device cuda --study

Prints the time of a step of 1 to N cases (clumps, bonds, analytic pipe, case A) taken at the start of pumping, as runs
take them, samples apart: lists rebuilt, stable steps estimated; after as many untimed, in which graphs are captured.
With --study prints how long the paper's 27 cases and its four units take, run to their ends as batches.
"""

import argparse
import time

import numpy as np
import warp as wp

from warpcrete import Simulation, scenes
from warpcrete.core.run.coroutines import Until
from warpcrete.core.run.run import Run
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.engine.scheduling import drive_batches

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")

# Zhan et al. 2019, section 5.2: each parameter alone, on unit D unless its own is named.
STUDY = {
    "diameter": [0.100, 0.125, 0.150, 0.175, 0.200],
    "elbow_radius": [0.25, 0.5, 0.75, 1.0],
    "velocity": [0.1, 0.3, 0.5, 0.7, 0.9],
    "size_max": [20e-3, 30e-3, 40e-3],
    "shapes": ["shape-1.5", "shape-2.5", "shape-3.5", "shape-4.5"],
    "hydration": [0.0, 0.05, 0.1, 0.2],
    "friction": [0.05, 0.3],
}
OWN = {"diameter": 0.150, "elbow_radius": 0.5, "velocity": 0.3, "size_max": 20e-3, "hydration": 0.0, "friction": 0.05}
"""Values that all other cases have."""


def cases() -> list[dict]:
    """Parameters of the whole study: 27 cases and the four units, of which those on unit D's own values are one."""
    base = dict(concrete="zhan-table1", unit="bend-to-vertical", shapes="reference", **OWN)
    found = [base | {name: value} for name, values in STUDY.items() for value in values]
    found += [base | {"unit": unit} for unit in UNITS]
    return list({tuple(case.items()): case for case in found}.values())


def prepared(count: int, device: str) -> list[Simulation]:
    """Case A with `count` velocities around 0.3 m/s, packed, bonded and driven to the start of pumping."""
    simulations = [
        Simulation(
            scenes.pipe(
                concrete="zhan-table1", shapes="reference", velocity=0.3 + 1e-3 * k, travel=1e-3, ramp=0.0, settle=0.3
            ),
            device=device,
            threads=1,
        )
        for k in range(count)
    ]
    for outcome in run_batch(simulations):
        if not isinstance(outcome, Run):
            raise outcome
    return simulations


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sizes", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--study", action="store_true")
    parser.add_argument("--skip", nargs="*", default=[], help="parameters of the study to leave out, as hydration")
    arguments = parser.parse_args()
    if arguments.study:
        whole_study(arguments.device, [c for c in cases() if all(c[name] == OWN[name] for name in arguments.skip)])
        return
    print("| cases | spheres | time of a step [us] | over one case | sphere-steps/s [million] |")
    print("|---|---|---|---|---|")
    first = None
    for size in arguments.sizes:
        simulations = prepared(size, arguments.device)
        spheres = np.array([s.state.sphere_count for s in simulations])
        took, rates = [], []
        for _ in range(arguments.repeats + 1):
            wp.synchronize()
            before = np.array([s.stepper.steps for s in simulations])
            begun = time.perf_counter()
            scenes_of_batch = {k: (s.stepper, _on(s.stepper, arguments.steps)) for k, s in enumerate(simulations)}
            drive_batches([(scenes_of_batch, None)], regroups=False)
            wp.synchronize()
            spent = time.perf_counter() - begun
            done = np.array([s.stepper.steps for s in simulations]) - before
            took.append(spent / done.mean())
            rates.append(float(np.sum(spheres * done)) / spent / 1e6)
        step = float(np.median(took[1:]))
        first = first or step
        print(
            f"| {size} | {spheres.sum()} | {1e6 * step:.1f} | {step / first:.2f} | {np.median(rates[1:]):.0f} |",
            flush=True,
        )
        del simulations
    print(f"\n{wp.get_device(arguments.device).name}; {arguments.steps} steps, medians of {arguments.repeats}")


def _on(stepper, count: int):
    """Coroutine: on by the time of so many steps of the present size."""
    yield Until(stepper.time + count * stepper.dt)


def whole_study(device: str, cases: list[dict]) -> None:
    """Run all cases to their ends and print what they came to."""
    simulations = [Simulation(scenes.pipe(**case), device=device, threads=1) for case in cases]
    begun = time.perf_counter()
    outcomes = run_batch(simulations)
    took = time.perf_counter() - begun
    spent = [s.wall_times.phases for s in simulations]
    for case, outcome in zip(cases, outcomes):
        if isinstance(outcome, Run):
            r = outcome.result
            print(
                {name: value for name, value in case.items() if OWN.get(name) != value},
                f"peak {r['peak_pressure']['value'] / 1e3:.1f} end {r['end_pressure']['value'] / 1e3:.1f} kPa,"
                f" {r['steps']} steps, {r['spheres']} spheres",
            )
        else:
            print(case, type(outcome).__name__, str(outcome)[:150])
    print(
        f"{len(simulations)} cases, {took:.0f} s in all, packing {sum(s.get('packing', 0) for s in spent):.0f} of it, "
        f"on {wp.get_device(device).name}"
    )


if __name__ == "__main__":
    main()
