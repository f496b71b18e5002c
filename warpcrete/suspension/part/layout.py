"""Aggregates in a part of a pump line at the start, and the plane through which more of them enter.

A straight extension of the pipe behind this plane holds all aggregates that will enter during the run. They are placed
together with those in the part, so that the volume fraction is the same on both sides of the plane.
"""

from dataclasses import replace

import numpy as np

from ...mps.grid.layout import GridLayout
from ...mps.part.layout import Frame, bore_distance
from ..aggregates import Aggregates, Spheres
from ..entrance import Entrance
from ..nearby import CLEARANCE, Distance
from ..placing import aggregates_within
from .scene import PartSuspensionScene

MARGIN_CELLS = 2
"""Distance in cell widths at which an entering aggregate is added to the simulated box. It is the distance between the
plane through which aggregates enter and the front of the aggregate, which is still upstream of this plane."""
STRETCHES = 400
"""Number of stretches into which the pipe's axis is divided to draw random places for aggregates. A place lies in a
stretch with a probability proportional to the volume of the stretch."""


def placed_entering(scene: PartSuspensionScene, layout: GridLayout) -> tuple[Aggregates, Entrance]:
    """Place aggregates at random in the part, and upstream of the plane through which concrete enters the part.

    The aggregates upstream enter the part during the run. Returns all aggregates and this plane.

    Raises :class:`warpcrete.SceneError` if not all aggregates can be placed without overlaps.
    """
    velocity = np.array(layout.inflow)
    speed, largest = float(np.linalg.norm(velocity)), scene.diameters[1] / 2
    behind = speed * scene.duration + 2 * (1 + CLEARANCE) * largest
    frame, axis, half = Frame(scene), scene.axis, scene.is_half
    bore, way = bore_distance(scene), frame.axes @ axis.at(0.0)[1][0]
    edges = np.linspace(-behind, axis.length, STRETCHES + 1)
    radius = scene.bore(np.maximum(0.5 * (edges[1:] + edges[:-1]), 0.0))
    volume = np.concatenate([[0.0], np.cumsum(scene.simulated_share * np.pi * radius**2 * np.diff(edges))])

    def distance(x: np.ndarray) -> np.ndarray:
        s = axis.along(frame.to_scene(x))
        # Upstream of the plane through which aggregates enter, the bore has the same cross-section as at this plane.
        clearance = bore(x - np.minimum(s, 0.0)[:, None] * way)
        clearance = np.minimum(clearance, np.minimum(s + behind, axis.length - s))
        return np.minimum(clearance, x[:, 1]) if half else clearance

    def draw(rng: np.random.Generator, count: int) -> np.ndarray:
        s = np.interp(rng.uniform(0, volume[-1], count), volume, edges)
        middle, _, one, two = axis.frame(s)
        away = scene.bore(np.maximum(s, 0.0)) * np.sqrt(rng.uniform(0, 1, count))
        angle = rng.uniform(0, 2 * np.pi, count)
        aside = (away * np.cos(angle))[:, None] * one + (away * np.sin(angle))[:, None] * two
        x = frame.to_grid(middle + aside)
        return np.where([False, half, False], np.abs(x), x)

    corners = np.zeros(3)
    aggregates = aggregates_within(scene, float(volume[-1]), distance, corners, corners, scene.seed, draw=draw)
    enters, appears = _times(aggregates, lambda x: axis.along(frame.to_scene(x)), speed, scene, layout)
    gravity = frame.axes @ [0.0, 0.0, -scene.gravity]
    # All aggregates start with the mean velocity of the flow at their places, so that aggregates upstream of the plane
    # do not push others.
    depth = axis.along(frame.to_scene(aggregates.centre))
    fast = speed * (scene.radius / scene.bore(np.maximum(depth, 0.0))) ** 2
    start = fast[:, None] * (axis.at(depth)[1] @ frame.axes.T)
    return replace(aggregates, velocity=start), Entrance(velocity, appears, enters, gravity)


def _times(
    aggregates: Aggregates, along: Distance, speed: float, scene: PartSuspensionScene, layout: GridLayout
) -> tuple[np.ndarray, np.ndarray]:
    """Return two times for each aggregate [s]: when it has entered entirely, and when it is added to the simulated box.

    `along` returns the arc lengths of points [m], and `speed` is the speed of the plane through which aggregates enter
    [m/s]. An aggregate has entered entirely as soon as it no longer touches the plane.
    """
    parts = Spheres(aggregates)
    depth = along(parts.centres(aggregates.centre, aggregates.turns))
    enters = np.maximum.reduceat((1 + scene.roughness) * parts.radius - depth, parts.first[:-1]) / speed
    appears = np.minimum.reduceat(-parts.radius - depth, parts.first[:-1]) - MARGIN_CELLS * layout.spacing
    return np.maximum(enters, 0.0), np.maximum(appears / speed, 0.0)
