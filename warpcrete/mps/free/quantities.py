"""Result quantities of standard tests, under the names of their standards."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.run.method import Quantity, passage_time
from ...core.run.run_loop import Run
from ...core.units import number
from ...geometry.sections import section_area
from ...theory.vessels import box_at_rest, funnel_time, heap_at_rest, long_heap_spread, tall_cone_slump
from ..grid.geometry import polygon_distance, wall_distance
from ..quantities import largest
from .scene import FreeScene, Points

T500 = 0.5
"""Spread at which T500 is measured [m] (EN 12350-8)."""
SAMPLES = 30
"""Number of sample points along each axis for the part of the concrete's initial space that walls occupy."""
LIGHT = 0.5
"""Filled fraction of a funnel's middle below which light is seen through the funnel."""


@dataclass(frozen=True)
class Known:
    """Scene, series and volume from which the quantities of a test are computed."""

    scene: FreeScene
    series: dict[str, np.ndarray]
    """Columns of the time series, with two rows or more."""
    volume: float
    """Initial volume of the concrete [m3], in a plane per metre of depth and about an axis per radian."""

    @property
    def is_slump(self) -> bool:
        """True for a slump test: a cone on a plate."""
        return self.scene.test == "slump"

    @property
    def is_funnel(self) -> bool:
        """True for a V-funnel test."""
        return self.scene.test == "funnel"

    @property
    def is_box(self) -> bool:
        """True for an L-box test."""
        return self.scene.test == "lbox"

    @property
    def cone(self) -> tuple[float, float, float]:
        """Top radius, base radius and height of the slump cone [m]."""
        corners = np.array(self.scene.outline)
        height = float(corners[:, 1].max())
        top = float(corners[corners[:, 1] == height, 0].max())
        return top, float(corners[:, 0].max()), height

    def last(self, name: str) -> float:
        """Return the last value of a column."""
        return float(self.series[name][-1])


def _slump(k: Known) -> float | None:
    return k.cone[2] - k.last("top") if k.is_slump else None


def _slump_of_theory(k: Known) -> float | None:
    if not k.is_slump:
        return None
    concrete = k.scene.concrete
    return tall_cone_slump(*k.cone, concrete.yield_stress, concrete.density, k.scene.gravity)


def _spread_of_theory(k: Known) -> float | None:
    concrete = k.scene.concrete
    if not k.is_slump or concrete.yield_stress == 0:
        return None
    whole = 2 * math.pi * k.volume
    return long_heap_spread(whole, concrete.yield_stress, concrete.density, k.scene.gravity)


def _heap(k: Known) -> tuple[float, float] | None:
    """Return radius and depth of a heap that resists being stretched [m]; None unless it is wider than high."""
    concrete = k.scene.concrete
    if not k.is_slump or concrete.yield_stress == 0:
        return None
    whole = 2 * math.pi * k.volume
    reach, depth = heap_at_rest(whole, concrete.yield_stress, concrete.density, k.scene.gravity)
    return (reach, depth) if reach > depth else None


def _spread_of_heap(k: Known) -> float | None:
    found = _heap(k)
    return 2 * found[0] if found else None


def _slump_of_heap(k: Known) -> float | None:
    found = _heap(k)
    return k.cone[2] - found[1] if found else None


def funnel_estimate(scene: FreeScene) -> float | None:
    """Return the time in which a funnel empties by closed forms [s]; None if the yield stress holds the concrete."""
    size, concrete = scene.dimensions, scene.concrete
    halves = (size["outlet_width"] / 2, size["top_width"] / 2)
    heights = (size["outlet_height"], size["outlet_height"] + size["cone_height"])
    time = funnel_time(halves, heights, size["breadth"], concrete.viscosity, concrete.yield_stress, concrete.density,
                       scene.gravity)  # fmt: skip
    return time if math.isfinite(time) else None


def _ratio(k: Known) -> float | None:
    return k.last("far_depth") / k.last("near_depth") if k.is_box and k.last("near_depth") > 0 else None


def _ratio_of_theory(k: Known) -> float | None:
    if not k.is_box:
        return None
    concrete, width = k.scene.concrete, k.scene.dimensions["width"]
    whole = k.volume * width / k.scene.depth
    near, far, _ = box_at_rest(whole, k.scene.width, width, concrete.yield_stress, concrete.density, k.scene.gravity)
    return far / near


def _with_time(name: str, form: str):
    def words(run: Run) -> str:
        theory = run.result.get(f"{name}_theory")
        beside = f"   ({form}: {number(theory):.2f} s)" if theory else ""
        return f"{number(run.result[name]):.2f} s{beside}"

    return words


