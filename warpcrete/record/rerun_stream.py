"""Stream of a Rerun recording to a file in parts and to a viewer, with time limits for writing to each of them."""

import atexit
import importlib
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.errors import RunFolderError, refuse
from ..core.run.files import cannot_write, space_error
from ..core.run.viewer import LOOPBACK, has_screen, screen_viewer
from .joining import join

PATIENCE = 4.0
"""Longest time [s] to wait for a viewer that receives no data, or for Rerun's writer if the recording's file does not
grow."""
CLOSE_TIMEOUT = 30.0
"""Longest time [s] for opening the recording's file, or for closing it if a viewer has not received the whole
recording."""
POLL_INTERVAL = 0.5
"""Time [s] between two checks whether the recording's file has grown."""


def _rerun() -> Any:
    """Import Rerun's library without its log, and return it.

    The log would fill the terminal, and calls of the library raise exceptions for errors anyway. The library reads the
    environment variable RUST_LOG when it is imported. If the user has set this variable, its value is used.
    """
    quiet = "RUST_LOG" not in os.environ
    if quiet:
        os.environ["RUST_LOG"] = "off"
    try:
        return importlib.import_module("rerun")
    finally:
        if quiet:
            del os.environ["RUST_LOG"]


class RerunStream:
    """Stream of a recording to a file, to a viewer, or to both.

    `path` is the path of the .rrd file, or None. `live` is True to open a viewer, or the URL of a running viewer.
    `bind` is the IP address on which a newly opened viewer listens. The file has parts (`run.rrd`, `run-0001.rrd` and
    so on), because only a complete part can be kept when a run is resumed.
    """

    def __init__(self, path: Path | None, live: bool | str = False, bind: str = LOOPBACK) -> None:
        self.path = path
        self.live = live
        """URL of the viewer, or False if there is none or it has disconnected; True until a viewer is opened."""
        self.part = 0
        """Number of the part of the recording's file that is being written."""
        self.recording_id = ""
        """Name by which viewers recognise the parts of one recording."""
        self._bind = bind
        if live is True and not has_screen():
            hint = "give the URL of a running viewer, or use 'warpcrete view FOLDER --web' after the run"
            refuse("live", live, "needs a screen, but no screen was found (DISPLAY is not set)", hint)
        self._recording: Any = None
        self.rr = _rerun()
        """Python module of the Rerun library."""
        if isinstance(live, str):
            try:
                self.rr.GrpcSink(live)
            except (RuntimeError, ValueError) as error:
                problem = f"is not the URL of a viewer ({error})"
                refuse("live", live, problem, "for example rerun+http://127.0.0.1:9876/proxy")

    @property
    def is_connected(self) -> bool:
        """True after :meth:`connect` has opened the recording."""
        return self._recording is not None

    def connect(self, application: str, caption: str, recording_id: str, part: int, blueprint: object) -> None:
        """Begin a recording: open its file and, for a live recording, the viewer.

        A recording may consist of several files, and `part` is the number of the file to open. `caption` is the title
        of the recording, and `recording_id` is the name by which viewers recognise that several files belong together.
        `blueprint` is the layout of the views, which a viewer stores under the name `application`.
        """
        self._recording = self.rr.RecordingStream(application, recording_id=recording_id)
        if part == 0:
            self._recording.send_recording_name(caption)
        self.recording_id, self.part = recording_id, part
        if self.live is True:
            opened = screen_viewer(bind=self._bind)
            opened.start()
            print(f"live: {opened.address}", file=sys.stderr)
            self.live = opened.address
        self._open_sinks(default_blueprint=blueprint)

    def open_next_part(self) -> None:
        """Close the current file of the recording and open the next one."""
        self.flush()
        self.part += 1
        self._open_sinks()

    def log(self, path: str, what: object, static: bool = False) -> None:
        """Record the data `what` under `path`; if `static` is true, the data apply to all times."""
        try:
            self._recording.log(path, what, static=static)
        except RuntimeError as error:
            raise self.error(error) from error

    def set_time(self, time: float, steps: int | None) -> None:
        """Set the simulated time [s] and, if known, the step number of the data that this thread records next."""
        self._recording.set_time("time", duration=time)
        if steps is None:
            self._recording.disable_timeline("step")
        else:
            self._recording.set_time("step", sequence=steps)

    def close(self) -> None:
        """Wait until the file and the viewer have received all data, then close the recording."""
        watched = bool(self.live)
        try:
            self.flush()
        except BaseException:
            self.disconnect(POLL_INTERVAL)
            raise
        # If the viewer has disconnected, closing takes longer, because Rerun waits for the viewer before it closes the
        # file.
        if not self.disconnect(CLOSE_TIMEOUT if watched and not self.live else PATIENCE):
            raise self.error(RuntimeError("Rerun's writer did not finish in time"))

    def join_parts(self) -> None:
        """Join the part files of the recording into one file."""
        if self.path is not None and self.part > 0:
            join([self.part_path(number) for number in range(self.part + 1)], self.path)

    def _open_sinks(self, **settings: object) -> None:
        """Open the file of the current part and the connection to a viewer; raise :class:`RunFolderError` on failure.

        Rerun's writer may never return if the disk is full. A separate thread therefore calls the writer, and this
        method waits for the thread for a limited time.
        """
        failures: list[RuntimeError] = []

        def open_them() -> None:
            try:
                self._recording.set_sinks(*self._sinks(), **settings)
            except RuntimeError as error:
                failures.append(error)

        if not self._finishes(open_them, CLOSE_TIMEOUT):
            failures.append(RuntimeError("Rerun's writer does not answer"))
        if failures:
            raise self.error(failures[0]) from failures[0]

    def _finishes(self, call: Callable[[], None], patience: float) -> bool:
        """Run a call of Rerun in a thread, and return whether it ends within `patience` [s].

        The wait is shorter if the disk turns out to be full. If the call does not end, Rerun's exit handler is removed,
        because it would block the exit of the program.
        """
        calling = threading.Thread(target=call, daemon=True)
        calling.start()
        end = time.monotonic() + patience
        while calling.is_alive() and time.monotonic() < end:
            calling.join(POLL_INTERVAL)
            if calling.is_alive() and self.path is not None and space_error(self.path.parent):
                calling.join(PATIENCE)
                break
        if calling.is_alive():
            atexit.unregister(self.rr.rerun_shutdown)
        return not calling.is_alive()

    def error(self, error: Exception) -> RunFolderError:
        """Return the exception to raise for the `error` of a call of Rerun; it names the recording's file."""
        return cannot_write(self.path if self.path is not None else Path("run.rrd"), error)

    def flush(self) -> None:
        """Wait until the file and the viewer have received all data."""
        size, since = -1, time.monotonic()
        while True:
            try:
                self._recording.flush(timeout_sec=POLL_INTERVAL)
                return
            except (RuntimeError, ValueError) as error:
                trouble = error
                # If Rerun's writer has crashed, `flush` fails at once, so pause before the next attempt.
                time.sleep(0.05)
            # If the disk was full at some time, the thread that writes the recording may never answer, so stop waiting
            # for it. If the writer is only slow, the file still grows, so go on waiting.
            if self.path is not None:
                before, size = size, self._written_size()
                if size != before:
                    since = time.monotonic()
            if time.monotonic() - since > PATIENCE or (self.path is not None and space_error(self.path.parent)):
                break
        if not self.live:
            raise self.error(trouble) from trouble
        # A viewer that has disconnected must not stop the run, because the file has all data.
        warnings.warn(
            f"the Rerun viewer did not receive the whole recording, and the run goes on without it: {trouble}",
            stacklevel=2,
        )
        self.live = False

    def _written_size(self) -> int:
        """Return the size of the current part's file [bytes]; 0 if the file was deleted or cannot be read."""
        try:
            return self.part_path(self.part).stat().st_size
        except OSError:
            return 0

    def disconnect(self, patience: float) -> bool:
        """Close the recording, and return whether the writer answered within `patience` [s]."""
        return self._finishes(self._recording.disconnect, patience)

    def _sinks(self) -> list[Any]:
        sinks: list[Any] = []
        if self.path is not None:
            sinks.append(self.rr.FileSink(str(self.part_path(self.part))))
        if self.live:
            sinks.append(self.rr.GrpcSink(str(self.live)))
        return sinks

    def part_path(self, number: int) -> Path:
        """Return the path of the recording's part with this `number`."""
        assert self.path is not None
        return self.path if number == 0 else self.path.with_name(f"{self.path.stem}-{number:04d}{self.path.suffix}")

    def parts_from(self, first: int) -> list[Path]:
        """Return the paths of all existing parts whose numbers are at least `first`."""
        assert self.path is not None
        numbered = self.path.parent.glob(f"{self.path.stem}-[0-9][0-9][0-9][0-9]*{self.path.suffix}")
        later = [path for path in numbered if int(path.stem[len(self.path.stem) + 1 :]) >= first]
        return ([self.path] if first == 0 else []) + later
