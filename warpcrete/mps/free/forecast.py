"""Forecast of the run time of a free-surface flow.

A coarser copy of the flow is run to predict the simulated time until the concrete rests. The wall time of a step is
measured in the first steps of the flow itself.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...core.run.forecast import Forecast, Probe
from ..common.forecast import Course, coarser_run, flow_forecast, law_features
from .quantities import expected
from .scene import FreeScene
from .simulation import FreeSimulation

DURATION_FACTOR = 1.2
"""Assumed ratio of the simulated time in which a funnel empties to its closed-form estimate. The closed form neglects
the stretching of concrete in the taper.

Simulations gave ratios from 1.0 to 1.3.
"""
COARSE_CELLS_HIGH = 12
"""Number of cells over the concrete's initial height in the coarser copy of a flow, which predicts its duration."""


def forecast(
    scene: FreeScene, device: Any, precision: str, threads: int | None, probe: Probe, make: Any = FreeSimulation
) -> Forecast:
    """Return the forecast of a run on a Warp `device`; the function `probe` measures the wall time of one frame.

    `make` is the class whose instance simulates the scene.
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
            **law_features(scene.concrete),
        },
        probe,
        **({"governing": step} if scene.step_error else {}),
    )


def course_of(simulation: FreeSimulation) -> Course:
    """Return the expected duration and mean time step of a run until the concrete rests or a funnel is empty."""
    scene = simulation.scene
    # A step must not carry concrete farther than about one cell. Estimate the mean step as the time in which concrete
    # crosses a cell at the speed that it has after falling by its initial height.
    height = scene.extent[1, 1]
    swift = scene.spacing / math.sqrt(2 * scene.gravity * height)
    mean = min(scene.time_step, swift) if scene.step_error else scene.time_step
    if scene.test and scene.test.outflow:
        estimate = expected(scene).get(scene.test.outflow.time)
        if estimate is None:
            return Course(scene.duration, mean, ["the yield stress may hold the concrete in the funnel"])
        return Course(min(DURATION_FACTOR * estimate, scene.duration), mean)
    if scene.depth:
        # Do not predict the duration by a coarser copy of this flow, because coarse cells would not resolve the
        # obstacles that the concrete must pass.
        remark = "the time until the concrete rests is not predicted; the longest allowed time is assumed"
        return Course(scene.duration, mean, [remark])
    spacing = min(max(scene.spacing, height / COARSE_CELLS_HIGH), min(np.ptp(scene.extent, axis=0)) / 4)
    run, reached, remarks = coarser_run(simulation, "the concrete is not at rest", spacing=spacing)
    if run is not None and scene.step_error:
        # With adaptive steps, two limits apply: the error of a step, and the time in which concrete crosses a cell. The
        # first limit is the same in the coarser copy and in the flow itself. The second limit is stricter in the flow
        # itself, whose cells are smaller, so the flow may need more steps than the copy.
        passed = np.diff(run.series["time"]) * run.series["fastest"][1:] / scene.spacing
        mean = reached / float(np.maximum(np.diff(run.series["steps"]), passed).sum())
    return Course(reached, mean, remarks)
