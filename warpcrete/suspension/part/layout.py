"""Aggregates in a part of a pump line at the start, and the plane through which more of them enter.

A straight extension of the pipe behind this plane holds all aggregates that will enter during the run. They are placed
together with those in the part, so that the volume fraction is the same on both sides of the plane.
"""

from __future__ import annotations

import numpy as np

from ...mps.grid.layout import GridLayout
from ...mps.part.layout import Frame, bore_distance
from ..aggregates import Aggregates
from ..entrance import Entrance
from ..placing import CLEARANCE, aggregates_within
from .scene import PartSuspensionScene

MARGIN_CELLS = 2
"""Distance behind the plane, in cells, at which aggregates that enter appear in the box of cells."""
STRETCHES = 400
"""Number of stretches of the axis between which places of aggregates are drawn in proportion to their volumes."""


def placed_entering(scene: PartSuspensionScene, layout: GridLayout) -> tuple[Aggregates, Entrance]:
    """Return randomly placed aggregates in the part and behind the plane of its start, and this plane.

    Raises :class:`warpcrete.SceneError` if not all aggregates find a place.
    """
    velocity = np.array(layout.inflow)
    speed, largest = float(np.linalg.norm(velocity)), scene.aggregate_diameters[1] / 2
    behind = speed * scene.duration + 2 * (1 + CLEARANCE) * largest
    frame, axis, half = Frame(scene), scene.axis, scene.is_half
    bore, way = bore_distance(scene), frame.axes @ axis.at(0.0)[1][0]
    edges = np.linspace(-behind, axis.length, STRETCHES + 1)
    radius = scene.bore(np.maximum(0.5 * (edges[1:] + edges[:-1]), 0.0))
    volume = np.concatenate([[0.0], np.cumsum(scene.simulated_share * np.pi * radius**2 * np.diff(edges))])

    def distance(x: np.ndarray) -> np.ndarray:
        s = axis.along(frame.to_scene(x))
        # Behind the plane the bore is that at the plane.
        found = bore(x - np.minimum(s, 0.0)[:, None] * way)
        found = np.minimum(found, np.minimum(s + behind, axis.length - s))
        return np.minimum(found, x[:, 1]) if half else found

    def draw(rng: np.random.Generator, count: int) -> np.ndarray:
        s = np.interp(rng.uniform(0, volume[-1], count), volume, edges)
        middle, _, one, two = axis.frame(s)
        away, angle = (
            scene.bore(np.maximum(s, 0.0)) * np.sqrt(rng.uniform(0, 1, count)),
            rng.uniform(0, 2 * np.pi, count),
        )
        aside = (away * np.cos(angle))[:, None] * one + (away * np.sin(angle))[:, None] * two
        x = frame.to_grid(middle + aside)
        return np.where([False, half, False], np.abs(x), x)

    corners = np.zeros(3)
    found = aggregates_within(scene, float(volume[-1]), distance, corners, corners, scene.seed, draw=draw)
    # An aggregate is free as soon as it does not touch the plane any more.
    depth = axis.along(frame.to_scene(found.centre))
    clear = (1 + scene.roughness) * found.radius
    enters = np.where(depth < clear, (clear - depth) / speed, 0.0)
    appears = np.maximum((-found.radius - MARGIN_CELLS * layout.spacing - depth) / speed, 0.0)
    gravity = frame.axes @ [0.0, 0.0, -scene.gravity]
    # All aggregates start with the mean velocity of the flow at their places, so that those behind the plane do not
    # push others.
    fast = speed * (scene.radius / scene.bore(np.maximum(depth, 0.0))) ** 2
    start = fast[:, None] * (axis.at(depth)[1] @ frame.axes.T)
    return (
        Aggregates(found.centre, found.radius, found.density, start),
        Entrance(velocity, np.where(enters > 0, appears, 0.0), enters, gravity),
    )
