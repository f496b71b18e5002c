"""Verification of pipe flows that a force starts from rest, against a one-dimensional finite volume solution."""

from dataclasses import replace

import numpy as np

from ..core.device.device import find_device
from ..mps.column import FlowParameters, column_scene
from ..mps.grid.flow import GridFlow
from ..mps.grid.state import GridState
from ..mps.pipe_grid import pipe_layout
from ..mps.scene import FluidScene
from ..theory.pipe import Concrete
from .case import Case, Row

FINER = 4
"""Number of cells of the one-dimensional solution per cell of the grid."""
SAMPLES = 40
"""Number of instants at which the solution on the grid is compared with the one-dimensional solution."""
START_CASES = (
    # The columns are the Bingham number, the viscous constant of the slip layer [Pa s/m], the allowed error of a time
    # step on the grid, and the time at which the flow is almost steady [s].
    (0.0, 1e6, 1e-4, 0.4), (0.0, 4e3, 1e-4, 0.4), (1.0, 1e6, 3e-6, 0.2), (10.0, 1e6, 1e-6, 0.04),
)  # fmt: skip
"""Flows that are compared with the one-dimensional solution. Each time step on the grid uses the mean of the
viscosities at its start and at its end; with a yield stress, this mean is accurate only for short time steps."""
LONGEST = 2e-3
"""Longest time step on the grid [s]."""
EXACT_STEP_RATIO = 5e-4
"""Time step of the one-dimensional solution, as a fraction of the simulated time."""


def apparent(concrete: Concrete, regularisation: float, rate: np.ndarray) -> np.ndarray:
    """Return the apparent viscosity [Pa s] of Bingham concrete at shear rates `rate` [1/s].

    `regularisation` is the parameter beta of the regularised flow law [s] (Xu, Li & Jiang 2021, Eq. 15).
    """
    bent = np.maximum(regularisation * np.abs(rate), 1e-12)
    return concrete.viscosity + concrete.yield_stress * regularisation * -np.expm1(-bent) / bent


def profiles(scene: FluidScene, force: float, cells: int, times: np.ndarray, step: float) -> np.ndarray:
    """Return velocity profiles [m/s] of a pipe flow that starts from rest, at the `times` [s], shape (times, cells).

    A `force` per volume [N/m3] drives the flow. The cells divide the radius of the pipe, or half the width of the
    channel. `step` is the time step [s].
    """
    concrete, axial = scene.concrete, scene.dimensions == 3
    h = scene.radius / cells
    sides = np.arange(cells + 1) * h
    area = sides if axial else np.ones(cells + 1)
    volume = 0.5 * np.diff(sides**2) if axial else np.full(cells, h)
    inertia = concrete.density * volume / step
    velocity, slip, profiles_at_times = np.zeros(cells), 0.0, []
    for n in range(round(times[-1] / step)):
        start = velocity
        # Solve the implicit step by fixed-point iterations, because the viscosity depends on the velocity at the end of
        # the step.
        for _ in range(6):
            c = apparent(concrete, scene.regularisation, np.diff(velocity) / h) * area[1:-1] / h
            # Two resistances in series act on the flow at the wall: the slip layer, and the shear across the outer half
            # of the cell next to the wall.
            half = 2 * float(apparent(concrete, scene.regularisation, np.array(2 * (velocity[-1] - slip) / h))) / h
            layer = concrete.slip_viscosity
            ease, fixed = half * layer / (half + layer), half * concrete.slip_yield / (half + layer)
            if half * velocity[-1] < concrete.slip_yield:
                ease, fixed = half, 0.0
            matrix = np.diag(inertia + np.r_[c, ease * area[-1]] + np.r_[0, c]) - np.diag(c, 1) - np.diag(c, -1)
            right = inertia * start + force * volume
            right[-1] -= fixed * area[-1]
            velocity = np.linalg.solve(matrix, right)
            slip = max(ease * velocity[-1] + fixed - concrete.slip_yield, 0.0) / layer
        if np.any(np.abs((n + 1) * step - times) < 0.5 * step):
            profiles_at_times.append(velocity)
    return np.array(profiles_at_times)


def worst(
    dimensions: int, number: float, layer: float, longest: float, error: float, end: float, device: str, precision: str
) -> tuple[float, float]:
    """Return the largest rms error of the velocity profile over all compared times, and the largest error in any cell.

    Errors are divided by the mean velocity of the steady flow. `dimensions` is 2 for a channel and 3 for a pipe.
    `number` is the Bingham number, and `layer` the viscous constant of the slip layer [Pa s/m]. `longest` is the
    longest time step on the grid [s], `error` the allowed error of a time step, and `end` the simulated time [s].
    """
    speed, viscosity, radius = 0.19, 20.0, 0.05
    given = FlowParameters(
        concrete="own", density=2400.0, viscosity=viscosity, yield_stress=number * viscosity * speed / radius,
        slip_viscosity=layer, slip_yield=0.0, ends="periodic", length=0.04, spacing=5e-3, gravity=0.0,
        time_step=longest, step_error=error,
    )  # fmt: skip
    scene = column_scene("flow", dimensions, given)
    force = scene.theory().pressure / scene.length
    layout = replace(pipe_layout(scene), frame=0.0, drive=force, mean_velocity_fixed=False)
    flow = GridFlow(GridState(scene, layout, find_device(device), precision))
    times = np.linspace(0, end, SAMPLES + 1)[1:]
    across = layout.cells[0] if dimensions == 3 else layout.cells[0] // 2
    exact = profiles(scene, force, across * FINER, times, EXACT_STEP_RATIO * end).reshape(SAMPLES, across, FINER)
    # In a pipe, the cells of the one-dimensional solution are rings. Average the solution over the rings that
    # correspond to one cell of the grid, because velocities on the grid are such means.
    weight = (np.arange(across * FINER) + 0.5).reshape(across, FINER) if dimensions == 3 else np.ones((across, FINER))
    exact = (exact * weight).sum(-1) / weight.sum(-1)
    rms, largest = 0.0, 0.0
    for time, means in zip(times, exact, strict=True):
        flow.advance(time)
        ours = flow.state.faces("velocity")[1][1:-1, 1:-1].mean(0)[-across:]
        off = (ours - means) / speed
        ring = weight.sum(-1) / weight.sum()
        rms, largest = max(rms, float(np.sqrt(np.sum(ring * off**2)))), max(largest, float(np.abs(off).max()))
    return rms, largest


def start(device: str, precision: str) -> list[Row]:
    """Compare flows that start from rest with the one-dimensional solution.

    The flows run through a channel and a tube, with and without slip at the wall, and with and without a yield stress.
    """
    rows = []
    for dimensions, form in ((2, "channel"), (3, "tube")):
        for number, layer, error, end in START_CASES:
            rms, largest = worst(dimensions, number, layer, LONGEST, error, end, device, precision)
            name = f"{form}, Bn {number:g}" + (", slips" if layer < 1e6 else "")
            # The measured errors of the velocity profile without a yield stress are 0.11 to 0.38 % (rms) and 0.15 to
            # 0.7 % (largest in any cell). With a yield stress they are 0.8 % (rms) and 1.4 % (in a cell on the axis of
            # the tube).
            rows += [
                Row(f"{name}: profile, largest rms error", rms, 0.0, 0.01, scale=1.0),
                Row(f"{name}: largest error of any cell", largest, 0.0, 0.015, scale=1.0),
            ]
    return rows


CASES = [Case("start from rest under a force", "finite volumes in one dimension", start, "flows")]
