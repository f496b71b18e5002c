r"""Three bulk processes of Dosta et al. 2024 (Computer Physics Communications 296, 109066): results and run times.

    python tests/bench/bench_bulk.py --device cuda --steps paper --total 75 --coordinates coordinates \
        --runs impact-25k impact-50k impact-100k --out impact.json
    python tests/bench/bench_bulk.py --device cuda --total 150 --coordinates coordinates \
        --runs silo-large-M1:50 drum:45 silo-small-M1:30 silo-large-M2:30 --out flow.json
    python tests/bench/bench_bulk.py --device cpu --coarse 3 --runs silo-large-M1:60

A run may have a limit of wall time in seconds after a colon. Every run pours its own bed, unless the folder
--coordinates holds the file of the benchmark (Zenodo 10.5281/zenodo.8252892): 25KParticles.txt, PartCoordinates.txt for
the drum, `PartCoordinates M1 (large orifice).txt` for a silo. With --coarse C, spheres are C times as large and C^3
times fewer, to try a run on a CPU. The time step is automatic, or that of the paper (--steps paper).

Prints what the paper compares. Wall time begins at t = 0, after pouring and compiling, and includes measuring. The
paper deletes spheres that have left the silo, here they lie on a floor and still cost time.
"""

import argparse
import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from bulk import Drum, Impact, Measured, Process, Silo, measured, poured, read

from warpcrete.core.device.device import find_device

DURATIONS = {"impact": 0.1, "silo": 5.0, "drum": 5.0}  # [s]


def process_of(name: str, coarse: float) -> tuple[Process, str]:
    """Return the process of a name such as `silo-small-M2`, and the name of its file of coordinates."""
    kind, *others = name.split("-")
    fewer = coarse**-3
    if kind == "impact":
        count = 1000 * int(others[0].removesuffix("k"))
        return Impact(count=round(count * fewer), size=0.002 * coarse), f"{count // 1000}KParticles.txt"
    if kind == "drum":
        counts = round(30_000 * fewer), round(8000 * fewer)
        return Drum(counts=counts, sizes=(0.002 * coarse, 0.004 * coarse)), "PartCoordinates.txt"
    made = Silo(orifice=others[0], material=others[1], count=round(100_000 * fewer), size=0.004 * coarse)
    return made, f"PartCoordinates {made.material} ({made.orifice} orifice).txt"


def measure_of(process: Process):
    """Return the function that measures a process from the positions of its bodies."""
    if isinstance(process, Impact):
        return lambda places: float(places[-1, 2])
    if isinstance(process, Silo):
        return lambda places: int((places[:, 2] > process.low).sum())

    def zones(places: np.ndarray) -> list[int]:
        # The spheres of M2 come first, because they are poured first; a file lists them in the order of their radii.
        large = np.zeros(len(places), bool)
        large[: process.counts[1]] = True
        upper = (places[:, 0] > 0) & (places[:, 2] > 0)
        lower = (places[:, 0] < 0) & (places[:, 2] < 0)
        return [int((zone & kind).sum()) for zone in (upper, lower) for kind in (~large, large)]

    return zones


def summary(process: Process, found: Measured) -> dict[str, float]:
    """Return the numbers of a run that are compared with other programs."""
    times, rows = np.array(found.times), np.array(found.rows, dtype=float)
    if isinstance(process, Impact):
        low = int(rows.argmin())
        return {"deepest [m]": rows[low], "at [s]": times[low], "at the end [m]": rows[-1]}
    if isinstance(process, Silo):
        flows = (times >= 0.5) & (times <= 3.5) & (rows > 0.02 * rows[0])
        slope = -np.polyfit(times[flows], rows[flows], 1)[0] if flows.sum() > 2 else math.nan
        empty = times[rows <= 0]
        return {"rate [1/s]": slope, "above at 2 s": float(np.interp(2.0, times, rows)) if times[-1] >= 2 else math.nan,
                "empty at [s]": float(empty[0]) if len(empty) else math.nan, "left": rows[-1]}  # fmt: skip
    small = rows[:, 2]
    high = int(small[: np.searchsorted(times, 1.2)].argmax())
    after = high + int(small[high : high + 13].argmin())
    again = after + int(small[after : after + 13].argmax())
    return {"first peak": small[high], "at [s]": times[high], "first trough": small[after], "trough at [s]":
            times[after], "second peak": small[again], "second peak at [s]": times[again]}  # fmt: skip


def run_one(text: str, arguments, left: float) -> dict:
    """Prepare and run one process in at most `left` seconds; return its name, figures and curves."""
    started = time.perf_counter()
    name, _, limit = text.partition(":")
    process, file = process_of(name, arguments.coarse)
    given = arguments.coordinates / file if arguments.coordinates else None
    begun = time.perf_counter()
    if given is not None and given.exists() and arguments.coarse == 1:
        bed, spheres = "published", read(given, process)
        spheres.sort(key=lambda each: -each[1])
    else:
        bed, spheres = "poured", poured(process, seed=arguments.seed, device=arguments.device)
    prepared = time.perf_counter() - begun
    duration = arguments.duration or DURATIONS[name.split("-")[0]]
    made = process.scene(spheres, duration, process.step if arguments.steps == "paper" else None)
    if not isinstance(process, Impact):
        made = replace(made, sample_interval=min(0.1, duration / 10))
    begun = time.perf_counter()
    most = min(float(limit or "inf"), left - (begun - started))
    found = measured(made, measure_of(process), arguments.device, most)
    wall, bodies = found.clock[-1] - found.clock[0], sum(len(places) for _, _, places in spheres)
    return {
        "run": name, "bed": bed, "spheres": bodies, "seed": arguments.seed, "prepared [s]": prepared,
        "compiled [s]": found.clock[0] - begun, "wall [s]": wall, "simulated [s]": found.times[-1],
        "steps": found.steps, "million sphere-steps/s": bodies * found.steps / max(wall, 1e-9) / 1e6,
        **summary(process, found), "times": found.times, "rows": found.rows,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--runs", nargs="+", default=["impact-25k"])
    parser.add_argument("--coarse", type=float, default=1.0)
    parser.add_argument("--steps", choices=("automatic", "paper"), default="automatic")
    parser.add_argument("--coordinates", type=Path)
    parser.add_argument("--duration", type=float, help="simulated time [s]; default: that of the paper")
    parser.add_argument("--total", type=float, default=math.inf, help="wall time of all runs together [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file to which figures and curves are written as JSON")
    arguments = parser.parse_args()
    print(find_device(arguments.device).name, flush=True)
    results, begun = [], time.perf_counter()
    for text in arguments.runs:
        left = arguments.total - (time.perf_counter() - begun)
        if left < 0:
            print(f"no time left for {text}")
            continue
        result = run_one(text, arguments, left)
        results.append(result)
        print(", ".join(f"{key} {value:.6g}" if isinstance(value, float) else f"{key} {value}"
                        for key, value in result.items() if not isinstance(value, list)), flush=True)  # fmt: skip
        if arguments.out:
            arguments.out.write_text(json.dumps(results), encoding="utf-8")


if __name__ == "__main__":
    main()
