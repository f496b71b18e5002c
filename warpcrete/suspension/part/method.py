"""Interface through which the program finds, runs, draws and reports parts of pump lines with aggregates."""

from dataclasses import replace

import warp as wp

from ...core.run.forecast import Forecast, Probe
from ...mps.common.forecast import Course, flow_forecast, law_features
from ...mps.part.forecast import dimensions
from ...mps.part.method import METHOD as PARTS_OF_LINES
from ..quantities import in_words
from .display import PartSuspensionDisplay
from .pictures import plot_part_with_aggregates
from .quantities import QUANTITIES, report_part
from .scene import PartSuspensionScene
from .simulation import PartSuspensionSimulation


def forecast(
    scene: PartSuspensionScene, device: wp.Device, precision: str, threads: int | None, probe: Probe
) -> Forecast:
    """Return the forecast of a run on a Warp `device`; `probe` times one frame of the recordings."""
    return flow_forecast(
        lambda: PartSuspensionSimulation(scene, device=str(device), precision=precision, threads=threads),
        lambda simulation: Course(scene.duration, scene.time_step),
        lambda simulation: {
            "dimensions": dimensions(scene),
            "walls": "mesh" if scene.wall is not None else "exact",
            "aggregates": f"{in_words(simulation.flow.aggregates, scene)}; {int((simulation.entering > 0).sum())} of "
            "them enter during the run",
            "slip layer": f"{scene.concrete.slip_viscosity:g} Pa s/m, {scene.concrete.slip_yield:g} Pa",
            "yield stress": f"{scene.concrete.yield_stress:g} Pa, regularised",
            **law_features(scene.concrete),
        },
        probe,
    )


METHOD = replace(
    PARTS_OF_LINES,
    name="suspension",
    simulation=PartSuspensionSimulation,
    list_quantities=lambda: QUANTITIES,
    display=PartSuspensionDisplay,
    show=plot_part_with_aggregates,
    report=report_part,
    forecast=forecast,
)
