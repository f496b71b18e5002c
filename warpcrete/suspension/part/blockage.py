"""Blockage of a part of a pump line by aggregates: when the part counts as blocked, and where."""

import numpy as np

from ...dem.measure.blockage import STANDING_RATIO
from .scene import PartSuspensionScene

BLOCKED_OVERLAP = 0.2
"""Overlap, divided by the radius of an aggregate, that shows a blockage. If aggregates stand still in a part of a pump
line and overlap further than this, the inflow pushes them into each other, and the part counts as blocked at once."""


def is_blocked(scene: PartSuspensionScene, rows: list[dict[str, float]]) -> bool:
    """Return whether a part of a pump line counts as blocked at the end of a time series.

    The part is blocked if the frictional pressure at its start has exceeded the scene's limit in two successive rows.
    It is also blocked if some of the aggregates have stood still while the pressure rose, and one of two conditions
    holds: meanwhile the inflow has advanced by the scene's `standing_travel`, or overlaps exceed BLOCKED_OVERLAP at the
    end.
    """
    weight = scene.density * scene.gravity * scene.rise
    if len(rows) > 2 and all(row["pressure"] - weight > scene.pressure_limit for row in rows[-2:]):
        return True
    first = len(rows)
    while first > 1 and rows[first - 1]["slowest_part"] < STANDING_RATIO:
        first -= 1
    if first == len(rows):
        return False
    start = rows[first - 1]
    travel = scene.velocity * (rows[-1]["time"] - start["time"])
    long = travel >= scene.standing_travel or rows[-1]["smallest_gap"] < -BLOCKED_OVERLAP
    return long and rows[-1]["pressure"] > start["pressure"]


def blocked_place(scene: PartSuspensionScene, s: np.ndarray, friction: np.ndarray) -> float:
    """Return the arc length at which the frictional pressure falls most steeply [m].

    The slope at an arc length is the mean over a stretch as long as the largest diameter of the aggregates. `friction`
    is the loss from the arc lengths `s` [m] to the end of the part [Pa].
    """
    half = scene.diameters[1] / 2
    low, high = np.maximum(s - half, s[0]), np.minimum(s + half, s[-1])
    drop = (np.interp(low, s, friction) - np.interp(high, s, friction)) / (high - low)
    return float(s[np.argmax(drop)])
