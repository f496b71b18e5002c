"""Run many simulations in a few batches.

The simulations of a batch share every kernel launch. They must therefore need the same features, for example the same
types of contact laws, bonds or clumps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import warp as wp

from ..core.device.device import MEMORY_FRACTION, memory_free, parallel
from ..core.device.kernel_files import run_clock
from ..core.device.launching import report_compiling
from ..core.errors import WarpcreteError
from ..core.inputs.fingerprints import fingerprint
from ..core.run.coroutines import Coroutine
from ..core.run.run import Run
from .engine.batch import batch_key
from .engine.memory import memory_needed
from .engine.scheduling import drive_batches
from .engine.stepper import Stepper, steppers_of
from .packing import Request, pack_many
from .scene.bodies import BodyTable, placed_bodies
from .simulation import ElementSimulation

Outcome = Run | BaseException
PACKINGS_PER_BATCH = 32


def run_batch(
    simulations: Sequence[ElementSimulation],
    checkpoints: Sequence[Path | None] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Outcome]:
    """Run simulations on one device, in batches of simulations that need the same kernel features and fit the memory.

    Returns one entry for each simulation: its :class:`Run`, or the error that ended the simulation. The failure of a
    simulation does not affect the other simulations. `checkpoints` gives, for each simulation, the checkpoint to resume
    from, or None. After Ctrl-C the entry of a simulation that had begun is its unfinished run, and the entry of any
    other simulation is a `KeyboardInterrupt`. `progress` is called with the name of the current phase and the completed
    fraction of the work.
    """
    tell = progress or (lambda phase, fraction: None)
    try:
        with report_compiling(tell):
            return _run_batch(simulations, checkpoints or [None] * len(simulations), tell)
    finally:
        for simulation in simulations:
            simulation.abandon()


def _run_batch(
    simulations: Sequence[ElementSimulation], checkpoints: Sequence[Path | None], tell: Callable[[str, float], None]
) -> list[Outcome]:
    outcomes: dict[int, Outcome] = {}
    for number, simulation in enumerate(simulations):
        try:
            simulation.claim()
        except WarpcreteError as error:
            outcomes[number] = error
    claimed = [(n, s, c) for n, (s, c) in enumerate(zip(simulations, checkpoints)) if n not in outcomes]
    try:
        new = [simulation for _, simulation, path in claimed if path is None]
        packings = _packed(new, lambda fraction: tell("packing", fraction))
    except KeyboardInterrupt as stop:
        return [stop] * len(simulations)
    packings_by_number: dict[int, tuple[Any, float]] = {}
    groups: dict[Any, list[int]] = {}
    for number, simulation, path in claimed:
        if path is None and simulation.scene.fill is not None:
            packings_by_number[number] = packings[_packing_key(simulation)]
            if isinstance(packings_by_number[number][0], BaseException):
                outcomes[number] = packings_by_number[number][0]
                simulation.note_failure(outcomes[number])
                continue
        groups.setdefault((batch_key(simulation.model), simulation.threads), []).append(number)
    parts = [part for numbers in groups.values() for part in _split_by_memory(simulations, packings_by_number, numbers)]
    turns = _turns(simulations, parts)
    for done, turn in enumerate(turns):
        members = [
            _BatchMember(simulations, checkpoints, packings_by_number, outcomes, stream)
            for stream in _streams(simulations, turn)
        ]
        try:
            for part, (numbers, _) in zip(members, turn):
                part.begin(numbers)
            started_members = [part for part in members if part.scenes]
            _share_rounds(started_members)
            for part, results in zip(
                started_members, drive_batches([(part.scenes, part.stream) for part in started_members])
            ):
                part.end(results)
        except KeyboardInterrupt:
            break
        tell("running", (done + 1) / len(turns))
        if any(part.stopped for part in members):
            break
        if done + 1 < len(turns):
            for part in members:
                part.release()  # Free the memory of these batches, because the next batches need it.
    return [outcomes.get(number, KeyboardInterrupt()) for number in range(len(simulations))]


def _share_rounds(parts: Sequence[_BatchMember]) -> None:
    """Tell each batch with sub-cycled bonds how many such batches run on the GPU at the same time.

    `parts` contains all batches that run at the same time. Sub-cycled bonds are stiff bonds that are integrated with
    several shorter steps within each time step. The kernel for these shorter steps synchronises its thread blocks at
    barriers, so all blocks of all these batches must be resident on the GPU at once. Each batch therefore launches only
    its share of the blocks that fit.
    """
    batches = [next(iter(part.scenes.values()))[0].batch for part in parts]
    several = [batch for batch in batches if batch.features.subcycling]
    for batch in several:
        batch.subcycles.concurrent_batches = len(several)


class _BatchMember:
    """Simulations that advance together as one batch, with the coroutine and the result of each.

    A simulation is identified by its index in the list of all simulations.
    """

    def __init__(
        self,
        simulations: Sequence[ElementSimulation],
        checkpoints: Sequence[Path | None],
        packings_by_number: dict[int, tuple[Any, float]],
        outcomes: dict[int, Outcome],
        stream: Any,
    ) -> None:
        self.simulations, self.checkpoints, self.packings_by_number = simulations, checkpoints, packings_by_number
        self.outcomes = outcomes
        self.resumed: dict[int, dict[str, Any]] = {}
        self.stopped = False
        """True if Ctrl-C interrupted a run of this batch."""
        self.scenes: dict[int, tuple[Stepper, Coroutine]] = {}
        """Coroutine and :class:`Stepper` of each running simulation, by the index of the simulation.

        The coroutine carries out the run and is executed by `drive_batches`. The stepper advances the simulation in
        time.
        """
        self.stream = stream
        """CUDA stream on which this batch runs while other batches run at the same time; None if the batch runs
        alone."""
        self._members: list[ElementSimulation] = []

    def begin(self, numbers: Sequence[int]) -> None:
        """Create a batch of the simulations with the indices `numbers`.

        If a simulation cannot begin, its error is stored as its result.
        """
        with wp.ScopedStream(self.stream):
            self._begin(numbers)

    def _begin(self, numbers: Sequence[int]) -> None:
        running = [number for number in numbers if self._restore_or_place(number)]
        self._members = [self.simulations[number] for number in running]
        if not running:
            return
        try:
            steppers = self._steppers(running)
        except WarpcreteError as error:
            self.outcomes |= dict.fromkeys(running, error)
            self._members = []
            return
        for number, stepper in zip(running, steppers):
            self.simulations[number].join(stepper)
            self.scenes[number] = (stepper, self._whole_run(number))

    def end(self, results: dict[int, Outcome]) -> None:
        """Store the result of each simulation of this batch, and note whether Ctrl-C interrupted a run.

        `results` maps the index of a simulation to its run, or to the error that ended it.
        """
        self.outcomes |= results
        self.stopped = any(
            isinstance(r, KeyboardInterrupt) or (isinstance(r, Run) and not r.finished) for r in results.values()
        )

    def release(self) -> None:
        """Free the GPU memory of the simulations of this batch."""
        for member in self._members:
            if member.device.is_cuda:
                member.release()

    def _restore_or_place(self, number: int) -> bool:
        """Create the state of simulation `number`, or restore it from the simulation's checkpoint if it has one.

        Returns whether this succeeded. If it failed, the error is stored as the simulation's outcome.
        """
        simulation, path = self.simulations[number], self.checkpoints[number]
        try:
            if path is not None:
                self.resumed[number] = simulation.read_checkpoint(path)
                simulation.restore(self.resumed[number])
            else:
                simulation.place(*self.packings_by_number.get(number, (None, 0.0)))
        except WarpcreteError as error:
            self.outcomes[number] = error
            return False
        return True

    def _steppers(self, running: Sequence[int]) -> list[Stepper]:
        return steppers_of(
            [m.model for m in self._members],
            [m.state for m in self._members],
            time_steps=[m.scene.time_step for m in self._members],
            resumed=[self.resumed[number]["stepper"] if number in self.resumed else None for number in running],
            threads=self._members[0].threads,
        )

    def _whole_run(self, number: int) -> Coroutine:
        simulation = self.simulations[number]
        try:
            if number in self.resumed:
                yield from simulation.going_on(self.resumed[number])
            else:
                yield from simulation.preparing()
        except BaseException as error:
            simulation.note_failure(error)
            raise
        return (yield from simulation.running())


def _packing_key(simulation: ElementSimulation) -> tuple:
    """Return a key made of all settings that packing depends on; simulations with equal keys share one packing."""
    scene = simulation.scene
    return fingerprint(scene.fill), fingerprint(scene.contact), scene.seed, simulation.precision, str(simulation.device)


def _packed(simulations: Sequence[ElementSimulation], tell: Callable[[float], None]) -> dict[tuple, tuple[Any, float]]:
    """Run each distinct packing once, even if several simulations need it; return results and wall times.

    The dictionary's keys are results of :func:`_packing_key`. Each value is the packing's result from :func:`pack_many`
    and the wall time of one packing [s]. The wall time is the mean over all packings with the same device, precision
    and number of threads. `tell` is called with the completed fraction of the work.
    """
    needed = {_packing_key(s): s for s in simulations if s.scene.fill is not None}
    kinds: dict[tuple, list[tuple]] = {}
    for key, s in needed.items():
        kinds.setdefault((str(s.device), s.precision, s.threads), []).append(key)
    results_by_key: dict[tuple, tuple[Any, float]] = {}
    for (_, precision, threads), keys in kinds.items():
        started = run_clock()
        scenes = [needed[k].scene for k in keys]
        requests = [Request(scene.fill, scene.contact, scene.seed) for scene in scenes]  # type: ignore[arg-type]
        results: list[Any] = []
        for first in range(0, len(requests), PACKINGS_PER_BATCH):
            results += pack_many(
                requests[first : first + PACKINGS_PER_BATCH],
                device=needed[keys[0]].device,
                precision=precision,
                threads=threads,
                progress=tell,
            )
        took = (run_clock() - started) / len(keys)
        results_by_key |= {key: (result, took) for key, result in zip(keys, results)}
    return results_by_key


def _split_by_memory(
    simulations: Sequence[ElementSimulation], packings_by_number: dict[int, tuple[Any, float]], numbers: list[int]
) -> list[tuple[list[int], float]]:
    """Split the simulations with the indices `numbers` into batches that fit the device's memory.

    `packings_by_number` maps the index of a simulation to its packing and the wall time of this packing. Returns, for
    each batch, the indices of its simulations and the memory that they need [B].
    """
    first = simulations[numbers[0]]
    if not parallel(first.device) and first.threads > 1:
        # Give each simulation a separate batch, because a batch of several simulations runs on a single CPU thread.
        return [([number], 0.0) for number in numbers]
    room = MEMORY_FRACTION * memory_free(first.device)
    parts: list[tuple[list[int], float]] = []
    for number in numbers:
        simulation = simulations[number]
        table = packings_by_number[number][0][0] if number in packings_by_number else BodyTable.empty()
        needed = memory_needed(simulation.model, table.joined(placed_bodies(simulation.scene)))
        before, used = parts[-1] if parts else ([], 0.0)
        if before and used + needed <= room:
            parts[-1] = [*before, number], used + needed
        else:
            parts.append(([number], needed))
    return parts


def _turns(
    simulations: Sequence[ElementSimulation], parts: list[tuple[list[int], float]]
) -> list[list[tuple[list[int], float]]]:
    """Group the batches: the batches of one group run at the same time, and the groups run one after the other.

    `parts` contains, for each batch, the indices of its simulations and the memory that they need [B]. On a GPU, a
    group contains as many batches as fit into the memory. On a CPU, every group contains one batch.
    """
    turns: list[list[tuple[list[int], float]]] = []
    used = 0.0
    for numbers, needed in parts:
        device = simulations[numbers[0]].device
        if turns and parallel(device) and used + needed <= MEMORY_FRACTION * memory_free(device):
            turns[-1].append((numbers, needed))
            used += needed
        else:
            turns.append([(numbers, needed)])
            used = needed
    return turns


def _streams(simulations: Sequence[ElementSimulation], turn: list[tuple[list[int], float]]) -> list[Any]:
    """Return a CUDA stream for each batch in `turn`, a list of batches that run at the same time.

    On a CPU, and if `turn` contains only one batch, the list contains None instead of a stream. The largest batch has
    the lowest priority: it keeps the GPU busy anyway, so small batches should not wait for it.
    """
    device = simulations[turn[0][0][0]].device
    if len(turn) == 1 or not device.is_cuda:
        return [None] * len(turn)
    largest = max(needed for _, needed in turn)
    return [wp.Stream(device, priority=0 if needed == largest else -1) for _, needed in turn]
