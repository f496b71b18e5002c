"""Preparation of the command line's output streams for terminals that cannot show all characters."""

import io
import sys


def prepare_streams() -> None:
    """Make the output streams escape characters that the terminal cannot show, instead of raising an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
