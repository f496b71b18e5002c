"""Interface through which the program finds, runs, draws and reports stretches of an endless pipe."""

import warp as wp

from ...core.run.forecast import Forecast, Probe
from ...core.run.method import Method
from ...mps.common.forecast import Course, flow_forecast, law_features
from ...mps.common.stepping import run_abreast
from ..quantities import in_words
from .display import StretchDisplay
from .pictures import plot_stretch
from .quantities import QUANTITIES, report
from .scene import StretchScene
from .simulation import StretchSimulation


def forecast(scene: StretchScene, device: wp.Device, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Return the forecast of a run on a Warp `device`; `probe` times one frame of the recordings."""
    return flow_forecast(
        lambda: StretchSimulation(scene, device=str(device), precision=precision, threads=threads),
        lambda simulation: Course(scene.duration, scene.time_step, _too_short(scene)),
        lambda simulation: {
            "dimensions": "three, connected ends",
            "wall": "slip layer" if scene.slips else "mortar sticks",
            "aggregates": in_words(simulation.flow.aggregates, scene),
            "yield stress": f"{scene.concrete.yield_stress:g} Pa, regularised",
            **law_features(scene.concrete),
        },
        probe,
        governing="choice: number of cells by which mortar on the axis moves in a step ('courant')",
    )


def _too_short(scene: StretchScene) -> list[str]:
    """Return a remark if a run at a constant pressure gradient is probably too short to become steady."""
    # The flow must be steady over the last quarter of the run.
    needed = scene.starting_time / 0.75
    if scene.mean_velocity is not None or scene.duration >= needed:
        return []
    return [
        f"the flow becomes steady after about {needed:.2g} s of simulated time, but 'duration' is {scene.duration:g} s"
    ]


METHOD = Method(
    name="suspension",
    simulation=StretchSimulation,
    list_quantities=lambda: QUANTITIES,
    display=StretchDisplay,
    picture="flow.png",
    show=plot_stretch,
    report=report,
    forecast=forecast,
    run_many=run_abreast,
)
