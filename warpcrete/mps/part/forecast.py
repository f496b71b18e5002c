"""Forecast of a flow through a part: a coarser copy gives the time until it is steady, the first steps their cost."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from ...core.device.footprint import footprint
from ...core.errors import InstabilityError, SceneError
from ...core.run.forecast import Forecast, Probe, median_time, timed
from ..forecast import TAKEN, step_time
from .scene import FEWEST, PartScene
from .simulation import PartSimulation


def forecast(scene: PartScene, device: Any, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Return the forecast of a run on a Warp `device`; `probe` times one frame of the recordings."""

    def begun() -> PartSimulation:
        simulation = PartSimulation(scene, device=str(device), precision=precision)
        simulation.prepare()
        return simulation

    loading = begun()  # loads the kernels, so that later timings exclude the loading
    loading.flow.take(TAKEN)
    loading.release()
    duration, remarks = _duration(scene, str(device), precision)
    simulation, placing = timed(begun, device)
    simulation.flow.take(TAKEN)
    step = step_time(simulation)
    sample = median_time(simulation.measure, simulation.flow.device)
    steps = max(1.0, duration / scene.time_step)
    found = Forecast(
        method="moving particles",
        device="",
        counts=simulation.flow.counts,
        features={
            "dimensions": "half of the part, in space" if scene.is_half else "in space",
            "walls": "mesh" if scene.wall is not None else "exact",
            "slip layer": f"{scene.concrete.slip_viscosity:g} Pa s/m, {scene.concrete.slip_yield:g} Pa",
            "yield stress": f"{scene.concrete.yield_stress:g} Pa, regularised",
            "precision": simulation.precision,
        },
        memory={name: float(size) for name, size in footprint(**simulation.flow.holdings, rest=simulation).items()
                if size},
        time_step=scene.time_step,
        limits={},
        governing="choice: solves are implicit, so that viscosity and pressure set no limit",
        steps=steps,
        parts={
            "placing": placing,
            "steps": steps * step,
            "samples": math.ceil(duration / scene.sample_interval) * sample,
        },
        frame=probe(simulation),
        duration=duration,
        remarks=(*scene.remarks, *remarks),
    )  # fmt: skip
    simulation.release()
    return found


def _duration(scene: PartScene, device: str, precision: str) -> tuple[float, list[str]]:
    """Return the simulated time until the flow is steady [s], by a coarser copy, and remarks."""
    narrow = 2 * scene.narrowest
    simulation = None
    try:
        coarser = replace(scene, spacing=max(scene.spacing, 0.95 * narrow / FEWEST))
        simulation = PartSimulation(coarser, device=device, precision=precision)
        run = simulation.run()
    except (InstabilityError, SceneError) as error:
        return scene.duration, [
            f"the simulated time is uncertain, because a coarser copy of this flow stopped: {error}"
        ]
    finally:
        if simulation is not None:
            simulation.release()
    reached = float(run.result["simulated_time"]["value"])
    return reached, [] if run.result["steady"] else [f"the pressure is not steady within {reached:g} s"]
