"""Output streams of the command line."""

from __future__ import annotations

import io
import sys
import warnings
from typing import Any

import click

from ..core.errors import PlausibilityWarning, one_line


def prepare_streams() -> None:
    """Let no character that the terminal cannot show end the command, and make every warning one line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    usual, shown = warnings.showwarning, set()

    def show(message: Warning | str, category: type[Warning], *more: Any, **others: Any) -> None:
        if issubclass(category, PlausibilityWarning):
            text = one_line(str(message))
            if text not in shown:
                click.echo(f"warning: {text}", err=True)
            shown.add(text)
        else:
            usual(message, category, *more, **others)

    warnings.showwarning = show
