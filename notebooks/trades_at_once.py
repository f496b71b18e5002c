"""Runs of many trades at once on one machine: errors on its GPU, times on its CPU cores.

python notebooks/trades_at_once.py --out FOLDER                  all plans within 400 s of wall time
python notebooks/trades_at_once.py --out FOLDER --only slump     one plan
python notebooks/trades_at_once.py --out FOLDER --tiny --cpu     short runs of everything without a GPU: a test

A trade of `warpcrete trade` makes one run at a time, because it measures their wall times. This script computes the
results on a GPU, many runs together, while the CPU cores measure the times that matter, two threads for each run.
`notebooks/trades.py --folder FOLDER` judges the runs. FOLDER/runs.tar.gz holds all results.
"""

import argparse
import json
import multiprocessing
import os
import tarfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trade_plans import PLANS, WHOLE, jobs_of, trade_of

THREADS = 2
"""Number of threads of a run on a CPU."""
HOST_CORES = 6
"""Least number of CPU cores that are left to the processes of the GPUs; on larger machines it is half of the cores."""
TOGETHER, CREWS = 8, 4
"""Maximum number of flows that a process runs together on a GPU, and number of these processes for each GPU. A process
takes its next group when all runs of the last one have ended."""


Progress = Callable[[str, float, dict], None]


@dataclass(frozen=True)
class Job:
    """One run: parameters of a scene, and the folder of its result."""

    scene: str
    parameters: dict
    folder: str
    timed: bool
    """True for a run on the CPU."""
    level: int
    """Order of the runs: those with a smaller number begin first."""
    elements: bool


def all_jobs(names: list[str], out: Path) -> list[Job]:
    """Return the runs of the plans, each result in OUT/gpu/PLAN/runs or OUT/cpu/PLAN/runs."""
    jobs = []
    for name in names:
        plan = PLANS[name]
        for timed in (False, True):
            folder = out / ("cpu" if timed else "gpu") / name
            trade = trade_of(plan, folder)
            for point, seed, level in jobs_of(plan, trade, timed):
                made = trade.folder_of(point, seed)
                if (made / "result.json").exists():  # An earlier call with the same folder has made this run.
                    continue
                jobs.append(Job(plan.scene, trade.parameters_of(point, seed), str(made), timed, level, plan.elements))
    return jobs


def work(mine: list[int], device: str, deadline: float, tiny: bool, queue: Any, told: Any) -> None:
    """Take groups of jobs from the queue until it is empty or the time is up, and run each group together."""
    if hasattr(os, "sched_setaffinity") and mine:
        os.sched_setaffinity(0, set(mine))
    import queue as queues

    warm: set = set()
    while time.time() < deadline:
        try:
            group = queue.get(timeout=1.0)
        except queues.Empty:
            return
        begun = time.time()
        try:
            failed = run_whole(*group) if isinstance(group, tuple) else run_group(group, device, deadline, tiny, warm)
        except Exception as error:
            failed = {"group": f"{type(error).__name__}: {error}"}
        whole = isinstance(group, tuple)
        names = group[:1] if whole else sorted({Path(job.folder).parts[-3] for job in group})
        told.put((device, f"{1 if whole else len(group)} of {', '.join(names)}", begun, time.time(), failed))


def run_whole(name: str, out: Path, tiny: bool) -> dict[str, str]:
    """Make a trade with one run at a time on this process' cores; return nothing."""
    from warpcrete.scenes import modules
    from warpcrete.studies.tradeoffs.trade import run_trade

    scene, parameters, budget = WHOLE[name]
    run_trade(scene, modules()[scene], base=parameters, device="cpu", threads=THREADS, budget=10 if tiny else budget,
              out=out / "whole" / name)  # fmt: skip
    return {}


