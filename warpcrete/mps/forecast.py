"""What a run of a flow will take: a coarser one tells when it is steady, the first steps of the flow what they cost.

Start-up is physics, not numerics, so that the coarser flow takes as long as the finer one.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import warp as wp

from ..core.errors import InstabilityError
from ..core.footprint import footprint
from ..core.forecast import Forecast, Probe, median_time
from .scene import FluidScene
from .simulation import FluidSimulation

ENOUGH = 2500
"""Particles of the coarser flow."""
SPENT = 1.0  # wall time for which steps are timed [s]
TAKEN = 5  # steps at once


def forecast(scene: FluidScene, device: Any, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Forecast of a run; `device` as Warp's, `probe` times a frame of recordings.

    Raises what the run would raise before its first step.
    """
    begun = time.perf_counter()
    simulation = FluidSimulation(scene, device=str(device), precision=precision, threads=threads)
    simulation.prepare()
    flow = simulation.flow
    placing = time.perf_counter() - begun
    duration, spent, remarks = _duration(scene, flow.count, str(device), precision, threads)
    step = _step_time(simulation)
    if spent is not None:  # the coarser flow was this one
        step = spent
    steps = max(1.0, duration / scene.time_step)
    sample = median_time(simulation.measure, flow.device)
    samples = math.ceil(duration / scene.sample_interval - 1e-9)
    found = Forecast(
        method="moving particles",
        device="",
        counts={"particles": flow.count, "wall particles": len(flow.points) - flow.count},
        features=_features(simulation),
        memory={name: float(size) for name, size in footprint(
            particles=flow.particles, neighbours=flow.lists, matrix=flow.matrix,
            solves=(flow.viscous, flow.projection, flow.shifting), rest=simulation).items() if size},
        time_step=scene.time_step,
        limits={"half a spacing of the piston's way": 0.5 * scene.spacing / scene.velocity},
        governing="as it is given: solves are implicit, so that viscosity and pressure set no limit",
        steps=steps,
        parts={"placing": placing, "steps": steps * step, "samples": samples * sample},
        frame=probe(simulation),
        duration=duration,
        remarks=(*scene.remarks, *remarks),
    )  # fmt: skip
    simulation.release()
    return found


def _duration(
    scene: FluidScene, count: int, device: str, precision: str, threads: int | None
) -> tuple[float, float | None, list[str]]:
    """Simulated time until the flow is steady [s], wall time of a step if the flow itself was run, and remarks."""
    if scene.duration is not None:
        return scene.duration, None, []
    factor = max(1.0, (count / ENOUGH) ** (1 / scene.dimensions))
    coarse = scene if factor == 1.0 else replace(
        scene, spacing=min(factor * scene.spacing, scene.radius / 2, scene.length / 8), aggregates=None
    )  # fmt: skip
    simulation = FluidSimulation(coarse, device=device, precision=precision, threads=threads)
    try:
        simulation.prepare()
        simulation.stepper.take(1)
        simulation.release()
        simulation = FluidSimulation(coarse, device=device, precision=precision, threads=threads)
        run = simulation.run()
    except InstabilityError as error:
        return FluidSimulation(scene, device=device).duration, None, [f"a coarser copy of this flow stops: {error}"]
    finally:
        simulation.release()
    reached = run.result["simulated_time"]["value"]
    remarks = [] if run.result["steady"] else [f"not steady within {reached:g} s"]
    step = run.result["speed"]["wall_time"]["value"] / max(run.result["steps"], 1) if factor == 1.0 else None
    return reached, step, remarks


def _step_time(simulation: FluidSimulation) -> float:
    """Wall time of a step [s]."""
    flow = simulation.flow
    for _ in range(2):  # loads kernels, then records the graph of so many steps
        flow.take(TAKEN)
    done = 0
    wp.synchronize_device(flow.device)
    begun = time.perf_counter()
    while time.perf_counter() - begun < SPENT:
        flow.take(TAKEN)
        done += TAKEN
        wp.synchronize_device(flow.device)
    return (time.perf_counter() - begun) / done


def _features(simulation: FluidSimulation) -> dict[str, str]:
    """What is computed and why, in words."""
    scene, flow = simulation.scene, simulation.flow
    concrete = scene.concrete
    return {
        "dimensions": f"{scene.dimensions}: {'channel' if scene.dimensions == 2 else 'tube'}",
        "phases": "one" if scene.aggregates is None else "two: rigid grains in mortar",
        "yield stress": f"{concrete.yield_stress:g} Pa, regularised" if concrete.yield_stress else "left out",
        "slip layer": f"{concrete.slip_viscosity:g} Pa s/m and {concrete.slip_yield:g} Pa",
        "scheme": "as the paper prints it" if scene.paper_scheme else "corrected",
        "precision": simulation.precision,
        "threads": "a thread a particle" if flow.parallel else f"{flow.threads}",
    }
