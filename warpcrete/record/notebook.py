"""Display of runs in notebooks, in Rerun's viewer if it is installed, otherwise as a figure."""

import importlib.util
from pathlib import Path
from typing import Any

from ..core.run.run import Run
from ..methods import method_of


def show(run: Run, recording: Path | str | None = None) -> Any:
    """Show a run's `recording` (.rrd) in Rerun's notebook viewer, or the run as a Matplotlib figure.

    The viewer needs `pip install rerun-notebook`. Without it, or without a recording, the result is a figure: the final
    aggregates of a discrete element run, or pressure and profiles of a flow.
    """
    if recording is None or importlib.util.find_spec("rerun_notebook") is None:
        return method_of(run.scene).show(run)
    import rerun as rr

    stream = rr.RecordingStream("warpcrete")
    stream.log_file_from_path(recording)
    return rr.notebook_show(recording=stream, width=900, height=600)
