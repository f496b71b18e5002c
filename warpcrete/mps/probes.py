"""Measurements of a particle flow: pressure, slip velocity, profiles, volume, force balance, aggregate fractions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..theory.pipe import velocity
from .particles import MovingParticles

MIDDLE = (0.4, 0.6)
"""Lower and upper end of the heights at which slip velocity and velocity profile are measured, as fractions of the
column's height."""
STRAIGHT = (0.2, 0.8)
"""Lower and upper end of the heights between which the pressure gradient is measured, as fractions of the column's
height."""
LOWEST = 0.1
"""Height of a zone above the piston, divided by the height of the column. The pressure on the piston is extrapolated
from the pressures of the particles in this zone."""
WINDOW = (0.65, 0.85)
"""Two heights above the piston, divided by the height of the column. From the lower to the upper height, a particle's
weight in the measurement of the volume falls from one to zero."""
UNITS = {
    "time": "s",
    "travel": "m",
    "pressure": "Pa",
    "pressure_gradient": "Pa/m",
    "wall_stress": "Pa",
    "slip_velocity": "m/s",
    "profile_deviation": "m/s",
    "fastest": "m/s",
    "volume_error": "1",
    "force_balance_error": "1",
    "front": "m",
    "momentum": "kg m/s",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
    "layer_gained": "Pa",
    "bulk_gained": "Pa",
    "aggregate_inner": "1",
    "aggregate_outer": "1",
    "aggregate_front": "1",
    "aggregate_rear": "1",
}
"""Units of the columns of the time series."""


@dataclass(frozen=True)
class Snapshot:
    """Quantities of all particles at one time, on the host and in double precision; each array has the shape (n,)."""

    height: np.ndarray
    """Height of each particle above the piston [m]."""
    distance: np.ndarray
    """Distance of each particle from the axis or the middle plane [m]."""
    velocity: np.ndarray
    """Velocity of each particle along the pipe [m/s]."""
    speed: np.ndarray
    """Magnitude of each particle's velocity [m/s]."""
    pressure: np.ndarray
    """Pressure of each particle [Pa]."""

    @staticmethod
    def of(flow: MovingParticles) -> Snapshot:
        """Return the snapshot of a flow's particles."""
        p = flow.state.particles
        x, v = p.position.numpy().astype(float), p.velocity.numpy().astype(float)
        speed = np.linalg.norm(v, axis=1)
        pressure = p.pressure.numpy().astype(float)
        return Snapshot(x[:, -1], np.linalg.norm(x[:, :-1], axis=1), v[:, -1], speed, pressure)


def section(flow: MovingParticles) -> float:
    """Return the cross-sectional area of the pipe [m2]; for a channel, the area per metre of depth [m]."""
    return 2 * flow.scene.radius if flow.scene.dimensions == 2 else math.pi * flow.scene.radius**2


