"""Base class of recorders, which write the output of a run to files or to a viewer."""

from typing import ClassVar

from ..records import SavedState
from .run import Run
from .simulation_base import SimulationBase


class Recorder:
    """Base class of objects that record a run; subclasses override the methods that they need.

    The methods are called in the order `claim`, `abandon` (if the run never begins), `start` or `resume`, `sample`,
    `frame`, `checkpoint`, `write`, `finish`, `tidy`, `close`. The methods from `sample` to `write` repeat. `finish` and
    `close` are also called after an interruption or an error. An exception in any method ends the run, unless the
    recorder is `expendable`.
    """

    expendable: ClassVar[bool] = False
    """True if a failure of this recorder only causes a warning, after which the run goes on without the recorder. A
    full disk ends the run in any case: the run can be resumed when there is space, and then no data is missing."""

    def claim(self, simulation: SimulationBase) -> None:
        """Take exclusive resources, such as the run folder, before any work is done."""

    def abandon(self, simulation: SimulationBase) -> None:
        """Release the exclusive resources that `claim` took, because the run never began."""

    def start(self, simulation: SimulationBase) -> None:
        """Prepare to record a run that is about to begin."""

    def resume(self, simulation: SimulationBase, state: SavedState) -> None:
        """Prepare to record a run that goes on from a checkpoint; called instead of `start`.

        `state` is what the method `checkpoint` returned for this checkpoint. Everything that was recorded after the
        checkpoint must be removed.
        """
        self.start(simulation)

    def sample(self, simulation: SimulationBase, row: dict[str, float]) -> None:
        """Record one row of the time series, with the value of each column by the column's name."""

    def frame(self, simulation: SimulationBase) -> None:
        """Record a frame, which is a picture of the state at this time."""

    def checkpoint(self, simulation: SimulationBase) -> SavedState:
        """Return the data that the method `resume` needs to go on recording from this time.

        The run stores this data in its checkpoint and then calls `write`. The checkpoint replaces the previous
        checkpoint only when all recorders have written their data.
        """
        return {}

    def write(self, simulation: SimulationBase) -> None:
        """Write to disk everything that was recorded so far; the run calls this method at each checkpoint."""

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Write everything to disk, because the run has ended.

        Recorders finish in the reverse order of their start, except that recorders with the attribute `expendable`
        finish after all others.
        """

    def tidy(self, simulation: SimulationBase, run: Run) -> None:
        """Remove or join files that only a resumed run would need, because the run is complete."""

    def close(self, simulation: SimulationBase) -> None:
        """Release all resources, however the run ended."""
