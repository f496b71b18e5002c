"""Exclusive write access to folders, by a lock that the system releases whenever the owning process ends."""

import os
import platform
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import RunFolderError
from .files import LOCK, cannot_write, check_new, is_empty, remove_partial

fcntl: Any
msvcrt: Any
try:
    import fcntl
except ImportError:  # Windows has no `fcntl`; it locks bytes of files instead of whole files.
    fcntl = None
    import msvcrt

KILL_GRACE = 2.0
"""Time for which locking a folder is retried [s], because the processes of a killed run need some time to end."""
LOCKED_BYTE = 2**30
"""Position of the byte of the lock file that is locked on Windows. Other processes cannot read a locked byte, but must
be able to read the owner's name in the file, so the byte lies beyond the end of the file."""


class FolderLock:
    """Exclusive right to write into a folder, until it is released or the process ends.

    Readers need no lock. The system holds the lock as long as the lock file is open. A copy of the folder is therefore
    not locked, and the lock file that a killed process leaves behind locks nothing.
    """

    def __init__(self, folder: Path) -> None:
        """Lock the folder; raises :class:`RunFolderError` with the owner's name if another process holds the lock."""
        self.folder = folder
        self.created: list[Path] = []
        """Folders that were created for this lock: new parents, the outermost first, and the locked folder itself."""
        self._path = folder / LOCK
        self._file = self._locked()
        os.ftruncate(self._file, 0)
        owner = f"process {os.getpid()} on {platform.node()} since {time.strftime('%Y-%m-%d %H:%M:%S')}"
        # Ignore a full disk: the lock works even if the owner's name cannot be written into the lock file.
        with suppress(OSError):
            os.write(self._file, owner.encode())
        remove_partial(folder)

    def _locked(self) -> int:
        end = time.monotonic() + KILL_GRACE
        while True:
            try:
                file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
            except OSError as error:
                # While another process removes its lock file, Windows refuses access for a moment, so try again.
                if fcntl is None and isinstance(error, PermissionError) and time.monotonic() < end:
                    time.sleep(0.05)
                    continue
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
        """Release the lock, so that other processes can write; further calls do nothing."""
        if self._file >= 0:
            with suppress(OSError):
                self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1
            if fcntl is None:  # On Windows, remove the lock file now, because an open file cannot be removed.
                with suppress(OSError):
                    self._path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Release the lock, then remove the folders that were created for this lock and are still empty."""
        self.release()
        for path in reversed(self.created):
            with suppress(OSError):
                path.rmdir()

    def __del__(self) -> None:
        if getattr(self, "_file", -1) >= 0:
            os.close(self._file)


def _lock(file: int) -> bool:
    """Lock an open file without waiting, and return whether this succeeded; closing the file releases the lock."""
    if fcntl is None:
        os.lseek(file, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError:  # Another process holds the lock: Windows reports a locked byte as "permission denied".
            return False
        finally:
            os.lseek(file, 0, os.SEEK_SET)
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # Treat the lock as obtained, because the file system does not support locks.
        return True
    return True


def _is_at(file: int, path: Path) -> bool:
    """Return whether an open lock file still exists at `path`; its last owner may have removed or replaced it."""
    if fcntl is None:  # Windows cannot remove an open file, so the lock file still exists.
        return True
    try:
        there = path.stat()
    except OSError:
        return False
    return os.path.samestat(os.fstat(file), there)


@contextmanager
def locked_folder(folder: Path, record: str) -> Generator[None]:
    """Lock an existing folder inside the `with` block, then clean up what killed processes left in its subfolders.

    Raises :class:`RunFolderError` if the folder does not contain the file `record`, or if another process holds the
    lock.
    """
    if not (folder / record).is_file():
        missing = f"holds no {record}" if folder.is_dir() else "is not a folder"
        raise RunFolderError(f"'{folder}': {missing}; give the folder of an interrupted run")
    hold = FolderLock(folder)
    try:
        yield
    finally:
        for lock in folder.rglob(f"*/{LOCK}"):
            with suppress(RunFolderError):  # Skip a folder that another process has locked, because it is in use.
                FolderLock(lock.parent).release()
        hold.release()


def make_folder(folder: Path) -> FolderLock:
    """Create a new folder with its parents, and return the lock on the folder.

    Raises :class:`RunFolderError` if the folder contains files or cannot be created.
    """
    check_new(folder)
    created = [path for path in (*reversed(folder.absolute().parents), folder) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(f"out = '{folder}': cannot be created ({error.strerror}); choose another path") from error
    hold = FolderLock(folder)
    if not is_empty(folder):  # Another run wrote into the folder before it was locked, so refuse the folder.
        hold.release()
        check_new(folder)
    hold.created = created
    return hold


@contextmanager
def new_folder(folder: Path) -> Generator[None]:
    """Create a new folder with its parents, and hold its lock inside the `with` block.

    After the block, remove each of the created folders that is still empty.
    """
    hold = make_folder(folder)
    try:
        yield
    finally:
        hold.remove()
