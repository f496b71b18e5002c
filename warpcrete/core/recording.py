"""The recorders of one run: each fails alone, and the run is told what is on disk."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from .errors import DiskFullError
from .files import is_full
from .recorder import Recorder
from .run import Run


class Recording:
    """Calls the recorders of a run, those that are not expendable first."""

    def __init__(self, simulation: Any, recorders: Sequence[Recorder]) -> None:
        self.simulation = simulation
        self.recorders = sorted(recorders, key=lambda recorder: recorder.expendable)
        self.active: list[Recorder] = []
        """Recorders that have begun and have not failed, in the same order."""
        self.failures: list[Exception] = []
        """What the run could not put on disk, or could not end with."""
        self._states: dict[str, Any] = {}  # of recorders at the last checkpoint, by their kind

    def begin(self, states: dict[str, Any]) -> None:
        """Start every recorder, or resume it from its state in a checkpoint."""
        self._states = dict(states)
        for recorder in self.recorders:
            self.active.append(recorder)
            state = states.get(kind_of(recorder))
            if state is None:
                self._call(recorder, "start")
            else:
                self._call(recorder, "resume", state)

    def call(self, method: str, *arguments: Any) -> None:
        """Call a method of every recorder; an expendable one that fails is left out from then on, with a warning."""
        for recorder in list(self.active):
            self._call(recorder, method, *arguments)

    def states(self) -> dict[str, Any]:
        """Return what each recorder needs to go on from this moment, by the kind of recorder.

        A recorder that was left out goes on from its state at an earlier checkpoint.
        """
        for recorder in list(self.active):
            self._states[kind_of(recorder)] = self._call(recorder, "checkpoint")
        return {kind: state for kind, state in self._states.items() if state is not None}

    def _call(self, recorder: Recorder, method: str, *arguments: Any) -> Any:
        try:
            return getattr(recorder, method)(self.simulation, *arguments)
        except Exception as error:
            if not recorder.expendable or is_full(error):
                raise
            self.active.remove(recorder)
            self._warn(recorder, error)
            with suppress(Exception):  # what there is of it
                recorder.finish(self.simulation, None)  # type: ignore[arg-type]
            return self._states.get(kind_of(recorder))

    def finish(self, run: Run) -> None:
        """Put everything on disk, each recorder for itself; `failures` then has what a run cannot do without."""
        essential = [recorder for recorder in self.active if not recorder.expendable]
        for recorder in [*reversed(essential), *reversed(self.active[len(essential) :])]:
            self._end(recorder, "finish", run)

    def tidy(self, run: Run) -> None:
        """Bring a complete run into its final form."""
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
            run.finished = run.result["finished"] = False

    def call_off(self) -> None:
        """Have essential recorders note that the run is not complete, where nothing else says so."""
        for recorder in self.active:
            if not recorder.expendable:
                with suppress(Exception):
                    recorder.write(self.simulation)

    def close(self) -> None:
        """Let go of everything."""
        for recorder in self.recorders:
            recorder.close(self.simulation)

    @staticmethod
    def _warn(recorder: Recorder, error: Exception) -> None:
        reason = " ".join(str(error).split()) or type(error).__name__
        warnings.warn(f"{kind_of(recorder)} failed, the run goes on without it: {reason}", stacklevel=2)


def kind_of(recorder: Recorder) -> str:
    """Return the name by which a checkpoint knows a recorder."""
    return type(recorder).__name__


def full_disk(errors: Sequence[Exception], kept: float | None) -> DiskFullError:
    """Return the error of a run that a full disk ended: the first of `errors`, and what was not written.

    `kept` is the simulated time of the state on disk [s], None if there is none.
    """
    first = " ".join(str(errors[0]).split()).partition("; what is on disk")[0]
    more = [text.partition(": ")[0] for text in dict.fromkeys(map(str, errors[1:])) if not text.startswith(first)]
    missing = f"; neither can {', '.join(more)}" if more else ""
    state = "no state was kept" if kept is None else f"the state at t = {kept:.6g} s is kept"
    return DiskFullError(f"{first}{missing}; {state}; free some space, then go on with --resume")