def run_group(group: list[Job], device: str, deadline: float, tiny: bool, warm: set) -> dict[str, str]:
    """Run jobs of one method together; return the errors of those that failed, by folder."""
    from warpcrete.methods import Simulation, method_of
    from warpcrete.record.recorders import recorders_of
    from warpcrete.scenes import modules
    from warpcrete.studies.tradeoffs.trials import warm_up

    simulations, ran, failed = [], [], {}

    def told_by(number: int) -> Progress:
        def stop_in_time(phase: str, fraction: float, figures: dict) -> None:
            late = time.time() > deadline
            for simulation in simulations if late else simulations[number : number + 1]:
                simulation.stop_requested |= late or (tiny and phase == "running" and fraction > 0.02)

        return stop_in_time

    for job in group:
        module = modules()[job.scene]
        try:
            scene = module.scene(**job.parameters)
            settings = {"device": device, "precision": scene.precision, "threads": THREADS}
            kind = (job.scene, scene.precision)
            if job.timed and kind not in warm:
                warm_up(Simulation(scene, **settings))
                warm.add(kind)
            recorders = recorders_of(Path(job.folder), module.check, {}, pictures=False)
            simulations.append(Simulation(scene, recorders=recorders, progress=told_by(len(simulations)), **settings))
            simulations[-1].shares_cores = True
            ran.append(job)
        except Exception as error:
            failed[job.folder] = f"{type(error).__name__}: {error}"
    if simulations:
        outcomes = method_of(simulations[0].scene).run_many(simulations, [None] * len(simulations), lambda *said: None)
        for job, outcome in zip(ran, outcomes):
            if isinstance(outcome, Exception):
                failed[job.folder] = f"{type(outcome).__name__}: {outcome}"
    for folder, error in failed.items():
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / "failed.txt").write_text(f"failed: {error}\n", encoding="utf-8")
    return failed


def groups_of(jobs: list[Job]) -> tuple[list, list, list]:
    """Return the groups of jobs for the CPU, for flows on the GPU and for discrete elements on the GPU, in order."""
    alone: list = [[job] for job in sorted((j for j in jobs if j.timed), key=lambda job: job.level)]
    flows: list[list[Job]] = []
    by_method: dict = {}
    for job in sorted((j for j in jobs if not j.timed and not j.elements), key=lambda job: job.level):
        group = by_method.setdefault((method_name(job), job.level), [])
        if len(group) == TOGETHER:
            group = by_method[(method_name(job), job.level)] = []
        if not group:
            flows.append(group)
        group.append(job)
    elements: dict = {}
    for job in sorted((j for j in jobs if not j.timed and j.elements), key=lambda job: job.level):
        elements.setdefault(Path(job.folder).parts[-3], []).append(job)
    return alone, flows, list(elements.values())


def few_of(jobs: list[Job]) -> set[str]:
    """Return the folders of two jobs for each plan, device and order."""
    kept: dict = {}
    for job in jobs:
        kept.setdefault((Path(job.folder).parts[-4:-2], job.level), []).append(job.folder)
    return {folder for folders in kept.values() for folder in folders[:2]}


def method_name(job: Job) -> str:
    """Return a word that is the same for scenes that one call can run together."""
    return job.scene if job.scene in ("part", "stretch") else "vessels"


