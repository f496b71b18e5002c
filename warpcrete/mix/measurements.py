"""Measurements that a mix may state: constants of concrete, mortar and slip layer, and points from instruments."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..core.errors import SceneError, between, one_of, positive, refuse
from ..core.inputs.amounts import amount
from ..core.inputs.limits import check_limit
from ..core.inputs.text_files import errors_located_at
from .points import PUMPED, read_points

UNITS = {"yield_stress": "Pa", "viscosity": "Pa s"}
CONCRETE_UNITS = {**UNITS, "flow_index": "1", "quadratic_viscosity": "Pa s2"}
LAYER_UNITS = {"yield_stress": "Pa", "viscosity": "Pa s/m", "flow_index": "1", "quadratic_viscosity": "Pa s2/m2"}
"""Constants of the slip layer that a mix may state as measured, with their SI units. The last two belong to flow laws
other than Bingham's."""
LARGEST_UNCERTAINTY = 0.9
"""Largest relative uncertainty that a mix may state for a measured constant. The uncertainty band extends by this
fraction of the value upwards and downwards. The band of a slip layer that was fitted to pipe pressures extends by a
factor instead, which may have any size."""
CONTRADICTORY = "contradictory"
"""Value of the entry `gauges` of a slip layer that was fitted to a trial line whose gauges contradict each other."""
SLIPPED = {"speed": "m/s", "stress": "Pa"}
SLIP = {"yield_stress": "slip_yield", "viscosity": "slip_viscosity", "flow_index": "slip_flow_index",
        "quadratic_viscosity": "slip_quadratic_viscosity"}  # fmt: skip
"""Names of the slip layer's constants in a mix, each mapped to the name of the same constant in `core.inputs.limits`,
the table of permitted values."""
SHEARED = {"rate": "1/s", "stress": "Pa"}
"""Columns of points measured with a viscometer, with their SI units."""


@dataclass(frozen=True)
class Measured:
    """Measured constants by name, and one relative uncertainty for all of them; None if the mix does not state it."""

    values: Mapping[str, float] = field(default_factory=dict)
    uncertainty: float | None = None


@dataclass(frozen=True)
class Layer:
    """Measurements of the slip layer that a mix states: constants, points from a pipe, or points from a tribometer.

    A point is a pair: of flow and pressure in a pipe, or of speed and stress in a tribometer.
    """

    constants: Measured | None = None
    pipe_points: tuple[list[float], list[float]] | None = None
    """Flows [m3/s] and pressures [Pa] measured in a pipe with the dimensions `diameter`, `length` and `rise`."""
    diameter: float = 0.0
    """Inner diameter of the pipe [m]."""
    length: float = 0.0
    """Length of the pipe [m]."""
    rise: float = 0.0
    """Height of the pipe's end above its start [m]."""
    tribometer_points: tuple[list[float], list[float]] | None = None
    """Points measured with a tribometer: speeds [m/s] and stresses [Pa]; None if the mix states none."""
    pipe: bool = False
    """True if the constants of the slip layer were fitted to pressures of a pipe, False if a tribometer measured
    them."""
    contradicted: bool = False
    """True if the slip layer was fitted to pressures of a pipe whose gauges contradict each other, so that no slip
    layer explains all of them."""

    @property
    def is_of_this_delivery(self) -> bool:
        """True if the slip layer was fitted to pressures of a trial line, pumped with this delivery of the concrete.

        Such a fit states its uncertainty; a layer from an earlier delivery does not.
        """
        return self.pipe and self.constants is not None and self.constants.uncertainty is not None


def read_constants(name: str, given: object, units: Mapping[str, str], widest: float = LARGEST_UNCERTAINTY) -> Measured:
    """Return the measured constants in the entry `name` of a mix, checked and converted to `units`.

    `widest` is the largest relative uncertainty that is allowed.
    """
    if not isinstance(given, Mapping):
        problem = "must consist of 'key: value' lines"
        refuse(f"mix {name}", given, problem, f"possible keys are {', '.join(units)} and uncertainty")
    for key in given:
        with errors_located_at(given, key):
            one_of(f"mix {name}: key", key, (*units, "uncertainty"))
    values = {}
    for key, unit in units.items():
        if key in given:
            with errors_located_at(given, key):
                values[key] = _constant(name, key, given[key], unit)
    off = None
    if "uncertainty" in given:
        with errors_located_at(given, "uncertainty"):
            off = amount(f"mix {name}: uncertainty", given["uncertainty"], "1")
            hint = "give the uncertainty relative to the values, for example '15 %'"
            between(f"mix {name}: uncertainty", off, 0, widest, "", hint)
    return Measured(values, off)