def _ratio_words(run: Run) -> str:
    return f"{run.result['passing_ratio']:.2f}   (slow flow, no bars: {run.result['passing_ratio_theory']:.2f})"


def _with_theory(name: str, **forms: str):
    def words(run: Run) -> str:
        found = [(form, run.result.get(f"{name}_{key}")) for key, form in forms.items()]
        beside = ", ".join(f"{form}: {1e3 * number(theory):.0f} mm" for form, theory in found if theory)
        return f"{1e3 * number(run.result[name]):.1f} mm" + (f"   ({beside})" if beside else "")

    return words


QUANTITIES = (
    Quantity("slump", "m", _slump, "slump", _with_theory("slump", theory="tall cone", heap="heap"), True),
    Quantity("slump_theory", "m", _slump_of_theory),
    Quantity("slump_heap", "m", _slump_of_heap),
    Quantity("spread", "m", lambda k: k.last("spread") if k.is_slump else None, "spread",
             _with_theory("spread", heap="heap", theory="long heap"), True),
    Quantity("spread_theory", "m", _spread_of_theory),
    Quantity("spread_heap", "m", _spread_of_heap),
    Quantity("t500", "s", lambda k: passage_time(k.series, "spread", T500) if k.is_slump else None, "T500", None, True),
    Quantity("funnel_time", "s", lambda k: passage_time(k.series, "screen", LIGHT, True) if k.is_funnel else None,
             "funnel time", _with_time("funnel_time", "row of ducts"), True),
    Quantity("funnel_time_theory", "s", lambda k: funnel_estimate(k.scene) if k.is_funnel else None),
    Quantity("remaining", "1", lambda k: k.last("inside") if k.is_funnel else None, "remaining",
             lambda run: f"{100 * run.result['remaining']:.1f} %"),
    Quantity("passing_ratio", "1", _ratio, "H2/H1", _ratio_words, True),
    Quantity("passing_ratio_theory", "1", _ratio_of_theory),
    Quantity("h1", "m", lambda k: k.last("near_depth") if k.is_box else None, "H1"),
    Quantity("h2", "m", lambda k: k.last("far_depth") if k.is_box else None, "H2"),
    Quantity("t200", "s", lambda k: passage_time(k.series, "front", 0.2) if k.is_box else None, "T200", None, True),
    Quantity("t400", "s", lambda k: passage_time(k.series, "front", 0.4) if k.is_box else None, "T400", None, True),
    Quantity("rest_speed", "m/s", lambda k: k.last("fastest")),
    Quantity("volume_error", "1", lambda k: largest(k.series["volume_error"])),
)  # fmt: skip


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield lines of the report that go beyond the quantities: published values, and a flow that is not at rest."""
    for name, value in run.scene.published.items():
        if name in run.result:
            yield f"{name}, Xu", f"{1e3 * value:.0f} mm printed (Xu, Li & Jiang 2021)"
    if run.finished and not run.result["at_rest"] and "funnel_time" not in run.result:
        yield "not at rest", f"{1e3 * number(run.result['rest_speed']):.2g} mm/s at {run.series['time'][-1]:.3g} s"


def expected(scene: FreeScene) -> dict[str, float]:
    """Return the quantities of a test by closed forms.

    The slump is calculated for a wide heap if the heap is wider than high, else for a tall cone.
    """
    known = Known(scene, {}, start_volume(scene))
    closed = {each.name: each.of(known) for each in QUANTITIES if each.name.endswith(("_theory", "_heap"))}
    found = {
        "slump": closed["slump_heap"] or closed["slump_theory"],
        "spread": closed["spread_heap"],
        "funnel_time": closed["funnel_time_theory"],
        "passing_ratio": closed["passing_ratio_theory"],
    }
    return {name: float(value) for name, value in found.items() if value is not None}


def start_volume(scene: FreeScene) -> float:
    """Return the initial volume of the concrete [m3].

    About an axis the volume is that per radian, in a plane that per metre of depth, in space the whole.
    """
    held = (*scene.blocks, scene.gate) if scene.gate else scene.blocks
    area = section_area(scene.outline, held, width=scene.width, height=scene.height, axial=scene.axial)
    return area * (scene.depth or 1.0) * _free_part(scene, held)


def _free_part(scene: FreeScene, held: Sequence[Points]) -> float:
    """Return the fraction of the concrete's initial space that three-dimensional walls leave free."""
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
