"""Part of a simulation that writes its state to checkpoints, and restores the state from them."""

from pathlib import Path

from ..records import SavedState
from . import checkpoint
from .checkpoint import RunRecord
from .recording import Recording
from .simulation_base import SimulationBase
from .wall_times import WallTimes


class CheckpointedSimulation(SimulationBase):
    """Simulation that can save its state and go on from a saved state; the run loop derives from this class."""

    wall_times: WallTimes
    """Wall times of the phases of the run."""
    _recording: Recording
    _has_run = False
    _checkpoint_time: float | None = None
    """Simulated time of the state in the checkpoint [s]; None if there is no checkpoint."""
    _resumed: RunRecord | None = None
    """Data about the run, read from the checkpoint when the run was resumed; None in a new run."""

    def save(self, path: Path) -> None:
        """Write a checkpoint of the present state, which takes effect once all recorders have written their data.

        If a file cannot be written, raise :class:`RunFolderError`. The previous checkpoint then remains, from which
        every recorder can go on.
        """
        try:
            self._write_state(path)
            if self._has_run:
                self._recording.call("write")
            self._commit_state(path)
        except BaseException:
            checkpoint.discard(path)
            raise

    def _write_state(self, path: Path) -> None:
        """Write the state to a partial file next to the checkpoint at `path`."""
        states = self._recording.states() if self._has_run else {}
        contents = self._contents(states, self.at_end)
        checkpoint.write_partial(path, self.scene, self.device, self.precision, contents)

    def _contents(self, recorders: dict[str, object], over: bool) -> SavedState:
        """Return the contents of a checkpoint: the present state and the data about the run.

        `recorders` holds the data of each recorder by its class name. `over` is true if the last step of the run is
        done.
        """
        run: RunRecord = {
            "recorders": recorders,
            "next_frame": self.frames.next,
            "spent": self.wall_times.phases | {"running": self.wall_times.running},
            "over": over,
        }
        return self.state_dict() | {"run": run}

    def _commit_state(self, path: Path) -> None:
        checkpoint.commit(path)
        self._checkpoint_time = self.stepper.time if self._has_run else 0.0
        self.wall_times.note_checkpoint()

    def resume(self, path: Path) -> None:
        """Restore the state from a checkpoint of the same scene, device and precision, instead of calling `prepare`.

        The results of the resumed run are bitwise identical to those of a run without interruption. Raises
        :class:`RunFolderError` for a file that is not a complete checkpoint of this simulation.
        """
        self.load_state_dict(self.read_checkpoint(path))

    def read_checkpoint(self, path: Path) -> SavedState:
        """Return the `state_dict` stored in a checkpoint, and restore the data about the run from this checkpoint.

        The data about the run include the wall times and the time of the next frame.
        """
        return self._restored(checkpoint.read(path, self.scene, self.device, self.precision))

    def _restored(self, contents: SavedState) -> SavedState:
        """Restore the data about the run, such as wall times, from a checkpoint's contents; return the contents."""
        run: RunRecord = contents["run"]
        self._resumed = run
        self.frames.next = run["next_frame"]
        self.wall_times.restore(run["spent"])
        self.at_end, self.resumes = run["over"], True
        return contents
