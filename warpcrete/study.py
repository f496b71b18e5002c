"""Parameter studies: cases from lists of values, run side by side, with one table and one figure.

On a GPU all cases that need the same features are one batch; on a CPU each runs in a process of its own. Every case
fills a run folder of its own below the study's, and a study that is started again runs only what is not finished.
"""

from __future__ import annotations

import csv
import importlib
import inspect
import itertools
import json
import multiprocessing
import shutil
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InstabilityError, RunFolderError, SceneError, WarpcreteError, between, positive, refuse
from .fluid import FluidScene
from .fluid_simulation import FluidSimulation
from .launching import default_threads
from .model import find_device
from .provenance import provenance, write_json
from .recorders import recorder_types
from .run_folder import TableRecorder, check_new, read_json
from .simulation import Simulation
from .spine import Recorder, Run
from .together import run_together

FIGURES = {"peak_pressure": "Pa", "plateau_pressure": "Pa"}
FLOW_FIGURES = {
    "pressure": "Pa", "pressure_theory": "Pa", "pressure_error": "1", "slip_velocity": "m/s",
    "slip_velocity_error": "1", "profile_error": "1",
}  # fmt: skip
"""What a study of flows compares."""
SHOWN = {"Pa": (1e-3, "kPa"), "m/s": (100.0, "cm/s"), "1": (100.0, "%")}
FAILED = "failed.txt"


@dataclass(frozen=True)
class Case:
    """One run of a study."""

    name: str
    """Of its run folder."""
    varied: dict[str, Any]
    """The parameters that the study varies, and their values here; without the seed."""
    parameters: dict[str, Any]
    """All that the scene function is given."""


@dataclass
class Study:
    """A finished study, or what there is of it."""

    folder: Path
    cases: list[Case]
    results: dict[str, dict[str, Any]] = field(default_factory=dict)
    """result.json of every finished case, by name."""
    failures: dict[str, str] = field(default_factory=dict)
    """What ended a case, by name."""
    figures: Mapping[str, str] = field(default_factory=lambda: FIGURES)
    """What the cases are compared by, and its unit."""

    @property
    def finished(self) -> bool:
        """Every case ran to its end, or failed for good."""
        return len(self.results) + len(self.failures) == len(self.cases)

    def rows(self) -> list[dict[str, Any]]:
        """A row for each set of varied values: mean and scatter (standard deviation) of the figures over its seeds."""
        groups: dict[str, list[Case]] = {}
        for case in self.cases:
            groups.setdefault(json.dumps(case.varied, sort_keys=True), []).append(case)
        rows = []
        for members in groups.values():
            row: dict[str, Any] = dict(members[0].varied)
            done = [self.results[c.name] for c in members if c.name in self.results]
            for figure in self.figures:
                found = [r[figure] for r in done if figure in r]
                values = [f["value"] if isinstance(f, dict) else f for f in found]
                row[figure] = float(np.mean(values)) if values else float("nan")
                row[f"{figure}_scatter"] = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
            row["runs"] = len(done)
            row["failed"] = sum(c.name in self.failures for c in members)
            rows.append(row)
        return rows

    def table(self) -> str:
        """Markdown table, pressures in kPa, velocities in cm/s, errors in %."""
        names = list(dict.fromkeys(key for case in self.cases for key in case.varied))
        titles = [
            f"{figure.removesuffix('_pressure').replace('_', ' ')} [{SHOWN[unit][1]}]"
            for figure, unit in self.figures.items()
        ]
        head = [*names, *titles, "runs", "failed"]
        lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
        for row in self.rows():
            cells = [str(row.get(name, "")) for name in names]
            for figure, unit in self.figures.items():
                mean, scatter = (row[name] * SHOWN[unit][0] for name in (figure, f"{figure}_scatter"))
                cells.append(f"{mean:.2f}" + (f" +- {scatter:.2f}" if np.isfinite(scatter) else ""))
            lines.append("| " + " | ".join([*cells, str(row["runs"]), str(row["failed"])]) + " |")
        return "\n".join(lines)


