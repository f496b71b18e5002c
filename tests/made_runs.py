"""Made-up runs of every scene: sound series from which the method's own quantities follow, without a simulation."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from warpcrete import scenes
from warpcrete.core.run.method import results_of
from warpcrete.core.units import quantity
from warpcrete.dem.measure.quantities import Known as KnownElements
from warpcrete.dem.measure.vessel_measures import at_rest
from warpcrete.dem.scene.scene import Scene
from warpcrete.dem.simulation import ElementRun
from warpcrete.methods import method_of
from warpcrete.mps.column import plug_restart_state
from warpcrete.mps.free.quantities import RunData as KnownFree
from warpcrete.mps.free.scene import FreeScene
from warpcrete.mps.part.quantities import RunData as KnownPart
from warpcrete.mps.part.scene import PartScene
from warpcrete.mps.quantities import RunData as KnownColumn
from warpcrete.mps.scene import FluidScene
from warpcrete.suspension.stretch.quantities import RunData as KnownStretch
from warpcrete.suspension.stretch.scene import StretchScene

ROWS = 21
MIDDLE = ROWS // 2


@dataclass
class Made:
    """A made-up run: what a simulation would have measured."""

    scene: Any
    series: dict[str, np.ndarray]
    steady: bool = True
    """Flows: steady, or at rest."""
    finished: bool = True
    steps: int = 10**9
    blocked: dict[str, float] | None = field(default_factory=dict)
    bodies: Any = None
    measured: dict[str, float] = field(default_factory=dict)
    """Results that a simulation would have measured beside the series."""

    def run(self) -> ElementRun:
        """Return the run, with the quantities of its method worked out from the series."""
        scene, series = self.scene, self.series
        result: dict[str, Any] = {"simulated_time": quantity(series["time"][-1], "s"), "steps": self.steps}
        known: Any = None
        if isinstance(scene, Scene):
            contacts = SimpleNamespace(coordination_number=6.0)
            watch = None if self.blocked is None else SimpleNamespace(found=self.blocked, window=0.1, slowest=1.0)
            known = KnownElements(scene, scene.walls, series, 1.0, contacts, blockage=watch)  # type: ignore
            result["bodies"] = len(self.bodies.group)
            if scene.vessel is not None:
                rows = [{name: column[k] for name, column in series.items()} for k in range(len(series["time"]))]
                result["at_rest"] = at_rest(scene.vessel, rows)
        else:
            result |= {"steady": self.steady, "at_rest": self.steady}
            if len(series["time"]) > 1:
                makers = {FluidScene: lambda: KnownColumn(scene, series, scene.theory()),
                          FreeScene: lambda: KnownFree(scene, series, 1e-3),
                          PartScene: lambda: KnownPart(scene, series),
                          StretchScene: lambda: KnownStretch(scene, series, scene.aggregate_fraction)}  # fmt: skip
                known = makers[type(scene)]()
        if known is not None:
            closed = (
                ("_theory", "_heap") if isinstance(scene, FreeScene) else ()
            )  # these take long, and no check has them
            wanted = [each for each in method_of(scene).quantities if not each.name.endswith(closed)]
            result |= results_of(wanted, known)
        result |= self.measured
        return ElementRun(scene, series, {}, result, self.finished, bodies=self.bodies)


# Sound runs.


def column(**parameters) -> Made:
    """Return the flow of `channel` or `tube` exactly by theory, from the second row on."""
    scene = getattr(scenes, parameters["name"])(**{k: v for k, v in parameters.items() if k != "name"})
    theory, one = scene.theory(), np.ones(ROWS)
    series = {name: value * one for name, value in (
        ("pressure", theory.pressure), ("slip_velocity", theory.slip_velocity), ("wall_stress", theory.wall_stress),
        ("profile_deviation", 0.0), ("volume_error", 0.0), ("force_balance_error", 0.0))}  # fmt: skip
    if scene.gained:
        series["pressure"][1] = 0.5 * (theory.pressure + plug_restart_state(scene).pressure)
    return Made(scene, {"time": np.linspace(0, 0.1, ROWS)} | series)


def free(scene: FreeScene) -> Made:
    """Return a standard test of a flow that comes to rest, or lets light through."""
    falling = np.linspace(1, 0.2, ROWS)
    columns = {
        "slump": {"top": 0.3 * falling, "spread": 0.5 / falling},
        "jring": {"top": 0.3 * falling, "spread": 0.5 / falling, "outside": 0.02 / falling},
        "funnel": {"screen": falling, "inside": falling},
        "lbox": {
            "near_depth": 0.6 * falling,
            "far_depth": 0.1 / falling,
            "front": 0.7 - 0.7 * falling,
            "speed_of_most": 0 * falling,
        },
        "lcpc": {"near_depth": 0.15 * falling, "front": 0.2 / falling},
    }[scene.name]
    zero = np.zeros(ROWS)
    return Made(scene, {"time": np.linspace(0, 5, ROWS), "fastest": zero, "volume_error": zero.copy()} | columns)


def part(**parameters) -> Made:
    """Return a flow through a part whose straight stretches lose what theory says."""
    scene: Any = scenes.modules()["part"].scene(**parameters)
    one = np.ones(ROWS)
    series = {
        "time": np.linspace(0, 1, ROWS),
        "pressure": 1e4 * one,
        "upstream_gradient": scene.theory(0.0).pressure * one,
        "middle_loss": 1e3 * one,
        "downstream_gradient": scene.theory(scene.axis.length).pressure * one,
        "outflow_error": 0 * one,
    }
    return Made(scene, series)


def stretch(**parameters) -> Made:
    """Return a steady flow of mortar with aggregates whose friction at the wall balances the driving force."""
    scene: Any = scenes.modules()["stretch"].scene(**parameters)
    one = np.ones(ROWS)
    columns = {"flow": scene.mortar_alone.flow, "wall_stress": scene.wall_stress, "aggregate_velocity": 0.1,
               "aggregate_radius": 0.6, "smallest_gap": 0.01}  # fmt: skip
    return Made(scene, {"time": np.linspace(0, 1, ROWS)} | {name: value * one for name, value in columns.items()})


def elements(scene: Scene, columns: dict[str, np.ndarray], groups: list[str]) -> Made:
    """Return a run of discrete elements in balance: one wall bears the weight of all, for ten seconds."""
    zero = np.zeros(ROWS)
    series = {"time": np.linspace(0, 10, ROWS), "largest_overlap": 0.1 + zero}
    for axis, letter in enumerate("xyz"):
        series |= {f"drive_{letter}": zero, f"momentum_{letter}": zero.copy()}
        series |= {f"{wall.name}_impulse_{letter}": zero for wall in scene.walls}
        series[f"{scene.walls[0].name}_impulse_{letter}"] = scene.gravity[axis] * series["time"]
    bodies = SimpleNamespace(group=np.array(groups, object), position=np.zeros((len(groups), 3)),
                             size=np.full(len(groups), 0.01))  # fmt: skip
    return Made(scene, series | columns, bodies=bodies)


def pumped(name: str, **parameters) -> Made:
    """Return concrete on the axis of its pipe, behind a plug, that a piston pushes at an even pressure."""
    scene: Any = scenes.modules()[name].scene(**parameters)
    columns = {"travel": np.linspace(0, scene.pipe.travel, ROWS), "pressure": np.full(ROWS, 3e3)}
    made = elements(scene, columns, [""] * 200 + ["plug"] * 20)
    made.bodies.position, _ = scene.pipe.axis.at(np.linspace(0.01, 0.2, 220))
    return made


def vessel(name: str, **parameters) -> Made:
    """Return a standard test by discrete elements in which one heap comes to rest, or light is seen."""
    scene: Any = scenes.modules()[name].scene(**parameters)
    falling = np.linspace(1, 0.2, ROWS)
    columns = {name: falling for name in ("top", "spread", "outside", "screen", "inside", "near_depth", "far_depth")}
    return elements(scene, columns | {"front": 1 - falling, "main_body": 1 + 0 * falling, "fastest": 0 * falling,
                                      "mean_speed": 0 * falling}, [""] * 300)  # fmt: skip


RESTED: dict[str, Any] = dict(rest=600.0, ends="periodic")
COLUMN = {"channel": dict(name="channel"), "tube": dict(name="tube"),
          "channel, some time": dict(name="channel", duration=0.1), "tube, some time": dict(name="tube", duration=0.1),
          "channel, two phases": dict(name="channel", aggregates=True),
          "tube, two phases": dict(name="tube", aggregates=True),
          "channel, rested": dict(name="channel", **RESTED, thixotropy=0.1),
          "tube, rested": dict(name="tube", **RESTED, thixotropy=0.1),
          "channel, rested plug": dict(name="channel", **RESTED, thixotropy=1.0),
          "tube, rested plug": dict(name="tube", **RESTED, thixotropy=1.0),
          "channel, tolerant": dict(name="channel", tolerated_error=0.2),
          "tube, tolerant": dict(name="tube", tolerated_error=0.2)}  # fmt: skip
RUNS: dict[str, Callable[[], Made]] = {
    **{name: lambda given=given: column(**given) for name, given in COLUMN.items()},
    **{name: lambda name=name: free(getattr(scenes, name)()) for name in ("slump", "jring", "funnel", "lbox", "lcpc")},
    "part": part,
    "stretch": stretch,
    "part, level": lambda: part(unit="bend-level"),
    **{
        name: lambda name=name: vessel(name)
        for name in ("slump-dem", "funnel-dem", "lbox-dem", "jring-dem", "lcpc-dem")
    },
    "pipe": lambda: pumped("pipe"),
    "pipe, stops": lambda: pumped("pipe", stop_when_blocked=True),
    "pipe, plate": lambda: pumped("pipe", plug="plate"),
    "part-dem": lambda: replace(pumped("part-dem"), measured={"flux_ratio": 1.0}),
}
"""Functions that make the sound runs, by the name of the scene and, after a comma, the name of the variant."""


def scene_name(run: str) -> str:
    return run.split(",")[0]


def verdicts(made: Made) -> dict[str, bool]:
    """Return whether each entry of the scene's check passes."""
    check = scenes.modules()[made.scene.name].check
    return {name: bool(passed) for name, (passed, _) in check(made.run()).items()}
