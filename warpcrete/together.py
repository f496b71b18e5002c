"""Many simulations as few batches: those with the same features share every launch."""

from __future__ import annotations

import time as wall_clock
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .batch import batch_key
from .errors import WarpcreteError
from .memory import SHARE, memory_free, memory_needed
from .packing import Request, pack_many
from .simulation import Run, Simulation
from .state import BodyTable, placed_bodies
from .stepper import Course, drive, steppers_of

Outcome = Run | BaseException


def run_together(
    simulations: Sequence[Simulation],
    *,
    checkpoints: Sequence[Path | None] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Outcome]:
    """Run simulations on one device, side by side where they share features and fit its memory.

    Returns a :class:`Run`, or the error that ended it, for each. A simulation with a path in `checkpoints` goes on
    from there. What fails harms no other. After an interruption (Ctrl-C) unfinished runs are returned as such, and
    `KeyboardInterrupt` for those that had not begun. `progress` is called with a phase and the share done.
    """
    tell = progress or (lambda phase, share: None)
    checkpoints = checkpoints or [None] * len(simulations)
    outcomes: dict[int, Outcome] = {}
    memories: dict[int, dict[str, Any]] = {}
    try:
        new = [s for s, c in zip(simulations, checkpoints) if c is None]
        packings = _packed(new, lambda share: tell("packing", share))
    except KeyboardInterrupt as stop:
        return [stop] * len(simulations)
    groups: dict[Any, list[int]] = {}
    for number, (simulation, path) in enumerate(zip(simulations, checkpoints)):
        try:
            if path is not None:
                memories[number] = simulation.restore(path)
            else:
                packed, took = packings[_packing_key(simulation)] if simulation.scene.fill is not None else (None, 0.0)
                if isinstance(packed, BaseException):
                    raise packed
                simulation.place(packed, took)
        except WarpcreteError as error:
            outcomes[number] = error
            continue
        groups.setdefault(batch_key(simulation.model, simulation.state), []).append(number)
    parts = [part for numbers in groups.values() for part in _fitting(simulations, numbers)]
    finished = len(outcomes)
    for part in parts:
        members = [simulations[number] for number in part]
        steppers = steppers_of(
            [m.model for m in members],
            [m.state for m in members],
            time_steps=[m.scene.time_step for m in members],
            memories=[memories[number]["stepper"] if number in memories else None for number in part],
            threads=members[0].threads,
        )
        for member, stepper in zip(members, steppers):
            member.join(stepper)
        courses = {
            stepper.index: (stepper, _course(simulations[number], number in memories))
            for number, stepper in zip(part, steppers)
        }
        results = drive(courses)
        for number, stepper in zip(part, steppers):
            outcomes[number] = results[stepper.index]
        finished += len(part)
        tell("running", finished / len(simulations))
        stop = next((r for r in results.values() if isinstance(r, KeyboardInterrupt)), None)
        if stop is not None or any(isinstance(r, Run) and not r.finished for r in results.values()):
            break
    return [outcomes.get(number, KeyboardInterrupt()) for number in range(len(simulations))]


def _course(simulation: Simulation, resumed: bool) -> Course:
    if resumed:
        simulation.recall()
    else:
        yield from simulation.preparing()
    return (yield from simulation.running())


def _packing_key(simulation: Simulation) -> tuple:
    """Simulations with equal keys start from the same packing."""
    from .provenance import fingerprint

    scene = simulation.scene
    return fingerprint(scene.fill), fingerprint(scene.contact), scene.seed, simulation.precision, str(simulation.device)


def _packed(simulations: Sequence[Simulation], tell: Callable[[float], None]) -> dict[tuple, tuple[Any, float]]:
    """Every different packing once: what :func:`pack_many` returned for it, and its share of the time it took [s]."""
    needed = {_packing_key(s): s for s in simulations if s.scene.fill is not None}
    kinds: dict[tuple, list[tuple]] = {}
    for key, s in needed.items():
        kinds.setdefault((str(s.device), s.precision, s.threads), []).append(key)
    found: dict[tuple, tuple[Any, float]] = {}
    for (_, precision, threads), keys in kinds.items():
        started = wall_clock.perf_counter()
        requests = [Request(needed[k].scene.fill, needed[k].scene.contact, needed[k].scene.seed) for k in keys]  # type: ignore[arg-type]
        results = pack_many(
            requests, device=needed[keys[0]].device, precision=precision, threads=threads, progress=tell
        )
        took = (wall_clock.perf_counter() - started) / len(keys)
        found |= {key: (result, took) for key, result in zip(keys, results)}
    return found


def _fitting(simulations: Sequence[Simulation], numbers: list[int]) -> list[list[int]]:
    """Split into batches that fit the device's memory, together with what is there already."""
    device = simulations[numbers[0]].model.device
    if not device.is_cuda and simulations[numbers[0]].threads > 1:
        return [[number] for number in numbers]  # one after the other, each with all threads
    room = SHARE * memory_free(device)
    parts: list[list[int]] = [[]]
    used = 0.0
    for number in numbers:
        simulation = simulations[number]
        table = placed_bodies(simulation.scene) if simulation.scene.fill is None else simulation.state.table()
        needed = memory_needed(simulation.model, table if len(table) else BodyTable.empty())
        if parts[-1] and used + needed > room:
            parts.append([])
            used = 0.0
        parts[-1].append(number)
        used += needed
    return parts
