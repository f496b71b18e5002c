"""Choice of the settings that reach a required accuracy, from a measured trade-off between speed and accuracy."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import RunFolderError, at_least, refuse
from ...core.inputs.by_name import names_from_file
from ...core.inputs.parameters import declared_fields
from ...core.records import SceneArguments
from ...core.run.files import read_json
from ...core.run.scene_module import SceneModule

IGNORED_PARAMETERS = ("seed", "precision", "tolerated_error")
"""Parameters in which a scene may differ from the scene of a trade-off study without a remark to the user."""
SHIPPED = Path(__file__).parents[2] / "measured"
"""Folder of the trade-off records that come with the package, in the short form written by :func:`compact`."""


@dataclass(frozen=True)
class Advice:
    """Recommended accuracy settings for a scene, their error bound, and the conditions under which it was tested."""

    changes: SceneArguments
    """Recommended parameter values, by parameter name."""
    setting: str
    """Description of the recommended settings for the user."""
    promised: float
    """Upper bound of the relative error that the settings cause in each of `quantities`, as a fraction."""
    quantities: tuple[str, ...]
    """Names of the measured quantities to which the promised error applies."""
    ratio: float
    """Wall time of a run with these settings, divided by the wall time of a run without them."""
    left_out: tuple[str, ...]
    """Descriptions of recommended settings that cannot be used in this scene. If there are any, the error may be larger
    than `promised`."""
    outside: tuple[str, ...]
    """Texts that describe the differences between this scene and the measured scene. The error of a scene with these
    differences was not measured, so it may be larger than `promised`."""
    tried: tuple[str, ...]
    """Descriptions of other scenes on which the settings were tested."""
    machine: str
    """Name of the GPU or CPU on which the wall times were measured."""
    time: float
    """Wall time of one run of the trade-off study's scene with the recommended settings, on the processor `machine`
    [s]; NaN if unknown."""
    version: str
    """Version of warpcrete with which the trade-off was measured; empty if unknown."""


def nearest_shipped(name: str, module: SceneModule, given: Mapping[str, object], on_gpu: bool) -> Path | None:
    """Return the file of the shipped trade-off record that is most similar to a scene; None if there is none.

    The scene has the parameters `given`, and runs on a GPU if `on_gpu` is True. Only records of the scene function
    `name` with the same kind of simulated aggregates are considered, because aggregates limit the width of the cells. A
    record is more similar than another one by the first of these criteria that distinguishes them:

    - A closed form exists for both scenes, or for neither of them.
    - Fewer knobs (accuracy parameters) exist in only one of the two scenes.
    - Fewer parameters have different values.
    - The record was measured on the same kind of machine (GPU or CPU).
    """
    own = module.scene.resolved(given)
    candidates = []
    for path in sorted(SHIPPED.glob("*.json")):
        record = read_json(path)
        if record["scene"] == name:
            here, there = (module.scene.declared(each) for each in (own, record["parameters"]))
            if _kinds_of_aggregates(here) != _kinds_of_aggregates(there):
                continue
            closed = module.trading.closed_form
            unlike = len({k.name for k in module.trading.knobs(here)} ^ {k.name for k in module.trading.knobs(there)})
            apart = len(outside(record["parameters"], own, module))
            other_machine = record["device"].startswith("cuda") != on_gpu
            candidates.append((closed(here) != closed(there), unlike, apart, other_machine, str(path)))
    return Path(min(candidates)[-1]) if candidates else None


def _kinds_of_aggregates(given: object) -> tuple[bool, bool]:
    """Return whether the aggregates of a flow are groups of particles, and whether they are rigid bodies."""
    # Test `is True`, because `aggregates` is a truth value in the parameters of channels and tubes, but a function,
    # which would count as true, in the parameters of vessels.
    grouped = getattr(given, "aggregates", None) is True
    return grouped, not grouped and bool(getattr(given, "aggregate_fraction", None))


def compact(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a shortened trade.json record, which holds only the entries that are shipped with the package."""
    kept = ("scene", "parameters", "quantities", "repeat", "device", "machine", "threads", "promises")
    kept += ("reference_errors",)
    of_points = ("setting", "origin", "time", "errors", "suspect")
    points = [{name: point[name] for name in of_points} for point in record["points"]]
    version = {"warpcrete": record["provenance"]["warpcrete"], "commit": record["provenance"].get("commit")}
    return {name: record[name] for name in kept} | {"points": points} | version


