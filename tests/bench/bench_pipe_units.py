"""The paper's four pipe units, ours beside the published figures: a table, and a figure.

    python tests/bench/bench_pipe_units.py --device cuda --out units      # clumps on a GPU, about half a minute
    python tests/bench/bench_pipe_units.py --device cpu --shapes spheres  # about a minute and a half a unit

Prints device, sizes, repeats (seeds), the Markdown table of notebooks/validation/pumping.md, and what each run took.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from warpcrete import Simulation, scenes
from warpcrete.core.drawing.style import MEASURED, SERIES, legend_above, new_figure, open_frame, rgb
from warpcrete.core.run.run import Run
from warpcrete.dem.scene.scene import Published

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
PAPER = {unit: scenes.pipe(unit=unit, shapes="reference").published or Published(source="") for unit in UNITS}
LETTER = dict(zip(PAPER, "ABCD"))


def measure(unit: str, shapes: str, device: str, seed: int) -> tuple[Run, float]:
    """One run and the time it took, from the scene to the result [s]."""
    begun = time.perf_counter()
    travel = 0.25 * np.pi  # the elbow's arc, for all four
    run = Simulation(
        scenes.pipe(concrete="zhan-table1", unit=unit, shapes=shapes, seed=seed, travel=travel), device=device
    ).run()
    return run, time.perf_counter() - begun


def beside(ours: float, paper: float | None) -> str:
    """Ours in kPa, the paper's and the ratio."""
    return f"{ours / 1e3:.1f} | {paper / 1e3:.2f} | {ours / paper:.2f}" if paper else f"{ours / 1e3:.1f} | - | -"


def main() -> None:
    """Run, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--shapes", default="reference")
    parser.add_argument("--units", nargs="*", default=list(PAPER))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for units.json and units.png")
    arguments = parser.parse_args()
    print("| unit | peak, ours [kPa] | paper | ratio | end, ours [kPa] | paper's plateau | ratio | at [m] | took [s] |")
    print("|---|---|---|---|---|---|---|---|---|")
    runs: dict[str, Run] = {}
    rows = []
    for unit in arguments.units:
        for seed in range(arguments.seeds):
            run, took = measure(unit, arguments.shapes, arguments.device, seed)
            result = run.result
            peak, plateau = result["peak_pressure"]["value"], result["end_pressure"]["value"]
            at = result["peak_travel"]["value"]
            paper = PAPER[unit]
            print(
                f"| {LETTER[unit]} {unit}{f', seed {seed}' if seed else ''} | {beside(peak, paper.peak)} | "
                f"{beside(plateau, paper.plateau)} | {at:.3f} | {took:.0f} |",
                flush=True,
            )
            runs.setdefault(f"{LETTER[unit]} {unit}", run)
            columns = {name: run.series[name].tolist() for name in ("time", "travel", "pressure")}
            rows.append(dict(unit=unit, seed=seed, took=took, result=result, series=columns))
    last = rows[-1]["result"]
    print(
        f"\ndevice: {last['provenance']['device_name']}; {last['bodies']} bodies, {last['spheres']} spheres; "
        f"repeats: {arguments.seeds} seed(s)"
    )
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "units.json").write_text(json.dumps(rows, default=float), encoding="utf-8")
        figure(rows).savefig(arguments.out / "units.png", dpi=150)


def figure(rows: list[dict]):
    """Pressure against travel of all units, with the figures that the paper's text gives."""
    pipe = scenes.pipe(concrete="zhan-table1").pipe
    flow = 3600 * np.pi * pipe.radius**2 * pipe.velocity
    drawing = new_figure(
        f"pipe units, diameter {2e3 * pipe.radius:g} mm, concrete zhan-table1, {flow:.3g} m3/h"
    )  # fmt: skip
    axes = drawing.add_subplot()
    for row in rows:
        if row["seed"]:
            continue
        colour = rgb(SERIES[UNITS.index(row["unit"])])
        axes.plot(
            row["series"]["travel"], np.array(row["series"]["pressure"]) / 1e3, color=colour,
            label=f"{LETTER[row['unit']]} {row['unit']}",
        )  # fmt: skip
        paper = PAPER[row["unit"]]
        if paper.peak_travel is not None:
            axes.plot(paper.peak_travel, paper.peak / 1e3, "+", color=colour, markersize=11, mew=2)
            axes.axhline(paper.plateau / 1e3, color=colour, linestyle=":")
    axes.plot([], [], "+", color=rgb(MEASURED), markersize=9, label="peak in the paper's text")
    axes.plot([], [], ":", color=rgb(MEASURED), label="plateau in the paper's text")
    axes.set(xlabel="piston travel [m]", ylabel="pressure on the piston [kPa]", ylim=(0, None), xlim=(0, None))
    open_frame(axes)
    legend_above(axes)
    return drawing


if __name__ == "__main__":
    main()
