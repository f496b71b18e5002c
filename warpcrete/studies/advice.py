"""Settings for a wanted accuracy, from a trade that measured them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.by_name import names_from_file
from ..core.errors import RunFolderError, refuse
from ..core.files import read_json
from ..core.parameters import declared_fields

NO_MATTER = ("seed", "precision", "tolerated_error")
"""Parameters in which a scene may differ from that of a trade."""
SHIPPED = Path(__file__).parents[1] / "measured"
"""Folder of the trades of standard scenes that come with the package, as `compact` leaves them."""


@dataclass(frozen=True)
class Advice:
    """What to set, what is promised of it, and how far that carries."""

    changes: dict[str, Any]
    """Parameters to set."""
    setting: str
    """In words."""
    promised: float
    """Largest error of the trade's quantities."""
    quantities: tuple[str, ...]
    ratio: float
    """Time of a run over that of the scene without these changes."""
    left_out: tuple[str, ...]
    """What belongs to the setting, but could not be set: without it nothing is promised."""
    outside: tuple[str, ...]
    """In what the scene differs from the one that was measured: the promise was not tried there."""
    tried: tuple[str, ...]
    """Other scenes on which it was tried."""
    machine: str
    """What times were measured on."""
    time: float
    """Of a run in the trade's scene on that machine [s]."""


def shipped(name: str, module: Any, given: Mapping[str, Any], on_gpu: bool) -> Path | None:
    """The shipped trade of a scene that is nearest to what is `given`; None where there is none.

    It is of the same scene function; then what could be traded there is most alike, then least parameters are apart,
    then it is of the same kind of machine.
    """
    own = module.scene.resolved(given)
    found = []
    for path in sorted(SHIPPED.glob("*.json")):
        record = read_json(path)
        if record["scene"] == name:
            here, there = (module.scene.declared(each) for each in (own, record["parameters"]))
            closed = module.trading.closed_form
            unlike = len({k.name for k in module.trading.knobs(here)} ^ {k.name for k in module.trading.knobs(there)})
            apart = len(outside(record["parameters"], own, module))
            other_machine = record["device"].startswith("cuda") != on_gpu
            found.append((closed(here) != closed(there), unlike, apart, other_machine, str(path)))
    return Path(min(found)[-1]) if found else None


def compact(record: Mapping[str, Any]) -> dict[str, Any]:
    """What a shipped trade keeps of a trade.json."""
    kept = ("scene", "parameters", "quantities", "repeat", "device", "machine", "threads", "promises")
    of_points = ("setting", "origin", "time", "errors", "suspect")
    points = [{name: point[name] for name in of_points} for point in record["points"]]
    version = {"warpcrete": record["provenance"]["warpcrete"], "commit": record["provenance"].get("commit")}
    return {name: record[name] for name in kept} | {"points": points} | version


def advise(trade: Path, name: str, module: Any, given: Mapping[str, Any], accuracy: float) -> Advice:
    """Cheapest settings that a trade promises to err by no more than `accuracy` (1 is all).

    `trade` is its folder, or the file of a shipped one; `given` are the parameters of the scene `name` of `module` that
    somebody chose; of those only properties of the concrete change, as the aggregate's sizes do when it is coarsened.
    Raises :class:`SceneError` for an accuracy that is none or that the trade did not reach, :class:`RunFolderError`
    for what holds no trade of this scene.
    """
    if not 0 < accuracy < 1:
        refuse("accuracy", f"{100 * accuracy:g} %", "must be above 0 % and below 100 %")
    file = trade if trade.suffix == ".json" else trade / "trade.json"
    record = read_json(file)
    if record.get("scene") != name:
        raise RunFolderError(
            f"trade = '{trade}': measures the scene {record.get('scene')!r}, not {name!r}; give a trade of this scene"
        )
    try:
        promises = [p for p in record.get("promises", []) if p["setting"] is not None]
        best = min((float(p["promised"]) for p in promises), default=None)
        within = [p for p in promises if p["promised"] <= accuracy]
        chosen = min(within, key=lambda p: float(p["ratio"]), default=None)
        levels = dict(chosen["levels"]) if chosen else {}
        measured, quantities = dict(record["parameters"]), tuple(record["quantities"])
        machine, time = str(record.get("machine", "")), float((chosen or {}).get("time") or math.nan)
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"'{file}': is not the record of a trade ({type(error).__name__}: {error}); give the folder of a trade"
        ) from error
    if best is None:
        raise RunFolderError(f"trade = '{trade}': has no result yet; continue it with 'warpcrete trade --resume'")
    if chosen is None:
        refuse("accuracy", f"{100 * accuracy:g} %", f"was not reached: this trade guarantees {100 * best:.2g} % at "
                                                    "best",
               "use that accuracy, or continue the trade")  # fmt: skip
    own = module.scene.resolved(given)
    knobs = {knob.name: knob for knob in module.trading.knobs(module.scene.declared(own))}
    changes: dict[str, Any] = {}
    taken, left_out = [], []
    for knob_name, key in levels.items():
        knob = knobs.get(knob_name)
        level = knob.level_of(key) if knob else None
        if knob is None or level is None:
            left_out.append(f"{knob_name} {key}, which this scene does not have")
        elif not knob.physical and any(k in own and own[k] != measured.get(k, ...) for k in level.changes):
            left_out.append(f"{knob_name} {level.label}, because its parameter is given")
        else:
            changes |= level.changes
            taken.append(f"{knob_name} {level.label}")
    tolerance = module.trading.tolerance
    if tolerance and tolerance not in own and not left_out and module.trading.closed_form(module.scene.declared(own)):
        changes[tolerance] = accuracy
    return Advice(
        changes, ", ".join(taken) or "as given", chosen["promised"], quantities, chosen["ratio"],
        tuple(left_out), tuple(outside(measured, own, module)),
        tuple(name for name, error in chosen.get("carried", {}).items() if error), machine,
        time,
    )  # fmt: skip


def outside(measured: Mapping[str, Any], own: Mapping[str, Any], module: Any) -> list[str]:
    """Parameters that differ from those of the trade's scene, in words."""
    # As the scene takes them: a letter for a unit is its name.
    ours = module.scene.declared(own)
    with names_from_file():
        theirs = module.scene.declared(measured)
    found = []
    for name in declared_fields(module.scene.parameters):
        here, there = getattr(ours, name), getattr(theirs, name)
        if name not in NO_MATTER and here != there:
            found.append(f"{name} {_shown(here)} instead of {_shown(there)}")
    return found


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
