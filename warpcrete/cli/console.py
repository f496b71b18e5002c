"""Preparation of the command line's output streams for terminals that are closed or cannot show all characters."""

import io
import os
import sys


class MessageStream(io.TextIOWrapper):
    """Output stream that ignores failed writes, so that a message that cannot be written does not end a run.

    A write fails if the terminal was closed, or if the stream is redirected to a file on a full disk. The stream
    replaces standard error, and also standard output if it is a terminal. If standard output is a file or a pipe, it
    must be complete, so failed writes to it are still reported.
    """

    def __init__(self, stream: io.TextIOWrapper) -> None:
        super().__init__(stream.buffer, stream.encoding, stream.errors, line_buffering=True)
        self._stream = stream  # Keep a reference: if the stream were deleted, Python would close its buffer.

    def write(self, text: str) -> int:
        """Write a text to the stream; drop it if the system cannot write it."""
        try:
            return super().write(text)
        except OSError:
            self._discard()
            return len(text)

    def flush(self) -> None:
        """Write the buffered text to the stream; drop it if the system cannot write it."""
        try:
            super().flush()
        except OSError:
            self._discard()

    def _discard(self) -> None:
        """Redirect the stream to the null device, which discards all later text."""
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, self.fileno())
        os.close(sink)


def prepare_streams() -> None:
    """Prepare standard output and standard error, so that printing does not raise errors.

    The streams escape characters that the terminal cannot show. Text is dropped if standard error cannot be written, or
    if standard output was a terminal that is now closed (:class:`MessageStream`).
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
    """Connect each standard stream that the parent process has closed to the null device.

    Otherwise, the next file that the run opens would get the file descriptor of the closed stream (0, 1 or 2), and
    libraries would write their messages into this file.
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
