"""List of the recorders for run folders. The command line builds its options from the entries of this list."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core.records import Record
from ..core.run.recorder import Recorder
from ..core.run.viewer import LOOPBACK
from .checks import Check, CheckRecorder
from .paraview import ParaViewRecorder
from .picture import PictureRecorder
from .rerun import RerunRecorder
from .run_folder import TableRecorder
from .usd import UsdRecorder


@dataclass(frozen=True)
class DrawSettings:
    """Settings for drawing a run: colours, lines between bodies, and viewer."""

    colouring: str | None = None
    """Quantity that the colours show; None selects a suitable quantity for the simulation method."""
    network: bool = False
    live: bool | str = False
    """Viewer that shows the run while it is computed: True opens a new Rerun viewer; a URL selects a running viewer."""
    bind: str = LOOPBACK
    """IP address on which a newly opened viewer listens."""


@dataclass(frozen=True)
class RecorderKind:
    """Optional recorder, with its name, default and help text."""

    name: str
    """Name of the recorder. The command-line option and the setting stored for a resumed run have the same name."""
    default: bool
    """True if `warpcrete run` uses the recorder by default; studies use none by default."""
    help: str
    make: Callable[[Path, DrawSettings], Recorder]


RECORDERS = (
    RecorderKind("rerun", True, "Write run.rrd for the Rerun viewer", lambda folder, look: RerunRecorder(
        folder / "run.rrd", live=look.live, bind=look.bind, colouring=look.colouring, network=look.network)),
    RecorderKind("usd", True, "Write scene.usdc for USD viewers and Blender", lambda folder, look: UsdRecorder(
        folder / "scene.usdc", colouring=look.colouring, velocities=False)),
    RecorderKind("paraview", False, "Write bodies, walls, contacts and surfaces as VTKHDF for ParaView (needs h5py)",
         lambda folder, look: ParaViewRecorder(folder, colouring=look.colouring)),
)  # fmt: skip


def recorders_of(
    folder: Path,
    check: Check | None,
    chosen: Mapping[str, object],
    look: DrawSettings | None = None,
    command: Record | None = None,
    *,
    going_on: bool = False,
    again: bool = False,
    pictures: bool = True,
) -> list[Recorder]:
    """Return the recorders of a run folder.

    The list always contains the recorder of tables. It contains the recorder of pictures if `pictures` is true, and
    each optional recorder whose name has a true value in `chosen`. `check` is the scene's acceptance check, or None if
    the scene has none. `command` holds settings that are stored in scene.json for a resumed run. If `going_on` is true,
    the folder must belong to the same run, which was interrupted. If `again` is true, the scene.json of an existing
    folder must describe exactly this run.
    """
    look = look or DrawSettings()
    recorders: list[Recorder] = [TableRecorder(folder, command, going_on=going_on, again=again)]
    if check is not None:
        recorders.append(CheckRecorder(check))
    recorders += [kind.make(folder, look) for kind in RECORDERS if chosen.get(kind.name)]
    if look.live and not chosen.get("rerun"):
        recorders.append(
            RerunRecorder(None, live=look.live, bind=look.bind, colouring=look.colouring, network=look.network)
        )
    return [*recorders, PictureRecorder(folder, colouring=look.colouring)] if pictures else recorders
