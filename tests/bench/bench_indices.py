"""Measures what notebooks/validation/wear.md shows: wear of pipe units, and blockage over the width of an orifice.

PYTHONPATH=tests python tests/bench/bench_indices.py wear [--device cuda] | blockage [--seeds 6] | cost
"""

import argparse
import time

import numpy as np
from orifices import orifice
from pumping import SMALL

from warpcrete import Simulation, scenes
from warpcrete.dem.measure.blockage_results import blocked_words
from warpcrete.dem.measure.wear_results import places

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
PIPE = dict(diameter=0.1, length=0.5, travel=0.4, ramp=0.1, elbow_radius=0.3, settle=0.5, size_min=10e-3,
            size_max=20e-3, wear=True)  # fmt: skip
RATIOS = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0)


def wear(device: str | None) -> None:
    """Load times way over the area of the first 0.1 to 0.45 m, all round and by quarters, of the paper's units."""
    print("| shapes | unit | end [kPa] | all round [kN/m] | outside | sides | inside | impacts | mm in 1000 m3 |")
    for shapes in ("spheres", "reference"):
        for unit in UNITS:
            run = Simulation(scenes.pipe(**PIPE, unit=unit, shapes=shapes), device=device).run()
            wall = run.wear.main
            found = places(wall, run.scene)
            assert found is not None
            s, angle = found
            bend, cosine = (s > 0.1) & (s < 0.45), np.cos(angle)
            parts = (cosine < 2, cosine > np.sqrt(0.5), np.abs(cosine) < np.sqrt(0.5), cosine < -np.sqrt(0.5))
            loads = [wall.mean_depth(bend & part) / wall.coefficient / 1e3 for part in parts]
            bumps = run["wear_impact_energy"] / run["wear_sliding_energy"]
            print(f"| {shapes} | {unit} | {run['end_pressure'] / 1e3:.1f} |", " | ".join(f"{x:.2f}" for x in loads),
                  f"| {bumps:.1e} | {1e6 * run['wear_depth_per_volume']:.3f} |", flush=True)  # fmt: skip


def blockage(device: str | None, seeds: int) -> None:
    """How often a funnel is blocked, over its outlet's width."""
    for ratio in RATIOS:
        runs = [Simulation(orifice(ratio, seed), device=device).run() for seed in range(seeds)]
        told = [run["blocked"] for run in runs]
        highest = np.mean([run.series["pressure"].max() for run in runs])
        print(f"| {ratio:g} | {sum(told):.0f} of {seeds} | {highest / 1e3:.0f} kPa |", flush=True)
    run = Simulation(orifice(2.0), device=device).run()
    print(blocked_words(run))


def cost(device: str | None) -> None:
    """Time of a small run with and without each index, best of three."""
    for case in (dict(), dict(wear=True), dict(segregation=True)):
        took = []
        for _ in range(3):
            simulation = Simulation(scenes.pipe(**SMALL, **case), device=device, threads=1)
            simulation.prepare()
            began = time.perf_counter()
            simulation.run()
            took.append(time.perf_counter() - began)
        print(case, f"{min(took):.2f} s", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("wear", "blockage", "cost"))
    parser.add_argument("--device")
    parser.add_argument("--seeds", type=int, default=6)
    given = parser.parse_args()
    if given.what == "blockage":
        blockage(given.device, given.seeds)
    else:
        {"wear": wear, "cost": cost}[given.what](given.device)
