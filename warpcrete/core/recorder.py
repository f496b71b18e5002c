"""Recorders: where a run goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from .run import Run


class Recorder:
    """Where a run goes; subclasses override what they need.

    Methods are called in this order; `finish` and `close` also after an interruption or an error. What `start`,
    `sample` or any other method raises ends the run, unless the recorder is `expendable`.
    """

    expendable: ClassVar[bool] = False
    """The run goes on without this recorder when it fails, with a warning. A full disk ends the run all the same: it
    can be resumed when there is room, and then nothing is missing."""

    rows_alone: ClassVar[bool] = False
    """Its `sample` reads the row and `simulation.sampled`, and nothing of the state, which may have gone on since. The
    class that defines `sample` says so."""
    draws_alone: ClassVar[bool] = False
    """Its `frame` draws by the display, and reads no row: that of this moment may come later. The class that defines
    `frame` says so."""

    def claim(self, simulation: Any) -> None:
        """Take what only one run may have, before any work is done."""

    def abandon(self, simulation: Any) -> None:
        """Give back what `claim` took: the run never began."""

    def start(self, simulation: Any) -> None:
        """The run is about to begin."""

    def resume(self, simulation: Any, state: dict[str, Any]) -> None:
        """Instead of `start`, when a run goes on from the checkpoint at which `checkpoint` returned `state`.

        Whatever was recorded after it must go.
        """
        self.start(simulation)

    def sample(self, simulation: Any, row: dict[str, float]) -> None:
        """A row of the series."""

    def frame(self, simulation: Any) -> None:
        """A picture is due."""

    def checkpoint(self, simulation: Any) -> dict[str, Any]:
        """Return what `resume` will need to go on from this moment.

        `write` follows; the checkpoint with this state takes effect when every recorder has written.
        """
        return {}

    def write(self, simulation: Any) -> None:
        """Put on disk what there is so far, at a checkpoint."""

    def finish(self, simulation: Any, run: Run) -> None:
        """Put everything on disk: the run has ended. The last recorder finishes first, expendable ones after all
        others."""

    def tidy(self, simulation: Any, run: Run) -> None:
        """Remove or join what only a resumed run needs: the run is complete."""

    def close(self, simulation: Any) -> None:
        """Let go of everything, whatever came of the run."""


def says(kind: type[Recorder], method: str, name: str) -> bool:
    """Whether the class that has a method of recorders of this kind says something of it; what does nothing does."""
    owner = next(each for each in kind.__mro__ if method in vars(each))
    return owner is Recorder or bool(vars(owner).get(name, False))
