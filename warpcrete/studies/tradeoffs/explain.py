"""Forecast of a scene before it runs: features, memory, time step, wall time, and the most effective savings."""

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import warp as wp

from ...core.device.device import checked_threads, find_device
from ...core.errors import RunFolderError, SceneError, flag, refuse, with_suggestions
from ...core.inputs.by_name import names_from_file
from ...core.inputs.fingerprints import fingerprint
from ...core.inputs.knobs import Knob
from ...core.inputs.origin import arguments_of
from ...core.run.files import folder_path, read_json, read_record, write_json
from ...core.run.folder_kinds import wrong_folder
from ...core.run.forecast import Forecast
from ...core.run.frames import LONGEST_FRAME_INTERVAL, MINIMUM_FRAMES
from ...core.run.provenance import provenance
from ...core.run.simulation_base import SimulationBase
from ...methods import method_of
from ...record.recorders import RECORDERS, DrawSettings
from ...scenes import modules
from .advice import nearest_shipped, outside
from .fronts import Error, worst
from .report import percent

TIMED_FRAMES = 3  # number of frames that are timed for each recorder
MEASURING = "measuring the first steps; kernels that are not in the cache are compiled before, which can take minutes"
"""Sentence that is shown to users before the measurements, which may take minutes."""
MAX_TIME_RATIO = 0.9
"""Limit for listing a simplification: wall time with the simplification, divided by the wall time without it."""


@dataclass(frozen=True)
class Saving:
    """A simplification of a scene that shortens its run."""

    what: str
    """Name of the simplification, as it is shown to the user."""
    ratio: float
    """Wall time with the simplification, divided by the wall time of the unchanged scene."""
    error: str
    """Text with the measured error that the simplification causes, or a note that this error was not measured."""


@dataclass(frozen=True)
class Explanation:
    """Forecast of a scene on a device, with the savings that simplifications would bring."""

    scene: str
    forecast: Forecast
    savings: tuple[Saving, ...]
    """Simplifications that shorten the run, in order of their effect, the largest first."""
    source: str
    """Source of the measured errors; empty if there are none."""

    def __str__(self) -> str:
        return "\n".join(_lines(self))

    __repr__ = __str__


@with_suggestions
def explain(
    scene: Any,
    *,
    device: str | None = None,
    threads: int | None = None,
    trade: Path | str | None = None,
    cache: bool = True,
    announce: Callable[[str], None] | None = None,
) -> Explanation:
    """Forecast memory, time step and wall time of a scene on a device, from measurements of a few seconds.

    `scene` is any scene that :class:`warpcrete.Simulation` accepts. `trade` is the folder of a trade-off study, whose
    measured errors are listed with the savings in time. By default, these errors come from the most similar record that
    is shipped with the package. With `cache`, results are kept in the user's cache folder. The measurements may take
    minutes if kernels must be compiled first; before them, `announce` is called with a sentence that says so. Raises
    the same errors as a run of the scene before its first step.
    """
    method = method_of(scene)
    selected_device = find_device(device)
    threads = checked_threads(threads)
    flag("cache", cache)
    # Read the trade-off record first, so that a wrong folder is refused before the measurements.
    folder = None if trade is None else folder_path("trade", trade)
    savings, source = _measured_savings(scene, folder, selected_device.is_cuda)
    path = _cached(scene, selected_device, threads) if cache else None
    forecast = _read(path) if path is not None else None
    if forecast is None:
        if announce is not None:
            announce(MEASURING)
        forecast = method.forecast(scene, selected_device, scene.precision, threads, _frames)
        words = provenance(selected_device, scene.precision, 0)
        name = (
            words["device_name"] if selected_device.is_cuda else f"{words.get('processor') or 'CPU'}, {threads} threads"
        )
        forecast = replace(forecast, device=name)
        if path is not None:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_json(path, asdict(forecast))
            except (OSError, RunFolderError):  # The forecast is valid even if it cannot be written to the cache.
                pass
    savings = sorted((*_time_step_savings(forecast), *savings), key=lambda each: each.ratio)
    return Explanation(scene.name, forecast, tuple(savings), source)


