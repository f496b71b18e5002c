"""The first steps of short runs with all that is measured, drawn and written of them, kept (see `kept`).

Only the first moments are kept, in which rounding has not grown. Other tests make the same kernels.
"""

import json
import math
from types import SimpleNamespace

import kept
import numpy as np
import pytest
from pumping import TINY
from test_stretch import PIPE as STRETCH

from warpcrete import Simulation, scenes
from warpcrete.core.errors import RunFolderError
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.scene.clumps import reference
from warpcrete.dem.scene.scene import Bodies, Scene
from warpcrete.geometry.walls import PlaneWall, Prescribed
from warpcrete.record.checks import CheckRecorder
from warpcrete.record.paraview import ParaViewRecorder
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.rerun_stream import RerunStream
from warpcrete.record.run_folder import TableRecorder
from warpcrete.record.usd import UsdRecorder

PIPE = TINY | dict(shapes="reference", travel=0.002, ramp=0.001)
FREE = dict(concrete="own", density=2300.0, viscosity=30.0, yield_stress=500.0, spacing=0.0125)


def clumps():
    """Return a scene of clumps of two shapes, which spin, move, and press on each other and on a turning plate."""
    shapes, random = reference()[:2], np.random.default_rng(3)
    turned = random.normal(size=(6, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    place = np.array([[0.0115 * k, 0.004 * (k % 2), 0.006] for k in range(6)])
    bodies = tuple(
        Bodies(
            positions=place[k::2],
            sizes=[0.01, 0.012, 0.014],
            template=shapes[k],
            orientations=turned[k::2],
            spins=random.normal(scale=20, size=(3, 3)),
            velocities=random.normal(scale=0.3, size=(3, 3)),
        )
        for k in range(2)
    )
    motion = Prescribed(velocity=(0.1, 0.0, 0.2), spin=(3.0, 0.0, 5.0), ramp_time=0.0)
    plate = PlaneWall(name="plate", point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), drawn_radius=0.1, motion=motion)
    return Scene(
        name="clumps", duration=2e-3, sample_interval=1e-3, gravity=(0.0, 0.0, 0.0), bodies=bodies, walls=(plate,)
    )


STARTS = {
    "clumps": lambda: clumps(),
    "pipe": lambda: scenes.pipe(**PIPE | {"settle": 0.0}),
    "channel": lambda: scenes.channel(spacing=0.02, duration=0.012, sample_interval=4e-3),
    "tube": lambda: scenes.tube(spacing=0.02, duration=0.012, sample_interval=4e-3, ends="piston"),
    "slump": lambda: scenes.slump(**FREE, duration=0.06, sample_interval=0.02, lift_time=0.2),
    "part": lambda: scenes.part(concrete="no1", unit="bend-to-vertical", straight=0.2, spacing=0.0125, duration=0.03),
    "stretch": lambda: scenes.stretch(**STRETCH, gradient=20.0, sample_interval=10.0, duration=20.0),
}
COLOURINGS = {
    "clumps": ("force", "speed", "size"),
    "pipe": ("force", "speed", "size"),
    "slump": ("shear", "speed"),
    "part": ("shear", "pressure"),
    "stretch": ("shear", "pressure"),
}
NETWORK = ("clumps", "pipe")
"""Scenes of which force chains are recorded."""
LOOSE = 1e-2
"""Single precision, over some dozens of steps, and colours of one byte."""
WORDS = math.inf
"""Aggregates of a packing are elsewhere where another processor rounds differently, so only words are compared."""
OTHERS = ("speed", "provenance", "state_hash", "checks", "memory", "steps", "iterations")
COUNTS = ("viscosity_iterations", "pressure_iterations", "steps")
"""Columns that may differ by one where another processor rounds differently."""


class Seen(Recorder):
    """Recorder that collects everything that displays offer at the last frame."""

    def __init__(self, colourings):
        self.colourings = colourings

    def frame(self, simulation):
        self.found = {str(colouring): dict(self.look(simulation.display(colouring))) for colouring in self.colourings}

    def look(self, display):
        yield "radii", display.radii()
        yield "centres", display.centres()
        yield "colours", np.asarray(display.colours(), float)
        yield "bodies", np.asarray(display.body_colours(), float)
        yield "fields", display.fields()
        yield "scale", display.scale()
        yield "bounds", display.bounds()
        yield "categories", display.categories()
        yield "words", [display.cut, display.palette, display.preferred]
        yield "view", display.view(2.0)
        for number, wall in enumerate(display.walls()):
            yield f"wall {wall.name}", [wall, display.wall_pose(number), display.wall_values(number)]
        for plot in display.plots():
            yield f"plot {plot.title}", plot
        for profile in display.profiles():
            yield f"profile {profile.title}", [profile, [curve.read() for curve in profile.curves]]
        surface = display.surface()
        yield "surface", None if surface is None else [surface, np.asarray(display.surface_colours(surface), float)]
        yield "network", {name: [lines.ends.shape, np.sort(lines.forces)] for name, lines in display.network().items()}


class Logged(RerunRecorder):
    """Recorder for Rerun that also stores what it logs: the values of every component, by path."""

    logged: dict

    def _log(self, path, what, static=False):
        found = {}
        for batch in what.as_component_batches():
            values = batch.as_arrow_array().to_pylist()
            kind = str(batch.component_descriptor()).rpartition(":")[2]
            if "blob" not in kind.lower():
                found[kind] = list(numbers_in(values))
        self.logged[f"{path}{' (static)' if static else ''}"] = found
        super()._log(path, what, static)

    def _blueprint(self, simulation, display):
        made = super()._blueprint(simulation, display)
        self.views = list(views_of(made.root_container))
        return made


def numbers_in(values):
    """Return all numbers and words of nested lists and dictionaries, one after the other."""
    if isinstance(values, dict):
        values = values.values()
    if isinstance(values, str | bytes | bytearray) or not hasattr(values, "__iter__"):
        yield values if isinstance(values, int | float | str) else str(type(values).__name__)
        return
    for each in values:
        yield from numbers_in(each)


def views_of(view):
    own = {name: getattr(view, name, None) for name in ("name", "origin", "column_shares", "row_shares", "active_tab")}
    yield [type(view).__name__, *(f"{name} {value}" for name, value in own.items() if value is not None)]
    contents = getattr(view, "contents", None)
    for each in contents if isinstance(contents, list | tuple) else ():
        if isinstance(each, str):
            yield each
        else:
            yield from views_of(each)


def usd(path):
    """Return every attribute of every prim of a stage, at its first and last time."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    found = {"times": [stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()]}
    for prim in stage.Traverse():
        one = {"kind": str(prim.GetTypeName())}
        for attribute in prim.GetAuthoredAttributes():
            times = attribute.GetTimeSamples()
            values = [attribute.Get(time) for time in (times[:1] + times[-1:] if times else [Usd.TimeCode.Default()])]
            one[attribute.GetName()] = [len(times), *(flat(value) for value in values)]
        found[str(prim.GetPath())] = one
    return found


def flat(value):
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        return str(value)[:200]
    return array.ravel() if array.ndim else float(array)


def hdf(path):
    """Return all datasets and attributes of a file for ParaView."""
    import h5py

    found = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, each: found.update({name: each[()] if isinstance(each, h5py.Dataset) else dict(each.attrs)})
        )
    return {name: each if isinstance(each, dict) else np.asarray(each, float) for name, each in found.items()}


@pytest.mark.parametrize("name", STARTS)
def test_the_start_of_a_run_is_kept(name, tmp_path):
    scene = STARTS[name]()
    seen = Seen((None, *COLOURINGS.get(name, ())))
    known = scenes.modules().get(name)
    recorders = [TableRecorder(tmp_path / "run"), *([CheckRecorder(known.check)] if known else []), seen]
    tolerance = WORDS if name == "pipe" else LOOSE
    look = Logged(tmp_path / "run.rrd", network=name in NETWORK)
    look.logged = {}
    recorders += [look, UsdRecorder(tmp_path / "scene.usdc", velocities=False), ParaViewRecorder(tmp_path)]
    run = Simulation(scene, device="cpu", threads=1, recorders=recorders).run()
    kept.compare(
        f"recorded-{name}",
        {
            "rerun": look.logged,
            "views": look.views,
            "usd": usd(tmp_path / "scene.usdc"),
            "paraview": {path.name: hdf(path) for path in sorted(tmp_path.glob("*.vtkhdf"))},
        },
        tolerance,
    )
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    kept.compare(
        f"start-{name}",
        {
            "series": {key: column for key, column in run.series.items() if key not in COUNTS},
            "units": run.units,
            "tables": {key: table.columns for key, table in run.tables.items()},
            "result": {key: value for key, value in result.items() if key not in OTHERS},
            "checks": list(result.get("checks", {})),
            "files": sorted(path.name for path in (tmp_path / "run").iterdir()),
            "seen": seen.found,
            "head": (tmp_path / "run" / "series.csv").read_text(encoding="utf-8").splitlines()[0],
        },
        tolerance,
    )


@pytest.mark.parametrize("live", [False, "rerun+http://127.0.0.1:9876/proxy"])
def test_a_deleted_recording_is_told_as_any_other_trouble(live, tmp_path, monkeypatch):
    """Without a viewer, the error names the file; with one, the run only loses its viewer."""
    monkeypatch.setattr("warpcrete.record.rerun_stream.PATIENCE", 0.01)
    monkeypatch.setattr("warpcrete.record.rerun_stream._rerun", lambda: SimpleNamespace(GrpcSink=str))
    stream = RerunStream(tmp_path / "run.rrd", live)

    def fail(timeout_sec):
        raise RuntimeError("the writer has stopped")

    stream._recording = SimpleNamespace(flush=fail)
    warned, refused = pytest.warns(UserWarning, match="without it"), pytest.raises(RunFolderError, match=r"run\.rrd'")
    with warned if live else refused:
        stream.flush()
    assert stream.live is False


@pytest.mark.parametrize(
    "live, path, sinks",
    [
        (False, "run.rrd", ["file"]),
        ("rerun+http://127.0.0.1:9876/proxy", "run.rrd", ["file", "viewer"]),
        ("rerun+http://127.0.0.1:9876/proxy", None, ["viewer"]),
    ],
)
def test_a_recording_goes_into_its_file_and_to_the_viewer(live, path, sinks, tmp_path):
    stream = RerunStream(path and tmp_path / path, live)
    stream.rr = SimpleNamespace(FileSink=lambda where: "file", GrpcSink=lambda where: "viewer")
    assert stream._sinks() == sinks
