"""Run loop that all simulation methods share: it steps the state, measures, records, saves and handles interruptions.

Each method provides a subclass of :class:`Simulation`; :mod:`warpcrete.methods` lists them.
"""

import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..device.device import checked_threads, find_device, scalar_of
from ..device.interrupts import terminate_as_interrupt
from ..device.launching import report_compiling
from ..errors import RunFolderError, SceneError, WarpcreteError, between, callback, is_full, positive, refuse
from ..records import Record
from ..units import number as number_of
from ..units import quantity
from . import checkpoint
from .checkpointed import CheckpointedSimulation
from .coroutines import Coroutine, run_coroutine
from .ending import Ending, failure, interruption
from .frames import Frames
from .output import CHECKPOINT, RunOutput, output_of, recorders_without_folder
from .progress import Progress, ProgressBar, announce_compiling
from .provenance import provenance
from .recorder import Recorder
from .recording import Recording, disk_full_error
from .run import FinalState, Run
from .wall_times import WallTimes

DEFAULT_CHECKPOINT_INTERVAL = 60.0
"""Default wall time between two checkpoints of a run [s]."""
MAX_KEPT_MEMORY = 2e9
"""Largest device memory of a run [B] for which the run keeps its final state for `run.save`."""


class Simulation(CheckpointedSimulation):
    """Simulation of a scene on a device from t = 0 to its end; the scene's type selects the simulation method.

    `device` is Warp's name of a device; None selects a GPU if there is one, else the CPU. `precision` is `float32` or
    `float64`; None selects the precision of the scene. `threads` is the number of threads on a CPU; None selects one
    thread for each core. The results of flows on a grid are bitwise equal for any number of threads; the
    results of discrete elements are bitwise equal only for equal numbers of threads. `frame_interval` is the simulated
    time between two recorded frames [s]; None selects the default of :class:`warpcrete.core.run.frames.Frames`.
    `progress` is True for a progress bar, or a callback.

    `out` is the path of a run folder, which gets everything that `warpcrete run` writes. If the folder holds an
    interrupted run of the same scene, this run continues. A :class:`warpcrete.RunFolder` also selects recordings and
    colours. The checkpoint is in this folder; with `checkpoint_every=0`, no checkpoint is written, as in the command.

    Without `out`, the file `checkpoint_path` is written at the start, then every `checkpoint_every` seconds of wall
    time (0: at every row of the time series), at an interruption and at the end. The file is removed when all other
    data is on disk. In a run with checkpoints, all `recorders` must be of different classes, because a resumed run
    identifies recorders by class.

    Raises :class:`SceneError`, :class:`DeviceError` and, for `out`, :class:`RunFolderError`. A run may raise
    :class:`InstabilityError`, and :class:`DiskFullError` if the disk is full.
    """

    def __init__(  # pyright: ignore[reportInconsistentConstructor]  # The scene's type selects the subclass.
        self,
        scene: Any,
        *,
        device: str | None = None,
        precision: str | None = None,
        threads: int | None = None,
        out: str | Path | RunOutput | None = None,
        recorders: Sequence[Recorder] = (),
        frame_interval: float | None = None,
        progress: Progress | bool = False,
        checkpoint_path: Path | None = None,
        checkpoint_every: float = DEFAULT_CHECKPOINT_INTERVAL,
    ) -> None:
        between("checkpoint_every", checkpoint_every, 0, np.inf, "s")
        if progress is not True:
            callback("progress", progress)
        self.scene = scene
        self.device = find_device(device)
        self.precision = precision or scene.precision
        scalar_of(self.precision)
        self.threads = checked_threads(threads)
        self.frame_interval = frame_interval
        self.checkpoint_path, self.checkpoint_every = checkpoint_path, checkpoint_every
        self.recorders = list(recorders)
        self.folder: Path | None = None
        """Run folder that the simulation writes; None if there was no argument `out`."""
        if frame_interval is not None:
            positive("frame_interval", frame_interval, "s")
        if out is not None:
            self._use_folder(output_of(out))
        # Do not add these recorders, which a run without a folder has, to `recorders`. If `recorders` is not empty, the
        # run also stops between samples to record frames, and these recorders need no frames.
        self._more_recorders = [] if out is not None else list(recorders_without_folder(self))
        self._recording = Recording(self, [*self.recorders, *self._more_recorders])
        self._progress: Progress = ProgressBar() if progress is True else progress or announce_compiling
        self.wall_times = WallTimes()
        # Finished run whose folder `write_run` is writing; None if this object simulates the scene itself.
        self._ended_run: Run | None = None
        self.frames = Frames(frame_interval, self.expected_duration, self.frame_step)
        self.set_up()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of scene {self.scene.name!r} on {self.device}, {self.precision}>"

    def _use_folder(self, output: RunOutput) -> None:
        if self.checkpoint_path is not None:
            problem = "cannot be combined with 'out', because the run folder holds the checkpoint"
            refuse("checkpoint_path", str(self.checkpoint_path), problem, "leave out 'checkpoint_path'")
        self.folder = output.path
        self.checkpoint_path = self.folder / CHECKPOINT if self.checkpoint_every else None
        self.recorders = [*output.recorders(self), *self.recorders]

    # The following methods run the simulation, from its preparation to its end.

    def begin(self, path: Path | None = None) -> None:
        """Prepare the state at t = 0, or restore it from the checkpoint at `path` if this file exists.

        If there is no `path`, the checkpoint in the run folder is used. Recorders claim their folders first, so that no
        other run can write or remove the checkpoint at the same time.
        """
        if path is None and self.folder is not None:
            path = self.folder / CHECKPOINT
        if path is not None and path.is_dir():
            raise RunFolderError(f"'{path}': is a directory, but a checkpoint is a file; remove the directory")
        self.resumes = path is not None and path.is_file()
        try:
            self.claim()
            self.resumes = path is not None and path.is_file()
            with report_compiling(self.tell):
                if path is not None and self.resumes:
                    self.resume(path)
                else:
                    self.prepare()
        except BaseException as error:
            self.note_failure(error)
            self.abandon(refused=isinstance(error, SceneError))
            if isinstance(error, Exception) and is_full(error):
                saved = self.checkpoint_path is not None and self.checkpoint_path.is_file()
                raise disk_full_error([error], 0.0 if saved else None) from error
            raise

    def note_failure(self, error: BaseException) -> None:
        """Store the `error` that ends the run before its first row, for the result in the run folder.

        Ignore an error about an invalid scene or an unusable folder, because no run has begun in that case.
        """
        if not isinstance(error, SceneError | RunFolderError):
            self.ending = failure(error, 0.0)

    def claim(self) -> None:
        """Let all recorders, which write the run's output, take exclusive resources, such as the run folder."""
        for recorder in self.recorders:
            recorder.claim(self)

    def abandon(self, refused: bool = False) -> None:
        """Release the resources that `claim` took, unless the run has begun.

        `refused` is true if the scene was found to be invalid. The checkpoint of a new run is then removed as well; the
        checkpoint of a resumed run is kept.
        """
        if not self._has_run:
            if refused and not self.resumes and self.checkpoint_path is not None:
                with suppress(OSError):
                    self.checkpoint_path.unlink(missing_ok=True)
            for recorder in self.recorders:
                recorder.abandon(self)

    def run(self) -> Run:
        """Prepare and run the simulation, until its end, `stop_requested`, Ctrl-C or SIGTERM; return the results.

        Ctrl-C and SIGTERM end the run at once, and a line on standard error says so. The returned run then has
        `interrupted` = True and `finished` = False. An interruption before t = 0 raises :class:`KeyboardInterrupt`. If
        the program has a handler of its own for SIGTERM, that handler stays in force.

        Raises :class:`WarpcreteError` if this simulation has run before.
        """
        if self._has_run:
            raise WarpcreteError("this simulation has already run; create a new Simulation for another run")
        with report_compiling(self.tell), terminate_as_interrupt(self):
            if not self.prepared:
                self.begin()
            run: Run = run_coroutine(self.running(), self.stepper.advance)
        if run.interrupted and not self.stop_requested:  # If a caller requested the stop, the caller informs the user.
            self._tell_interruption(run)
        if run.folder is None and self.rows:
            self._keep_final_state(run)
        return run

    def _tell_interruption(self, run: Run) -> None:
        """Print that the run was interrupted, and how it can go on."""
        text = f"interrupted at t = {self.stepper.time:.3f} s; run() returns the results so far"
        if run.folder is not None:
            text += f", which are saved in '{run.folder}'"
            if self._checkpoint_time is not None:
                text += f"; run the same lines again to go on from the checkpoint at t = {self._checkpoint_time:.3f} s"
        print(text, file=sys.stderr, flush=True)

    def write_run(self, run: Run, contents: Record) -> None:
        """Write the run folder of the `run`, which has ended already, without simulating the scene again.

        `contents` holds the data of a checkpoint of the run's final state. Recordings have all rows of the time series,
        but only the last frame. The folder of an unfinished run also holds a checkpoint.
        """
        self._ended_run, self.stop_requested, self.resumes = run, not run.finished, True
        try:
            self.claim()
            self.load_state_dict(self._restored(contents))
        except BaseException:
            self.abandon()
            raise
        try:
            self.run()
        finally:
            self.release()

    def running(self) -> Coroutine:
        """Run from t = 0 or from a checkpoint to the end, as a generator that returns the :class:`Run`."""
        self._has_run = True
        if self._ended_run is None:
            # An earlier call of `begin` may have failed and stored its error here. The run has now begun after all, so
            # discard this error; `_end` will store how the run ends.
            self.ending = None
        self._recording = Recording(self, [*self.recorders, *self._more_recorders])
        self.wall_times.start()
        if self._resumed is not None and self._ended_run is None:
            self._checkpoint_time = self.stepper.time
        finished = False
        error: BaseException | None = None
        # Errors of a full disk, which are raised only after everything else has been written.
        full: list[Exception] = []
        try:
            try:
                if not self.rows:  # Save the state at t = 0 first, because packing and settling took a long time.
                    self._checkpoint()
                self._recording.begin({} if self._resumed is None else self._resumed["recorders"])
                if self._ended_run is not None:
                    for row in self.rows:
                        self._recording.call("sample", row)
                    self._frame()
                finished = yield from self._loop()
            except KeyboardInterrupt as stop:
                error = stop
                if self._ended_run is not None:
                    raise  # Pass the interruption on, because the run folder that the caller requested is not complete.
            except Exception as found:
                error = found
                if not is_full(found):
                    raise
                full.append(found)
        finally:
            # Write all results, for whatever reason the run ended.
            failures = self._recording.failures
            self.wall_times.phases["running"] = self.wall_times.running
            self.finishing = True
            run = self._end(finished, error)
            # The traceback of the error refers to this stack frame, and the frame to the error, so both would stay in
            # memory. This variable is no longer needed: `_end` has used it, and an error in flight is still raised.
            error = None
        if full := [*full, *filter(is_full, failures)]:
            raise disk_full_error(full, self._checkpoint_time) from full[0]
        if failures:
            raise failures[0]
        return run

    def _end(self, finished: bool, error: BaseException | None) -> Run:
        """Write everything to disk, and remove the checkpoint if nothing is missing; return the results.

        `finished` is true if the run reached its end. `error` is the error or the interruption that ended the run at
        once, or None. The order of the steps makes sure that no data are lost if a recorder fails or the run is killed:

        - The final state is written first, but does not yet replace the previous checkpoint.
        - All recorders finish. If one fails, the run can go on from the previous checkpoint.
        - The final state becomes the checkpoint. Recorders then join the files of their recordings; a run that is
          killed meanwhile need not repeat its last steps.
        """
        recording, path = self._recording, self.checkpoint_path
        written = False
        if finished and path is not None:
            self.at_end = True
            with suppress(OSError, RunFolderError):
                self._write_state(path)
                written = True
        run = self._ended_run
        if run is None:
            run = self._results(finished, error)
        run.finished = run.result["finished"] = finished and run.finished and not recording.failures
        recording.finish(run)
        if written and path is not None:
            if run.finished:
                with suppress(OSError, RunFolderError):
                    self._commit_state(path)
            checkpoint.discard(path)
        if run.finished:
            recording.tidy(run)
        if finished and not run.finished and self._checkpoint_time is None:
            recording.mark_incomplete()
        if run.finished and path is not None:
            checkpoint.remove(path)
        recording.close()
        if isinstance(self._progress, ProgressBar):
            self._progress.close()
        return run

    def _results(self, finished: bool, error: BaseException | None) -> Run:
        """Return the results of the run, with the reason why it ended; `error` is an error that ended it, or None.

        If the results cannot be computed, return only the time series: the recorders must be able to write their data.
        After they have finished, :meth:`running` raises the error of the computation, unless it passes on `error`.
        """
        try:
            run = self.result(finished)
            self.ending = self._ending(finished, error)
        except Exception as fault:
            self._recording.failures.append(fault)
            self.ending = self._ending(finished, error or fault)
            columns = self.rows[0] if self.rows else {}
            series = {name: np.array([row[name] for row in self.rows]) for name in columns}
            result: Record = {
                "scene": self.scene.name,
                "finished": False,
                "ended": None,
                "simulated_time": quantity(self.stepper.time, "s"),
                "steps": self.stepper.steps,
                "provenance": provenance(self.device, self.precision, self.scene.seed, self.threads),
            }
            run = Run(self.scene, series, {name: self.unit(name) for name in series}, result, False)
        run.interrupted = isinstance(error, KeyboardInterrupt)
        run.result["ended"] = self.ending.entry()
        return run

    def _ending(self, finished: bool, error: BaseException | None) -> Ending:
        time = self.stepper.time
        if error is not None:
            return failure(error, time)
        return Ending(*self.why_ended(), time) if finished else interruption(time)

    def _keep_final_state(self, run: Run) -> None:
        """Keep the final state in host memory unless it is large, so that `run.save` can write a run folder."""
        if number_of(run.result["speed"]["memory"]) > MAX_KEPT_MEMORY:
            return
        settings = {
            "device": str(self.device),
            "precision": self.precision,
            "threads": self.threads,
            "frame_interval": self.frame_interval,
            # An interruption may have ended the run within a time step, so no checkpoint is made of this state.
            "checkpoint_every": 0.0 if run.interrupted else self.checkpoint_every or DEFAULT_CHECKPOINT_INTERVAL,
        }
        run.final_state = FinalState(type(self), settings, self._contents({}, run.finished))

    def _loop(self) -> Coroutine:
        interval, duration, stepper = self.scene.sample_interval, self.duration, self.stepper
        if self.at_end:
            # The checkpoint was written after the last step, so no step is left. Call `ended_early` nevertheless,
            # because it also stores properties of the run for the results, for example that the flow is steady.
            self.ended_early()
            return True
        if not self.rows:
            self._sample()
            self._frame()
        samples = max(1, int(np.ceil(duration / interval - 1e-9)))
        # The first row belongs to t = 0, so the number of rows is the number of the next sample.
        for number in range(len(self.rows), samples + 1):
            if self.stop_requested:
                self._checkpoint()
                return False
            goal = min(number * interval, duration)
            while self.recorders and self.frames.due_before(goal):
                yield from self.reaching(self.frames.next)
                self._frame()
            yield from self.reaching(goal)
            row = self._sample()
            self.wall_times.note_row(stepper.steps)
            ended = self.ended_early()
            if self.frames.due(stepper.time) or number == samples or ended:
                self._frame()
            if ended:
                return True
            if number < samples:
                self._checkpoint_if_due()
            figures = {name: row[name] for name in ("pressure",) if name in row}
            if self.wall_times.has_pace:  # Before the second new row, the rate would include recording the launches.
                figures["steps_per_s"] = self.pace
            if self.may_end_early:
                figures["at_most"] = 1.0
            self.tell("running", number / samples, **figures)
        return True

    def _sample(self) -> dict[str, float]:
        row = self.measure()
        self._recording.call("sample", row)
        self.watch_row(row)
        return row

    def _frame(self) -> None:
        self._recording.call("frame")
        self.frames.schedule_next(self.stepper.time)

    def _checkpoint(self) -> None:
        if self.checkpoint_path is not None:
            try:
                self.save(self.checkpoint_path)
            except RunFolderError as error:
                # The run goes on without this checkpoint, because the previous checkpoint is still valid.
                if is_full(error):
                    raise
                warnings.warn(f"the checkpoint could not be written: {error}", stacklevel=2)
        self.wall_times.note_checkpoint()

    def _checkpoint_if_due(self) -> None:
        if self.wall_times.since_checkpoint >= self.checkpoint_every:
            self._checkpoint()

    @property
    def pace(self) -> float:
        """Mean number of time steps per second of wall time, after the first row (see :meth:`WallTimes.pace`)."""
        return self.wall_times.pace(self.stepper.steps)

    def tell(self, phase: str, fraction: float, **figures: float) -> None:
        """Pass the phase (such as "running"), its completed fraction and current figures to the callback `progress`."""
        self._progress(phase, fraction, figures)