def core_sets() -> tuple[list[list[int]], list[int]]:
    """Return the pairs of cores for runs on the CPU, and the cores for the processes of the GPU."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))
    kept = max(HOST_CORES, len(cores) // 2) if len(cores) > 2 * HOST_CORES else 0
    pairs = [cores[k : k + THREADS] for k in range(0, len(cores) - kept - THREADS + 1, THREADS)]
    return pairs or [cores], cores[len(cores) - kept :] if kept else cores


def write_records(out: Path, seconds: float) -> None:
    """Write a description of the machine, and pack it with all results."""
    from warpcrete.core.device.device import find_device
    from warpcrete.core.run.provenance import provenance

    about = {"cpu": provenance(find_device("cpu"), "float32", 0), "seconds": seconds, "threads": THREADS}
    try:
        about["gpu"] = provenance(find_device("cuda"), "float32", 0)
    except Exception as error:
        about["gpu"] = str(error)
    (out / "about.json").write_text(json.dumps(about, indent=1, default=str), encoding="utf-8")
    with tarfile.open(out / "runs.tar.gz", "w:gz") as packed:
        packed.add(out / "about.json", "about.json")
        for path in sorted(found(out)):
            packed.add(path, str(path.relative_to(out)))


def found(out: Path) -> Iterator[Path]:
    """Yield the files of all results."""
    yield from (out / "whole").glob("*/trade.json")
    for kind in ("gpu", "cpu"):
        for name in ("result.json", "failed.txt"):
            yield from (out / kind).glob(f"*/runs/*/{name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=400.0, help="wall time until all runs are ended")
    parser.add_argument("--only", nargs="*", choices=[*PLANS, *WHOLE])
    parser.add_argument("--cpu", action="store_true", help="run on the CPU alone, one process")
    parser.add_argument("--without-times", action="store_true", help="make no runs for their times on the CPU")
    parser.add_argument("--tiny", action="store_true", help="few runs, each a fiftieth of its time")
    given = parser.parse_args()
    started = time.time()
    deadline = started + given.seconds - 15
    names = list(given.only or [*PLANS, *WHOLE])
    jobs = all_jobs([name for name in names if name in PLANS], given.out)
    if given.tiny:
        jobs = [job for job in jobs if job.folder in few_of(jobs)]
    alone, flows, elements = groups_of(jobs)
    alone = [(name, given.out, given.tiny) for name in names if name in WHOLE] + alone
    pairs, host = core_sets()
    if given.without_times:
        alone, host = [], sorted(os.sched_getaffinity(0))
    gpu = "cpu" if given.cpu else "cuda"
    print(f"CPU: {len(alone)} runs on {len(pairs)} x {THREADS} cores {pairs}")
    print(f"{gpu}: {sum(map(len, flows))} flows in {len(flows)} groups, {sum(map(len, elements))} of elements in "
          f"{len(elements)}", flush=True)  # fmt: skip
    gpus = 1 if given.cpu else len(os.environ.get("CUDA_VISIBLE_DEVICES", "0").split(","))
    context = multiprocessing.get_context("spawn")
    told, workers, queues = context.Queue(), [], []
    crews = [(elements, gpu, [host] * 2 * gpus), (flows, gpu, [host] * CREWS * gpus), (alone, "cpu", pairs)]
    for groups, device, places in crews:
        # A queue that nothing holds disappears before the processes have opened it.
        queues.append(queue := context.Queue())
        for group in groups:
            queue.put(group)
        for number, cores in enumerate(places[:1] if given.cpu else places):
            chosen = f"cuda:{number % gpus}" if device == "cuda" else device
            arguments = (cores, chosen, deadline, given.tiny, queue, told)
            workers.append(context.Process(target=work, args=arguments, daemon=True))
            workers[-1].start()
            if given.cpu:
                workers[-1].join()
    while any(worker.is_alive() for worker in workers) and time.time() < deadline + 10:
        time.sleep(0.2)
        report(told, started)
    report(told, started)
    write_records(given.out, time.time() - started)
    for worker in workers:
        if worker.is_alive():
            worker.kill()
    done = sum(1 for path in found(given.out) if path.name == "result.json")
    print(f"{done} results of {len(jobs)} runs after {time.time() - started:.0f} s", flush=True)
    os._exit(0)  # Queues of killed processes would keep this one from ending.


def report(told: Any, started: float) -> None:
    """Print what has ended since the last call: groups on the GPU, and runs on the CPU that failed."""
    while not told.empty():
        device, what, begun, ended, failed = told.get()
        if device != "cpu" or failed:
            print(f"{ended - started:4.0f} s {device}: {what}, {ended - begun:.0f} s, {len(failed)} failed "
                  f"{next(iter(failed.values()), '')[:150]}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
