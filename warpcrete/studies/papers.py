"""What the two papers report, as cases to run and claims to judge (Zhan et al. 2019; Xu, Li & Jiang 2021)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

FLAT = 0.05
"""Part of their mean by which pressures may differ that a paper calls equal."""
LINEAR = 0.98
"""Of a straight line's fit, the coefficient of determination from which on a course is called linear."""
GROWS = 0.03
"""Part by which a pressure grows at least that a paper calls growing."""

Judge = Callable[[Sequence[float], Sequence[float]], tuple[bool, str]]
"""Of values of a parameter and pressures [Pa]: does the claim hold, and what was found."""


@dataclass(frozen=True)
class Row:
    """A parameter that the paper varies, alone."""

    name: str
    parameter: str
    values: tuple[Any, ...]
    claim: str
    """What the paper says of it."""
    judge: Judge
    base: Mapping[str, Any] = field(default_factory=dict)
    numbers: tuple[float, ...] = ()
    """Values as numbers, where they are words."""
    printed: Mapping[Any, float] = field(default_factory=dict)
    """Largest pressures that the paper's text gives [Pa]."""

    @property
    def is_hydrated(self) -> bool:
        """Has to do with hydrated bonds."""
        return self.parameter.startswith("hydration")

    @property
    def places(self) -> tuple[float, ...]:
        """Values as numbers."""
        return self.numbers or self.values


