"""Results of two papers (Zhan et al. 2019; Xu, Li & Jiang 2021), as cases to run and claims to judge."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.records import SceneArguments

EQUAL_SPREAD = 0.05
"""Relative spread (range over mean) up to which pressures count as equal."""
MIN_DETERMINATION = 0.98
"""Coefficient of determination of a straight line's fit above which a relation counts as linear."""
MIN_GROWTH = 0.03
"""Increase of the pressure from the first to the last parameter value, divided by the pressure at the first value,
above which the pressure counts as growing."""

Judge = Callable[[Sequence[float], Sequence[float]], tuple[bool, str]]
"""Function that judges a claim of a paper. Its arguments are the values of a parameter and the pressure at each value
[Pa]. It returns whether the claim holds, and a short text on what was found."""


@dataclass(frozen=True)
class Row:
    """Variation of one parameter in a paper, with the paper's claim about its effect; a row of the report."""

    name: str
    """Name of the parameter variation in the report and in the option `--only`."""
    parameter: str
    """Name of the varied parameter of the scene function."""
    values: tuple[Any, ...]
    claim: str
    """Claim of the paper about the effect of the parameter."""
    judge: Judge
    """Function that judges whether the simulated pressures support the claim."""
    base: Mapping[str, Any] = field(default_factory=dict)
    """Further parameters that have the same values in all runs of this variation."""
    numbers: tuple[float, ...] = ()
    """Numbers that replace the entries of `values` in tables and figures if these entries are words; otherwise
    empty."""
    printed: Mapping[Any, float] = field(default_factory=dict)
    """Peak pressures that the text of the paper states, by parameter value [Pa]."""

    @property
    def is_hydrated(self) -> bool:
        """True if the varied parameter is a property of hydrated bonds.

        Hydrated bonds are the stiffer of the two kinds of bonds between elements in the model of Zhan et al.
        """
        return self.parameter.startswith("hydration")

    @property
    def places(self) -> tuple[float, ...]:
        """Values of the varied parameter as numbers, for the axis of a figure.

        If the entries of `values` are words, the result is `numbers`, which holds a number for each word.
        """
        return self.numbers or self.values


