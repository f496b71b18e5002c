"""Judge the runs of many trades: errors from the GPU, times from the CPU, promises, and their tests in fresh scenes."""

import json
import math
import shutil
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from trade_plans import FRESH, PLANS, REFERENCE, WHOLE, Plan, carried, point_of, scenes_of, trade_of

from warpcrete.core.units import number
from warpcrete.studies.tradeoffs.fronts import worst
from warpcrete.studies.tradeoffs.report import write
from warpcrete.studies.tradeoffs.state import Trade
from warpcrete.studies.tradeoffs.trade import promises_from_runs

PARTS = ("packing_time", "settling_time", "wall_time")
"""Parts of the wall time of a run that a trade adds up."""


def judged(name: str, raw: Path, folder: Path) -> Trade | None:
    """Write the trade of a plan into FOLDER/NAME and return it; None if its scene has no result or is a whole trade."""
    if name in WHOLE:
        if (raw / "whole" / name / "trade.json").is_file():
            shutil.copytree(raw / "whole" / name, folder / name, dirs_exist_ok=True)
        return None
    about = json.loads((raw / "about.json").read_text(encoding="utf-8"))
    plan = PLANS[name]
    if (folder / name).exists():
        shutil.rmtree(folder / name)
    if not merge(raw, folder, name):
        return None
    trade = trade_of(plan, folder / name, threads=about["threads"], provenance=about["cpu"])
    reference = point_of(trade, plan.reference, REFERENCE) or trade.given
    reference.origin = REFERENCE
    settings = [point for levels in (*plan.candidates, *plan.measured) if (point := point_of(trade, levels))]
    timed = {case.split("-seed=")[0] for case in results_of(raw / "cpu" / name)}
    for point in (trade.given, reference, *settings):
        point.timed = point is reference or trade.folder_of(point, 0).name.split("-seed=")[0] in timed
    trade.record = trade.record | {"rounding": {} if plan.elements else rounding(raw, name, trade)}
    promises_from_runs(trade, [trade.given, reference, *settings])
    write(trade)
    return trade


def rounding(raw: Path, name: str, trade: Trade) -> dict[str, float]:
    """Return how much rounding changes each result of a flow, in relation to the result, with a probability of 95 %.

    The GPU and the CPU round differently, and flows with a free surface amplify the difference. Two runs of each of
    several settings, one on each processor, give the standard deviation of a run, and the result is twice as large.
    """
    gpu, cpu = results_of(raw / "gpu" / name), results_of(raw / "cpu" / name)
    found = {}
    for each in trade.quantities:
        pairs = [(number(gpu[case][each.name]), number(cpu[case][each.name])) for case in sorted(set(gpu) & set(cpu))
                 if gpu[case].get(each.name) and cpu[case].get(each.name)]  # fmt: skip
        if pairs:
            found[each.name] = 2 * math.sqrt(sum(((a - b) / b) ** 2 for a, b in pairs) / (2 * len(pairs)))
    return found


def merge(raw: Path, folder: Path, name: str) -> int:
    """Copy the results of a plan's runs into FOLDER/NAME/runs, with times of the CPU; return how many there are.

    The time of a setting that did not run on the CPU is estimated from that of the scene as given: it is proportional
    to the number of steps times the number of particles or spheres.
    """
    gpu, cpu = results_of(raw / "gpu" / name), results_of(raw / "cpu" / name)
    found = cpu | gpu
    given = next((result for case, result in cpu.items() if case.startswith("given")), None)
    rate = taken(given) / work(given) if given else 1e-6
    for case, result in found.items():
        timed = cpu.get(case) or next(
            (r for c, r in cpu.items() if c.split("-seed=")[0] == case.split("-seed=")[0]), None
        )
        if timed:
            speed = {part: timed["speed"][part] for part in PARTS if part in timed["speed"]}
        else:
            speed = {"wall_time": {"value": rate * work(result), "unit": "s"}}
        place = folder / name / "runs" / case
        place.mkdir(parents=True)
        (place / "result.json").write_text(json.dumps(result | {"speed": speed}), encoding="utf-8")
    for kind in ("gpu", "cpu"):
        for path in (raw / kind / name / "runs").glob("*/failed.txt"):
            if path.parent.name not in found:
                (folder / name / "runs" / path.parent.name).mkdir(parents=True, exist_ok=True)
                shutil.copy(path, folder / name / "runs" / path.parent.name / "failed.txt")
    return len(found)


def results_of(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the results of the finished runs in a folder, by the name of the run."""
    found = {path.parent.name: json.loads(path.read_text(encoding="utf-8"))
             for path in (folder / "runs").glob("*/result.json")}  # fmt: skip
    return {case: result for case, result in found.items() if result.get("finished")}


def taken(result: dict[str, Any]) -> float:
    """Return the wall time of a run [s]."""
    return sum(number(result["speed"][part]) for part in PARTS if part in result["speed"])


def work(result: dict[str, Any]) -> float:
    """Return the number of steps of a run times its number of particles or spheres."""
    return result["steps"] * (result.get("spheres") or result["particles"])


def fresh_promises(name: str, trade: Trade) -> Iterator[tuple[str, float, float, str, bool]]:
    """Yield scene, promise, largest error, quantity and whether the promise was kept, for every fresh scene."""
    plan: Plan = PLANS[name]
    done = set()
    for promise in trade.promises:
        if promise.point is None or promise.point is trade.reference or id(promise.point) in done:
            continue
        done.add(id(promise.point))
        for scene, changes in scenes_of(plan, trade).items():
            if not scene.startswith(FRESH):
                continue
            other = carried(trade, promise.point, scene, changes)
            finest = carried(trade, trade.reference or trade.given, scene, changes)
            trade.run_all([finest, other], trade.seeds, lambda *said: None)
            error = worst(trade.errors_of(other, trade.seeds)) if other.results and finest.results else None
            if error is not None:
                yield scene.removeprefix(FRESH), promise.bound, error.shift, error.quantity, error.size <= promise.bound


def unpacked(folder: Path) -> Path:
    """Unpack FOLDER/runs.tar.gz into FOLDER/raw, unless that was done, and return the folder of the raw results."""
    raw = folder / "raw"
    if not raw.exists():
        with tarfile.open(folder / "runs.tar.gz") as packed:
            packed.extractall(raw, filter="data")
    return raw