def _frames(simulation: SimulationBase) -> dict[str, float]:
    """Return the mean wall time per frame [s] of each recorder that is on by default, by the name of the recorder.

    This time includes the time for finishing the recording at the end of a run, divided by the number of frames.
    """
    times = {}
    for kind in (kind for kind in RECORDERS if kind.default):
        with tempfile.TemporaryDirectory() as folder:
            recorder = kind.make(Path(folder), DrawSettings())
            recorder.start(simulation)
            recorder.frame(simulation)
            begun = time.perf_counter()
            for _ in range(TIMED_FRAMES):
                recorder.frame(simulation)
            recorder.finish(simulation, simulation.result(False))
            times[kind.name] = (time.perf_counter() - begun) / TIMED_FRAMES
    return times


def _cached(scene: Any, device: wp.Device, threads: int) -> Path:
    """Return the path of the cache file for the forecast of a scene.

    The name of the file depends on the scene, the versions of the software, the device, and the number of threads.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    version = provenance(device, "float32", 0)
    key = fingerprint((scene, version.get("warpcrete"), version.get("warp"), version.get("device_name"),
                       version.get("processor"), str(device), threads))  # fmt: skip
    return Path(home) / "warpcrete" / f"explain-{key[:24]}.json"


def _read(path: Path) -> Forecast | None:
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
        return Forecast(**{**known, "remarks": tuple(known["remarks"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _measured_savings(scene: Any, trade: Path | None, on_gpu: bool) -> tuple[list[Saving], str]:
    """Return the savings that a trade-off record contains for a scene, and a description of the record's source.

    :func:`_trade_of` explains the arguments.
    """
    record, source = _trade_of(scene, trade, on_gpu)
    try:
        return list(_knob_savings(record.get("points", []), _knobs_of(scene, record.get("parameters")))), source
    except (AttributeError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"trade = {source}: contains a damaged trade.json ({error!r}); give a folder made by 'warpcrete trade'"
        ) from error


def _knobs_of(scene: Any, measured: Mapping[str, object] | None) -> set[str]:
    """Return the names of the knobs (accuracy parameters) whose savings in a trade-off record apply to a scene.

    `measured` holds the parameters of the scene in the record. If a knob has another value in this scene, it is left
    out, because the record states savings relative to its own scene: cells of 12 mm, for example, save nothing in a
    scene that has cells of 12.5 mm. Knobs whose levels are factors, such as coarser aggregate, are not left out.
    """
    module = modules().get(scene.name)
    given = arguments_of(scene)
    if module is None or not given:
        return set()
    ours = module.scene.declared(given)
    with names_from_file():
        theirs = ours if measured is None else module.scene.declared(measured)

    def comparable(knob: Knob) -> bool:
        relative = all(level.label.startswith("x ") for level in knob.levels)
        return relative or all(
            getattr(ours, name) == getattr(theirs, name) for level in knob.levels for name in level.changes
        )

    return {knob.name for knob in module.trading.knobs(ours) if knob.chosen and comparable(knob)}


def _knob_savings(points: list[dict[str, Any]], knobs: set[str]) -> Iterator[Saving]:
    """Yield a saving for each change of a single accuracy parameter that shortened the run in a trade-off study.

    `points` contains the settings of the study with their run times and errors. The first of them is the user's scene.
    `knobs` holds the names of the accuracy parameters that are considered.
    """
    for point in points[1:]:
        given, alone = points[0], point["origin"] in knobs and point["errors"] and not point["suspect"]
        if not alone or not point["time"]["value"] or not given["time"]["value"]:
            continue
        ratio = point["time"]["value"] / given["time"]["value"]
        found = [Error(name, e["shift"], e["interval"] or 0.0) for name, e in point["errors"].items()
                 if e["shift"] is not None]  # fmt: skip
        largest = worst(found)
        if ratio < MAX_TIME_RATIO and largest is not None:
            yield Saving(point["setting"], ratio, f"error of {largest.quantity} {percent(largest)}")


def _time_step_savings(forecast: Forecast) -> Iterator[Saving]:
    """Yield the savings that are possible if the bonds or dashpots that limit the time step are removed or softened."""
    alone, whole = forecast.limits.get("contacts"), forecast.limits.get("all together")
    if not alone or not whole or not forecast.wall_time or not 0.9 < forecast.time_step / whole < 1.1:
        # The user chose the time step, so it would stay the same without bonds or dashpots, and nothing is saved.
        return
    rest = 1.0 - sum(forecast.parts.get(part, 0.0) for part in ("steps", "settling")) / forecast.wall_time
    for name, limit in forecast.limits.items():
        if name.startswith("contacts and ") and limit < 1.05 * whole and limit < MAX_TIME_RATIO * alone:
            others = [v for n, v in forecast.limits.items() if n.startswith("contacts and ") and n != name] + [alone]
            ratio = rest + (1.0 - rest) * whole / min(others)
            if ratio < MAX_TIME_RATIO:
                yield Saving(f"no {name.removeprefix('contacts and ')}, or softer ones", ratio, "error not measured")
    # In scenes without bonds, the forecast states the time step that is stable without dashpots. This step gives the
    # largest saving that weaker dashpots can bring.
    if alone < 1.05 * whole and not any(name.startswith("contacts and ") for name in forecast.limits):
        ratio = rest + (1.0 - rest) * alone / forecast.limits.get("contacts without dashpots", alone)
        if ratio < MAX_TIME_RATIO:
            yield Saving("no dashpots, or less damping", ratio, "error not measured")


def _trade_of(scene: Any, trade: Path | None, on_gpu: bool) -> tuple[Mapping[str, Any], str]:
    """Return a trade-off record for a scene, and a description of its source; both are empty if there is no record.

    The record comes from the folder `trade`. By default, it is the most similar record that is shipped with the
    package. `on_gpu` is True if the scene runs on a GPU, because a record from a GPU is then preferred.
    """
    module = modules().get(scene.name)
    if trade is not None:
        if not (trade / "trade.json").is_file():
            raise RunFolderError(f"trade = '{trade}': {wrong_folder(trade, 'trade.json', resumed=False)}")
        record = read_record(trade / "trade.json")
        if record.get("scene") != scene.name:
            problem = f"is a trade-off study of the scene {record.get('scene')!r}, not of {scene.name!r}"
            refuse("trade", str(trade), problem, "give the folder of another study, or leave out 'trade'")
        return record, f"'{trade}', {record.get('machine', '')}"
    given = dict(arguments_of(scene))
    if module is None or not given:
        return {}, ""
    try:
        path = nearest_shipped(scene.name, module, given, on_gpu)
    except SceneError:
        return {}, ""
    if path is None:
        return {}, ""
    record = read_json(path)
    apart = outside(record["parameters"], given, module)
    differs = f", measured with other {', '.join(each.split()[0] for each in apart)}" if apart else ""
    return record, f"the shipped trade {path.stem!r} on {record.get('machine', '')}{differs}"


def _lines(explanation: Explanation) -> Iterator[str]:
    f = explanation.forecast
    yield f"scene {explanation.scene}, {f.method}, on {f.device}"
    yield "  " + ", ".join(f"{count:,} {name}" for name, count in f.counts.items())
    yield from (f"  note: {remark}" for remark in f.remarks)
    yield "features"
    width = max(map(len, f.features))
    used = {name: why for name, why in f.features.items() if why != "left out"}
    yield from (f"  {name:{width}s}  {why}" for name, why in used.items())
    if len(used) < len(f.features):
        yield f"  left out: {', '.join(name for name in f.features if name not in used)}"
    yield f"memory: {_bytes(f.total_memory)}"
    yield from (f"  {name:20s} {_bytes(size)}" for name, size in f.memory.items())
    yield f"time step: {f.time_step:.3g} s, by {f.governing}"
    yield from (f"  {name:36s} {limit:.3g} s" for name, limit in f.limits.items())
    yield f"steps: {f.steps:,.0f} for {f.duration:.3g} s"
    yield f"wall time: {_seconds(f.wall_time)} without recordings, with compiled kernels"
    yield from (f"  {name:20s} {_seconds(spent)}" for name, spent in f.parts.items())
    if f.frame:
        frames = 1 + max(MINIMUM_FRAMES, int(f.duration / LONGEST_FRAME_INTERVAL))
        spent = ", ".join(f"{_seconds(frames * each)} {name}" for name, each in f.frame.items())
        yield f"  plus {frames} recorded frames: {spent}"
    yield "largest possible savings of time" + (f" (errors from {explanation.source})" if explanation.source else "")
    if not explanation.savings:
        yield "  none known"
    for saving in explanation.savings[:5]:
        yield f"  {saving.what}: {saving.ratio:.2g} of the wall time; {saving.error}"


def _bytes(size: float) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"


def _seconds(time: float) -> str:
    if time < 120:
        return f"{time:.2g} s" if time < 10 else f"{time:.0f} s"
    if time < 600:
        return f"{time / 60:.2g} min"
    hours, minutes = divmod(round(time / 60), 60)
    if hours >= 100:
        return f"{hours} h"
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