def cases_of(
    base: Mapping[str, Any], varied: Mapping[str, Sequence[Any]], *, repeat: int = 1, one_at_a_time: bool = False
) -> list[Case]:
    """Cases of a study: every combination of the values, or each parameter alone; seeds count from the base's.

    `base` and `varied` are parameters of the scene function. Raises :class:`SceneError` for empty or repeated values.
    """
    if repeat < 1:
        refuse("repeat", repeat, "must be 1 or more")
    for name, values in varied.items():
        if not values or len(set(map(repr, values))) < len(values):
            refuse(name, values, "must be one or more different values")
    if "seed" in varied and repeat > 1:
        refuse("repeat", repeat, "goes by seeds, which the study names itself", "leave out one of both")
    if one_at_a_time and varied:
        points = [{name: value} for name, values in varied.items() for value in values]
    else:
        points = [dict(zip(varied, values)) for values in itertools.product(*varied.values())]
    first = int(base.get("seed", 0))
    cases: list[Case] = []
    for point in points:
        for seed in range(first, first + repeat):
            seeds = {} if "seed" in point else {"seed": seed}
            shown = point | (seeds if repeat > 1 or not point else {})
            text = "-".join(f"{name}={_word(value)}" for name, value in shown.items())
            name = f"{len(cases) + 1:03d}-{text}"[:120]
            cases.append(Case(name, dict(point), {**base, **point, **seeds}))
    return cases


def _word(value: Any) -> str:
    """A value as part of a folder's name."""
    return "".join(
        c if c.isalnum() or c in ".+-" else "_" for c in (f"{value:g}" if isinstance(value, float) else str(value))
    )


def run_study(
    scene_name: str,
    module: Any,
    varied: Mapping[str, Sequence[Any]],
    *,
    base: Mapping[str, Any] | None = None,
    out: Path,
    repeat: int = 1,
    one_at_a_time: bool = False,
    device: str | None = None,
    precision: str = "float32",
    processes: int | None = None,
    frames: float = 25.0,
    rerun: bool = False,
    usd: bool = False,
    checkpoint_every: float = 60.0,
    progress: Callable[[str, float, dict[str, Any]], None] | None = None,
) -> Study:
    """Run a study of the scene function `module.scene` into the new folder `out`.

    `varied` holds the values of each varied parameter, `base` the others that differ from their defaults; `repeat`
    runs every case with so many seeds; `one_at_a_time` varies each parameter alone. `processes` are those of a CPU
    (default: one a core). Raises :class:`SceneError` before anything is written if any case makes no scene.
    """
    if "precision" in inspect.signature(module.scene).parameters:
        if "precision" in varied or (base or {}).get("precision", precision) != precision:
            refuse("precision", varied.get("precision", precision), "is one for the whole study", "run two studies")
        base = {**(base or {}), "precision": precision}
    cases = cases_of(base or {}, varied, repeat=repeat, one_at_a_time=one_at_a_time)
    positive("frames", frames, "1/s")
    between("checkpoint_every", checkpoint_every, 0, float("inf"), "s")
    found = find_device(device)
    for case in cases:
        module.scene(**case.parameters)
    check_new(out)
    out.mkdir(parents=True)
    write_json(
        out / "study.json",
        {
            "scene": scene_name,
            "cases": [{"name": c.name, "varied": c.varied, "parameters": c.parameters} for c in cases],
            "device": str(found),
            "precision": precision,
            "command": {"frames": frames, "rerun": rerun, "usd": usd, "checkpoint_every": checkpoint_every},
            "provenance": provenance(found, precision, int((base or {}).get("seed", 0))),
        },
    )
    return resume_study(out, module, processes=processes, progress=progress)


def resume_study(
    folder: Path,
    module: Any,
    *,
    processes: int | None = None,
    progress: Callable[[str, float, dict[str, Any]], None] | None = None,
) -> Study:
    """Go on with a study: finished and failed cases stay as they are, begun ones go on from their checkpoints."""
    record = read_json(folder / "study.json")
    try:
        cases = [Case(c["name"], c["varied"], c["parameters"]) for c in record["cases"]]
        command = record["command"]
    except (KeyError, TypeError) as error:
        raise RunFolderError(f"'{folder / 'study.json'}': holds no study ({error})") from error
    fluid = bool(cases) and isinstance(module.scene(**cases[0].parameters), FluidScene)
    study = Study(folder, cases, figures=FLOW_FIGURES if fluid else FIGURES)
    pending = []
    for case in cases:
        if not _known(study, case):
            pending.append(case)
    tell = progress or (lambda phase, share, figures: None)
    if pending:
        device = find_device(record["device"])
        if device.is_cuda:
            _run_on_gpu(record, module, command, folder, pending, study, tell)
        else:
            _run_in_processes(record, module, command, folder, pending, processes, study, tell)
    _write(study, record["scene"])
    return study


def _known(study: Study, case: Case) -> bool:
    """Take over a case that is finished or failed; clear away one that was cut before its first checkpoint."""
    folder = study.folder / case.name
    if (folder / FAILED).is_file():
        study.failures[case.name] = (folder / FAILED).read_text().strip()
        return True
    if (folder / "result.json").is_file() and not (folder / "checkpoint.npz").is_file():
        result = read_json(folder / "result.json")
        if result.get("finished"):
            study.results[case.name] = result
            return True
    if folder.exists() and not (folder / "checkpoint.npz").is_file():
        shutil.rmtree(folder)
    return False


