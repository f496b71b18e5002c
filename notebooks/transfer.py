"""Settings of the shipped trades on scenes that no trade has measured: what they promised beside what they come to.

python notebooks/transfer.py pipe-vertical --device cuda      elements: seeds that no trade had, as given and as advised
python notebooks/transfer.py channel tube                     flows: other concretes, flows and diameters, beside theory
"""

import argparse
import itertools
from pathlib import Path

import numpy as np

from warpcrete import Simulation
from warpcrete.core.errors import WarpcreteError
from warpcrete.core.units import number
from warpcrete.scenes import modules
from warpcrete.studies.tradeoffs.advice import SHIPPED, advise
from warpcrete.studies.tradeoffs.fronts import difference

SEEDS = (10, 11, 12)
WANTED = (0.2, 0.1, 0.05, 0.02, 0.01)
ELEMENTS = {
    "as measured, other seeds": {},
    "diameter 0.125 m": {"diameter": 0.125},
    "velocity 0.6 m/s": {"velocity": 0.6},
    "level unit (B)": {"unit": "B"},
    "friction 0.15": {"friction": 0.15},
    "length 0.5 m, travel 0.4 m, ramp 0.2 m": {"length": 0.5, "travel": 0.4, "ramp": 0.2},
    "sizes 8 to 16 mm": {"size_min": 8e-3, "size_max": 16e-3},
}
DIAMETERS = {"channel": (0.08, 0.1, 0.13), "tube": (0.1, 0.13)}


def elements(trade: Path, device: str) -> None:
    """Table of plateau and peak, settings for 5 and 2 % against the scene as it is given."""
    module = modules()["pipe"]
    print("| scene | 5 % wanted: plateau, peak | relative time | 2 % wanted: plateau, peak |\n|---|---|---|---|")
    for name, given in ELEMENTS.items():
        plain, own_time = runs(module, given, device)
        cells, kept = [name], []
        for wanted in (0.05, 0.02):
            advice = advise(trade, "pipe", module, given, wanted)
            found, time = runs(module, given | advice.changes, device)
            errors = [difference(name, found[name], values) for name, values in plain.items()]
            shown = ", ".join(f"{100 * e.shift:+.1f} +- {100 * (e.interval or 0):.1f}" for e in errors)
            cells += [f"{shown} %", f"{time / own_time:.2f}"]
            kept += [abs(e.shift) <= advice.promised for e in errors]
        print("| " + " | ".join(cells[:4]) + f" |  {sum(kept)} of {len(kept)} within what was promised", flush=True)


def runs(module, given: dict, device: str) -> tuple[dict[str, list[float]], float]:
    """Quantities of a run with each seed, and the median time of a run [s]."""
    values: dict[str, list[float]] = {"plateau_pressure": [], "peak_pressure": []}
    times = []
    for seed in SEEDS:
        scene = module.scene(**module.scene.effective_values(module.scene.resolved(given)), seed=seed)
        result = Simulation(scene, device=device, precision=scene.precision).run().result
        for name, found in values.items():
            found.append(number(result[name]))
        times.append(sum(number(result["speed"][part]) for part in ("packing_time", "settling_time", "wall_time")))
    return values, float(np.median(times))


def flows(trade: Path, name: str, device: str) -> None:
    """Every setting of a trade on every other flow: how many stay within what was promised."""
    module, ran = modules()[name], {}
    kept = count = 0
    for wanted, concrete, flow, diameter in itertools.product(
        WANTED, ("no1", "no2", "no3"), (500e-6, 1000e-6, 2500e-6), DIAMETERS[name]
    ):
        given = {"concrete": concrete, "flow": flow, "diameter": diameter}
        try:
            advice = advise(trade, name, module, given, wanted)
        except WarpcreteError:
            continue  # nothing was promised for so little
        key = (*given.values(), tuple(sorted(advice.changes.items())))
        if key not in ran:
            scene = module.scene(**module.scene.effective_values(module.scene.resolved(given) | advice.changes))
            result = Simulation(scene, device=device, precision=scene.precision).run().result
            ran[key] = max(abs(result["pressure_error"]), abs(result["slip_velocity_error"]))
        count += 1
        kept += ran[key] <= advice.promised
    most = max(ran.values())
    print(f"{name}: {kept} of {count} errors of {len(ran)} runs within what was promised, at most {most:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="+", choices=["pipe-vertical", *DIAMETERS])
    parser.add_argument("--device", default="cpu")
    given = parser.parse_args()
    for name in given.names:
        trade = SHIPPED / f"{name}.json"
        elements(trade, given.device) if name not in DIAMETERS else flows(trade, name, given.device)


if __name__ == "__main__":
    main()
