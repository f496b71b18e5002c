"""Forecast of the run time of a pipe flow.

A coarser copy of the flow is run to predict the simulated time until the flow is steady.
"""

from typing import Any

import warp as wp

from ..core.run.forecast import Forecast, Probe
from .common.forecast import Course, coarser_run, flow_forecast, law_features
from .scene import FluidScene
from .simulation import FluidSimulation

COARSE_PARTICLES = 2500
"""Number of particles of the coarser copy that predicts the simulated time of a run."""


def forecast(scene: FluidScene, device: wp.Device, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Return the forecast of the run time and memory of a run on a Warp `device`.

    The function `probe` measures the wall time of recording one frame. Raises the same errors as a run that fails
    before its first step.
    """
    return flow_forecast(
        lambda: FluidSimulation(scene, device=str(device), precision=precision, threads=threads),
        _course,
        _features,
        probe,
        limits={"half a spacing of piston travel": 0.5 * scene.spacing / scene.velocity},
    )


def _course(simulation: FluidSimulation) -> Course:
    """Return the expected duration and mean time step of a run that ends when the flow is steady."""
    scene = simulation.scene
    if scene.duration is not None:
        return Course(scene.duration, scene.time_step)
    factor = (simulation.flow.count / COARSE_PARTICLES) ** (1 / scene.dimensions)
    spacing = min(factor * scene.spacing, scene.radius / 2, scene.length / 8)
    changes = dict(spacing=spacing, aggregates=None) if factor > 1 else {}
    _, reached, remarks = coarser_run(simulation, "the flow is not steady", **changes)
    return Course(reached, scene.time_step, remarks)


def _features(simulation: FluidSimulation) -> dict[str, str]:
    """Return short texts about the model and the solvers of the flow, keyed by the feature that each text describes."""
    scene, flow = simulation.scene, simulation.flow
    concrete = scene.concrete
    return {
        "dimensions": f"{scene.dimensions}: {'channel' if scene.dimensions == 2 else 'tube'}",
        "phases": "one" if scene.aggregates is None else "two: rigid grains in mortar",
        "yield stress": f"{concrete.yield_stress:g} Pa, regularised" if concrete.yield_stress else "left out",
        "slip layer": f"{concrete.slip_viscosity:g} Pa s/m and {concrete.slip_yield:g} Pa",
        **law_features(concrete),
        "scheme": _scheme_text(scene),
        "solves": _solver_text(flow),
    }


def _solver_text(flow: Any) -> str:
    coarse = getattr(flow, "coarse", None)
    return (
        "preconditioned by the diagonal"
        if coarse is None
        else f"preconditioned with a coarse grid of {coarse.count} cubes"
    )


def _scheme_text(scene: FluidScene) -> str:
    if scene.ends == "periodic":
        return "solved on a grid" + (" about the axis" if scene.dimensions == 3 else "")
    return "particles alone"
