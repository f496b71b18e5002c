"""Management of a run's recorders: it calls them, and handles failures of single recorders and full disks."""

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress

from ..errors import DiskFullError, is_full
from .ending import failure
from .recorder import Recorder
from .run import Run
from .simulation_base import SimulationBase


class Recording:
    """Group of a run's recorders, which are called one after the other.

    Expendable recorders, whose failure only causes a warning, are called last.
    """

    def __init__(self, simulation: SimulationBase, recorders: Sequence[Recorder]) -> None:
        self.simulation = simulation
        self.recorders = sorted(recorders, key=lambda recorder: recorder.expendable)
        self.active: list[Recorder] = []
        """Recorders that have started and have not failed, in the order in which they are called."""
        self.failures: list[Exception] = []
        """Errors at the end of the run that make the run count as unfinished: errors of recorders that are not
        `expendable`, and errors of any recorder that found the disk full."""
        self._states: dict[str, object] = {}  # Data that each recorder stored in the last checkpoint, by class name.

    def begin(self, states: Mapping[str, object]) -> None:
        """Start every recorder, or resume the recorder if `states` contains its state from a checkpoint."""
        self._states = dict(states)
        for recorder in self.recorders:
            self.active.append(recorder)
            state = states.get(class_name_of(recorder))
            if state is None:
                self._call(recorder, "start")
            else:
                self._call(recorder, "resume", state)

    def call(self, method: str, *arguments: object) -> None:
        """Call a method of every recorder; if an expendable recorder fails, warn and go on without this recorder."""
        for recorder in list(self.active):
            self._call(recorder, method, *arguments)

    def states(self) -> dict[str, object]:
        """Return the data that each recorder needs to go on after a checkpoint, by the class name of the recorder.

        For a recorder that has failed and is no longer used, return its data from an earlier checkpoint, if any.
        """
        for recorder in list(self.active):
            self._states[class_name_of(recorder)] = self._call(recorder, "checkpoint")
        return {kind: state for kind, state in self._states.items() if state is not None}

    def _call(self, recorder: Recorder, method: str, *arguments: object) -> object:
        try:
            return getattr(recorder, method)(self.simulation, *arguments)
        except Exception as error:
            if not recorder.expendable or is_full(error):
                raise
            self.active.remove(recorder)
            self._warn(recorder, error)
            with suppress(Exception):  # Write what the failed recorder has recorded so far.
                recorder.finish(self.simulation, None)  # type: ignore[arg-type]
            return self._states.get(class_name_of(recorder))

    def finish(self, run: Run) -> None:
        """Let every recorder write its data to disk, because the run has ended.

        Add errors to `failures`, except those that only cause a warning because the recorder is expendable.
        """
        essential = [recorder for recorder in self.active if not recorder.expendable]
        for recorder in [*reversed(essential), *reversed(self.active[len(essential) :])]:
            self._end(recorder, "finish", run)

    def tidy(self, run: Run) -> None:
        """Let every recorder tidy up its files after a complete run, for example join several files into one."""
        for recorder in self.active:
            self._end(recorder, "tidy", run)

    def _end(self, recorder: Recorder, method: str, run: Run) -> None:
        try:
            getattr(recorder, method)(self.simulation, run)
        except Exception as error:
            if recorder.expendable and not is_full(error):
                self._warn(recorder, error)
                return
            self.failures.append(error)
            if run.finished:
                self.simulation.ending = failure(error, self.simulation.stepper.time)
                run.result["ended"] = self.simulation.ending.entry()
            run.finished = run.result["finished"] = False

    def mark_incomplete(self) -> None:
        """Write the results again, now with the entry that the run is not complete.

        The results must be written again if a recorder failed at the end of a run that has no checkpoint to continue
        from. Recorders that are `expendable` write no results.
        """
        for recorder in self.active:
            if not recorder.expendable:
                with suppress(Exception):
                    recorder.write(self.simulation)

    def close(self) -> None:
        """Let every recorder release its resources."""
        for recorder in self.recorders:
            recorder.close(self.simulation)

    @staticmethod
    def _warn(recorder: Recorder, error: Exception) -> None:
        reason = " ".join(str(error).split()) or type(error).__name__
        warnings.warn(
            f"{class_name_of(recorder)} failed, and the run continues without its output: {reason}", stacklevel=2
        )


def class_name_of(recorder: Recorder) -> str:
    """Return the class name of a recorder, by which a checkpoint identifies it."""
    return type(recorder).__name__


def disk_full_error(errors: Sequence[Exception], kept: float | None) -> DiskFullError:
    """Return the error to raise for a run that a full disk has ended.

    `errors` are the errors of the run's recorders, and the message names all files that they mention. `kept` is the
    simulated time of the checkpoint on disk [s], or None if there is no checkpoint.
    """
    first = " ".join(str(errors[0]).split()).partition("; files written so far")[0]
    more = [text.partition(": ")[0] for text in dict.fromkeys(map(str, errors[1:])) if not text.startswith(first)]
    missing = f"; neither can {', '.join(more)}" if more else ""
    state = "no checkpoint was saved" if kept is None else f"the checkpoint at t = {kept:.6g} s is saved"
    return DiskFullError(f"{first}{missing}; {state}; free some space, then continue with --resume")
