"""Recorder that draws the pictures of a run folder."""

from pathlib import Path

from ..core.run.files import atomic_file
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.simulation_base import SimulationBase
from ..methods import method_of


class PictureRecorder(Recorder):
    """Recorder that draws the pictures of a finished run and writes them into `folder`.

    The simulation method of the run defines which pictures are drawn.
    """

    expendable = True

    def __init__(self, folder: Path, *, colouring: str | None = None) -> None:
        self.folder, self.colouring = folder, colouring

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Draw the pictures of the finished run as PNG files, except those for which the run has no data."""
        method = method_of(simulation.scene)
        figures = {method.picture: method.drawn(simulation, run, self.colouring), **method.more_pictures(run)}
        for name, figure in figures.items():
            if figure is not None:
                with atomic_file(self.folder / name) as partial:
                    figure.savefig(partial, dpi=150, format="png")
