"""Showing runs in notebooks: in Rerun's viewer where it is installed, as a picture elsewhere."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from .record_plot import plot_aggregates
from .spine import Run


def show(run: Run, recording: Path | str | None = None):
    """Show a run's `recording` (.rrd) in Rerun's notebook viewer, or its aggregates as a Matplotlib figure.

    The viewer needs `pip install rerun-notebook`; without it, or without a recording, a figure is returned.
    """
    if recording is None or importlib.util.find_spec("rerun_notebook") is None:
        return plot_aggregates(run)
    import rerun as rr

    stream = rr.RecordingStream("warpcrete")
    stream.log_file_from_path(recording)
    return rr.notebook_show(recording=stream, width=900, height=600)
