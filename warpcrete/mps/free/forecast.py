"""What a flow with a free surface will take: a coarser one tells how long it flows, the first steps what they cost."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ...core.errors import InstabilityError
from ...core.footprint import footprint
from ...core.forecast import Forecast, Probe, median_time, timed
from ..forecast import TAKEN, step_time
from .quantities import funnel_estimate
from .scene import FreeScene
from .simulation import FreeSimulation

LONGER = 1.2
"""Time in which a funnel empties over its estimate, which leaves out the stretch in the taper; measured 1.0 to 1.3."""
COARSE = 12
"""Cells over the concrete's height at the start, of the coarser flow."""


def forecast(scene: FreeScene, device: Any, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Forecast of a run; `device` as Warp's, `probe` times a frame of recordings."""

    def begun() -> FreeSimulation:
        simulation = FreeSimulation(scene, device=str(device), precision=precision)
        simulation.prepare()
        return simulation

    loading = begun()  # kernels are loaded now, and no part of a time any more
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
    """Simulated time until the concrete rests or a funnel is empty [s], the mean step until then [s], and remarks."""
    # Where nothing better is known: a cell's way at the speed of a fall by the concrete's height.
    swift = scene.spacing / math.sqrt(2 * scene.gravity * scene.extent[1, 1])
    mean = min(scene.time_step, swift) if scene.step_error else scene.time_step
    if scene.test == "funnel":
        estimate = funnel_estimate(scene)
        if estimate is None:
            return scene.duration, mean, ["the yield stress may hold the concrete in the funnel"]
        return min(LONGER * estimate, scene.duration), mean, []
    if scene.depth:
        # A coarser copy would not see what concrete has to pass.
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
        # The finer one errs as this one does, but passes its cells sooner.
        passed = np.diff(run.series["time"]) * run.series["fastest"][1:] / scene.spacing
        mean = reached / float(np.maximum(np.diff(run.series["steps"]), passed).sum())
    return reached, mean, [] if run.result["at_rest"] else [f"the concrete is not at rest within {reached:g} s"]
