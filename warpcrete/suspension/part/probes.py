"""Measurements of mortar with aggregates that flows through a part of a pump line."""

import numpy as np

from ...dem.measure.blockage import least_advance
from ...kernels.suspension.bodies import FULL
from ...kernels.suspension.leaving import PARKED
from ...kernels.suspension.pairs import WALL
from ...mps.part.layout import Frame
from ...mps.part.probes import UNITS as PART_UNITS
from ...mps.part.probes import friction_ahead
from ...mps.part.probes import measured as measured_flow
from ..aggregates import is_inside
from ..balance import pair_forces
from ..flow import SuspensionFlow
from .scene import PartSuspensionScene

UNITS = PART_UNITS | {"aggregates_present": "1", "aggregates_entered": "1", "aggregates_left": "1", "slowest_part": "1"}
"""Units of the columns of the time series, except for the columns that every flow of mortar with aggregates has."""


class Census:
    """Positions of the aggregates along the pipe's axis at the present time."""

    def __init__(self, flow: SuspensionFlow, enters: np.ndarray) -> None:
        scene: PartSuspensionScene = flow.scene
        self.flow, self.scene, self.frame = flow, scene, Frame(scene)
        self.centre = flow.aggregates.bodies.centre.numpy().astype(float)
        self.radius = flow.aggregates.radius
        self.left = self.centre[:, 2] >= float(PARKED)
        """Mask of the aggregates that have left the part entirely, shape (n,)."""
        self.free = (enters <= flow.time) & ~self.left
        """Mask of the aggregates that have entered entirely, and have not left entirely, shape (n,)."""
        self.entered = (enters > 0) & (enters <= flow.time)
        """Mask of the aggregates that have entered entirely since the start, shape (n,)."""
        self.seen = is_inside(self.centre)
        """Mask of the aggregates that are at least partly in the simulated box, shape (n,)."""
        self.place = np.full(len(self.radius), np.nan)
        """Arc length of each aggregate [m], shape (n,); NaN for aggregates that are outside the simulated box."""
        self.place[self.seen] = scene.axis.along(self.frame.to_scene(self.centre[self.seen]))

    def _area(self, s: np.ndarray) -> np.ndarray:
        """Return the area of the simulated cross-section at arc lengths `s` [m2]."""
        scene = self.scene
        return scene.simulated_share * np.pi * scene.bore(np.clip(s, 0.0, scene.axis.length)) ** 2

    def ahead(self, s: np.ndarray, share: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return, for each arc length in `s` [m], the sum of a quantity of the `chosen` aggregates that lie beyond it.

        `share` holds the quantity for each aggregate, such as its volume. An aggregate that reaches across an arc
        length counts with the fraction of its volume that lies beyond.
        """
        place, radius = self.place[chosen], self.radius[chosen]
        beyond = np.clip((place - s[:, None]) / radius, -1.0, 1.0)
        return np.sum(0.25 * (1 + beyond) ** 2 * (2 - beyond) * share[chosen], axis=1)

    def fractions(self, s: np.ndarray) -> np.ndarray:
        """Return the volume fraction of aggregates around the arc lengths `s` [m].

        Each fraction is the mean over a stretch as long as the diameter of the largest aggregate. The stretch is cut
        off at the ends of the part.
        """
        scene, wide = self.scene, self.scene.diameters[1] / 2
        low, high = np.maximum(s - wide, 0.0), np.minimum(s + wide, scene.axis.length)
        volume = 4 / 3 * np.pi * self.radius**3
        inside = self.ahead(low, volume, self.seen) - self.ahead(high, volume, self.seen)
        middles = low + (high - low) * (np.arange(8)[:, None] + 0.5) / 8
        area = np.mean(self._area(middles.ravel()).reshape(middles.shape), axis=0)
        return inside / (area * (high - low))

    def friction(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m], and the frictional loss from each arc length to the end of the part [Pa].

        The axial stress is the sum of the stress in the flow and the stress due to forces between aggregates. A part of
        this sum carries the weight of the aggregates minus their buoyancy. This part is subtracted, because it is not
        friction.
        """
        state = self.flow.state
        inner = (slice(1, -1),) * 3
        solid = self.flow.aggregates.cover.solid.numpy()[: state.slots].reshape(state.shape)[inner] / int(FULL)
        s, stress = friction_ahead(self.flow, np.maximum(1 - solid, 0.0))
        stress = stress + self._pair_stress(s)
        force = self.flow.aggregates.bodies.force.numpy().astype(float)
        share, scene = np.zeros(len(self.radius)), self.scene
        place = self.place[self.free]
        tangent = scene.axis.at(place)[1] @ self.frame.axes.T
        share[self.free] = -np.sum(force[self.free] * tangent, 1) / self._area(place)
        return s, stress - self.ahead(s, share, self.free)

    def _pair_stress(self, s: np.ndarray) -> np.ndarray:
        """Return the axial stress that contacts and lubrication between aggregates bear at arc lengths `s` [Pa].

        The force between two aggregates acts on the cross-sections between their centres.
        """
        forces, scene, body = pair_forces(self.flow), self.scene, self.flow.aggregates.parts.body
        between = forces.other != int(WALL)
        own, other = body[forces.own[between]], body[forces.other[between]]
        ends = np.sort(self.place[np.stack([own, other])], axis=0)
        middle = np.clip(ends.mean(0), 0, scene.axis.length)
        tangent = scene.axis.at(middle)[1] @ self.frame.axes.T
        # The component of the normal along the pipe's axis is positive if the sphere is upstream of its neighbour.
        upstream = np.sign(np.sum(forces.normal[between] * tangent, 1))
        pushing = -upstream * np.sum(forces.force[between] * tangent, 1)
        # Two aggregates that have both entered occur twice as a pair. A pair with an aggregate that is still entering
        # occurs once.
        share = np.where(self.free[other], 0.5, 1.0)
        stress = share * pushing / self._area(middle)
        return np.sum(np.where((ends[0] < s[:, None]) & (ends[1] >= s[:, None]), stress, 0.0), axis=1)

    def slowest(self, before: np.ndarray, travel: float) -> float:
        """Return how far the slowest aggregates have moved since the previous measurement, divided by `travel`.

        `travel` is the distance by which the inflow has advanced in this time [m]. `before` holds the arc lengths of
        the aggregates at the previous measurement [m]. The distance of an aggregate is multiplied by the area of the
        bore around it and divided by the area at the start of the part, so that the result is 1 everywhere if concrete
        flows evenly through a taper. The function `least_advance` finds the slowest aggregates; simulations with
        discrete elements use it as well.
        """
        if travel <= 0:
            return 1.0
        known = self.free & np.isfinite(before) & (before > 0)
        if not known.any():
            return 1.0
        old, now, scene = before[known], self.place[known], self.scene
        middle = np.clip(0.5 * (old + now), 0, scene.axis.length)
        wider = (scene.bore(middle) / scene.radius) ** 2
        least = least_advance(old, old + wider * (now - old), self.radius[known] ** 3, scene.axis.length)
        return min(least / travel, 1.0)


def measured(census: Census, before: np.ndarray, travel: float) -> tuple[dict[str, float], np.ndarray]:
    """Return the values of one row of the time series, and profiles along the part, shape (3, stations).

    The profiles are the arc lengths of the stations [m], the frictional loss from each station to the end of the part
    [Pa], and the volume fraction of aggregates around each station. `before` holds the arc lengths of the aggregates at
    the previous measurement [m]. The inflow has advanced by `travel` [m] since the previous measurement.
    """
    flow = census.flow
    friction = census.friction()
    row = measured_flow(flow, friction, flow.coupled.mean_velocity() if flow.steps else None)
    return row | {
        "aggregates_present": float(census.free.sum()),
        "aggregates_entered": float(census.entered.sum()),
        "aggregates_left": float(census.left.sum()),
        "slowest_part": census.slowest(before, travel),
    }, np.stack([*friction, census.fractions(friction[0])])
