"""The first steps of short runs with all that is measured, drawn and written of them, kept (see `kept`).

Only the first moments are kept, in which rounding has not grown. Other tests make the same kernels.
"""

import json

import kept
import numpy as np
import pytest
from pumping import TINY

from warpcrete import Simulation, scenes
from warpcrete.core.run.run_loop import Recorder
from warpcrete.record.checks import CheckRecorder
from warpcrete.record.run_folder import TableRecorder

PIPE = TINY | dict(shapes="reference", travel=0.002, ramp=0.001)
FREE = dict(concrete="own", density=2300.0, viscosity=30.0, yield_stress=500.0, spacing=0.0125)
STARTS = {
    "pipe": lambda: scenes.pipe(**PIPE | {"settle": 0.0}),
    "channel": lambda: scenes.channel(spacing=0.02, duration=0.012, sample_interval=4e-3),
    "tube": lambda: scenes.tube(spacing=0.02, duration=0.012, sample_interval=4e-3, ends="piston"),
    "slump": lambda: scenes.slump(**FREE, duration=0.06, sample_interval=0.02, lift_time=0.2),
    "part": lambda: scenes.part(concrete="no1", unit="bend-to-vertical", straight=0.2, spacing=0.0125, duration=0.03),
}
COLOURINGS = {"pipe": ("force", "speed", "size"), "slump": ("shear", "speed"), "part": ("shear", "pressure")}
LOOSE = 1e-3
"""Single precision, over some hundred steps."""
OTHERS = ("speed", "provenance", "state_hash", "checks", "memory")


class Seen(Recorder):
    """All that displays have at the last frame."""

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


@pytest.mark.parametrize("name", STARTS)
def test_the_start_of_a_run_is_kept(name, tmp_path):
    scene = STARTS[name]()
    seen = Seen((None, *COLOURINGS.get(name, ())))
    recorders = [TableRecorder(tmp_path / "run"), CheckRecorder(scenes.modules()[name].check), seen]
    run = Simulation(scene, device="cpu", threads=1, recorders=recorders).run()
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    kept.compare(f"start-{name}", {
        "series": run.series, "units": run.units, "tables": {key: table.columns for key, table in run.tables.items()},
        "result": {key: value for key, value in result.items() if key not in OTHERS}, "checks": list(result["checks"]),
        "files": sorted(path.name for path in (tmp_path / "run").iterdir()), "seen": seen.found,
        "head": (tmp_path / "run" / "series.csv").read_text(encoding="utf-8").splitlines()[0]}, LOOSE)  # fmt: skip
