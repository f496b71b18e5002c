"""Forecast of the run time of a free-surface flow.

A coarser copy of the flow is run to predict the simulated time until the concrete rests. The wall time of a step is
measured in the first steps of the flow itself.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from ...core.run.forecast import Forecast, Probe, median_time
from ...core.run.run import Run
from ...core.units import number
from ..common.forecast import Course, coarser_run, flow_forecast, law_features, step_time
from .quantities import expected
from .scene import FreeScene
from .simulation import FreeSimulation

DURATION_FACTOR = 1.2
"""Assumed time in which a simulated funnel empties, divided by the closed-form estimate of this time. The closed form
neglects the stretching of concrete in the taper.

Simulations gave ratios from 1.0 to 1.3.
"""
COARSE_CELLS_HIGH = 12
"""Number of cells over the concrete's initial height in the coarser copy of a flow, which predicts its duration."""
MAX_SPEEDUP = 3.0
"""Maximum factor by which a forecast assumes that steps get faster as a funnel empties. The factor is the mean wall
time of the first steps, divided by the mean wall time of all steps."""
CELLS_ACROSS = 4
"""Minimum number of cells that the coarser copy has along each side of the concrete and along each dimension of the
vessel. The diameter of bars does not count as such a dimension."""


def forecast(
    scene: FreeScene, device: wp.Device, precision: str, threads: int | None, probe: Probe, make: Any = FreeSimulation,
    features_of: Callable[[Any], Mapping[str, str]] = lambda simulation: {},
) -> Forecast:  # fmt: skip
    """Return the forecast of the run time and memory of a run on a Warp `device`.

    The function `probe` measures the wall time of recording one frame. `make` is the class whose instance simulates
    the scene. `features_of` takes this instance, and returns further texts that describe what the flow computes.
    """
    step = "step error and a cell's length per step; this is the mean step"
    return flow_forecast(
        lambda: make(scene, device=str(device), precision=precision, threads=threads),
        course_of,
        lambda simulation: {
            "dimensions": scene.form,
            "surface": "free",
            "gate": f"lifted at {scene.lift_speed:g} m/s" if scene.gate else "left out",
            "sides of the box": "slip layer" if scene.plate_slips else "concrete sticks",
            "walls": "slip layer" if scene.walls_slip else "concrete sticks",
            "yield stress": f"{scene.concrete.yield_stress:g} Pa, regularised",
            **features_of(simulation),
            **law_features(scene.concrete),
        },
        probe,
        **({"governing": step} if scene.step_error else {}),
    )


def course_of(simulation: FreeSimulation) -> Course:
    """Predict duration, mean time step and slowdown of later steps of a flow, from a run of a coarser copy.

    The run ends when the concrete is at rest or a funnel is empty. If the scene has aggregates, the copy contains the
    mortar without them, because coarser cells would not resolve the aggregates.
    """
    scene = simulation.scene
    outflow = scene.test.outflow if scene.test else None
    estimate = expected(scene).get(outflow.time) if outflow else None
    if outflow and estimate is None:
        note = "theory gives no time in which the vessel empties; the yield stress may hold the concrete back"
        return Course(scene.duration, scene.time_step, [note])
    # The bars of a vessel do not limit the cells of the coarser copy. If they did, these cells would be as small as the
    # cells of the scene itself.
    across = *np.ptp(scene.extent, axis=0), *(x for name, x in scene.dimensions.items() if name != "bar_diameter")
    spacing = min(max(scene.spacing, scene.extent[1, 1] / COARSE_CELLS_HIGH), min(across) / CELLS_ACROSS)
    coarse = {"spacing": float(max(spacing, scene.spacing))}
    notes = []
    if scene.fluid is not scene:
        simulation = FreeSimulation(
            scene.fluid, device=str(simulation.device), precision=simulation.precision, threads=simulation.threads
        )
        notes = ["the forecast of time and steps is for the mortar alone; a run with aggregates takes longer"]
    run, reached, remarks = coarser_run(simulation, "the concrete is not at rest", **coarse)
    if outflow and run is not None and outflow.time in run.result:
        remarks = []
    remarks = [*notes, *remarks]
    if run is None:
        return Course(reached, scene.time_step, remarks)
    duration = min(DURATION_FACTOR * estimate, scene.duration) if estimate else reached
    # The flow of the scene and its coarser copy adapt their steps to the same error. In addition, a step must not be
    # longer than the time in which the fastest concrete crosses a cell (Courant number). This time is shorter in the
    # scene's smaller cells.
    steps = np.diff(run.series["steps"])
    if scene.step_error:
        steps = np.maximum(steps, np.diff(run.series["time"]) * run.series["fastest"][1:] / scene.spacing)
    mean_step = float(run.series["time"][-1]) / float(steps.sum())
    return Course(duration, mean_step, remarks, _slowdown(simulation, run, coarse))


def _slowdown(simulation: FreeSimulation, run: Run, changes: dict[str, float]) -> float:
    """Return the factor by which an average time step takes longer to compute than one of the first time steps.

    The forecast measures the wall time of only the first steps of the flow itself. Each of these steps simulates less
    time than a later step, so its solves need fewer iterations. The factor is measured with a coarser copy of the flow:
    `run` is a complete run of this copy, and `changes` are the attributes of the scene in which the copy differs from
    the flow itself.
    """
    start = type(simulation)(
        replace(simulation.scene, **changes),
        device=str(simulation.device),
        precision=simulation.precision,
        threads=simulation.threads,
    )
    start.prepare()
    first, sample = step_time(start), median_time(start.measure, start.device)
    start.release()
    spent = number(run.result["speed"]["wall_time"]) - sample * len(run.series["time"])
    return max(spent / run.result["steps"] / first, 1 / MAX_SPEEDUP)
