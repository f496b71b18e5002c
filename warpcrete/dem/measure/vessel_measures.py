"""Measurements of concrete in a test vessel, and the test results derived from them.

The names of columns and results are the same as in the flow method.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...core.run.method import Quantity, passage_time
from ..scene.scene import Vessel
from .heaps import height_around, height_at, height_of_top, main_body, shadow, spread

UNITS = {
    "top": "m",
    "spread": "m",
    "outside": "m",
    "screen": "1",
    "inside": "1",
    "near_depth": "m",
    "far_depth": "m",
    "front": "m",
    "main_body": "1",
    "fastest": "m/s",
    "mean_speed": "m/s",
}
"""Units of the recorded columns; each test records only the columns that it needs."""
T500 = 0.5
"""Spread whose time T500 is reported [m] (EN 12350-8)."""
LIGHT = 0.5
"""Covered fraction of a funnel's outlet below which light counts as seen through it, which ends the test."""
HEAPS = ("slump", "jring")
"""Tests that end with a heap of concrete on a plate."""
RESTED = 1.0
"""Simulated time for which concrete must be slow to count as being at rest [s]."""
BESIDE = 0.025
"""Width of the annulus around the J-ring over which the height outside the ring is averaged [m]."""
FAR_END = 0.05
"""Length at the far end of an L-box over which the depth is averaged [m]."""


def measured(vessel: Vessel, spheres: np.ndarray, velocity: np.ndarray) -> dict[str, float]:
    """Return the measured columns of one sample, by name.

    `spheres` has rows of centre and radius [m], shape (n, 4), n > 0; the first three columns of `velocity` are their
    velocities [m/s]. Speeds are those of the main body, because a stray aggregate may roll for a long time.
    """
    spheres = spheres.astype(float)
    speed = np.linalg.norm(velocity[:, :3].astype(float), axis=1)
    size = vessel.dimensions
    found: dict[str, float]
    if vessel.test == "funnel":
        here = (spheres[:, 2] > 0) & (spheres[:, 2] < 2 * size["whole_height"])
        volume = spheres[:, 3] ** 3
        narrow, deep = size["outlet_width"] / 2, size["breadth"] / 2
        found = {
            "screen": shadow(spheres[here], narrow, deep, min(narrow, deep) / 16),
            "inside": float(volume[here].sum() / volume.sum()),
        }
    else:
        here = main_body(spheres)
        body = spheres[here]
        if vessel.test in HEAPS:
            # The height is averaged over half the diameter of the mould's top, where a stiff heap stays level.
            found = {"top": height_of_top(body, size["top_diameter"] / 4), "spread": spread(body)}
            if vessel.test == "jring":
                ring = 0.5 * (size["ring_diameter"] + size["bar_diameter"])
                found["outside"] = height_around(body, ring, ring + BESIDE)
        else:
            found = _box(body, size)
    moving = speed[here] if here.any() else np.zeros(1)
    return found | {
        "main_body": float(np.mean(here)),
        "fastest": float(moving.max()),
        "mean_speed": float(np.sqrt(np.mean(moving**2))),
    }


def _box(spheres: np.ndarray, size: Any) -> dict[str, float]:
    """Return the depths behind the gate and at the far end of an L-box, and the front's distance from the gate [m]."""
    gate, half = size["column_width"], size["width"] / 2
    return {
        "near_depth": height_at(spheres, (0.5 * gate, gate), (-half, half)),
        "far_depth": height_at(spheres, (size["length"] - FAR_END, size["length"]), (-half, half)),
        "front": max(float((spheres[:, 0] + spheres[:, 3]).max()) - gate, 0.0),
    }


def at_rest(vessel: Vessel, rows: Sequence[dict[str, float]]) -> bool:
    """Return whether the main body has been slow for `RESTED` seconds since its release; always False for a funnel."""
    now = rows[-1]["time"]
    if vessel.test == "funnel" or now < vessel.opened + RESTED:
        return False
    return all(row["fastest"] < vessel.rest_speed for row in rows if row["time"] > now - RESTED - 1e-9)


def is_over(vessel: Vessel, rows: Sequence[dict[str, float]]) -> bool:
    """Return whether the test is over: the concrete is at rest, or light is seen through the funnel."""
    if "screen" not in rows[-1]:
        return at_rest(vessel, rows)
    return rows[-1]["screen"] < LIGHT and rows[-1]["time"] > vessel.opened


def _of(of: Any, *tests: str) -> Any:
    """Return a function that evaluates `of` for runs of the given tests and returns None for all other runs."""
    return lambda k: of(k) if k.scene.vessel is not None and k.scene.vessel.test in tests else None


def _last(name: str) -> Any:
    return lambda k: float(k.series[name][-1])


def _ratio(k: Any) -> float | None:
    near = float(k.series["near_depth"][-1])
    return float(k.series["far_depth"][-1]) / near if near > 0 else None


QUANTITIES = (
    Quantity("slump", "m", _of(lambda k: float(k.series["top"][0] - k.series["top"][-1]), *HEAPS), "slump", None,
             True),
    Quantity("fill_height", "m", _of(lambda k: float(k.series["top"][0]), *HEAPS), "height at the start"),
    Quantity("spread", "m", _of(_last("spread"), *HEAPS), "spread", None, True),
    Quantity("t500", "s", _of(lambda k: passage_time(k.series, "spread", T500), *HEAPS), "T500", None, True),
    Quantity("blocking_step", "m", _of(lambda k: float(k.series["top"][-1] - k.series["outside"][-1]), "jring"),
             "blocking step", None, True),
    Quantity("funnel_time", "s", _of(lambda k: passage_time(k.series, "screen", LIGHT, True), "funnel"), "funnel time",
             None, True),
    Quantity("remaining", "1", _of(_last("inside"), "funnel"), "remaining",
             lambda run: f"{100 * run.result['remaining']:.1f} %"),
    Quantity("passing_ratio", "1", _of(_ratio, "lbox"), "H2/H1", None, True),
    Quantity("h1", "m", _of(_last("near_depth"), "lbox"), "H1"),
    Quantity("h2", "m", _of(_last("far_depth"), "lbox"), "H2"),
    Quantity("t200", "s", _of(lambda k: passage_time(k.series, "front", 0.2), "lbox"), "T200", None, True),
    Quantity("t400", "s", _of(lambda k: passage_time(k.series, "front", 0.4), "lbox"), "T400", None, True),
    Quantity("rest_speed", "m/s", lambda k: None if k.scene.vessel is None else float(k.series["fastest"][-1])),
    Quantity("strays", "1", lambda k: None if k.scene.vessel is None or k.scene.vessel.test == "funnel"
             else 1 - float(k.series["main_body"][-1])),
)  # fmt: skip
"""Results of the tests.

The slump is the difference of the heights at the start and at the end, measured in the same way. The roughness of the
surface and the settlement of the concrete in the mould therefore do not count as slump.
"""
