"""Recorders: where a run goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from .run import Run


class Recorder:
    """Where a run goes; subclasses override what they need.

    Methods are called in this order; `finish` also after an interruption or an error.
    """

    rows_alone: ClassVar[bool] = False
    """Its `sample` reads the row and `simulation.sampled`, and nothing of the state, which may have gone on since. The
    class that defines `sample` says so."""
    draws_alone: ClassVar[bool] = False
    """Its `frame` draws by the display, and reads no row: that of this moment may come later. The class that defines
    `frame` says so."""

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
        """Put on disk what is there so far; returns what `resume` will need."""
        return {}

    def finish(self, simulation: Any, run: Run) -> None:
        """The run has ended: put everything on disk. The last recorder finishes first."""

    def tidy(self, simulation: Any, run: Run) -> None:
        """The run is complete and its checkpoint gone: what only a resumed run needs may go."""


def says(kind: type[Recorder], method: str, name: str) -> bool:
    """Whether the class that has a method of recorders of this kind says something of it; what does nothing does."""
    owner = next(each for each in kind.__mro__ if method in vars(each))
    return owner is Recorder or bool(vars(owner).get(name, False))
