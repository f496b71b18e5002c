"""Measurements of a flow on a grid, under the same names as measurements of particle flows."""

import math

import numpy as np

from ..kernels.mps.grid.cells import FORCE, LAST_FORCE, LIQUID
from ..theory.pipe import velocity
from .grid.flow import GridFlow
from .grid.layout import GridLayout
from .probes import Snapshot, section, window
from .scene import FluidScene

POINTS_PER_CELL = 40
"""Number of points per cell at which the theoretical velocity is evaluated to average it over the cell."""


def measured(flow: GridFlow, before: dict[str, float] | None = None) -> dict[str, float]:
    """Measure a flow and return a row of the time series.

    `before` is the previous row, from which the rate of change of momentum is computed. The momentum of a channel is
    per metre of depth. The pressure of a periodic pipe is the driving force per volume times the pipe's length; this
    force balances friction and weight.
    """
    scene, state, layout = flow.scene, flow.state, flow.state.layout
    drive = state.mesh.drive.numpy()
    gradient = float(drive[int(LAST_FORCE if flow.steps else FORCE)])
    area, around = section(flow), 2 * math.pi if layout.axial else 1.0
    wet = (2 * math.pi * scene.radius if layout.axial else 2.0) * layout.height
    along = state.faces("velocity")[1]
    volume = state.faces("volume")[1] * around
    kind = state.faces("kind")[1] == int(LIQUID)
    mass = scene.concrete.density * area * layout.height
    momentum = mass * scene.velocity
    # Before the first step, the faces hold no velocities. The momentum is then the mass times the mean velocity, which
    # has been computed above.
    if flow.steps:
        momentum = scene.concrete.density * float(np.sum(volume * along, where=kind))
    # The faces along the wall belong to the first and last cells across a channel, or to the last cell of a tube.
    beside = [-2] if layout.axial else [1, -2]
    stress, at_wall = (float(np.mean(state.faces(name)[1][1:-1, beside])) for name in ("traction", "slip"))
    force = gradient * layout.height * area
    change = 0.0
    if before is not None and flow.time > before["time"]:
        change = (momentum - before["momentum"]) / (flow.time - before["time"])
    # The driving force must equal the sum of weight, wall drag and rate of change of momentum; the residual is the
    # difference.
    residual = force - mass * scene.gravity - stress * wet - change
    radius, mean = profile(flow)
    weight = radius if layout.axial else np.ones_like(radius)
    deviation = math.sqrt(float(np.sum(weight * (mean - theory_profile(scene, layout)) ** 2) / np.sum(weight)))
    outcomes = flow.outcomes()
    within = [_mass_in_window(layout, x, scene) for x in (layout.fluid, state.particles.position.numpy().astype(float))]
    return {
        "time": flow.time,
        "travel": scene.velocity * flow.time,
        "pressure": gradient * layout.height,
        "pressure_gradient": gradient,
        "wall_stress": stress,
        "slip_velocity": at_wall if flow.steps else math.nan,
        "profile_deviation": deviation,
        "fastest": float(Snapshot.of(flow).speed.max()),
        "volume_error": within[0] / within[1] - 1,
        "force_balance_error": residual / force if force else math.nan,
        "front": layout.height,
        "momentum": momentum,
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
        **_structure(flow, beside),
    }


def _structure(flow: GridFlow, beside: list[int]) -> dict[str, float]:
    """Return the remaining part of the yield stress gained at rest [Pa], in the slip layer and in the bulk beside it.

    Both values are means along the wall. `beside` contains the numbers of the cells at the wall, counted across the
    pipe. The result is empty for concrete without thixotropy.
    """
    if not flow.state.layout.kind.thixotropic:
        return {}
    layer, bulk = flow.state.faces("layer")[1], flow.state.faces("gained")[0]
    return {"layer_gained": float(layer[1:-1, beside].mean()), "bulk_gained": float(bulk[1:-1, beside].mean())}


def _mass_in_window(layout: GridLayout, places: np.ndarray, scene: FluidScene) -> float:
    """Return the mass of concrete, weighted with a factor that falls smoothly from the pipe's middle to its wall.

    The mass of each particle is relative to the mean mass. As long as the particles remain evenly distributed across
    the pipe, the result keeps its initial value.
    """
    part = (np.abs(places[:, 0]) / scene.radius) ** (2 if layout.axial else 1)
    return window(part, layout.mass)


def profile(flow: GridFlow, height: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the velocity profile of a pipe at a `height` [m], by default at half the height of the grid.

    The profile consists of the distances of the cells from the axis of a tube or the middle plane of a channel [m], in
    rising order, and of the cells' mean velocities [m/s].
    """
    layout = flow.state.layout
    height = 0.5 * layout.height if height is None else height
    row = 1 + min(round(height / layout.step), layout.cells[1] - 1)
    across = np.abs(layout.left + (np.arange(layout.cells[0]) + 0.5) * layout.spacing)
    order = np.argsort(across, kind="stable")
    return across[order], flow.state.faces("velocity")[1, row, 1:-1][order]


def theory_profile(scene: FluidScene, layout: GridLayout) -> np.ndarray:
    """Return the theoretical velocity of each cell [m/s], averaged over its width, in the order of :func:`profile`."""
    nx = layout.cells[0]
    across = np.abs(layout.left + (np.arange(nx * POINTS_PER_CELL) + 0.5) * layout.spacing / POINTS_PER_CELL).reshape(
        nx, POINTS_PER_CELL
    )
    weight = across if layout.axial else np.ones_like(across)
    exact = velocity(scene.concrete, scene.line, scene.theory(), across.ravel()).reshape(nx, POINTS_PER_CELL)
    mean = (exact * weight).sum(1) / weight.sum(1)
    return mean[np.argsort(across.mean(1), kind="stable")]
