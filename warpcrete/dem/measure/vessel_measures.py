"""Measurements in standard tests of fresh concrete, whose concrete consists of spheres in a vessel."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...core.run.method import Quantity
from ...standards import TESTS, Outcome, Specimen, StandardTest
from ...standards.standard_test import is_at_rest, quantities_of_tests
from ..scene.scene import Vessel
from .heaps import height_around, height_at, height_of_top, main_body, shadow, spread

UNITS = {"main_body": "1", "fastest": "m/s", "mean_speed": "m/s"}
"""Units of the columns of the time series that every test in a vessel records."""


def unit_of_column(name: str) -> str | None:
    """Return the unit of a column that a test records, or None if no test has such a column."""
    return next((test.columns[name] for test in TESTS.values() if name in test.columns), UNITS.get(name))


def measured(vessel: Vessel, spheres: np.ndarray, velocity: np.ndarray) -> dict[str, float]:
    """Return the values that a test in a vessel records in one sample, by column name.

    `spheres` has rows of centre and radius [m], shape (n, 4), n > 0. The first three columns of `velocity` are
    the velocities of the same spheres [m/s], shape (n, 3) or wider. Speeds are measured only in the main body of the
    concrete, because a stray aggregate may roll for a long time.
    """
    spheres = spheres.astype(float)
    speed = np.linalg.norm(velocity[:, :3].astype(float), axis=1)
    outflow = vessel.test.outflow
    if outflow is None:
        here = main_body(spheres)
    else:
        here = (spheres[:, 2] > 0) & (spheres[:, 2] < 2 * outflow.height(vessel.dimensions))
    volume, grains = spheres[:, 3] ** 3, spheres[here]
    concrete = Specimen(
        top=lambda radius: height_of_top(grains, radius),
        spread=lambda: spread(grains),
        height_around=lambda inner, outer: height_around(grains, inner, outer),
        depth=lambda low, high, width: height_at(grains, (low, high), (-width / 2, width / 2)),
        front=lambda: float((grains[:, 0] + grains[:, 3]).max()),
        screen=lambda width, breadth: shadow(grains, width / 2, breadth / 2, min(width / 2, breadth / 2) / 16),
        inside=float(volume[here].sum() / volume.sum()),
    )
    moving = speed[here] if here.any() else np.zeros(1)
    return vessel.test.measure(concrete, vessel.dimensions) | {
        "main_body": float(np.mean(here)),
        "fastest": float(moving.max()),
        "mean_speed": float(np.sqrt(np.mean(moving**2))),
    }


def at_rest(vessel: Vessel, rows: Sequence[dict[str, float]]) -> bool:
    """Return whether the main body of a heap has been slow throughout the last second of simulated time.

    `rows` contains the rows of the time series. The result is False until one second has passed since the vessel was
    opened. For a test in which the concrete flows out of a vessel, the result is always False.
    """
    return vessel.test.outflow is None and is_at_rest(rows, vessel.opened, vessel.rest_speed)


def is_over(vessel: Vessel, rows: Sequence[dict[str, float]]) -> bool:
    """Return whether the time series `rows` shows that the concrete is at rest or has flowed out."""
    return at_rest(vessel, rows) or (vessel.test.is_over(rows[-1]) and rows[-1]["time"] > vessel.opened)


def outcome(known: Any) -> Outcome | None:
    """Return the data from which the results of a standard test are computed; None for a run without such a test."""
    vessel, series, fill = known.scene.vessel, known.series, known.scene.fill
    if vessel is None:
        return None
    height = float(series["top"][0]) if "top" in series else None
    concrete = dict(density=fill.filled_density, whole=fill.container.volume) if fill else {}
    gravity = float(np.linalg.norm(known.scene.gravity))
    return Outcome(
        vessel.test, vessel.dimensions, series, height, concrete=vessel.concrete, gravity=gravity, **concrete
    )


def _own(test: StandardTest) -> tuple[Quantity, ...]:
    rest = Quantity(
        "rest_speed",
        "m/s",
        lambda k: k.last("fastest"),
        meaning="Largest speed in the main body of the concrete in a vessel at the end",
    )
    return rest, Quantity(
        "strays",
        "1",
        lambda k: None if test.outflow else 1 - k.last("main_body"),
        meaning="Fraction of the spheres in a vessel that are not in the main body at the end",
    )


def quantities() -> list[Quantity]:
    """Return the definitions of all results of standard tests.

    Each result for which a test has closed-form predictions is followed by these predictions.
    """
    return quantities_of_tests(StandardTest.with_forms, outcome) + quantities_of_tests(_own, outcome)
