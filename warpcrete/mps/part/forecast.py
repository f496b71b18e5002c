"""Forecast of the run time of a flow through a part of a pump line.

The time until the flow is steady is predicted by a run of the same flow on a coarser grid. The wall time of a step is
measured in the first steps of the flow itself.
"""

import warp as wp

from ...core.run.forecast import Forecast, Probe
from ..common.forecast import Course, coarser_run, flow_forecast, law_features
from .scene import MIN_ACROSS, PartScene
from .simulation import PartSimulation


def forecast(scene: PartScene, device: wp.Device, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Return the forecast of the run time and memory of a run on a Warp `device`.

    The function `probe` measures the wall time of recording one frame.
    """
    return flow_forecast(
        lambda: PartSimulation(scene, device=str(device), precision=precision, threads=threads),
        _course,
        lambda simulation: {
            "dimensions": dimensions(scene),
            "walls": "mesh" if scene.wall is not None else "exact",
            "slip layer": f"{scene.concrete.slip_viscosity:g} Pa s/m, {scene.concrete.slip_yield:g} Pa",
            "yield stress": f"{scene.concrete.yield_stress:g} Pa, regularised",
            **law_features(scene.concrete),
        },
        probe,
    )


def dimensions(scene: PartScene) -> str:
    """Return a text with the number of dimensions, and with the reason if the whole part is simulated."""
    if scene.is_half:
        return "three, half of the part"
    if scene.symmetry == "whole":
        return "three"
    if not scene.axis.is_plane:
        return "three, because the axis does not lie in one plane"
    return f"three, because {scene.orientation.obstacle}"


def _course(simulation: PartSimulation) -> Course:
    """Return the expected duration and time step of a run until the flow is steady.

    A run of a coarser copy of the flow gives the duration.
    """
    scene = simulation.scene
    spacing = max(scene.spacing, 0.95 * 2 * scene.narrowest / MIN_ACROSS)
    _, reached, remarks = coarser_run(simulation, "the pressure is not steady", spacing=spacing)
    return Course(reached, scene.time_step, remarks)
