"""Forecast of a free-surface flow: a coarser copy gives the time until it rests, the first steps give their cost."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ...core.device.footprint import footprint
from ...core.errors import InstabilityError
from ...core.run.forecast import Forecast, Probe, median_time, timed
from ..forecast import TAKEN, step_time
from .quantities import expected
from .scene import FreeScene
from .simulation import FreeSimulation

LONGER = 1.2
"""Ratio of a funnel's emptying time to its estimate, which ignores stretching in the taper; measured 1.0 to 1.3."""
COARSE = 12
"""Number of cells over the concrete's initial height in the coarser copy."""


def forecast(scene: FreeScene, device: Any, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Return the forecast of a run on a Warp `device`; `probe` times one frame of the recordings."""

    def begun() -> FreeSimulation:
        simulation = FreeSimulation(scene, device=str(device), precision=precision)
        simulation.prepare()
        return simulation

    loading = begun()  # loads the kernels, so that later timings exclude the loading
    loading.flow.take(TAKEN)
    loading.release()
    duration, mean, remarks = _course(scene, str(device), precision)
    simulation, placing = timed(begun, device)
    flow = simulation.flow
    step = step_time(simulation)
    sample = median_time(simulation.measure, flow.device)
    steps = max(1.0, duration / mean)
    found = Forecast(
        method="moving particles",
        device="",
        counts=flow.counts,
        features={
            "dimensions": scene.form,
            "surface": "free",
            "gate": f"lifted at {scene.lift_speed:g} m/s" if scene.gate else "left out",
            "sides of the room": "slip layer" if scene.plate_slips else "concrete sticks",
            "walls": "slip layer" if scene.walls_slip else "concrete sticks",
            "yield stress": f"{scene.concrete.yield_stress:g} Pa, regularised",
            "precision": simulation.precision,
        },
        memory={name: float(size) for name, size in footprint(**flow.holdings, rest=simulation).items() if size},
        time_step=mean,
        limits={},
        governing="step error and a cell's length per step; this is the mean step"
        if scene.step_error
        else "choice: solves are implicit, so that viscosity and pressure set no limit",
        steps=steps,
        parts={
            "placing": placing,
            "steps": steps * step,
            "samples": math.ceil(duration / scene.sample_interval) * sample,
        },
        frame=probe(simulation),
        duration=duration,
        remarks=(*scene.remarks, *remarks),
    )
    simulation.release()
    return found


def _course(scene: FreeScene, device: str, precision: str) -> tuple[float, float, list[str]]:
    """Return the simulated time until rest or until a funnel is empty [s], the mean time step [s], and remarks."""
    # The default estimate of the step is the time in which concrete crosses one cell after a fall by its own height.
    swift = scene.spacing / math.sqrt(2 * scene.gravity * scene.extent[1, 1])
    mean = min(scene.time_step, swift) if scene.step_error else scene.time_step
    if scene.test and scene.test.outflow:
        estimate = expected(scene).get(scene.test.outflow.time)
        if estimate is None:
            return scene.duration, mean, ["the yield stress may hold the concrete in the funnel"]
        return min(LONGER * estimate, scene.duration), mean, []
    if scene.depth:
        # A coarser copy would not resolve the obstacles that the concrete must pass.
        return (
            scene.duration,
            mean,
            ["the time until the concrete rests is not predicted; the longest allowed time is assumed"],
        )
    height = scene.extent[1, 1]
    spacing = min(max(scene.spacing, height / COARSE), min(np.ptp(scene.extent, axis=0)) / 4)
    simulation = FreeSimulation(replace(scene, spacing=spacing), device=device, precision=precision)
    try:
        run = simulation.run()
    except InstabilityError as error:
        return (
            scene.duration,
            mean,
            [f"the simulated time is uncertain, because a coarser copy of this flow stopped: {error}"],
        )
    finally:
        simulation.release()
    reached = float(run.result["simulated_time"]["value"])
    if scene.step_error:
        # The finer flow has the same error in a step, but its concrete crosses the smaller cells in less time.
        passed = np.diff(run.series["time"]) * run.series["fastest"][1:] / scene.spacing
        mean = reached / float(np.maximum(np.diff(run.series["steps"]), passed).sum())
    return reached, mean, [] if run.result["at_rest"] else [f"the concrete is not at rest within {reached:g} s"]
