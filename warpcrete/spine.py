"""What every run goes through, whatever its method: samples, frames, checkpoints, interruptions, recorders."""

from __future__ import annotations

import os
import time as wall_clock
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import checkpoint
from .errors import between, one_of, positive, refuse
from .launching import default_threads
from .model import find_device
from .packing import PackingReport
from .progress import ProgressBar
from .scene import PRECISIONS
from .state import BodyTable

Progress = Callable[[str, float, dict[str, Any]], None]
"""Called with the phase (`packing`, `settling`, `running`), the share done and a few current figures."""
Course = Generator[None, None, Any]
"""What a run does, as a generator: each `yield` waits until the goal that was set is reached."""


class Recorder:
    """Where a run goes; subclasses override what they need.

    Methods are called in this order; `finish` also after an interruption or an error.
    """

    def start(self, simulation: Any) -> None:
        """The run is about to begin."""

    def resume(self, simulation: Any, memory: dict[str, Any]) -> None:
        """Instead of `start`, when a run goes on from the checkpoint at which `checkpoint` returned `memory`.

        Whatever was recorded after it must go.
        """
        self.start(simulation)

    def sample(self, simulation: Any, row: dict[str, float]) -> None:
        """A row of the series."""

    def frame(self, simulation: Any) -> None:
        """A picture is due."""

    def checkpoint(self, simulation: Any) -> dict[str, Any]:
        """Put on disk what is there so far; returns what `resume` will need."""
        return {}

    def finish(self, simulation: Any, run: Run) -> None:
        """The run has ended: put everything on disk. The last recorder finishes first."""

    def tidy(self, simulation: Any, run: Run) -> None:
        """The run is complete and its checkpoint gone: what only a resumed run needs may go."""


@dataclass
class Run:
    """A finished (or interrupted) run."""

    scene: Any
    series: dict[str, np.ndarray]
    """One array a column, one entry a sample."""
    units: dict[str, str]
    """Unit of each column."""
    result: dict[str, Any]
    """Figures of the whole run; those with a unit are `{"value", "unit"}`."""
    packing: PackingReport | None
    finished: bool
    interrupted: bool = False
    """Cut at once by an interruption (Ctrl-C), not at a sample."""
    folder: Path | None = None
    bodies: BodyTable = field(default_factory=BodyTable.empty)
    """Bodies at the end."""