def _simulation(record: dict[str, Any], module: Any, command: dict[str, Any], folder: Path, case: Case, threads: int,
                tell: Callable[[str, float, dict[str, Any]], None]) -> tuple[Any, Path | None]:  # fmt: skip
    parameters = dict(case.parameters)
    scene = module.scene(**parameters)
    here = folder / case.name
    recorders: list[Recorder] = [TableRecorder(here)]
    fluid = isinstance(scene, FluidScene)
    rerun, usd, plot = recorder_types(fluid)
    if command["rerun"]:
        recorders.append(rerun(here / "run.rrd"))
    if command["usd"]:
        recorders.append(usd(here / "scene.usdc"))
    recorders.append(plot(here / "flow.png") if fluid else plot(here / "pressure.png", scene.notes.get("paper")))
    every = command["checkpoint_every"]
    simulation = (FluidSimulation if fluid else Simulation)(
        scene,
        device=record["device"],
        precision=record["precision"],
        threads=threads,
        recorders=recorders,
        frame_interval=1.0 / command["frames"],
        progress=tell,
        checkpoint_path=here / "checkpoint.npz" if every else None,
        checkpoint_every=every,
    )
    begun = here / "checkpoint.npz"
    return simulation, begun if begun.is_file() else None


def _book(study: Study, case: Case, outcome: Any) -> None:
    """Note what came of a case. Only what the case itself is to blame for counts for good."""
    if isinstance(outcome, Run):
        if outcome.finished:
            study.results[case.name] = outcome.result
    elif isinstance(outcome, Exception):
        study.failures[case.name] = str(outcome) or type(outcome).__name__
        if isinstance(outcome, InstabilityError | SceneError):
            (study.folder / case.name).mkdir(exist_ok=True)
            (study.folder / case.name / FAILED).write_text(f"{outcome}\n")


class _StopAtSample:
    """The first Ctrl-C ends every run at its next sample, a second one at once; only the main thread gets any."""

    def __init__(self, simulations: list[Simulation]) -> None:
        self.simulations, self.asked = simulations, False
        self._previous: Any = None

    def __enter__(self) -> _StopAtSample:
        if threading.current_thread() is threading.main_thread():
            self._previous = signal.signal(signal.SIGINT, self._stop)
        return self

    def _stop(self, signum, frame) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        for simulation in self.simulations:
            simulation.stop_requested = True

    def __exit__(self, *unused) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._previous)


def run_all(pairs: Sequence[tuple[Any, Path | None]], progress: Callable[[str, float], None]) -> list[Any]:
    """Run simulations, from their checkpoints where there are any: discrete elements together, flows in turn.

    Returns a :class:`Run` or an exception for each.
    """
    simulations = [simulation for simulation, _ in pairs]
    if not simulations or isinstance(simulations[0], Simulation):
        return run_together(simulations, checkpoints=[checkpoint for _, checkpoint in pairs], progress=progress)
    outcomes: list[Any] = []
    for simulation, checkpoint in pairs:
        try:
            if checkpoint is not None:
                simulation.resume(checkpoint)
            elif simulation.stop_requested:
                raise KeyboardInterrupt
            outcomes.append(simulation.run())
            simulation.release()
        except (Exception, KeyboardInterrupt) as error:
            outcomes.append(error)
    return outcomes


def _run_on_gpu(record, module, command, folder, pending, study, tell) -> None:
    shares = dict.fromkeys((c.name for c in pending), 0.0)

    def told(name: str) -> Callable[[str, float, dict[str, Any]], None]:
        def hear(phase: str, share: float, figures: dict[str, Any]) -> None:
            if phase == "running":
                shares[name] = share
                tell("running", sum(shares.values()) / len(shares), {})

        return hear

    pairs = [_simulation(record, module, command, folder, case, 1, told(case.name)) for case in pending]
    with _StopAtSample([simulation for simulation, _ in pairs]) as stop:

        def packing(phase: str, share: float) -> None:
            if phase == "packing":
                if stop.asked:
                    raise KeyboardInterrupt
                tell(phase, share, {})

        outcomes = run_all(pairs, packing)
    for case, outcome in zip(pending, outcomes):
        _book(study, case, outcome)


