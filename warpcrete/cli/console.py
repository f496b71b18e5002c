"""The streams that the command prints to."""

from __future__ import annotations

import io
import sys


def prepare_streams() -> None:
    """Escape characters that the terminal cannot show, instead of ending the command with an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
