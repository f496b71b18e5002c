"""The numbers that a standard test comes to, as its standard calls them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...core.method import Quantity
from ...core.run_loop import Run
from ...core.units import number
from .scene import FreeScene
from .theory import long_heap_spread, tall_cone_slump

T500 = 0.5
"""Spread whose time is told [m] (EN 12350-8)."""


@dataclass(frozen=True)
class Known:
    """What there is to know of a test when its quantities are worked out."""

    scene: FreeScene
    series: dict[str, np.ndarray]
    """Two rows or more."""
    volume: float
    """Of the concrete, of a radian or a metre's depth."""

    @property
    def is_slump(self) -> bool:
        """A cone on a plate."""
        return self.scene.test == "slump"

    @property
    def cone(self) -> tuple[float, float, float]:
        """Radii at top and base, and height [m]."""
        corners = np.array(self.scene.outline)
        height = float(corners[:, 1].max())
        top = float(corners[corners[:, 1] == height, 0].max())
        return top, float(corners[:, 0].max()), height

    def last(self, name: str) -> float:
        """Of a column."""
        return float(self.series[name][-1])

    def when(self, name: str, value: float) -> float | None:
        """When a column first passes a value [s]; None if it does not."""
        time, column = self.series["time"], self.series[name]
        past = np.nonzero(column >= value)[0]
        if len(past) == 0 or past[0] == 0:
            return None
        k = past[0]
        part = (value - column[k - 1]) / (column[k] - column[k - 1])
        return float(time[k - 1] + part * (time[k] - time[k - 1]))


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


def _with_theory(name: str, form: str):
    def words(run: Run) -> str:
        theory = run.result.get(f"{name}_theory")
        beside = f"   ({form}: {1e3 * number(theory):.0f} mm)" if theory else ""
        return f"{1e3 * number(run.result[name]):.1f} mm{beside}"

    return words


QUANTITIES = (
    Quantity("slump", "m", _slump, "slump", _with_theory("slump", "tall cone"), True),
    Quantity("slump_theory", "m", _slump_of_theory),
    Quantity("spread", "m", lambda k: k.last("spread") if k.is_slump else None, "spread",
             _with_theory("spread", "long heap"), True),
    Quantity("spread_theory", "m", _spread_of_theory),
    Quantity("t500", "s", lambda k: k.when("spread", T500) if k.is_slump else None, "T500", None, True),
    Quantity("rest_speed", "m/s", lambda k: k.last("fastest")),
    Quantity("volume_error", "1", lambda k: float(max(k.series["volume_error"], key=abs))),
)  # fmt: skip


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Lines about a run besides its quantities."""
    for name, value in run.scene.published.items():
        if name in run.result:
            yield f"{name}, Xu", f"{1e3 * value:.0f} mm printed (Xu, Li & Jiang 2021)"
    if run.finished and not run.result["at_rest"]:
        yield "not at rest", f"{1e3 * number(run.result['rest_speed']):.2g} mm/s at {run.series['time'][-1]:.3g} s"