class Spine(ABC):
    """A scene on a device, with recorders, from t = 0 to its end; subclasses bring the method.

    Parameters: `scene`; `device` as Warp names it, None for a GPU if there is one, else the CPU; `precision`
    `float32` or `float64`, None for the scene's own; `threads` on a CPU, None for all its cores (a run is the same to
    the bit for a given number of them); `recorders`; `frame_interval` simulated seconds between two recorded frames;
    `progress` True for a bar, or a callback; `checkpoint_path` of a file that is written at the start, then every
    `checkpoint_every` seconds of wall time (0: at every sample) and at an interruption, and removed at the end.
    Recorders of a run with checkpoints are of different classes, by which a resumed run knows them. Raises
    :class:`SceneError`, :class:`DeviceError`; a run may raise :class:`InstabilityError`.
    """

    stepper: Any
    """Has `time` [s], `steps`, and `advancing(until)`, a course."""

    def __init__(
        self,
        scene: Any,
        *,
        device: str | None = None,
        precision: str | None = None,
        threads: int | None = None,
        recorders: Sequence[Recorder] = (),
        frame_interval: float = 0.04,
        progress: Progress | bool = False,
        checkpoint_path: Path | None = None,
        checkpoint_every: float = 60.0,
    ) -> None:
        positive("frame_interval", frame_interval, "s")
        between("checkpoint_every", checkpoint_every, 0, np.inf, "s")
        self.scene = scene
        self.device = find_device(device)
        self.precision = precision or scene.precision
        one_of("precision", self.precision, PRECISIONS)
        self.threads = default_threads() if threads is None else threads
        cores = os.cpu_count() or 1
        if not 1 <= self.threads <= cores:
            refuse("threads", threads, f"must be in [1, {cores}], the cores of this machine")
        self.recorders = list(recorders)
        self.frame_interval = frame_interval
        self.checkpoint_path, self.checkpoint_every = checkpoint_path, checkpoint_every
        self.stop_requested = False
        self.finishing = False
        if progress is True:
            progress = ProgressBar()
        self._progress = progress or (lambda phase, share, figures: None)
        self._spent: dict[str, float] = {}
        self._ran = False
        self._ran_before = 0.0  # wall time before the checkpoint that this run goes on from [s]
        self._samples = 0  # rows after the one at t = 0
        self._next_frame = frame_interval
        self._resumed: dict[str, Any] | None = None
        self._set_up()

    @abstractmethod
    def _set_up(self) -> None:
        """What the method makes of the scene at once; refuses a scene that it does not know."""

    @property
    @abstractmethod
    def rows(self) -> list[dict[str, float]]:
        """Rows of the series so far."""

    @property
    def duration(self) -> float:
        """Simulated time of the whole run, at most [s]."""
        return self.scene.duration

    @abstractmethod
    def save(self, path: Path) -> None:
        """Write a checkpoint of the state as it is now, recorders included."""

    @abstractmethod
    def _sample(self) -> dict[str, float]:
        """Measure, tell the recorders, and return the row."""

    @abstractmethod
    def _result(self, finished: bool) -> Run:
        """The run as it is now, with its figures."""

    def _enough(self) -> bool:
        """The run may end before its duration."""
        return False

    def _clocks(self) -> dict[str, Any]:
        """What a checkpoint keeps of the run itself."""
        return {
            "recorders": {_kind(r): r.checkpoint(self) for r in self.recorders} if self._ran else {},
            "samples": self._samples,
            "next_frame": self._next_frame,
            "spent": self._spent | {"running": self._running()},
        }

    def _recall_clocks(self, memory: dict[str, Any]) -> None:
        self._samples, self._next_frame = memory["samples"], memory["next_frame"]
        self._spent = memory["spent"]
        self._ran_before = self._spent["running"]

    def running(self) -> Course:
        """Course: from t = 0, or a checkpoint, to the end; returns the :class:`Run`."""
        self._ran = True
        self._started = wall_clock.perf_counter()
        begun: list[Recorder] = []
        finished = interrupted = False
        try:
            try:
                for recorder in self.recorders:
                    begun.append(recorder)
                    memory = (self._resumed or {}).get("recorders", {}).get(_kind(recorder))
                    if memory is None:
                        recorder.start(self)
                    else:
                        recorder.resume(self, memory)
                finished = yield from self._loop()
            except KeyboardInterrupt:
                interrupted = True
        finally:
            self._spent["running"] = self._running()
            self.finishing = True
            run = self._result(finished)
            run.interrupted = interrupted
            failures = []
            for recorder in reversed(begun):
                try:
                    recorder.finish(self, run)
                except Exception as error:  # one broken output must not cost the others
                    failures.append(error)
            if finished and not failures:
                if self.checkpoint_path is not None:
                    checkpoint.remove(self.checkpoint_path)
                for recorder in begun:
                    recorder.tidy(self, run)
            if isinstance(self._progress, ProgressBar):
                self._progress.close()
        if failures:
            raise failures[0]
        return run

    def _loop(self) -> Course:
        interval, duration, stepper = self.scene.sample_interval, self.duration, self.stepper
        if not self.rows:
            self._sample()
            for recorder in self.recorders:
                recorder.frame(self)
            self._checkpoint()
        else:
            self._saved = wall_clock.perf_counter()
        samples = max(1, int(np.ceil(duration / interval - 1e-9)))
        for number in range(self._samples + 1, samples + 1):
            if self.stop_requested:
                self._checkpoint()
                return False
            until = min(number * interval, duration)
            yield from stepper.advancing(until)
            self._samples = number
            row = self._sample()
            enough = self._enough()
            if stepper.time >= self._next_frame - 1e-9 or number == samples or enough:
                for recorder in self.recorders:
                    recorder.frame(self)
                self._next_frame = self.frame_interval * (np.floor(stepper.time / self.frame_interval + 1e-9) + 1)
            if enough:
                return True
            if number < samples and wall_clock.perf_counter() - self._saved >= self.checkpoint_every:
                self._checkpoint()
            self._tell(
                "running",
                number / samples,
                steps_per_s=stepper.steps / max(self._running(), 1e-9),
                **({"pressure": row["pressure"]} if "pressure" in row else {}),
            )
        return True

    def _checkpoint(self) -> None:
        if self.checkpoint_path is not None:
            try:
                self.save(self.checkpoint_path)
            except OSError as error:  # a full disk must not end the run; the checkpoint before is still there
                warnings.warn(f"'{self.checkpoint_path}': no checkpoint was written: {error}", stacklevel=2)
        self._saved = wall_clock.perf_counter()

    def _running(self) -> float:
        return self._ran_before + (wall_clock.perf_counter() - self._started if self._ran else 0.0)

    def _tell(self, phase: str, share: float, **figures: Any) -> None:
        self._progress(phase, share, figures)


def to_end(course: Course) -> Any:
    """Go through a course that waits for nobody else; what it returns."""
    while True:
        try:
            next(course)
        except StopIteration as end:
            return end.value


def _kind(recorder: Recorder) -> str:
    return type(recorder).__name__
