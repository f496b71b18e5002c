"""Preparation of the command line's output streams for terminals that are closed or show few characters."""

import io
import os
import sys


class MessageStream(io.TextIOWrapper):
    """Stream of the command that drops texts that the system cannot write, so that none of them ends a run.

    This happens if the terminal is closed, or if the file of a log lies on a full disk. The stream replaces standard
    error, and standard output on a terminal. In a file or a pipe, standard output must be complete, so errors in
    writing it are reported.
    """

    def __init__(self, stream: io.TextIOWrapper) -> None:
        super().__init__(stream.buffer, stream.encoding, stream.errors, line_buffering=True)
        self._stream = stream  # Python closes the buffer as soon as nobody refers to the stream that owns it.

    def write(self, text: str) -> int:
        """Write a text to the stream; drop it if the system cannot write it."""
        try:
            return super().write(text)
        except OSError:
            self._discard()
            return len(text)

    def flush(self) -> None:
        """Write buffered texts to standard error; drop them if the system cannot write them."""
        try:
            super().flush()
        except OSError:
            self._discard()

    def _discard(self) -> None:
        """Send everything that follows to the null device."""
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, self.fileno())
        os.close(sink)


def prepare_streams() -> None:
    """Make the output streams escape characters that the terminal cannot show.

    Messages on standard error, and texts for a terminal that is closed, no longer raise errors.
    """
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if type(sys.stderr) is io.TextIOWrapper:
        sys.stderr = MessageStream(sys.stderr)
    if type(sys.stdout) is io.TextIOWrapper and sys.stdout.isatty():
        sys.stdout = MessageStream(sys.stdout)


def _open_closed_streams() -> None:
    """Connect each standard stream that was closed by the parent process to the null device.

    Otherwise a file of the run gets the number of the stream, and libraries write their messages into it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            sink = os.open(os.devnull, os.O_RDWR)
            if sink != number:
                os.dup2(sink, number)
                os.close(sink)
            else:
                os.set_inheritable(sink, True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w" if number else "r", encoding="utf-8"))  # noqa: SIM115