def _run_in_processes(record, module, command, folder, pending, processes, study, tell) -> None:
    """One case a process at a time, so that after a Ctrl-C nothing begins that has not begun."""
    workers = min(processes or default_threads(), len(pending))
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    left = list(pending)
    running: dict[Any, Case] = {}
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(stop,)) as pool:
        while left or running:
            try:
                while left and len(running) < workers and not stop.is_set():
                    case = left[0]
                    future = pool.submit(_run_case, record, module.__name__, command, str(folder), case)
                    running[future] = left.pop(0)
                if not running:
                    break
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    case = running.pop(future)
                    try:
                        finished, result, error = future.result()
                    except Exception as broken:  # a process that was killed, or what nobody foresaw
                        error = WarpcreteError(f"its process failed: {type(broken).__name__}: {broken}")
                        finished, result = False, None
                    if finished:
                        study.results[case.name] = result
                    elif error is not None:
                        _book(study, case, error)
                    tell("running", len(study.results) / len(study.cases), {})
            except KeyboardInterrupt:
                stop.set()  # those that run end at their next sample
            except BrokenExecutor as broken:
                study.failures |= {case.name: f"not run: {broken}" for case in left}
                left.clear()


_stop_event: Any = None


def _begin_worker(stop: Any) -> None:
    """A worker leaves Ctrl-C to its parent, which tells it through `stop`."""
    global _stop_event
    _stop_event = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_case(record, module_name: str, command, folder: str, case: Case) -> tuple[bool, Any, Exception | None]:
    """One case in a process of its own; returns whether it finished, its result, and what it failed with."""
    simulation: Simulation | None = None

    def hear(phase: str, share: float, figures: dict[str, Any]) -> None:
        if _stop_event is not None and _stop_event.is_set():
            if phase != "running" or simulation is None:
                raise KeyboardInterrupt
            simulation.stop_requested = True

    module = importlib.import_module(module_name)
    simulation, checkpoint = _simulation(record, module, command, Path(folder), case, 1, hear)
    (outcome,) = run_all([(simulation, checkpoint)], lambda phase, share: hear(phase, share, {}))
    if isinstance(outcome, Run):
        return outcome.finished, outcome.result, None
    return False, None, outcome if isinstance(outcome, Exception) else None


def _write(study: Study, title: str) -> None:
    """Table as Markdown and CSV, and the figure, of what there is."""
    rows = study.rows()
    names = list(dict.fromkeys(key for row in rows for key in row))
    partial = study.folder / "study.csv.partial"
    with partial.open("w", newline="") as file:
        writer = csv.writer(file)
        units = {**study.figures, **{f"{name}_scatter": unit for name, unit in study.figures.items()}}
        writer.writerow([f"{name} [{units[name]}]" if name in units else name for name in names])
        writer.writerows([[row.get(name, "") for name in names] for row in rows])
    partial.replace(study.folder / "study.csv")
    (study.folder / "study.md").write_text(f"{study.table()}\n")
    if study.results:
        partial = study.folder / "study.png.partial"
        draw(study, title).savefig(partial, dpi=150, format="png")
        partial.replace(study.folder / "study.png")


def draw(study: Study, title: str = ""):
    """Matplotlib figure: the pressures that a study compares over each varied parameter, with their scatter."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(key for case in study.cases for key in case.varied)) or ["seed"]
    figure = Figure(figsize=(4.6 * min(len(names), 3), 3.6 * -(-len(names) // 3)), layout="constrained")
    grid = figure.subplots(-(-len(names) // 3), min(len(names), 3), squeeze=False, sharey=True).ravel()
    rows = study.rows()
    drawn = [name for name, unit in study.figures.items() if unit == "Pa"]
    for axes, name in zip(grid, names):
        mine = [row for row in rows if name in row] or rows
        values = list(dict.fromkeys(row.get(name, 0) for row in mine))
        numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
        others = [n for n in names if n != name]
        lines: dict[str, list[dict[str, Any]]] = {}
        for row in mine:
            label = ", ".join(f"{n} {row[n]}" for n in others if n in row)
            lines.setdefault(label, []).append(row)
        for number, (label, part) in enumerate(lines.items()):
            x = [row.get(name, 0) if numeric else values.index(row.get(name, 0)) for row in part]
            for key, marker, words in zip(drawn, ("o-", "s--"), [d.removesuffix("_pressure") for d in drawn]):
                y = np.array([row[key] for row in part]) / 1e3
                scatter = np.nan_to_num([row[f"{key}_scatter"] for row in part]) / 1e3
                axes.errorbar(
                    x, y, scatter, fmt=marker, color=f"C{number % 10}", capsize=3, markersize=4, linewidth=1.3,
                    label=f"{words.replace('_', ' ')}, {label}" if label else words.replace("_", " "),
                )  # fmt: skip
        if not numeric:
            axes.set_xticks(range(len(values)), [str(v) for v in values])
        axes.set(xlabel=name.replace("_", " "), ylim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
        if len(lines) <= 4:
            axes.legend(frameon=False, fontsize=8)
    for axes in grid[len(names) :]:
        axes.set_visible(False)
    grid[0].set_ylabel("pressure on the piston [kPa]")
    if title:
        figure.suptitle(title, fontsize=10)
    return figure
