"""How often a reducer is blocked, over the bore in stones and over the share of stones in the concrete.

Each stone is a hard core in a shell of Bingham mortar (contact law `mortar`). The shells are so thick that the cores
fill the given share of the volume when the shells are packed. The reducer narrows from 1.3 times its outlet. A run
counts as blocked if part of the concrete stands still during 0.7 diameters of piston travel while the pressure rises.

With `--inlet 5`, all reducers begin with a pipe five stones wide and narrow at 45 degrees. Part of the concrete must
then stand still during 1.75 stones of piston travel.

    python notebooks/blocking_map.py --device cpu --seeds 2 --ratios 2 3 --shares 0.3 0.5      small, on a CPU
    python notebooks/blocking_map.py --device cuda --seeds 20                                  whole map, on a GPU
    python notebooks/blocking_map.py --device cpu --seeds 6 --inlet 5 --ratios 1.5 2 2.5 3 4 --shares 0.3 0.4 0.5 0.55
    timeout -s INT 240 python notebooks/blocking_map.py --device cuda --seeds 20 --out FOLDER  in slices
    timeout -s INT 240 python notebooks/blocking_map.py --resume FOLDER                              as often as needed

The runs are a study in the folder `--out`, which Ctrl-C interrupts (`timeout -s INT` sends the same signal) and
`--resume FOLDER` continues. An interrupted command prints the map so far.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from warpcrete import scenes
from warpcrete.core.run.files import next_folder
from warpcrete.core.units import number
from warpcrete.studies.cases import Case
from warpcrete.studies.study import resume_study, run_listed
from warpcrete.studies.study_result import Study
from warpcrete.theory.bands import wilson_interval

STONE = 0.016
"""Diameter of the stones, without mortar [m]; their sizes are spread by a tenth."""
PACKED = 0.60
"""Share of the volume that the spheres with their shells fill in the pipe."""
SPEED = 0.3
"""Speed of the piston [m/s]."""
SAMPLE_TRAVEL = 0.09
"""Travel of the piston between two samples [diameters of the inlet].

Checks for blockage are at least :data:`BLOCKED_TRAVEL` / 8 apart. A little more makes a check of every sample.
"""
BLOCKED_TRAVEL = 0.7
"""Travel of the piston during which part of a blocked concrete stands still [diameters of the inlet]."""
BLOCKED_STONES = 1.75
"""Travel of the piston during which part of a blocked concrete stands still, if `--inlet` is given [stones]."""
RATIOS = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0)
SHARES = (0.30, 0.40, 0.50, 0.55, 0.59)
MORTAR = dict(contact="mortar", contact_effective_modulus=2e6, contact_friction=0.5, contact_shell_modulus=5e5,
              contact_yield_stress=50.0, contact_plastic_viscosity=5.0)  # fmt: skip
"""Cores of 2 MPa with the friction of dry stones, in a mortar of 50 Pa and 5 Pa s.

The shells are stiff. Soft shells would let the piston push the stones together while the front stands still, but mortar
is incompressible and cannot leave a full pipe.
"""


def shell(share: float) -> float:
    """Return the thickness of two shells over the distance of two centres, for a `share` of stones in the volume."""
    return 1 - (share / PACKED) ** (1 / 3)


def parameters(ratio: float, share: float, seed: int, inlet: float | None = None) -> dict[str, Any]:
    """Return the parameters of a run: an outlet `ratio` stones wide, and a `share` of stones in the concrete.

    `inlet` is the width of the inlet in stones; None means 1.3 times that of the outlet, and a longer cone.
    """
    outlet = ratio * STONE
    wide, size = (1.3 * outlet if inlet is None else inlet * STONE), STONE / (1 - shell(share))
    taper = outlet if inlet is None else (wide - outlet) / 2
    travel, blocked = (2.5 * wide, BLOCKED_TRAVEL * wide) if inlet is None else (2 * wide, BLOCKED_STONES * STONE)
    interval = SAMPLE_TRAVEL / BLOCKED_TRAVEL * blocked / SPEED
    return dict(
        unit="horizontal", diameter=wide, outlet_diameter=outlet, taper=taper, straight=wide, travel=travel,
        ramp=0.25 * wide, flow=SPEED * math.pi * wide**2 / 4, sizes="uniform", size_min=0.9 * size,
        size_max=1.1 * size, solid_fraction=PACKED, plug_ball=STONE / 2, bonds=False, gravity=0.0, settle=0.1,
        contact_shell_fraction=shell(share), stop_when_blocked=True, blocked_travel=blocked,
        sample_interval=interval, slices=0.0, seed=seed, **MORTAR,
    )  # fmt: skip


def cases(ratios: Sequence[float], shares: Sequence[float], seeds: int, inlet: float | None = None) -> list[Case]:
    """Return one case for each ratio, share and seed."""
    return [
        Case(f"{ratio:g}-{share:g}-seed-{seed}", {"ratio": ratio, "share": share},
             parameters(ratio, share, seed, inlet))
        for ratio in ratios for share in shares for seed in range(seeds)
    ]  # fmt: skip


def table(study: Study) -> str:
    """Return the map as a Markdown table: blocked runs of all runs, and the 95 % interval of the probability."""
    found: dict[tuple[float, float], list[bool]] = {}
    for case in study.cases:
        if case.name in study.results:
            key = case.varied["ratio"], case.varied["share"]
            found.setdefault(key, []).append(bool(number(study.results[case.name]["blocked"])))
    shares = sorted({share for _, share in found})
    lines = ["| bore over stone | " + " | ".join(f"{100 * share:g} % stones" for share in shares) + " |"]
    lines.append("|" + "---|" * (1 + len(shares)))
    for ratio in sorted({ratio for ratio, _ in found}):
        cells = []
        for share in shares:
            runs = found.get((ratio, share), [])
            low, high = wilson_interval(sum(runs), len(runs)) if runs else (0.0, 1.0)
            cells.append(f"{sum(runs)} of {len(runs)} ({100 * low:.0f} to {100 * high:.0f} %)" if runs else "failed")
        lines.append(f"| {ratio:g} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run the map, or continue it, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ratios", type=float, nargs="+", default=RATIOS, help="bore over stone")
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES, help="share of stones in the volume")
    parser.add_argument("--inlet", type=float, help="inlet over stone; default: 1.3 times the outlet")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--device")
    parser.add_argument("--processes", type=int, help="processes on a CPU")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--resume", type=Path)
    given = parser.parse_args()
    module = scenes.modules()["part-dem"]
    if given.resume:
        study = resume_study(given.resume, module, processes=given.processes)
    else:
        study = run_listed(
            "part-dem", module, cases(given.ratios, given.shares, given.seeds, given.inlet), device=given.device,
            processes=given.processes, out=given.out or next_folder("blocking-map"), figure=False,
        )  # fmt: skip
    print(table(study) if study.results else "no run has finished yet")
    for name, why in study.failures.items():
        print(f"failed: {name}: {why}")
    print(f"folder: {study.folder}")


if __name__ == "__main__":
    main()