def advise(trade: Path, name: str, module: SceneModule, given: Mapping[str, object], accuracy: float) -> Advice:
    """Return the cheapest accuracy settings whose relative error is at most `accuracy`, a fraction between 0 and 1.

    `trade` is the folder of a trade-off study, or the file of a shipped record; it states an error bound for each
    setting. `given` holds the parameters that the user chose for the scene `name` of `module`. The advice does not
    change these parameters, except properties of the concrete: a setting with coarser aggregate, for example, replaces
    the grain sizes. Raises :class:`SceneError` if `accuracy` is not between 0 and 1 or no setting reaches it, and
    :class:`RunFolderError` if `trade` holds no record of this scene.
    """
    if not 0 < accuracy < 1:
        refuse("accuracy", f"{100 * accuracy:g} %", "must be above 0 % and below 100 %", "for example 5%")
    file = trade if trade.suffix == ".json" else trade / "trade.json"
    record = read_json(file)
    if record.get("scene") != name:
        raise RunFolderError(
            f"trade = '{trade}': measures the scene {record.get('scene')!r}, not {name!r}; give a folder made by "
            f"'warpcrete trade {name}'"
        )
    try:
        promises = [p for p in record.get("promises", []) if p["setting"] is not None]
        best = min((float(p["promised"]) for p in promises), default=None)
        within = [p for p in promises if p["promised"] <= accuracy]
        chosen = min(within, key=lambda p: float(p["ratio"]), default=None)
        levels = dict(chosen["levels"]) if chosen else {}
        measured, quantities = dict(record["parameters"]), tuple(record["quantities"])
        machine, time = str(record.get("machine", "")), float((chosen or {}).get("time") or math.nan)
        version = str(record.get("warpcrete") or record.get("provenance", {}).get("warpcrete", ""))
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"'{file}': is not the record of a trade-off study ({type(error).__name__}: {error}); give a folder made "
            "by 'warpcrete trade'"
        ) from error
    if best is None:
        raise RunFolderError(
            f"trade = '{trade}': has no result yet; finish the study with 'warpcrete trade --resume {trade}'"
        )
    if chosen is None:
        more = f"make a longer one with 'warpcrete trade {name} --budget 1h'" if trade.suffix == ".json" else (
            "continue the study with 'warpcrete trade --resume'")  # fmt: skip
        problem = f"was not reached: this trade-off study guarantees {100 * best:.2g} % at best"
        refuse("accuracy", f"{100 * accuracy:g} %", problem, f"use {at_least(100 * best, 2)} % or more, or {more}")
    own = module.scene.resolved(given)
    knobs = {knob.name: knob for knob in module.trading.knobs(module.scene.declared(own))}
    changes: SceneArguments = {}
    levels_used, left_out = [], []
    for knob_name, key in levels.items():
        knob = knobs.get(knob_name)
        level = knob.level_of(key) if knob else None
        if knob is None or level is None:
            left_out.append(f"{knob_name} {key}, which this scene does not have")
        elif not knob.physical and any(k in own and own[k] != measured.get(k, ...) for k in level.changes):
            left_out.append(f"{knob_name} {level.label}, because you set its parameter")
        else:
            changes |= level.changes
            levels_used.append(f"{knob_name} {level.label}")
    tolerance = module.trading.tolerance
    if tolerance and tolerance not in own and not left_out and module.trading.closed_form(module.scene.declared(own)):
        changes[tolerance] = accuracy
    return Advice(
        changes, ", ".join(levels_used) or "as given", chosen["promised"], quantities, chosen["ratio"],
        tuple(left_out), tuple(outside(measured, own, module)),
        tuple(name for name, error in chosen.get("carried", {}).items() if error), machine,
        time, version,
    )  # fmt: skip


def outside(measured: Mapping[str, object], own: Mapping[str, object], module: SceneModule) -> list[str]:
    """Return a description of each parameter whose value in this scene differs from its value in the measured scene.

    `own` holds the parameters of this scene, and `measured` those of the measured scene.
    """
    # Compare converted values, because the same value can be stated in different ways. A pipe unit of Zhan et al., for
    # example, has a letter and a name.
    ours = module.scene.declared(own)
    with names_from_file():
        theirs = module.scene.declared(measured)
    differences = []
    for name in declared_fields(module.scene.parameters):
        here, there = getattr(ours, name), getattr(theirs, name)
        if name not in IGNORED_PARAMETERS and here != there:
            differences.append(f"{name} {_shown(here)} instead of {_shown(there)}")
    return differences


def _shown(value: object) -> str:
    if value is None:
        return "the default"
    return f"{value:g}" if isinstance(value, float) else str(value)
