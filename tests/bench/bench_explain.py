"""Compare the predictions of `explain` with runs of twelve scenes: wall time, steps, memory.

python tests/bench/bench_explain.py [--device cuda] [--only WORD]
"""

import argparse
import platform

import warp as wp

from warpcrete import Simulation, scenes
from warpcrete.core.device.device import default_threads, find_device
from warpcrete.core.units import number
from warpcrete.studies.tradeoffs.explain import explain

SMALL = dict(diameter=0.1, length=0.5, ramp=0.15, travel=0.3)
SCENES = {
    "pipe": ("pipe", {}),
    "narrow pipe": ("pipe", SMALL),
    "level, layer": ("pipe", SMALL | dict(unit="B", layer_yield=50.0, layer_viscosity=100.0)),
    "bend": ("pipe", SMALL | dict(unit="D", elbow_radius=0.3)),
    "bend, mesh": ("pipe", SMALL | dict(unit="C", elbow_radius=0.3, wall="mesh")),
    "clumps": ("pipe", SMALL | dict(shapes="reference", length=0.3, ramp=0.1, travel=0.2)),
    "no bonds, float64": ("pipe", SMALL | dict(bonds=False, precision="float64")),
    "hydrated, 1e7 Pa": ("pipe", SMALL | dict(hydration=0.05, hydration_modulus=1e7, length=0.3, ramp=0.02,
                                               travel=0.05)),
    "channel": ("channel", {}),
    "fine channel": ("channel", dict(spacing=2e-3)),
    "fine tube": ("tube", dict(spacing=5e-3)),
    "two phases": ("channel", dict(aggregates=True, duration=0.2)),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    wp.config.quiet = True
    device = find_device(given.device)
    where = device.name if device.is_cuda else f"{platform.processor() or 'CPU'}, {default_threads()} threads"
    print(f"{where}; each scene run twice, the second time counts\n")
    print("| scene | particles | time, foretold [s] | run [s] | ratio | steps, foretold | run | memory, foretold [MB] "
          "| run | ratio |\n|---|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for name, (function, parameters) in SCENES.items():
        if given.only not in name:
            continue
        told = explain(getattr(scenes, function)(**parameters), device=given.device, cache=False).forecast
        for _ in range(2):
            scene = getattr(scenes, function)(**parameters)
            run = Simulation(scene, device=given.device, precision=scene.precision).run()
        speed = run.result["speed"]
        spent = sum(number(speed[part]) for part in ("packing_time", "settling_time", "wall_time") if part in speed)
        memory = number(speed["memory"])
        count = run.result.get("spheres") or run.result["particles"]
        print(f"| {name} | {count} | {told.wall_time:.3g} | {spent:.3g} | {told.wall_time / spent:.2f} | "
              f"{told.steps:.0f} | {run.result['steps']} | {told.total_memory / 1e6:.3g} | {memory / 1e6:.3g} | "
              f"{told.total_memory / memory:.2f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