def flat(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """All are nearly equal."""
    spread = (max(pressures) - min(pressures)) / float(np.mean(pressures))
    return spread < FLAT, f"they differ by {100 * spread:.1f} %"


def linear(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Grows along a straight line."""
    slope, shift = np.polyfit(values, pressures, 1)
    rest = np.asarray(pressures) - (slope * np.asarray(values) + shift)
    fit = 1 - float(rest @ rest) / max(float(np.var(pressures)) * len(pressures), 1e-300)
    growth = (pressures[-1] - pressures[0]) / pressures[0]
    holds = fit > LINEAR and growth > GROWS
    return holds, f"{'+' if growth > 0 else ''}{100 * growth:.0f} % from end to end, straight to R2 = {fit:.3f}"


def growing(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Grows from each value to the next."""
    steps = np.diff(pressures) / pressures[0]
    growth = (pressures[-1] - pressures[0]) / pressures[0]
    return bool(np.all(steps > -FLAT / 5) and growth > GROWS), f"{100 * growth:+.0f} % from end to end"


def narrow(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Equal in wide pipes, far more in the narrowest."""
    level, what = flat(values[2:], pressures[2:])
    growth = pressures[0] / pressures[2] - 1
    holds = level and growth > 0.5
    return holds, f"from 150 mm on {what}; {100 * growth:+.0f} % at {1e3 * values[0]:.0f} mm"


def late(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """The first two equal, then growth."""
    level, what = flat(values[:2], pressures[:2])
    grown, how = growing(values[1:], pressures[1:])
    return level and grown, f"the first two values: {what}; then {how}"


OF_ALL = (narrow, late)
"""Judges that go by single values, so that none may be missing."""

ZHAN = (
    Row("diameter", "diameter", (0.100, 0.125, 0.150, 0.175, 0.200),
        "150, 175 and 200 mm nearly equal, steeply more below", narrow, printed={0.100: 72.99e3, 0.150: 38.58e3}),
    Row("elbow radius", "elbow_radius", (0.25, 0.5, 0.75, 1.0), "largest pressures nearly equal", flat),
    Row("aggregate size", "size_max", (10e-3, 20e-3, 40e-3, 60e-3),
        "5-10 and 5-20 mm equal, then growing", late),
    Row("shape factor", "shapes", ("shape-1.5", "shape-2.5", "shape-3.5", "shape-4.5"),
        "linear in the shape factor", linear, numbers=(1.5, 2.5, 3.5, 4.5)),
    Row("velocity", "velocity", (0.1, 0.3, 0.5, 0.7, 0.9), "about linear in velocity", linear),
    Row("hydrated fraction", "hydration", (0.0, 0.05, 0.10, 0.15, 0.20), "grows with the fraction (at 1e9 Pa)", growing,
        base={"hydration_modulus": 1e9}),
    Row("hydrated modulus", "hydration_modulus", (2e4, 1e6, 1e7, 1e8, 1e9), "grows with the stiffness (at 20 %)",
        growing, base={"hydration": 0.2}),
)  # fmt: skip
"""Section 5 of Zhan et al. 2019, on unit D; pressures are the largest of a run."""
SMALLEST = {10e-3: 5e-3, 20e-3: 5e-3, 40e-3: 10e-3, 60e-3: 10e-3}
"""Of aggregates, by their largest [m]."""
UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
PRINTED = {"vertical": (38.93e3, 35e3), "horizontal": (15.69e3, 12e3), "bend-to-horizontal": (None, None),
           "bend-to-vertical": (38.58e3, None)}  # fmt: skip
"""Largest pressure and that at the end, of the units [Pa]."""
PRINTED_TRAVEL = {"vertical": 0.08, "horizontal": 0.10}
"""Travel of the piston at the largest pressure [m]."""
PIPELINES = {"Burj Khalifa": (576.0, 83.0, 21.15e6, 17.1e6), "Shanghai Tower": (582.0, 150.0, 22.17e6, 23.4e6)}
"""Metres up and along, the paper's prediction and what was recorded [Pa]."""

UNITS_ROW = "units"
"""Name by which the four units are chosen."""

CONCRETES: dict[str, dict[str, Any]] = {
    "literal": {"concrete": "zhan-table1"},
    "calibrated": {"concrete": "zhan"},
    "stiff stones": {"concrete": "zhan", "modulus": 1e7, "solid_fraction": 0.62, "layer_viscosity": 1660.0},
}
"""The paper's Table 1; with layer and friction of the wall calibrated on A and B; the same with stones of 1e7 Pa,
loosely packed, for which the layer is another (and the friction the same)."""

OPEN: dict[str, tuple[dict[str, Any], tuple[str, ...], str]] = {
    "equal fraction": ({"solid_fraction": 0.70}, ("units", "diameter", "aggregate size", "shape factor"),
        "packed to a solid fraction of 0.70 for every pipe, sizes and shapes; the reference mix has this fraction at "
        "the plug's pressure"),
    "yielding layer": ({"layer_viscosity": 0.0, "layer_yield": 357.0}, ("units", "velocity"),
        "the layer's stress at 0.3 m/s as a yield stress of 357 Pa, at every speed"),
    "half yielding layer": ({"layer_viscosity": 595.0, "layer_yield": 178.5}, ("units", "velocity"),
        "the same stress at 0.3 m/s, half of it as a yield stress"),
    "faceted pipe": ({"wall": "mesh", "facets": 64}, ("units",), "a pipe of 64 facets instead of the exact one"),
    "longer plug": ({"plug_layers": 12}, ("units",), "a plug of twelve layers of balls instead of two (six in bends)"),
}  # fmt: skip
"""What the paper does not say, by name: parameters beside those of the calibrated concrete, which rows are run with
them, and in words. Nothing is fitted again: A and B may move."""
COARSE = dict(shapes="spheres", size_min=15e-3, size_max=40e-3)
"""What --quick runs instead of clumps of 5 to 20 mm."""


def zhan_case(row: Row, value: Any, quick: bool) -> dict[str, Any]:
    """Parameters of unit D at a value of a row."""
    case: dict[str, Any] = {"unit": "bend-to-vertical", "shapes": "reference", **(COARSE if quick else {})}
    case |= dict(row.base) | {row.parameter: value}
    if row.parameter == "size_max":
        case["size_min"] = SMALLEST[value]
    return case


def overrides(name: str) -> dict[str, Any]:
    """Parameters of a column of the report: a concrete, or the calibrated one with something open varied."""
    return CONCRETES[name] if name in CONCRETES else {**CONCRETES["calibrated"], **OPEN[name][0]}


def rows_of(name: str) -> tuple[str, ...]:
    """Names of what a column is run with."""
    return OPEN[name][1] if name in OPEN else (UNITS_ROW, *(row.name for row in ZHAN))


XU_CONCRETES = ("no1", "no2", "no3")
XU_FLOWS = (500e-6, 1000e-6, 1500e-6, 2000e-6)
"""[m3/s]"""
XU_REFERENCE = 1500e-6
XU_SPACINGS = (20e-3, 10e-3, 5e-3)
XU_THICKNESSES = (0.0, 2e-3, 4e-3, 6e-3)
XU_PRINTED = {"pressure": 9.40e3, "slip_velocity": 0.186}
"""Of concrete no. 1 at the reference flow [Pa, m/s]; the paper's own form of theory gives 9.43e3 and 0.186."""


def xu_cases(quick: bool) -> dict[str, list[tuple[str, dict[str, Any]]]]:
    """Scenes and parameters by what they are about; the paper computes planes, the pipe is ours."""
    column = {"length": 0.3, "diameter": 0.1}
    flows = XU_FLOWS[1::2] if quick else XU_FLOWS
    scenes = ("channel",) if quick else ("channel", "tube")
    spacing = 10e-3
    return {
        "flow": [(scene, column | {"concrete": name, "flow": flow, "spacing": spacing})
                 for scene in scenes for name in XU_CONCRETES for flow in flows],
        "resolution": [("channel", column | {"concrete": "no1", "flow": XU_REFERENCE, "spacing": each})
                       for each in XU_SPACINGS[: 2 if quick else None]],
        "slip layer": [("channel", column | {"concrete": "no1", "flow": XU_REFERENCE, "spacing": spacing,
                                             "slip_thickness": each}) for each in XU_THICKNESSES],
        "two phases": [("channel", column | {"concrete": name, "flow": XU_REFERENCE, "spacing": 5e-3,
                                             "aggregates": True, "duration": 0.1})
                       for name in (XU_CONCRETES[:1] if quick else XU_CONCRETES)],
    }  # fmt: skip
