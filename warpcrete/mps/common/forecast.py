"""Forecasts of the run time of flows.

The run time depends on the simulated time until the flow is steady, and on the wall time of a step. A coarser copy of
the flow is run to predict the simulated time, which is set by physics rather than by the resolution. The wall time of a
step is measured in the first steps of the flow itself.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.device.footprint import footprint
from ...core.errors import InstabilityError, SceneError
from ...core.run.forecast import Forecast, Probe, median_time, timed
from ...core.run.run import Run
from ...theory.laws import BINGHAM
from ...theory.pipe import Concrete
from .run import FlowRun
from .stepping import Stepping

TIMING_TIME = 1.0  # Minimum wall time over which steps are timed for a forecast [s].
TIMED_STEPS = 10  # Maximum number of steps that are timed in one measurement.
COPY_TIME = 30.0  # Maximum wall time of the run of a coarser copy, without compilation [s].


@dataclass(frozen=True)
class Course:
    """Expected duration and mean time step of a run."""

    duration: float
    """Expected simulated time of the run [s]."""
    time_step: float
    """Expected mean time step of the run [s]."""
    remarks: Sequence[str] = ()
    slowdown: float = 1.0
    """Mean wall time of a step over the whole run, divided by the mean wall time of the first steps."""


def flow_forecast(
    simulated: Callable[[], FlowRun],
    course_of: Callable[[Any], Course],
    features_of: Callable[[Any], Mapping[str, str]],
    probe: Probe,
    *,
    limits: Mapping[str, float] | None = None,
    governing: str = "choice: solves are implicit, so viscosity and pressure set no limit",
) -> Forecast:
    """Return the forecast of a flow's run time.

    `simulated` creates the simulation. From the prepared simulation, `course_of` returns the expected duration and mean
    time step, and `features_of` returns texts that describe what the flow computes. `probe` measures the wall time of
    recording one frame. `limits` are the largest time steps that single effects allow [s], by the name of the effect.
    `governing` states which effect limits the time step. `limits` and `governing` become attributes of the forecast.
    """

    def begun() -> FlowRun:
        simulation = simulated()
        simulation.prepare()
        return simulation

    scene = (loading := begun()).scene
    # Time several steps in one measurement, but no more steps than a run takes between two measurements of the flow.
    # Time slow steps one by one, so that the forecast itself stays short.
    loading.flow.take(1)  # The first step loads the kernels. It is taken here, so that the loading is not timed.
    count = max(1, min(round(scene.sample_interval / scene.time_step), _steps_at_once(loading.flow)))
    loading.flow.take(count)
    course = course_of(loading)
    loading.release()
    simulation, placing = timed(begun, loading.device)
    flow = simulation.flow
    _, first = timed(lambda: flow.take(count), flow.device)
    step = step_time(simulation)
    steps = max(1.0, course.duration / course.time_step)
    samples = math.ceil(course.duration / scene.sample_interval - 1e-9)
    flow_time = Forecast(
        method="moving particles",
        device="",
        counts=flow.counts,
        features={
            **features_of(simulation),
            "precision": simulation.precision,
            "threads": "one for each particle or cell" if flow.parallel else f"{flow.threads}",
        },
        memory={name: float(size) for name, size in footprint(**flow.holdings, rest=simulation).items() if size},
        time_step=course.time_step,
        limits=limits or {},
        governing=governing,
        steps=steps,
        parts={
            "placing": placing,
            "graphs": max(first - count * step, 0.0),
            "steps": steps * step * course.slowdown,
            "samples": samples * median_time(simulation.measure, flow.device),
        },
        frame=probe(simulation),
        duration=course.duration,
        remarks=(*scene.remarks, *course.remarks),
    )
    simulation.release()
    return flow_time


def coarser_run(simulation: FlowRun, unmet: str, **changes: object) -> tuple[Run | None, float, list[str]]:
    """Run a coarser copy of a flow; return its run, the expected simulated time [s], and a list of remarks.

    The copy's scene equals the scene of the flow except for the attributes in `changes`. The expected simulated time is
    the time at which the copy ends. If the copy ends without becoming steady, a remark with the text `unmet` says so;
    otherwise there are no remarks. If the copy needs more wall time than `COPY_TIME` or stops with an error, the
    expected simulated time is the longest time that the flow may simulate, and a remark states the reason. After an
    error, the returned run is None.
    """
    copy: FlowRun | None = None
    begun: list[float] = []

    def stop_late(phase: str) -> None:
        if phase == "running" and copy is not None:
            begun.append(time.monotonic())
            copy.stop_requested = begun[-1] - begun[0] > COPY_TIME

    try:
        copy = type(simulation)(
            replace(simulation.scene, **changes), device=str(simulation.device), precision=simulation.precision,
            threads=simulation.threads, progress=lambda phase, fraction, figures: stop_late(phase),
        )  # fmt: skip
        run, steady = copy.run(), copy.steady
    except (InstabilityError, SceneError) as error:
        remark = f"the simulated time is uncertain, because a coarser copy of this flow stopped: {error}"
        return None, simulation.duration, [remark]
    finally:
        if copy is not None:
            copy.release()
    reached = float(run.result["simulated_time"]["value"])
    if not run.finished:
        remark = (
            f"a coarser copy of this flow reached {reached:.2g} s in {COPY_TIME:g} s of wall time, but {unmet} then; "
            f"the forecast of steps and wall time assumes {simulation.duration:g} s"
        )
        return run, simulation.duration, [remark]
    return run, reached, [] if steady else [f"{unmet} within {reached:g} s"]


def step_time(simulation: FlowRun) -> float:
    """Return the wall time of a step [s], measured over the next steps of the simulation."""
    flow = simulation.flow
    # The first steps capture the launch graph. They are taken here, so that the capture is not timed.
    count = _steps_at_once(flow)
    flow.take(count)
    times: list[float] = []
    while sum(times) < TIMING_TIME:
        times.append(timed(lambda: flow.take(count), flow.device)[1])
    # Other programs that run at the same time can only make the measured steps slower, and would slow down only a small
    # part of a long run. Therefore use the lower quartile of the measured times instead of their mean.
    return float(np.quantile(times, 0.25)) / count


def _steps_at_once(flow: Stepping) -> int:
    """Return how many steps to time in one measurement: as many as `TIMING_TIME` allows, from 1 to `TIMED_STEPS`."""
    _, once = timed(lambda: flow.take(1), flow.device)
    return max(1, min(TIMED_STEPS, int(TIMING_TIME / max(once, 1e-9))))


def law_features(concrete: Concrete) -> dict[str, str]:
    """Return the flow laws of bulk and slip layer that are not Bingham's, as text for a forecast's list of features."""
    laws = {"flow law": (concrete.bulk_law, "Pa s2"), "law of the slip layer": (concrete.layer_law, "Pa s2/m2")}
    return {
        name: f"{law.name}, n = {law.index:g}" if law.index != 1 else f"{law.name}, c = {law.quadratic:g} {unit}"
        for name, (law, unit) in laws.items()
        if law.name != BINGHAM
    }
