"""Bends and reducers over straight pipe, by flows and by discrete elements, for three concretes.

The page validation/lines-by-elements.md shows the results.

Run as `python notebooks/part_studies.py [out] [--seeds N] [--device cuda]`. Elements run side by side on a
GPU; a concrete whose walls have a layer and no friction needs clumps, as single spheres roll along it.
"""

import argparse
from pathlib import Path

import numpy as np

from warpcrete.core.run.progress import ProgressBar
from warpcrete.core.units import number
from warpcrete.geometry.pipe_line import PipeLine
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.record.checks import failed_checks
from warpcrete.record.loading import load
from warpcrete.studies.lines.elements import Elements, run_elements
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.run import run_line

BENDS = (0.25, 0.5, 1.0)
"""Radii [m]."""
FLOW = 30 / 3600
"""[m3/s]"""


def every_part() -> PipeLine:
    """A line that has every part once: bends of 90 degrees in a pipe of 150 mm, and a reducer to 125 mm."""
    parts: list[dict] = [{"straight": 3.0}]
    for radius, way in zip(BENDS, ("left", "right", "left"), strict=True):
        parts += [{"bend": {"to": way, "radius": radius}}, {"straight": 3.0}]
    parts += [{"reducer": {"to": 0.125, "length": 0.3}}, {"straight": 3.0}]
    return line_of({"name": "every part", "diameter": 0.15, "parts": parts})


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("out", type=Path, nargs="?", default=Path("part-studies"))
    given.add_argument("--concretes", nargs="+", default=["no1", "no2", "no3"])
    given.add_argument("--shapes", default="reference")
    given.add_argument("--coarse", type=float)
    given.add_argument("--stiffer", type=float, default=5.0, help="times the concrete's modulus")
    given.add_argument("--seeds", type=int, default=3)
    given.add_argument("--flow", type=float, default=FLOW, help="[m3/s]")
    given.add_argument("--no-flows", action="store_true")
    given.add_argument("--device")
    options = given.parse_args()
    line = every_part()
    elements = Elements(shapes=options.shapes, coarse=options.coarse, seeds=options.seeds, stiffer=options.stiffer)
    print("| part | concrete | flow | elements | seeds | what leaves over what enters |\n|---|---|---|---|---|---|",
          flush=True)  # fmt: skip
    for name in options.concretes:
        out = options.out / Path(name).stem
        bar = ProgressBar()
        packed = run_elements(line, name, options.flow, elements=elements, out=out, device=options.device,
                              progress=lambda phase, done, bar=bar: bar(phase, done, {}))  # fmt: skip
        bar.close()
        flows = {}
        if not options.no_flows:
            settings = {"out": out / "flows", "device": options.device, "simulate": True}
            found = run_line(line, concrete_of(name), options.flow, **settings)
            flows = {loss.part.loss_key: loss.friction / loss.theory for loss in found.losses}
        runs = [load(folder) for folder in sorted((out / "parts").iterdir())]
        for part in line.parts:
            if part.is_by_length:
                continue
            ratios = [each.ratio(part) for each in packed.packed]
            flux = [number(run.result["flux_ratio"]) for run in runs if _is_of(run, part)]
            spread = f" ± {np.std(ratios, ddof=1) / len(ratios) ** 0.5:.2f}" if len(ratios) > 1 else ""
            flow = f"{flows[part.loss_key]:.3f}" if part.loss_key in flows else ""
            print(f"| {part.label} | {name} | {flow} | {np.mean(ratios):.2f}{spread} | {len(ratios)} | "
                  f"{np.mean(flux):.2f} |", flush=True)  # fmt: skip
        for run in runs:
            if bad := failed_checks(run.result):
                print(f"\n{run.folder}: FAILED {', '.join(bad)}\n")


def _is_of(run, part) -> bool:
    """Return whether `run` is a run of this kind of part."""
    known = run.scene.parameters
    if part.kind == "bend":
        return known["unit"] == "bend-level" and known["elbow_radius"] == part.radius
    return known["outlet_diameter"] == part.outlet


if __name__ == "__main__":
    main()
