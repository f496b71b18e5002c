"""Folder of one run: the same files for `warpcrete run --out` and for `Simulation(out=...)` in Python."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import one_of, refuse, with_suggestions
from ..core.inputs.field_help import help_on_fields
from ..core.inputs.origin import Arguments
from ..core.run.checks import Check
from ..core.run.files import check_new, folder_path
from ..core.run.output import RecordedSimulation, register_folders
from ..core.run.recorder import Recorder
from ..core.run.viewer import LOOPBACK
from ..methods import Simulation, method_of
from ..scenes import modules
from .checks import CheckRecorder
from .recorders import RECORDERS, DrawSettings, recorders_of

__all__ = ["SETTINGS", "RunFolder", "Simulation"]

PIPELINE = ("pipeline_vertical", "pipeline_horizontal", "pipeline_other")
"""Names of the options of `warpcrete run` that request an estimate of the pressure of a whole pipeline."""
SETTINGS = ("frames", "colour", "network", *(kind.name for kind in RECORDERS), *PIPELINE, "checkpoint_every", "threads")
"""Names of the settings of a run that scene.json stores, so that the run can be resumed with them."""


@help_on_fields
@dataclass(frozen=True)
class RunFolder:
    """Run folder at the path `folder`, with settings for its recordings; pass it to a simulation or to `run.save`.

    The folder gets the same files as with `warpcrete run --out`, and the settings have the names of that command's
    options. If the folder already holds the same run and this run is unfinished, the run continues. Raises
    :class:`RunFolderError` for a folder that holds something else, and :class:`SceneError` for a wrong setting.
    """

    folder: str | Path
    """Path of the run folder. It must be new, empty, or hold an unfinished run of the same scene."""
    recordings: Sequence[str] | None = None
    """Names of the recordings to write, any of `rerun`, `usd` and `paraview`; None selects `rerun` and `usd`."""
    colour: str | None = None
    """Quantity that colours bodies; None selects a suitable quantity for the simulation method."""
    network: bool = False
    """True to record lines between bodies: bonds, and force chains whose width shows the contact force."""
    live: bool | str = False
    """True to show the run in a new Rerun viewer while it is computed; a URL selects a running viewer."""
    bind: str = LOOPBACK
    """IP address on which a newly opened viewer listens."""
    pipeline: Mapping[str, Any] = field(default_factory=lambda: dict.fromkeys(PIPELINE))
    """Values of the options :data:`PIPELINE` of `warpcrete run`, by name; scene.json stores them for a resumed run."""
    resumed: bool = False
    """True if the settings were read from the scene.json in this folder, because its unfinished run continues."""

    def __post_init__(self) -> None:
        if isinstance(self.recordings, str):
            object.__setattr__(self, "recordings", (self.recordings,))
        if self.recordings is not None and not isinstance(self.recordings, Iterable):
            allowed = ", ".join(kind.name for kind in RECORDERS)
            refuse("recordings", self.recordings, f"must be a list of names, any of {allowed}, or None")
        for name in self.recordings or ():
            one_of("recordings", name, tuple(kind.name for kind in RECORDERS))
        for name in ("network", "live", "colour", "bind"):
            self._check_kind(name)
        folder_path("folder", self.folder)
        if not self._holds_run():
            check_new(self.path)

    def _check_kind(self, name: str) -> None:
        value, kind = getattr(self, name), str if name in ("colour", "bind") else bool
        if not isinstance(value, kind | None) and not (name == "live" and isinstance(value, str)):
            allowed = {"network": "True or False", "live": "True, False or the URL of a viewer"}
            refuse(name, value, f"must be {allowed.get(name, 'text')}")

    @property
    def path(self) -> Path:
        """Path of the run folder."""
        return Path(self.folder)

    def _holds_run(self) -> bool:
        return os.path.isfile(self.path / "scene.json")

    def _chosen(self) -> dict[str, bool]:
        """Return whether each kind of recording is written, by the name of the kind."""
        if self.recordings is None:
            return {kind.name: kind.default for kind in RECORDERS}
        return {kind.name: kind.name in self.recordings for kind in RECORDERS}

    def recorders(self, simulation: RecordedSimulation) -> list[Recorder]:
        """Return the recorders that write this folder.

        Raises :class:`SceneError` for a setting that the simulation method does not have, such as lines between bodies
        for a flow.
        """
        display = method_of(simulation.scene).display
        if self.colour is not None and self.colour not in display.colourings:
            refuse("colour", self.colour, f"must be one of {', '.join(display.colourings)}")
        if self.network and not display.has_network:
            problem = f"needs contacts between bodies, which a scene of {display.noun} does not have"
            refuse("network", True, problem, "leave out 'network'")
        interval = simulation.frame_interval
        settings = {
            # Store frames per second, because the command has such an option. Round the number, because the reciprocal
            # of the interval contains rounding errors.
            "frames": None if interval is None else float(f"{1.0 / interval:.12g}"),
            "colour": self.colour,
            "network": self.network,
            **self._chosen(),
            "checkpoint_every": simulation.checkpoint_every,
            "threads": simulation.threads,
            **self.pipeline,
        }
        look = DrawSettings(self.colour, self.network, self.live, self.bind)
        return recorders_of(
            self.path, check_of(simulation.scene), self._chosen(), look, settings,
            going_on=self._holds_run(), again=not self.resumed,
        )  # fmt: skip


RunFolder.__init__ = with_suggestions(RunFolder.__init__)


def check_of(scene: Any) -> Check | None:
    """Return the acceptance check that belongs to the scene function of a scene.

    For a scene that was built in Python without a scene function, return the check of its simulation method, or None.
    """
    function = scene.parameters.function if isinstance(scene.parameters, Arguments) else ""
    module = modules().get(function)
    return method_of(scene).check if module is None else module.check


def check_recorders(simulation: RecordedSimulation) -> list[Recorder]:
    """Return a list with a recorder of the acceptance checks, for a simulation without a folder.

    The list is empty if the scene has no checks, or if the simulation has such a recorder already.
    """
    check = check_of(simulation.scene)
    if check is None or any(isinstance(each, CheckRecorder) for each in simulation.recorders):
        return []
    return [CheckRecorder(check)]


register_folders(RunFolder, check_recorders)
