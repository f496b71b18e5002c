"""One writer for each folder: a lock that the system releases when its process ends, whatever ends it."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import RunFolderError
from .files import LOCK, cannot_write, check_new, is_empty, remove_partial

fcntl: Any
try:
    import fcntl
except ImportError:  # not a POSIX system: folders are not locked there
    fcntl = None

GRACE = 2.0
"""Time that the processes of a run that was just killed get to end [s]."""


class Hold:
    """Exclusive right to write into a folder, until it is released or the process ends.

    Readers need none. The lock belongs to the open file, so a copy of the folder is free, and a process that was killed
    leaves a file that holds nobody up.
    """

    def __init__(self, folder: Path) -> None:
        """Take the right; raises :class:`RunFolderError` that names the owner if another run has it."""
        self.folder = folder
        self.made: list[Path] = []
        """Folders that were made for it, the outermost first."""
        self._path = folder / LOCK
        self._file = self._locked()
        os.ftruncate(self._file, 0)
        owner = f"process {os.getpid()} on {socket.gethostname()} since {time.strftime('%Y-%m-%d %H:%M:%S')}"
        with suppress(OSError):  # without room for its name, an owner stays unnamed
            os.write(self._file, owner.encode())
        remove_partial(folder)

    def _locked(self) -> int:
        end = time.monotonic() + GRACE
        while True:
            try:
                file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            except OSError as error:
                raise cannot_write(self._path, error) from error
            if _lock(file) and _is_at(file, self._path):
                return file
            owner = os.read(file, 200).decode(errors="replace")
            os.close(file)
            if time.monotonic() > end:
                raise RunFolderError(
                    f"'{self.folder}': is in use by {owner or 'another process'}; wait until it ends, or choose "
                    "another folder"
                )
            time.sleep(0.05)

    def release(self) -> None:
        """Let others write; may be called again."""
        if self._file >= 0:
            with suppress(OSError):
                self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1

    def remove(self) -> None:
        """Release the folder and remove it, with the parents that were made for it, as far as they are empty."""
        self.release()
        for path in reversed(self.made):
            with suppress(OSError):
                path.rmdir()

    def __del__(self) -> None:
        if getattr(self, "_file", -1) >= 0:
            os.close(self._file)


def _lock(file: int) -> bool:
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def _is_at(file: int, path: Path) -> bool:
    """Return whether an open file is still the one at a path: its last owner may have removed it meanwhile."""
    try:
        there = path.stat()
    except OSError:
        return False
    return os.path.samestat(os.fstat(file), there)


@contextmanager
def held(folder: Path, record: str) -> Iterator[None]:
    """Hold a folder that is there while the block runs; raises :class:`RunFolderError` for one without its record."""
    if not (folder / record).is_file():
        missing = f"holds no {record}" if folder.is_dir() else "is not a folder"
        raise RunFolderError(f"'{folder}': {missing}; give the folder of an interrupted run")
    hold = Hold(folder)
    try:
        yield
    finally:
        hold.release()


def make_folder(folder: Path) -> Hold:
    """Make a new folder, with its parents, and hold it; raises :class:`RunFolderError` for one that is not new."""
    check_new(folder)
    made = [path for path in (*reversed(folder.absolute().parents), folder) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(f"out = '{folder}': cannot be created ({error.strerror}); choose another path") from error
    hold = Hold(folder)
    if not is_empty(folder):  # another run was faster
        hold.release()
        check_new(folder)
    hold.made = made
    return hold


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Make a new folder and hold it while the block runs; one that it leaves empty is removed."""
    hold = make_folder(folder)
    try:
        yield
    finally:
        hold.remove()
