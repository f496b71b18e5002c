"""One concrete by discrete elements, as a flow, and by closed forms: slump, V-funnel, L-box and pipe.

    python notebooks/both_methods.py --device cuda --out both

Writes `both.md` and `both.json` into the new folder; notebooks/validation/both-methods.md shows and discusses them.
Elements follow the mortar law in vessels; in the pipe they are clumps with contacts of Table 1 and the slip layer on
the wall.
"""

import argparse
import json
import math
import time
from pathlib import Path

from warpcrete import Simulation, scenes
from warpcrete.core.units import number
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.simulation import ElementSimulation

DENSITY = 2350.0
CONCRETES = {
    "soft": {"viscosity": 30.0, "yield_stress": 50.0, "slip_viscosity": 1000.0, "slip_yield": 20.0},
    "stiffer": {"viscosity": 50.0, "yield_stress": 200.0, "slip_viscosity": 2000.0, "slip_yield": 40.0},
}
SIZES = {"slump": (6e-3, 9e-3), "funnel": (10e-3, 14e-3), "lbox": (8e-3, 12e-3)}
"""Smallest and largest diameter of the grains [m]."""
DURATION = {"slump": 6.0, "funnel": 30.0, "lbox": 8.0}
OWN: dict[str, dict[str, float]] = {"slump": {"lift_time": 1.0}, "funnel": {}, "lbox": {}}
SHOWN = {"slump": ("slump", "spread"), "funnel": ("funnel_time",), "lbox": ("passing_ratio",)}
BY_THEORY = {"slump": "slump_heap", "spread": "spread_heap", "funnel_time": "funnel_time_theory",
             "passing_ratio": "passing_ratio_theory"}  # fmt: skip
DIAMETER, LENGTH, SPEED, PLUG_PRESSURE = 0.15, 1.0, 0.3, 1e3


def shown(value: object) -> float | None:
    return None if value is None else float(number(value))


def vessels(name: str, constants: dict[str, float], device: str) -> list[dict]:
    """Slump, V-funnel and L-box of a concrete: a row for each quantity."""
    rows = []
    for scene, quantities in SHOWN.items():
        own = {"concrete": "own", "density": DENSITY, **constants}
        flow = Simulation(getattr(scenes, scene)(**own), device=device).run().result
        low, high = SIZES[scene]
        made = getattr(scenes, f"{scene}_dem")(
            law="mortar", bulk_density=DENSITY, size_min=low, size_max=high, duration=DURATION[scene],
            viscosity=constants["viscosity"], yield_stress=constants["yield_stress"],
            **OWN[scene],
        )  # fmt: skip
        grains = run_batch([ElementSimulation(made, device=device)])[0]
        if isinstance(grains, BaseException):
            raise grains
        for each in quantities:
            rows.append({"concrete": name, "quantity": each, "elements": shown(grains.result.get(each)),
                         "flow": shown(flow.get(each)), "theory": shown(flow.get(BY_THEORY[each]))})  # fmt: skip
    return rows


def pipes(device: str) -> list[dict]:
    """Stress on the wall of a level pipe, of all concretes at once [Pa]."""
    layers = [
        {"layer_viscosity": c["slip_viscosity"], "layer_yield": c["slip_yield"], "wall_friction": 0.0}
        for c in CONCRETES.values()
    ]
    units = [
        scenes.pipe(unit="horizontal", shapes="reference", velocity=SPEED, bulk_density=DENSITY, **layer)
        for layer in layers
    ]
    runs = run_batch([ElementSimulation(unit, device=device) for unit in units])
    rows = []
    for (name, constants), run in zip(CONCRETES.items(), runs, strict=True):
        if isinstance(run, BaseException):
            raise run
        area = math.pi * DIAMETER**2 / 4
        own = {"concrete": "own", "density": DENSITY, **constants}
        tube = scenes.tube(**own, diameter=DIAMETER, flow=SPEED * area, gravity=0.0, ends="periodic")
        flow = Simulation(tube, device=device).run().result
        # The plug at the end holds the concrete back by its own pressure, which is not the wall's.
        elements = (number(run.result["end_pressure"]) - PLUG_PRESSURE) / LENGTH
        both = [4 * number(flow[key]) / DIAMETER for key in ("wall_stress", "wall_stress_theory")]
        rows.append({"concrete": name, "quantity": "pressure_per_metre", "elements": elements,
                     "flow": both[0], "theory": both[1]})  # fmt: skip
    return rows


def main() -> None:
    reader = argparse.ArgumentParser(description="One concrete by both methods")
    reader.add_argument("--device", default="cuda")
    reader.add_argument("--out", type=Path, required=True)
    given = reader.parse_args()
    given.out.mkdir(parents=True)
    start = time.perf_counter()
    rows = pipes(given.device)
    for name, constants in CONCRETES.items():
        rows += vessels(name, constants, given.device)
    (given.out / "both.json").write_text(json.dumps(rows, indent=1))
    lines = ["| concrete | quantity | elements | flow | theory |", "|---|---|---|---|---|"]
    for row in rows:
        values = [f"{row[key]:.4g}" if row[key] is not None else "-" for key in ("elements", "flow", "theory")]
        lines.append(f"| {row['concrete']} | {row['quantity']} | {' | '.join(values)} |")
    (given.out / "both.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines), f"\n{time.perf_counter() - start:.0f} s on {given.device}")


if __name__ == "__main__":
    main()
