"""Reader of runs and studies from their folders."""

from pathlib import Path

from ..core.run.files import folder_path
from ..core.run.run import Run
from ..record.loading import load as load_run
from .study import load_study
from .study_result import Study


def load(folder: Path | str) -> Run | Study:
    """Load the run or the study in a folder, even an unfinished one.

    A loaded :class:`Run` has the scene, time series and quantities, but not the state of the simulation, such as its
    bodies. A run that was killed has no result, and a run that has recorded no measurements has no series. If the scene
    cannot be built again, for example because its mesh file is missing, only its name and parameters are available. A
    loaded :class:`Study` has its cases; `study["001-velocity=0.3"]` is the run of the case with this name. Raises
    :class:`RunFolderError` if `folder` holds neither a run nor a study in the format of this version.
    """
    folder = folder_path("folder", folder)
    return load_study(folder) if (folder / "study.json").is_file() else load_run(folder)
