"""Result quantities of flows with a free surface."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...geometry.sections import section_area
from ...standards import Outcome, StandardTest
from ...standards.standard_test import FASTEST, MOST, quantities_of_tests, report_unrest
from ..common.run import largest
from ..grid.distances import polygon_distance, wall_distance
from ..grid.geometry import MIRROR
from .scene import FreeScene, Points

SAMPLES = 30
"""Number of sample points along each axis of a space with walls. The share of points outside the walls is the free
fraction of the space."""


def outcome(scene: FreeScene, series: Mapping[str, np.ndarray], volume: float) -> Outcome | None:
    """Return the data from which the results of a scene's standard test are computed; None if the scene has no test.

    `volume` is the initial volume of the concrete [m3]; in plane flow per metre of depth, in axisymmetric flow per
    radian.
    """
    concrete = dict(concrete=scene.whole_concrete, density=scene.whole_concrete.density)
    weight = dict(gravity=scene.gravity, whole=whole_volume(scene, volume))
    return Outcome(scene.test, scene.dimensions, series, **concrete, **weight) if scene.test else None


def whole_volume(scene: FreeScene, simulated: float) -> float:
    """Return the volume of all concrete of a scene [m3], or per metre of depth in a plane [m2].

    `simulated` is the volume of the simulated concrete. In axisymmetric flow, this is the volume per radian. In a
    three-dimensional flow, each plane of symmetry halves the simulated volume.
    """
    return simulated * (2 * math.pi if scene.axial else 2 ** _mirrors(scene))


@dataclass(frozen=True)
class RunData:
    """Data of a run from which its results are computed: scene, series with two rows or more, and initial volume."""

    scene: FreeScene
    series: dict[str, np.ndarray]
    volume: float


QUANTITIES = (
    Quantity("rest_speed", "m/s", lambda k: float(k.series[MOST if MOST in k.series else FASTEST][-1]),
             meaning="Speed at the end that no part of the concrete exceeds (in an L-box, nine tenths of it)"),
    Quantity("volume_error", "1", lambda k: largest(k.series["volume_error"]),
             meaning="Largest relative change of the volume of the concrete"),
)  # fmt: skip
"""Result quantities that every flow with a free surface has, with or without a standard test."""


def quantities() -> tuple[Quantity, ...]:
    """Return all result quantities of free-surface flows, including results of standard tests and of closed forms."""
    tests = quantities_of_tests(StandardTest.with_forms, lambda k: outcome(k.scene, k.series, k.volume))
    return (*tests, *QUANTITIES)


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield further lines of the report as pairs (label, text).

    The lines contain published values, and a note if the concrete is not at rest.
    """
    for name, value in run.scene.published.items():
        if name in run.result:
            yield f"{name}, Xu", f"{1e3 * value:.0f} mm printed (Xu, Li & Jiang 2021)"
    yield from report_unrest(run, run.scene.test)


def expected(scene: FreeScene) -> dict[str, float]:
    """Return the results that closed-form solutions predict for the scene's standard test; empty without a test."""
    known = outcome(scene, {}, start_volume(scene))
    return known.test.estimates(known) if known else {}


def start_volume(scene: FreeScene) -> float:
    """Return the initial volume of the concrete [m3].

    In axisymmetric flow the volume is per radian, in plane flow per metre of depth, and in three dimensions the full
    volume.
    """
    held = (*scene.blocks, scene.gate) if scene.gate else scene.blocks
    area = section_area(scene.outline, held, width=scene.width, height=scene.height, axial=scene.about_axis)
    if scene.round:
        return area * 2 * math.pi / 2 ** _mirrors(scene)
    return area * (scene.depth or 1.0) * _free_part(scene, held)


def _mirrors(scene: FreeScene) -> int:
    """Return the number of planes of symmetry at the sides of the simulated space."""
    return list(scene.sides.values()).count(MIRROR)


def _free_part(scene: FreeScene, held: Sequence[Points]) -> float:
    """Return the fraction of the concrete's initial outline that the three-dimensional walls of the scene leave free.

    The fraction refers to the volume inside the outline and outside the polygons `held` (blocks and gate).
    """
    if not scene.walls:
        return 1.0
    (left, low), (right, high) = scene.extent
    across = (np.arange(SAMPLES) + 0.5) / SAMPLES
    corner, size = np.array([left, 0.0, low]), np.array([right - left, scene.depth, high - low])
    points = corner + size * np.stack(np.meshgrid(across, across, across, indexing="ij"), -1).reshape(-1, 3)
    inside = polygon_distance(scene.outline)(points) < 0
    for polygon in held:
        inside &= polygon_distance(polygon)(points) > 0
    points = points[inside]
    free = np.ones(len(points), bool)
    for wall in scene.walls:
        free &= wall_distance(wall, np.array(scene.amid))(points) > 0
    return float(free.mean()) if len(points) else 1.0