def _constant(name: str, key: str, given: object, unit: str) -> float:
    """Return the constant `key` in the entry `name` of a mix, checked and converted to `unit`."""
    field = f"mix {name}: {key}"
    value = amount(field, given, unit)
    if key == "yield_stress":
        between(field, value, 0, 1e5, unit)
    else:
        positive(field, value, unit)
    check_limit(field, value, unit, SLIP.get(key, key) if name == "layer" else key)
    return value


def read_layer(given: object, folder: Path) -> Layer:
    """Return the measurements of the slip layer that the entry `layer` of a mix contains.

    The entry contains constants of the layer, flows and pressures measured in a pipe, or speeds and stresses measured
    with a tribometer. Paths of files are relative to `folder`.
    """
    if not isinstance(given, Mapping):
        problem = "must consist of 'key: value' lines"
        refuse("mix layer", given, problem, "for example {yield_stress: 20 Pa, viscosity: 900 Pa s/m}")
    if not given:
        return Layer()
    if "points" in given:
        for key in given:
            with errors_located_at(given, key):
                one_of("mix layer: key", key, ("points", "diameter", "length", "rise"))
        lengths = {}
        for key in ("diameter", "length"):
            if key not in given:
                example = f"for example '{key}: {'125 mm' if key == 'diameter' else '10 m'}'"
                raise SceneError(
                    f"mix layer: {key}: is missing; add the {key} of the pipe in which the points were measured, "
                    f"{example}"
                )
            lengths[key] = amount(f"mix layer: {key}", given[key], "m")
            positive(f"mix layer: {key}", lengths[key], "m")
            check_limit(f"mix layer: {key}", lengths[key], "m", key)
        lengths["rise"] = amount("mix layer: rise", given.get("rise", 0), "m")
        between(
            "mix layer: rise",
            lengths["rise"],
            -lengths["length"],
            lengths["length"],
            "m",
            "'rise' is the height of the pipe's end above its start",
        )
        return Layer(pipe_points=read_pairs("layer: points", given["points"], PUMPED, folder), **lengths)
    if "tribometer" in given:
        for key in given:
            one_of("mix layer: key", key, ("tribometer",))
        return Layer(tribometer_points=read_pairs("layer: tribometer", given["tribometer"], SLIPPED, folder))
    source = given.get("from", "tribometer")
    one_of("mix layer: from", source, ("tribometer", "pipe"))
    if "gauges" in given:
        one_of("mix layer: gauges", given["gauges"], (CONTRADICTORY,))
        if source != "pipe":
            refuse("mix layer: gauges", given["gauges"], "is allowed only with 'from: pipe'", "add 'from: pipe'")
    own = {key: value for key, value in given.items() if key not in ("from", "gauges")}
    constants = read_constants("layer", own, LAYER_UNITS, math.inf if source == "pipe" else LARGEST_UNCERTAINTY)
    if not set(UNITS) <= set(constants.values):
        problem = "must have 'yield_stress' and 'viscosity', or 'points', or 'tribometer'"
        refuse("mix layer", dict(given), problem, "for example {yield_stress: 20 Pa, viscosity: 900 Pa s/m}")
    return Layer(constants, pipe=source == "pipe", contradicted="gauges" in given)


def read_pairs(name: str, given: object, columns: Mapping[str, str], folder: Path) -> tuple[list[float], list[float]]:
    """Return the two columns of measured points, each as a list of numbers in SI units.

    `given` is the path of a CSV file relative to `folder`, or a list of pairs of numbers, which may have units. Raises
    :class:`SceneError` for an impossible value, or if the first column has fewer than two different values.
    """
    if isinstance(given, str):
        one, other = read_points(folder / given, columns, f"mix {name}")
    else:
        words = " and ".join(f"{each} [{unit}]" for each, unit in columns.items())
        if not isinstance(given, Sequence) or not all(isinstance(p, Sequence) and len(p) == 2 for p in given):
            refuse(f"mix {name}", given, f"must be a list of pairs of {words}, or the path of a .csv file")
        (x, x_unit), (y, y_unit) = columns.items()
        one = [amount(f"mix {name}: {x}", pair[0], x_unit) for pair in given]
        other = [amount(f"mix {name}: {y}", pair[1], y_unit) for pair in given]
    for column, values in zip(columns, (one, other), strict=True):
        if min(values, default=0.0) < 0:
            problem = f"must be 0 or more {columns[column]}"
            hint = "write positive values, also if the instrument turned backwards"
            refuse(f"mix {name}: {column}", min(values), problem, hint)
    if len(set(one)) < 2:
        refuse(
            f"mix {name}",
            f"{len(one)} point{'s' if len(one) != 1 else ''} at one {next(iter(columns))}",
            f"must have points at two or more different values of '{next(iter(columns))}'",
            "add points that were measured at other values",
        )
    return one, other
