"""Interface between the run loop and the folder that a run writes.

The package `record` implements the interface. It imports `core`, so `core` cannot import it. Instead, it registers two
functions here: one makes the run folder from a path, and the other makes the recorders of a run without a folder.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from ..errors import WarpcreteError, refuse
from .files import folder_path

CHECKPOINT = "checkpoint.npz"
"""File name of the checkpoint in a run folder."""


class RecordedSimulation(Protocol):
    """Members of a simulation that select its recorders, for modules that cannot import the simulation's class."""

    scene: Any
    threads: int
    """Number of CPU threads of the run."""
    recorders: list[Any]
    """Recorders of the run."""
    frame_interval: float | None
    """Simulated time between two frames [s]; None for the default."""
    checkpoint_every: float
    """Wall time between two checkpoints [s]."""


class RunOutput(Protocol):
    """Folder for the output of a run, with the recorders that write files into the folder."""

    @property
    def path(self) -> Path:
        """Path of the folder for the output of a run."""
        ...

    def recorders(self, simulation: RecordedSimulation) -> Sequence[Any]:
        """Return the recorders that write the output of `simulation` into this folder."""
        ...


_folder_at: Callable[[Path], RunOutput] | None = None
_without_folder: Callable[[RecordedSimulation], Sequence[Any]] | None = None


def register_folders(
    folder_at: Callable[[Path], RunOutput], without_folder: Callable[[RecordedSimulation], Sequence[Any]]
) -> None:
    """Register the two functions that the run loop needs from the package `record`.

    `folder_at` takes the path of a folder and returns a :class:`RunOutput` with default settings. `without_folder`
    takes a simulation without a folder and returns the recorders that it has in addition to the user's recorders.
    """
    global _folder_at, _without_folder
    _folder_at, _without_folder = folder_at, without_folder


def recorders_without_folder(simulation: RecordedSimulation) -> Sequence[Any]:
    """Return the recorders that a `simulation` without a folder has in addition to the user's recorders."""
    return () if _without_folder is None else _without_folder(simulation)


def output_of(out: str | Path | RunOutput) -> RunOutput:
    """Return the :class:`RunOutput` for the path `out`; if `out` is a :class:`RunOutput` already, return it."""
    if not isinstance(out, str | Path):
        if not hasattr(out, "recorders"):
            refuse("out", out, "must be the path of a new folder or a warpcrete.RunFolder")
        return out
    if _folder_at is None:
        raise WarpcreteError("out: needs the package warpcrete.record; use warpcrete.Simulation, which imports it")
    return _folder_at(folder_path("out", out))
