"""Runs and studies read back from their folders."""

from __future__ import annotations

from pathlib import Path

from ..core.run import Run
from ..record.loading import load as load_run
from .study import Study, load_study


def load(folder: Path | str) -> Run | Study:
    """The run in a folder, or the study, as far as it got.

    A :class:`Run` has scene, series and quantities. What only a simulation holds, as bodies at the end, is not there. A
    run that was killed has no result, and one without rows no series; of a scene that can no more be made, as its mesh
    file has gone, only name and parameters are there. A study has its cases, and the run of each as `study["001"]`.
    Raises :class:`RunFolderError` for anything that is no folder of this version's.
    """
    folder = Path(folder)
    return load_study(folder) if (folder / "study.json").is_file() else load_run(folder)