def measured(flow: MovingParticles, before: dict[str, float] | None = None) -> dict[str, float]:
    """Measure a flow and return a row of the time series.

    `before` is the previous row, from which the rate of change of momentum is computed. The momentum of a channel is
    per metre of depth. The pressure on the piston is extrapolated by a straight line from the particles near the
    piston. Half a spacing times the pressure gradient is added, because the pressure is zero at the centres of the
    surface particles, which lie half a spacing below the surface.
    """
    scene, state, layout = flow.scene, flow.state, flow.state.layout
    snap = Snapshot.of(flow)
    part = snap.height / layout.height
    straight = (part > STRAIGHT[0]) & (part < STRAIGHT[1])
    gradient = -_slope(snap.height[straight], snap.pressure[straight])[0]
    low = part < max(LOWEST, 2.1 * layout.spacing / layout.height)
    pressure = _slope(snap.height[low], snap.pressure[low])[1] + 0.5 * gradient * layout.spacing

    fields = flow.fields
    stress = fields.traction.numpy().astype(float)
    weight = fields.wall_weight.numpy().astype(float) * float(fields.wall_scale.numpy()[0])
    slip = snap.velocity - stress * fields.compliance.numpy()
    middle = (part > MIDDLE[0]) & (part < MIDDLE[1])
    wet = middle & (weight > 0)
    theory = velocity(scene.concrete, scene.line, flow.theory, np.minimum(snap.distance[middle], scene.radius))
    difference = snap.velocity[middle] - theory

    area = section(flow)
    one = state.grains is None
    mass = layout.volume * (scene.concrete.density if one else state.particles.density.numpy().astype(float))
    momentum = float(np.sum(mass * snap.velocity))
    change = 0.0
    if before is not None and flow.time > before["time"]:
        change = (momentum - before["momentum"]) / (flow.time - before["time"])
    force = pressure * area
    drag = float(np.sum(weight * stress)) * layout.volume
    outcomes = flow.outcomes()
    # The piston's force must equal the sum of weight, wall drag and rate of change of momentum; the residual is the
    # difference.
    residual = force - state.mass * scene.gravity - drag - change
    within, surface = window(part), np.array([layout.height - 0.5 * layout.spacing])
    if flow.steps:
        surface = snap.height[flow.matrix.free.numpy() != 0]
    row = {
        "time": flow.time,
        "travel": scene.velocity * flow.time,
        "pressure": float(pressure),
        "pressure_gradient": float(gradient),
        "wall_stress": drag / flow.wet_area,
        "slip_velocity": float(np.sum(weight[wet] * slip[wet]) / np.sum(weight[wet])) if wet.any() else math.nan,
        "profile_deviation": float(np.sqrt(np.mean(difference**2))) if len(difference) else math.nan,
        "fastest": float(snap.speed.max()),
        "volume_error": window(layout.fluid[:, -1] / layout.height) / within - 1 if within else math.nan,
        "force_balance_error": float(residual / force) if force else math.nan,
        "front": float(np.mean(surface)) + 0.5 * layout.spacing if len(surface) else math.nan,
        "momentum": momentum,
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
    }
    return row | aggregate_fractions(flow, snap)


def window(part: np.ndarray, weight: np.ndarray | float = 1.0) -> float:
    """Return the sum of `weight` times a window factor between 0 and 1 over all particles.

    `part` is the relative position of each particle, such as its height divided by the column's height. The factor is 1
    below the range WINDOW, and falls smoothly to 0 within it. The sum keeps its initial value if the concrete neither
    loses nor gains volume.
    """
    lower, upper = WINDOW
    return float(np.sum(weight * 0.5 * (1 + np.cos(np.pi * np.clip((part - lower) / (upper - lower), 0, 1)))))


def aggregate_fractions(flow: MovingParticles, snap: Snapshot) -> dict[str, float]:
    """Return the volume fractions of coarse aggregate in four parts of a column, by name.

    The parts are the inner and the outer half of the radius, and the front and the rear half of the length. The result
    is empty for a flow with one phase.
    """
    if flow.state.grains is None:
        return {}
    coarse = flow.state.grains.group >= 0
    parts = {
        "inner": snap.distance < 0.5 * flow.scene.radius,
        "outer": snap.distance >= 0.5 * flow.scene.radius,
        "front": snap.height >= 0.5 * flow.state.layout.height,
        "rear": snap.height < 0.5 * flow.state.layout.height,
    }
    return {f"aggregate_{name}": float(coarse[part].mean()) if part.any() else math.nan for name, part in parts.items()}


def profile(flow: MovingParticles, height: float, bins: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return distances from the axis [m] and mean velocities [m/s] of particles within 1.5 spacings of `height` [m].

    Each entry is the mean over the particles in a ring around the axis. There are up to `bins` rings, by default one
    per particle spacing.
    """
    snap, layout = Snapshot.of(flow), flow.state.layout
    chosen = np.abs(snap.height - height) < 1.5 * layout.spacing
    bins = bins or max(2, round(flow.scene.radius / layout.spacing))
    return over_radius(snap.distance[chosen], snap.velocity[chosen], flow.scene.radius, bins)


def over_radius(distance: np.ndarray, values: np.ndarray, radius: float, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean distance and the mean value of the particles in rings around the axis.

    There are `bins` rings of equal width up to `radius` [m]; rings without particles are left out.
    """
    edges = np.linspace(0, radius, bins + 1)
    place = np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(place, values, bins) / count
        middle = np.bincount(place, distance, bins) / count
    return middle[count > 0], mean[count > 0]


def _slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the slope of the straight line fitted to points, and the line's value at x = 0."""
    if len(x) < 2 or np.ptp(x) == 0:
        return 0.0, float(np.mean(y)) if len(y) else math.nan
    slope, value = np.polyfit(x, y, 1)
    return float(slope), float(value)