def judge_equal(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Return whether the `pressures` at all parameter values are nearly equal, and a short text that describes them."""
    spread = (max(pressures) - min(pressures)) / float(np.mean(pressures))
    return spread < EQUAL_SPREAD, f"they differ by {100 * spread:.1f} %"


def judge_linear(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Return whether the pressure grows along a straight line with the parameter value, and a short text about it."""
    slope, shift = np.polyfit(values, pressures, 1)
    rest = np.asarray(pressures) - (slope * np.asarray(values) + shift)
    fit = 1 - float(rest @ rest) / max(float(np.var(pressures)) * len(pressures), 1e-300)
    growth = (pressures[-1] - pressures[0]) / pressures[0]
    holds = fit > MIN_DETERMINATION and growth > MIN_GROWTH
    return holds, f"{'+' if growth > 0 else ''}{100 * growth:.0f} % from end to end, straight to R2 = {fit:.3f}"


def judge_growing(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Return whether the pressure grows from each parameter value to the next, and a short text on the growth."""
    steps = np.diff(pressures) / pressures[0]
    growth = (pressures[-1] - pressures[0]) / pressures[0]
    return bool(np.all(steps > -EQUAL_SPREAD / 5) and growth > MIN_GROWTH), f"{100 * growth:+.0f} % from end to end"


def judge_narrow(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Judge whether wide pipes need nearly equal pressures, and the narrowest pipe a far higher pressure.

    Return the verdict, and a short text that describes the pressures. `values` holds the diameters [m], from the
    narrowest pipe on. Pipes count as wide from the third diameter on.
    """
    level, what = judge_equal(values[2:], pressures[2:])
    growth = pressures[0] / pressures[2] - 1
    holds = level and growth > 0.5
    return holds, f"from 150 mm on {what}; {100 * growth:+.0f} % at {1e3 * values[0]:.0f} mm"


def judge_late_growth(values: Sequence[float], pressures: Sequence[float]) -> tuple[bool, str]:
    """Return whether pressures first stay nearly equal and then grow, and a short text that describes them.

    The first two pressures must be nearly equal, and the pressures must grow from the second value on.
    """
    level, what = judge_equal(values[:2], pressures[:2])
    grown, how = judge_growing(values[1:], pressures[1:])
    return level and grown, f"the first two values: {what}; then {how}"


NEEDS_ALL_VALUES = (judge_narrow, judge_late_growth)
"""Functions that judge a claim only if the pressures at all values of the varied parameter are known. If one of the
runs is missing, such a function leaves the claim undecided."""

ZHAN = (
    Row("diameter", "diameter", (0.100, 0.125, 0.150, 0.175, 0.200),
        "150, 175 and 200 mm nearly equal, steeply more below", judge_narrow, printed={0.100: 72.99e3, 0.150: 38.58e3}),
    Row("elbow radius", "elbow_radius", (0.25, 0.5, 0.75, 1.0), "largest pressures nearly equal", judge_equal),
    Row("aggregate size", "size_max", (10e-3, 20e-3, 40e-3, 60e-3),
        "5-10 and 5-20 mm equal, then growing", judge_late_growth),
    Row("shape factor", "shapes", ("shape-1.5", "shape-2.5", "shape-3.5", "shape-4.5"),
        "linear in the shape factor", judge_linear, numbers=(1.5, 2.5, 3.5, 4.5)),
    Row("velocity", "velocity", (0.1, 0.3, 0.5, 0.7, 0.9), "about linear in velocity", judge_linear),
    Row("hydrated fraction", "hydration", (0.0, 0.05, 0.10, 0.15, 0.20), "grows with the fraction (at 1e9 Pa)",
        judge_growing,
        base={"hydration_modulus": 1e9}),
    Row("hydrated modulus", "hydration_modulus", (2e4, 1e6, 1e7, 1e8, 1e9), "grows with the stiffness (at 20 %)",
        judge_growing, base={"hydration": 0.2}),
)  # fmt: skip
"""Parameter variations in section 5 of Zhan et al. 2019. They are run on pipe unit D (bend to vertical) and compared by
their peak pressures."""
SMALLEST = {10e-3: 5e-3, 20e-3: 5e-3, 40e-3: 10e-3, 60e-3: 10e-3}
"""Smallest aggregate size [m] in each grading of Zhan et al., by the grading's largest size [m]."""
UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
"""Names of the paper's four pipe units A to D."""
PRINTED = {"vertical": (38.93e3, 35e3), "horizontal": (15.69e3, 12e3), "bend-to-horizontal": (None, None),
           "bend-to-vertical": (38.58e3, None)}  # fmt: skip
"""Peak pressure and final pressure of each pipe unit in the paper [Pa]; None where the paper gives no number."""
PRINTED_TRAVEL = {"vertical": 0.08, "horizontal": 0.10}
"""Distance that the piston has travelled at the peak pressure in the paper [m], by pipe unit."""
PIPELINES = {"Burj Khalifa": (576.0, 83.0, 21.15e6, 17.1e6), "Shanghai Tower": (582.0, 150.0, 22.17e6, 23.4e6)}
"""For each pipeline: vertical and horizontal length [m], pressure predicted in the paper and pressure recorded on site
[Pa]."""

UNITS_ROW = "units"
"""Name of the group of runs through the paper's four pipe units."""

CONCRETES: dict[str, SceneArguments] = {
    "literal": {"concrete": "zhan-table1"},
    "calibrated": {"concrete": "zhan"},
    "stiff stones": {"concrete": "zhan", "modulus": 1e7, "solid_fraction": 0.62, "layer_viscosity": 1660.0},
}
"""Parameters of the concretes in the reproduction.

- "literal" is the concrete of Table 1 of Zhan et al. as printed.
- "calibrated" is the same concrete with a wall layer and wall friction that were calibrated on vertical and horizontal
  pipe (units A and B).
- "stiff stones" has loosely packed stones with a modulus of 1e7 Pa, the same wall friction and another wall layer.
"""

OPEN_ASSUMPTIONS: dict[str, tuple[SceneArguments, tuple[str, ...], str]] = {
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
"""Assumptions about details that Zhan et al. (2019) leave open, by name. Each entry has three elements: parameters that
are added to those of the calibrated concrete, the rows of the report that are run with them, and a description. The
concrete is not calibrated again with the added parameters, so its pressures in the pipe units A and B, to which it was
calibrated, may differ from the paper."""
COARSE = dict(shapes="spheres", size_min=15e-3, size_max=40e-3)
"""Parameters of a quick reproduction, which uses spheres of 15 to 40 mm instead of clumps of 5 to 20 mm."""


def zhan_case(row: Row, value: object, quick: bool) -> SceneArguments:
    """Return the scene parameters of pipe unit D (bend to vertical) with the parameter of `row` set to `value`.

    With `quick`, the concrete consists of coarse spheres instead of clumps (:data:`COARSE`).
    """
    case: SceneArguments = {"unit": "bend-to-vertical", "shapes": "reference", **(COARSE if quick else {})}
    case |= dict(row.base) | {row.parameter: value}
    if row.parameter == "size_max":
        case["size_min"] = SMALLEST[value]
    return case


def column_parameters(name: str) -> SceneArguments:
    """Return the scene parameters that all runs in one column of the report have in common.

    `name` is the name of the column: one of `CONCRETES`, or one of `OPEN_ASSUMPTIONS`, whose parameters are added to
    those of the calibrated concrete.
    """
    return CONCRETES[name] if name in CONCRETES else {**CONCRETES["calibrated"], **OPEN_ASSUMPTIONS[name][0]}


def rows_of(name: str) -> tuple[str, ...]:
    """Return the names of the rows of the report that have results in the column called `name`.

    `name` is one of `CONCRETES` or `OPEN_ASSUMPTIONS`. One row, "units", is for the paper's four pipe units: a vertical
    pipe, a horizontal pipe, and two pipes with a bend. Each other row is for one varied parameter, such as "diameter".
    """
    return OPEN_ASSUMPTIONS[name][1] if name in OPEN_ASSUMPTIONS else (UNITS_ROW, *(row.name for row in ZHAN))


XU_CONCRETES = ("no1", "no2", "no3")
XU_FLOWS = (500e-6, 1000e-6, 1500e-6, 2000e-6)
"""Flow rates in the study of Xu, Li & Jiang 2021 [m3/s]."""
XU_REFERENCE = 1500e-6
"""Flow rate in the study of Xu, Li & Jiang 2021 at which parameters other than the flow are varied [m3/s]."""
XU_SPACINGS = (20e-3, 10e-3, 5e-3)
"""Particle spacings in the resolution study of Xu, Li & Jiang 2021 [m]."""
XU_THICKNESSES = (0.0, 2e-3, 4e-3, 6e-3)
"""Thicknesses of the slip layer in the study of Xu, Li & Jiang 2021 [m]."""
XU_PRINTED = {"pressure": 9.40e3, "slip_velocity": 0.186}
"""Pressure [Pa] and slip velocity [m/s] of concrete no. 1 at the reference flow, as printed in Xu, Li & Jiang (2021).
The closed form in the same paper gives 9.43e3 Pa and 0.186 m/s."""


def xu_cases(quick: bool) -> dict[str, list[tuple[str, SceneArguments]]]:
    """Return the cases of Xu, Li & Jiang (2021), by the name of their group, as pairs of a scene and its parameters.

    The paper computes flow between planes (scene `channel`); the cases in a round pipe (scene `tube`) are an addition.
    With `quick`, the cases in a pipe and some of the other cases are left out.
    """
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
