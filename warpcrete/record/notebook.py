"""Showing runs in notebooks: in Rerun's viewer where it is installed, as a picture elsewhere."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from ..core.run_loop import Run
from ..methods import method_of


def show(run: Run, recording: Path | str | None = None) -> Any:
    """Show a run's `recording` (.rrd) in Rerun's notebook viewer, or the run as a Matplotlib figure.

    The viewer needs `pip install rerun-notebook`; without it, or without a recording, a figure is returned: the
    aggregates at the end, or pressure and profiles of a flow.
    """
    if recording is None or importlib.util.find_spec("rerun_notebook") is None:
        return method_of(run.scene).show(run)
    import rerun as rr

    stream = rr.RecordingStream("warpcrete")
    stream.log_file_from_path(recording)
    return rr.notebook_show(recording=stream, width=900, height=600)
