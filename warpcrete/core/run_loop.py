"""What every run goes through, whatever its method: samples, frames, checkpoints, interruptions, recorders.

A method brings a subclass of :class:`Simulation`; :mod:`warpcrete.methods` lists them.
"""

from __future__ import annotations

import time as wall_clock
import warnings
from abc import abstractmethod
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from . import checkpoint
from .device import checked_threads, find_device, scalar_of
from .display import Display
from .errors import InstabilityError, RunFolderError, SceneError, WarpcreteError, between, refuse
from .files import is_full
from .frames import Frames
from .launching import telling
from .progress import ProgressBar
from .recorder import Recorder, says
from .recording import Recording, full_disk
from .run import Run

Progress = Callable[[str, float, dict[str, Any]], None]
"""Called with the phase (`packing`, `settling`, `running`; `compiling` between them, where that takes a while), the
fraction done and a few current figures."""


@dataclass(frozen=True)
class Until:
    """Where a run wants to be before it goes on: at the end of the step that reaches `time` [s]."""

    time: float


Coroutine = Generator[Any, None, Any]
"""A run, or a part of one, that says at each `yield` where it wants to be and goes on when it is there.

So whoever drives it may take the steps of many runs together."""


S = TypeVar("S", bound="Simulation")


class Simulation:
    """A scene on a device, with recorders, from t = 0 to its end. The scene's type says by which method.

    Parameters: `scene`; `device` as Warp names it, None for a GPU if there is one, else the CPU; `precision`
    `float32` or `float64`, None for the scene's own; `threads` on a CPU, None for all its cores (a run is the same to
    the bit for a given number of them); `recorders`; `frame_interval` simulated seconds between two recorded frames,
    None for as many as :class:`warpcrete.core.frames.Frames` says; `progress` True for a bar, or a callback;
    `checkpoint_path` of a file that is written at the start, then every `checkpoint_every` seconds of wall time (0: at
    every sample), at an interruption and at the end, and removed when everything else is on disk.
    Recorders of a run with checkpoints are of different classes, by which a resumed run knows them. Raises
    :class:`SceneError`, :class:`DeviceError`; a run may raise :class:`InstabilityError`, and :class:`DiskFullError`
    when the disk takes no more.
    """

    scene_type: ClassVar[type]
    """Of the scenes that a subclass takes."""
    kinds: ClassVar[list[type[Simulation]]] = []
    """Subclasses, one for each method."""
    stepper: Any
    """Has `time` [s], `steps`, and `advance(until)`, which steps to a time [s]."""
    shares_cores = False
    """Other runs beside this one have the cores that its threads leave."""

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        if "scene_type" in cls.__dict__:
            missing = [name for name in vars(Simulation) if getattr(getattr(cls, name), "__isabstractmethod__", False)]
            if missing:
                raise TypeError(f"{cls.__name__} lacks {', '.join(missing)}")
            Simulation.kinds.append(cls)

    def __new__(cls: type[S], scene: Any, **settings: Any) -> S:
        kind: Any = cls
        if cls is Simulation:
            kind = next((kind for kind in Simulation.kinds if isinstance(scene, kind.scene_type)), cls)
        wanted = getattr(kind, "scene_type", None)
        if wanted is None or not isinstance(scene, wanted):
            known = [wanted] if wanted else [kind.scene_type for kind in Simulation.kinds]
            hint = (
                "warpcrete.Simulation takes every scene" if wanted else "warpcrete.scenes has functions that make some"
            )
            refuse("scene", type(scene).__name__, f"must be a {' or a '.join(t.__name__ for t in known)}", hint)
        return super().__new__(kind)

    def __init__(
        self,
        scene: Any,
        *,
        device: str | None = None,
        precision: str | None = None,
        threads: int | None = None,
        recorders: Sequence[Recorder] = (),
        frame_interval: float | None = None,
        progress: Progress | bool = False,
        checkpoint_path: Path | None = None,
        checkpoint_every: float = 60.0,
    ) -> None:
        between("checkpoint_every", checkpoint_every, 0, np.inf, "s")
        self.scene = scene
        self.device = find_device(device)
        self.precision = precision or scene.precision
        scalar_of(self.precision)
        self.threads = checked_threads(threads)
        self.recorders = list(recorders)
        self._recording = Recording(self, self.recorders)
        self.checkpoint_path, self.checkpoint_every = checkpoint_path, checkpoint_every
        self.stop_requested = False
        self.finishing = False
        self._progress: Progress = (
            ProgressBar() if progress is True else progress or (lambda phase, fraction, figures: None)
        )
        self._spent: dict[str, float] = {}
        self._ran = False
        self.over = False
        """True when the last step has been taken: only recordings may still have to be completed."""
        self._saved = wall_clock.perf_counter()  # when the last checkpoint was written or read
        self.goes_on = False
        """The run goes on from a checkpoint, in the folder that is there."""
        self._kept: float | None = None  # simulated time of the state in the checkpoint [s]
        self._ran_before = 0.0  # wall time before the checkpoint that this run goes on from [s]
        self._samples = 0  # rows after the one at t = 0
        self.sampled = 0.0, 0
        """Time [s] and steps of the last row, since this object began."""
        self._left: float | None = None  # fraction done at a row that is completed when further steps are under way
        self._resumed: dict[str, Any] | None = None
        self.frames = Frames(frame_interval, self.expected_duration, self.frame_step)
        self.set_up()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of scene {self.scene.name!r} on {self.device}, {self.precision}>"

    # What a method brings.

    @abstractmethod
    def set_up(self) -> None:
        """What the method makes of the scene at once; refuses what cannot be simulated."""

    @property
    @abstractmethod
    def prepared(self) -> bool:
        """The state at t = 0, or that of a checkpoint, is there."""

    @abstractmethod
    def prepare(self) -> None:
        """Everything up to t = 0."""

    @property
    @abstractmethod
    def rows(self) -> list[dict[str, float]]:
        """Rows of the series so far."""

    @abstractmethod
    def unit(self, column: str) -> str:
        """Unit of a column of the series."""

    @abstractmethod
    def measure(self) -> dict[str, float]:
        """Measure, and append the row to `rows`; the row that was begun, if one was."""

    def begin_measure(self) -> bool:
        """Begin a row of the state as it is now, if the run may go on before it is complete."""
        return False

    @abstractmethod
    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if the row shows that the state means nothing any more."""

    @abstractmethod
    def display(self, colouring: str | None = None) -> Display:
        """What recorders draw."""

    @abstractmethod
    def result(self, finished: bool) -> Run:
        """The run as it is now, with its quantities."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps besides what this class keeps."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a `state_dict`, in place of `prepare`."""

    @abstractmethod
    def release(self) -> None:
        """Let go of the device's memory; the run's results stay."""

    @property
    def duration(self) -> float:
        """Simulated time of the whole run, at most [s]."""
        return self.scene.duration

    @property
    def expected_duration(self) -> float:
        """Simulated time that the run will take, about [s]."""
        return self.duration

    @property
    def frame_step(self) -> float:
        """Size of the steps [s], if they are the same wherever the run stops: frames may lie between samples then."""
        return np.inf

    def ended_early(self) -> bool:
        """The run may end before its duration."""
        return False

    def reaching(self, time: float) -> Coroutine:
        """Go on to a time [s]; methods do here what must be done on the way."""
        yield Until(time)

    # Checkpoints.

    def save(self, path: Path) -> None:
        """Write a checkpoint of the state as it is now; it takes effect once recorders have written their part.

        A failure leaves the previous checkpoint, from which every recorder can go on. Raises :class:`RunFolderError`.
        """
        try:
            self._write_state(path)
            if self._ran:
                self._recording.call("write")
            self._commit_state(path)
        except BaseException:
            checkpoint.discard(path)
            raise

    def _write_state(self, path: Path) -> None:
        """Write the state beside the checkpoint at `path`."""
        contents = self.state_dict()
        contents["run"] = {
            "recorders": self._recording.states() if self._ran else {},
            "samples": self._samples,
            "next_frame": self.frames.next,
            "spent": self._spent | {"running": self._running()},
            "over": self.over,
        }
        checkpoint.write_beside(path, self.scene, self.device, self.precision, contents)

    def _commit_state(self, path: Path) -> None:
        checkpoint.commit(path)
        self._kept = self.stepper.time if self._ran else 0.0
        self._saved = wall_clock.perf_counter()

    def resume(self, path: Path) -> None:
        """Go on from a checkpoint of the same scene, device and precision, in place of `prepare`.

        The run then holds the same bits as one that was never cut. Raises :class:`RunFolderError` for a file that
        is no whole checkpoint of this simulation.
        """
        self.load_state_dict(self.read_checkpoint(path))

    def read_checkpoint(self, path: Path) -> dict[str, Any]:
        """The `state_dict` of a checkpoint; clocks go on from there."""
        contents = checkpoint.read(path, self.scene, self.device, self.precision)
        self._resumed = run = contents["run"]
        self._samples, self.frames.next = run["samples"], run["next_frame"]
        self._spent = run["spent"]
        self._ran_before = self._spent["running"]
        self.over = run["over"]
        self.goes_on, self._saved = True, wall_clock.perf_counter()
        return contents

    # The run.

    def begin(self, path: Path | None = None) -> None:
        """Do everything up to t = 0, or up to the checkpoint at `path` if it is there, once recorders have folders.

        Only then no other run can add the checkpoint, or remove it.
        """
        self.goes_on = path is not None and path.is_file()
        try:
            self.claim()
            self.goes_on = path is not None and path.is_file()
            if path is not None and self.goes_on:
                self.resume(path)
            else:
                self.prepare()
        except BaseException as error:
            self.abandon(refused=isinstance(error, SceneError))
            raise

    def claim(self) -> None:
        """Have recorders take what only one run may have, such as its folder."""
        for recorder in self.recorders:
            recorder.claim(self)

    def abandon(self, refused: bool = False) -> None:
        """Give back what `claim` took, unless the run has begun; a scene that is `refused` leaves no state either."""
        if not self._ran:
            if refused and not self.goes_on and self.checkpoint_path is not None:
                with suppress(OSError):
                    self.checkpoint_path.unlink(missing_ok=True)
            for recorder in self.recorders:
                recorder.abandon(self)

    def run(self) -> Run:
        """Prepare and run: to the end of the duration, or until `stop_requested` or Ctrl-C."""
        if self._ran:
            raise WarpcreteError("this simulation has run; make a new Simulation for another run")
        with telling(self.tell):
            if not self.prepared:
                self.begin()
            return drive_alone(self.running(), self.stepper.advance)

    def running(self) -> Coroutine:
        """From t = 0, or a checkpoint, to the end; returns the :class:`Run`."""
        self._ran = True
        self._recording = Recording(self, self.recorders)
        self._started = wall_clock.perf_counter()
        if self._resumed is not None:
            self._kept = self.stepper.time
        finished = interrupted = False
        full: list[Exception] = []  # disk
        try:
            try:
                if not self.rows:  # nothing may cost the state at t = 0, which took packing and settling
                    self._checkpoint()
                self._recording.begin((self._resumed or {}).get("recorders", {}))
                finished = yield from self._loop()
            except KeyboardInterrupt:
                interrupted = True
            except Exception as error:
                if not is_full(error):
                    raise
                full.append(error)
        finally:
            failures = self._recording.failures
            try:
                self._complete()
            except KeyboardInterrupt:
                interrupted = True
            except InstabilityError:  # the run has ended already, for another reason
                pass
            except Exception as error:
                failures.append(error)
            self._spent["running"] = self._running()
            self.finishing = True
            run = self._end(finished, interrupted)
        if full := [*full, *filter(is_full, failures)]:
            raise full_disk(full, self._kept) from full[0]
        if failures:
            raise failures[0]
        return run

    def _end(self, finished: bool, interrupted: bool) -> Run:
        """Put everything on disk, what matters most first; the checkpoint goes when nothing else is missing.

        The last state takes effect only when all recorders have finished, and then spares a run that is killed while
        recordings are joined its last steps. Otherwise the run goes on from the checkpoint before, and loses nothing.
        """
        recording, path = self._recording, self.checkpoint_path
        written = False
        if finished and path is not None:
            self.over = True
            with suppress(OSError, RunFolderError):
                self._write_state(path)
                written = True
        run = self.result(finished)
        run.interrupted = interrupted
        run.finished = run.result["finished"] = run.finished and not recording.failures
        recording.finish(run)
        if written and path is not None:
            if run.finished:
                with suppress(OSError, RunFolderError):
                    self._commit_state(path)
            checkpoint.discard(path)
        if run.finished:
            recording.tidy(run)
        if finished and not run.finished and self._kept is None:
            recording.call_off()
        if run.finished and path is not None:
            checkpoint.remove(path)
        recording.close()
        if isinstance(self._progress, ProgressBar):
            self._progress.close()
        return run

    def _loop(self) -> Coroutine:
        interval, duration, stepper = self.scene.sample_interval, self.duration, self.stepper
        if self.over:
            self.ended_early()  # which says how it ended
            return True
        if not self.rows:
            self.sampled = stepper.time, stepper.steps
            self._sample()
            self._frame()
        samples = max(1, int(np.ceil(duration / interval - 1e-9)))
        for number in range(self._samples + 1, samples + 1):
            if self.stop_requested:
                self._complete()
                self._checkpoint()
                return False
            goal = min(number * interval, duration)
            while self.recorders and self.frames.before(goal):
                yield from self.reaching(self.frames.next)
                self._frame()
            yield from self.reaching(goal)
            self._complete()  # where no step had to be taken
            self._samples, self.sampled = number, (stepper.time, stepper.steps)
            if number < samples and self._goes_on():
                self._left = number / samples
                if self._frame_is_due():
                    self._frame()
                stepper.meanwhile = self._complete
                continue
            row = self._sample()
            ended = self.ended_early()
            if self.frames.due(stepper.time) or number == samples or ended:
                self._frame()
            if ended:
                return True
            if number < samples:
                self._checkpoint_if_due()
            self._tell_of(row, number / samples)
        return True

    def _goes_on(self) -> bool:
        """Whether the next steps may be launched before this sample is complete: nobody but it wants the state as it is
        now, or takes at once what is drawn of it. Begins the sample then."""
        kinds = [type(recorder) for recorder in self.recorders]
        return (
            not self.stop_requested
            and all(says(kind, "sample", "rows_alone") for kind in kinds)
            and not (self._frame_is_due() and not all(says(kind, "frame", "draws_alone") for kind in kinds))
            and (self.checkpoint_path is None or wall_clock.perf_counter() - self._saved < self.checkpoint_every)
            and self.begin_measure()
        )

    def _frame_is_due(self) -> bool:
        return bool(self.recorders) and self.frames.due(self.sampled[0])

    def _complete(self) -> None:
        """Do what was left of a sample, if anything was."""
        fraction, self._left = self._left, None
        if fraction is not None:
            self._tell_of(self._sample(), fraction)

    def _sample(self) -> dict[str, float]:
        row = self.measure()
        self._recording.call("sample", row)
        self.watch_row(row)
        return row

    def _tell_of(self, row: dict[str, float], fraction: float) -> None:
        pressure = {name: row[name] for name in ("pressure",) if name in row}
        self.tell("running", fraction, steps_per_s=self.sampled[1] / max(self._running(), 1e-9), **pressure)

    def _frame(self) -> None:
        self._recording.call("frame")
        self.frames.taken(self.stepper.time)

    def _checkpoint(self) -> None:
        if self.checkpoint_path is not None:
            try:
                self.save(self.checkpoint_path)
            except RunFolderError as error:  # the one before is still there
                if is_full(error):
                    raise
                warnings.warn(f"no checkpoint was written: {error}", stacklevel=2)
        self._saved = wall_clock.perf_counter()

    def _checkpoint_if_due(self) -> None:
        if wall_clock.perf_counter() - self._saved >= self.checkpoint_every:
            self._checkpoint()

    def _running(self) -> float:
        return self._ran_before + (wall_clock.perf_counter() - self._started if self._ran else 0.0)

    def tell(self, phase: str, fraction: float, **figures: Any) -> None:
        """Report progress."""
        self._progress(phase, fraction, figures)


def drive_alone(coroutine: Coroutine, advance: Callable[[float], None]) -> Any:
    """Drive a coroutine that wants to be at times only; what it returns. Errors on the way are raised inside it."""
    try:
        goal = next(coroutine)
        while True:
            try:
                advance(goal.time)
            except BaseException as error:
                goal = coroutine.throw(error)
            else:
                goal = next(coroutine)
    except StopIteration as end:
        return end.value
