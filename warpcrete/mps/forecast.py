"""Forecast of a pipe flow: a coarser copy gives the time until it is steady, the first steps give their cost.

Start-up is physics rather than numerics, so the coarser flow takes as much simulated time as the finer one.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.device.footprint import footprint
from ..core.errors import InstabilityError
from ..core.run.forecast import Forecast, Probe, median_time, timed
from .scene import FluidScene
from .simulation import FluidSimulation

ENOUGH = 2500
"""Number of particles of the coarser copy."""
SPENT = 1.0  # wall time for which steps are timed [s]
TAKEN = 10  # number of steps that are timed together


def forecast(scene: FluidScene, device: Any, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Return the forecast of a run on a Warp `device`; `probe` times one frame of the recordings.

    Raises the errors that the run would raise before its first step.
    """

    def begun() -> FluidSimulation:
        simulation = FluidSimulation(scene, device=str(device), precision=precision, threads=threads)
        simulation.prepare()
        return simulation

    between = max(1, round(scene.sample_interval / scene.time_step))  # steps between two samples
    loading = begun()  # loads the kernels, so that later timings exclude the loading
    loading.flow.take(min(between, TAKEN))
    loading.release()
    simulation, placing = timed(begun, device)
    flow = simulation.flow
    _, first = timed(lambda: flow.take(min(between, TAKEN)), device)
    duration, remarks = _duration(scene, flow.count, str(device), precision, threads)
    step = step_time(simulation)
    steps = max(1.0, duration / scene.time_step)
    sample = median_time(simulation.measure, flow.device)
    samples = math.ceil(duration / scene.sample_interval - 1e-9)
    found = Forecast(
        method="moving particles",
        device="",
        counts=flow.counts,
        features=_features(simulation),
        memory={name: float(size) for name, size in footprint(
            **flow.holdings, rest=simulation).items() if size},
        time_step=scene.time_step,
        limits={"half a spacing of piston travel": 0.5 * scene.spacing / scene.velocity},
        governing="choice: solves are implicit, so that viscosity and pressure set no limit",
        steps=steps,
        parts={"placing": placing, "graphs": max(first - min(between, TAKEN) * step, 0.0), "steps": steps * step,
               "samples": samples * sample},
        frame=probe(simulation),
        duration=duration,
        remarks=(*scene.remarks, *remarks),
    )  # fmt: skip
    simulation.release()
    return found


def _duration(
    scene: FluidScene, count: int, device: str, precision: str, threads: int | None
) -> tuple[float, list[str]]:
    """Return the simulated time until the flow is steady [s], and remarks."""
    if scene.duration is not None:
        return scene.duration, []
    factor = max(1.0, (count / ENOUGH) ** (1 / scene.dimensions))
    coarse = scene if factor == 1.0 else replace(
        scene, spacing=min(factor * scene.spacing, scene.radius / 2, scene.length / 8), aggregates=None
    )  # fmt: skip
    simulation = FluidSimulation(coarse, device=device, precision=precision, threads=threads)
    try:
        run = simulation.run()
    except InstabilityError as error:
        return simulation.duration, [
            f"the simulated time is uncertain, because a coarser copy of this flow stopped: {error}"
        ]
    finally:
        simulation.release()
    reached = run.result["simulated_time"]["value"]
    return reached, [] if run.result["steady"] else [f"the flow is not steady within {reached:g} s"]


def step_time(simulation: Any) -> float:
    """Return the wall time of a step [s]."""
    flow = simulation.flow
    flow.take(TAKEN)  # captures the graph before steps are timed
    times: list[float] = []
    while sum(times) < SPENT:
        times.append(timed(lambda: flow.take(TAKEN), flow.device)[1])
    # Other programs only slow steps down, and do so rarely in a long run, so the forecast uses the lower quartile.
    return float(np.quantile(times, 0.25)) / TAKEN


def _features(simulation: FluidSimulation) -> dict[str, str]:
    """Return short descriptions of what is computed, by feature."""
    scene, flow = simulation.scene, simulation.flow
    concrete = scene.concrete
    return {
        "dimensions": f"{scene.dimensions}: {'channel' if scene.dimensions == 2 else 'tube'}",
        "phases": "one" if scene.aggregates is None else "two: rigid grains in mortar",
        "yield stress": f"{concrete.yield_stress:g} Pa, regularised" if concrete.yield_stress else "left out",
        "slip layer": f"{concrete.slip_viscosity:g} Pa s/m and {concrete.slip_yield:g} Pa",
        "scheme": _scheme(scene),
        "solves": _solves(flow),
        "precision": simulation.precision,
        "threads": "one thread per particle" if flow.parallel else f"{flow.threads}",
    }


def _solves(flow: Any) -> str:
    coarse = getattr(flow, "coarse", None)
    return (
        "preconditioned by the diagonal"
        if coarse is None
        else f"preconditioned with a coarse grid of {coarse.count} cubes"
    )


def _scheme(scene: FluidScene) -> str:
    if scene.ends == "periodic":
        return "solved on a grid" + (" about the axis" if scene.dimensions == 3 else "")
    return "as printed in the paper" if scene.paper_scheme else "corrected"
