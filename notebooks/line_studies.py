"""A line of 3 m by discrete elements, as one scene and from its parts, for three concretes.

The page validation/lines-by-elements.md shows the results.

Run as `python notebooks/line_studies.py [out] [--seeds N] [--device cuda]`.
"""

import argparse
from pathlib import Path

import numpy as np

from warpcrete.core.run.progress import ProgressBar
from warpcrete.core.units import number
from warpcrete.geometry.lines import read_line
from warpcrete.methods import Simulation, method_of
from warpcrete.record.checks import CheckRecorder, failed_checks
from warpcrete.record.run_folder import TableRecorder
from warpcrete.scenes import modules
from warpcrete.studies.lines.elements import SCENE, Elements, run_elements, scaled_parameters

LINE = """name: three metres
diameter: 125 mm
parts:
  - straight: 0.6 m
  - bend: {to: left, radius: 0.5 m}
  - straight: 0.6 m
  - reducer: {to: 100 mm, length: 0.4 m}
  - straight: 0.6 m
"""


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("out", type=Path, nargs="?", default=Path("line-studies"))
    given.add_argument("--concretes", nargs="+", default=["no1", "no2", "no3"])
    given.add_argument("--shapes", default="reference")
    given.add_argument("--coarse", type=float)
    given.add_argument("--stiffer", type=float, default=5.0)
    given.add_argument("--seeds", type=int, default=3)
    given.add_argument("--flow", type=float, default=9 / 3600, help="[m3/s]")
    given.add_argument("--travel", type=float, default=0.5, help="of the piston in the whole line [m]")
    given.add_argument("--no-parts", action="store_true")
    given.add_argument("--device")
    options = given.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "line.yaml"
    file.write_text(LINE)
    line = read_line(str(file))
    elements = Elements(shapes=options.shapes, coarse=options.coarse, seeds=options.seeds, stiffer=options.stiffer)
    print("| concrete | from its parts [kPa] | as one scene | outflow over inflow | wall time [s]: parts, one scene |\n"
          "|---|---|---|---|---|", flush=True)  # fmt: skip
    for name in options.concretes:
        out, bar = options.out / Path(name).stem, ProgressBar()
        pressures, elapsed = [], 0.0
        if not options.no_parts:
            parts = run_elements(line, name, options.flow, elements=elements, out=out, device=options.device,
                                 progress=lambda phase, done, bar=bar: bar(phase, done, {}))  # fmt: skip
            pressures, elapsed = parts.pressures, parts.elapsed
        whole = []
        for seed in range(options.seeds):
            own = {"concrete": name, "line": str(file), "flow": options.flow, "gravity": 0.0, "seed": seed,
                   "travel": options.travel, "shapes": options.shapes, "sample_interval": 0.02}  # fmt: skip
            scene = modules()[SCENE].scene(**scaled_parameters(own, 0.1, elements))
            recorders = [TableRecorder(out / f"whole-{seed}"), CheckRecorder(modules()[SCENE].check)]
            whole.append(Simulation(scene, device=options.device, recorders=recorders))
        runs = method_of(whole[0].scene).run_many(
            whole, [None] * len(whole), lambda phase, done, bar=bar: bar(phase, done, {})
        )
        bar.close()
        for run in runs:
            if isinstance(run, BaseException):
                raise run
            if bad := failed_checks(run.result):
                print(f"\n{run.folder}: FAILED {', '.join(bad)}\n")
        pressed = [number(run.result["end_pressure"]) for run in runs]
        left = [number(run.result["flux_ratio"]) for run in runs]
        took = max(number(run.result["speed"]["wall_time"]) for run in runs)
        print(f"| {name} | {_spread(pressures)} | {_spread(pressed)} | {np.mean(left):.2f} | "
              f"{elapsed:.0f}, {took:.0f} |", flush=True)  # fmt: skip


def _spread(pressures: list[float]) -> str:
    """Mean and standard deviation in kPa."""
    if not pressures:
        return "-"
    spread = f" ± {np.std(pressures, ddof=1) / 1e3:.2g}" if len(pressures) > 1 else ""
    return f"{np.mean(pressures) / 1e3:.4g}{spread}"


if __name__ == "__main__":
    main()
