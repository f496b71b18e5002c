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
from .simulation import Simulation
from .spine import Run
from .state import BodyTable, placed_bodies
from .stepper import Course, drive, steppers_of

Outcome = Run | BaseException
PACKED_TOGETHER = 32


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
    placed: dict[int, tuple[Any, float]] = {}
    groups: dict[Any, list[int]] = {}
    for number, (simulation, path) in enumerate(zip(simulations, checkpoints)):
        if path is None and simulation.scene.fill is not None:
            placed[number] = packings[_packing_key(simulation)]
            if isinstance(placed[number][0], BaseException):
                outcomes[number] = placed[number][0]
                continue
        groups.setdefault((batch_key(simulation.model), simulation.threads), []).append(number)
    parts = [part for numbers in groups.values() for part in _fitting(simulations, placed, numbers)]
    for done, part in enumerate(parts):
        courses: dict[int, tuple[Any, Course]] = {}
        running: list[int] = []
        try:
            for number in part:
                simulation, path = simulations[number], checkpoints[number]
                try:
                    if path is not None:
                        memories[number] = simulation.restore(path)
                    else:
                        simulation.place(*placed.get(number, (None, 0.0)))
                    running.append(number)
                except WarpcreteError as error:
                    outcomes[number] = error
            members = [simulations[number] for number in running]
            if not members:
                continue
            steppers = steppers_of(
                [m.model for m in members],
                [m.state for m in members],
                time_steps=[m.scene.time_step for m in members],
                memories=[memories[number]["stepper"] if number in memories else None for number in running],
                threads=members[0].threads,
            )
        except WarpcreteError as error:
            outcomes |= dict.fromkeys(running, error)
            continue
        except KeyboardInterrupt:
            break
        for number, stepper in zip(running, steppers):
            simulations[number].join(stepper)
            courses[stepper.index] = (stepper, _course(simulations[number], number in memories))
        results = drive(courses)
        outcomes |= {number: results[stepper.index] for number, stepper in zip(running, steppers)}
        tell("running", (done + 1) / len(parts))
        if any(isinstance(r, KeyboardInterrupt) or (isinstance(r, Run) and not r.finished) for r in results.values()):
            break
        if done + 1 < len(parts) and members[0].device.is_cuda:
            for member in members:  # the next part needs the memory
                member.release()
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
        results: list[Any] = []
        for first in range(0, len(requests), PACKED_TOGETHER):
            results += pack_many(
                requests[first : first + PACKED_TOGETHER],
                device=needed[keys[0]].device,
                precision=precision,
                threads=threads,
                progress=tell,
            )
        took = (wall_clock.perf_counter() - started) / len(keys)
        found |= {key: (result, took) for key, result in zip(keys, results)}
    return found


def _fitting(
    simulations: Sequence[Simulation], placed: dict[int, tuple[Any, float]], numbers: list[int]
) -> list[list[int]]:
    """Split into batches of which each alone fits the device's memory."""
    first = simulations[numbers[0]]
    if not first.device.is_cuda and first.threads > 1:
        return [[number] for number in numbers]  # one after the other, each with all threads
    room = SHARE * memory_free(first.device)
    parts: list[list[int]] = [[]]
    used = 0.0
    for number in numbers:
        simulation = simulations[number]
        table = placed[number][0][0] if number in placed else BodyTable.empty()
        needed = memory_needed(simulation.model, table.joined(placed_bodies(simulation.scene)))
        if parts[-1] and used + needed > room:
            parts.append([])
            used = 0.0
        parts[-1].append(number)
        used += needed
    return parts
