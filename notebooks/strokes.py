"""Two strokes with a stop, and a restart after ten minutes of rest, by both methods.

The page how-to/strokes.md shows them.

`python notebooks/strokes.py` takes some four minutes on a core and writes notebooks/images/strokes.png.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpcrete import Simulation, scenes
from warpcrete.core.drawing.style import SERIES, THEORY, legend_above, new_figure, rgb
from warpcrete.theory.pipe import CONCRETES, Line, restart, steady

UNIT = dict(
    unit="horizontal", concrete="no2", shapes="reference", diameter=0.1, length=0.3, ramp=0.02, strokes=2, stroke=0.12,
    pause=0.4, settle=0.5,
)  # fmt: skip
RESTS = {
    "no rest": {},
    "600 s, worn off over 0.1 m": dict(rest=600.0, breakdown=0.1),
    "600 s, never worn off": dict(rest=600.0, breakdown=100.0),
}
TUBE = dict(concrete="no2", ends="periodic", gravity=0.0, spacing=5e-3, flow=0.3 * np.pi * 0.05**2)
PLUG = 1e3
"""Pressure on the plug, that flows have none of [Pa]."""


def main() -> None:
    """Run and draw."""
    figure = new_figure("horizontal pipe, diameter 100 mm, concrete no2, 8.48 m3/h", 3.7, 2.8)
    above, below = figure.subplots(2, 1, height_ratios=[3.7, 2.8])
    pipe, concrete, flow = Line(length=0.3, rise=0.0), CONCRETES["no2"], TUBE["flow"]
    for name, given in RESTS.items():
        simulation = Simulation(scenes.pipe(**UNIT | given), device="cpu", threads=1)
        run = simulation.run()
        above.plot(run.series["time"], run.series["pressure"] / 1e3, label=name, color=_colour(name))
        found = ("first_peak_pressure", "held_pressure", "restart_pressure", "plateau_pressure", "restart_over_end")
        print(f"elements, {name}:", {each: round(run[each], 3) for each in found if each in run.result})
    stops = simulation.scene.pipe.stops
    above.axvspan(stops.stroke_time, stops.period, color="0.93", zorder=0)
    above.text((stops.stroke_time + stops.period) / 2, 0.3, "stop", color="0.4", ha="center")
    for name, given in list(RESTS.items())[1:]:
        run = Simulation(scenes.tube(**TUBE | given, duration=1.0), device="cpu").run()
        below.plot(run.series["time"][1:], run.series["pressure"][1:] / 1e3, label=name, color=_colour(name))
        print(f"tube, {name}:", {each: round(run[each], 3) for each in ("restart_pressure", "restart_over_steady")})
    fresh, grown = steady(concrete, pipe, flow).pressure, restart(concrete, pipe, 600.0, 0.5, flow).pressure
    print("theory:", round(fresh, 1), round(grown, 1))
    for axes, more in ((above, PLUG), (below, 0.0)):
        for value, line, words in ((grown, "--", "theory after 600 s"), (fresh, ":", "theory without a rest")):
            axes.axhline((value + more) / 1e3, color=rgb(THEORY), linestyle=line, label=words)
        axes.set(xlabel="time, the rest left out [s]", ylim=(0, None), xlim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
    above.set(ylabel="pressure [kPa]", title="elements: two strokes and a stop")
    below.set(ylabel="pressure [kPa]", title="flow: the restart")
    legend_above(above)
    figure.savefig(Path(__file__).parent / "images" / "strokes.png", dpi=150)


def _colour(name: str) -> Any:
    return rgb(SERIES[list(RESTS).index(name)])


if __name__ == "__main__":
    main()
