"""The recorders that a run folder may have, one entry each: the command makes its options from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.run_loop import Recorder
from ..core.viewer import LOOPBACK
from .checks import Check, CheckRecorder
from .paraview import ParaViewRecorder
from .picture import PictureRecorder
from .rerun import RerunRecorder
from .run_folder import TableRecorder
from .usd import UsdRecorder


@dataclass(frozen=True)
class Look:
    """How a run is drawn."""

    colouring: str | None = None
    """What colours show; None: what suits the method."""
    network: bool = False
    live: bool | str = False
    """Shown in a Rerun viewer while it runs: True opens one, or the URL of one that runs."""
    bind: str = LOOPBACK
    """IP address that a viewer that is opened listens on."""


@dataclass(frozen=True)
class Kind:
    """A recorder that may be left out."""

    name: str
    """Of the option, and of the setting that is kept for a resumed run."""
    default: bool
    """Whether `warpcrete run` has it unless told otherwise; studies have none unless told."""
    help: str
    make: Callable[[Path, Look], Recorder]


RECORDERS = (
    Kind("rerun", True, "write run.rrd", lambda folder, look: RerunRecorder(
        folder / "run.rrd", live=look.live, bind=look.bind, colouring=look.colouring, network=look.network)),
    Kind("usd", True, "write scene.usdc", lambda folder, look: UsdRecorder(
        folder / "scene.usdc", colouring=look.colouring, velocities=False)),
    Kind("paraview", False, "write bodies.vtkhdf, walls.vtkhdf and contacts.vtkhdf for ParaView (needs h5py)",
         lambda folder, look: ParaViewRecorder(folder, colouring=look.colouring)),
)  # fmt: skip


def recorders_of(
    folder: Path,
    check: Check,
    chosen: Mapping[str, Any],
    look: Look | None = None,
    command: dict[str, Any] | None = None,
    *,
    going_on: bool = False,
    again: bool = False,
) -> list[Recorder]:
    """Recorders of a run folder: table, checks and picture always, of the others those with a true entry in `chosen`.

    `check` is the scene's; `command` are settings to keep for a resumed run; `going_on` takes the folder of the same
    run, which was cut, and `again` only if it holds the record of this very run.
    """
    look = look or Look()
    found: list[Recorder] = [TableRecorder(folder, command, going_on=going_on, again=again), CheckRecorder(check)]
    found += [kind.make(folder, look) for kind in RECORDERS if chosen.get(kind.name)]
    if look.live and not chosen.get("rerun"):
        found.append(
            RerunRecorder(None, live=look.live, bind=look.bind, colouring=look.colouring, network=look.network)
        )
    return [*found, PictureRecorder(folder, colouring=look.colouring)]
