"""`warpcrete theory`: the closed form of a Bingham fluid with a slip layer."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..core.amounts import amount
from ..core.errors import SceneError, positive, refuse
from ..core.parameters import Field, declared_fields, resolved
from ..mps.column import FLOW, ColumnParameters, ConcreteParameters
from ..mps.mixes import CONSTANTS, concrete_of, file_constants
from ..mps.theory import Concrete, Line, restart_table, slip_constants, steady, table

THIXOTROPY = 0.5
"""A_thix of a concrete between those that stiffen and those that stiffen strongly (Roussel 2006) [Pa/s]."""
LINE = ("length", "rise", "gravity")
"""Fields of a line that have the same name there and here; its radius is half of the diameter."""


def fields() -> dict[str, Field]:
    """Parameters by name: those of the scenes `channel` and `tube` as far as the closed form knows them."""
    pipe = {"diameter": declared_fields(ColumnParameters)["diameter"]}
    return {**declared_fields(ConcreteParameters), **pipe, **{name: declared_fields(Line)[name] for name in LINE}}


def run(
    given: dict[str, Any], flows: tuple[float, ...], pressures: tuple[float, ...], fit: Path | None = None,
    rest: float | None = None, thixotropy: float | None = None,
) -> None:  # fmt: skip
    """Print the table for the parameters `given`, others at their defaults; with `fit`, a file of points that were
    measured, for the slip layer that they ask for; with `rest` [s] the restart after it, too."""
    growth = growth_of(rest, thixotropy)
    known = fields()
    values = {name: field.default for name, field in known.items()} | resolved(known, given)
    values |= {name: value for name, value in file_constants(values).items() if values[name] is None}
    for name, field in known.items():
        field.check(values[name], name)
    thickness = values["slip_thickness"]
    constants = {name: values[name] for name in CONSTANTS}
    if fit is not None:  # what is looked for need not be given
        constants |= {name: constants[name] or 1.0 for name in ("slip_viscosity", "slip_yield")}
    concrete = concrete_of(values["concrete"], **constants)
    line = Line(radius=values["diameter"] / 2, slip_thickness=thickness, **{name: values[name] for name in LINE})
    if fit is not None:
        measured = read_points(fit)
        concrete = _fitted(concrete, line, *measured)
        flows = flows or tuple(measured[0])
    tables = [table(concrete, line, flows or (() if pressures else (FLOW,)), pressures)]
    if rest is not None:
        tables += [restart_table(concrete, line, rest, growth, each) for each in flows or (FLOW,)]
    click.echo("\n\n".join(tables))


def growth_of(rest: float | None, thixotropy: float | None) -> float:
    """A_thix [Pa/s], that given or a usual one; refused without a rest."""
    if thixotropy is not None and rest is None:
        refuse("thixotropy", thixotropy, "means nothing without rest", "--rest 600")
    return THIXOTROPY if thixotropy is None else thixotropy


def _fitted(concrete: Concrete, line: Line, flows: list[float], pressures: list[float]) -> Concrete:
    """The concrete with the slip layer that measured points ask for; prints how well it meets them."""
    slope, offset = slip_constants(concrete, line, flows, pressures)
    if slope <= 0 or offset < 0:
        raise SceneError(
            f"fit: the points ask for a slip layer of {slope:.4g} Pa s/m and {offset:.4g} Pa, which none has; look at "
            "length, rise and diameter, and at viscosity and yield stress, whose shear is taken off the flows"
        )
    found = replace(concrete, slip_viscosity=slope, slip_yield=offset)
    off = [steady(found, line, flow).pressure / pressure - 1 for flow, pressure in zip(flows, pressures)]
    click.echo(f"fitted to {len(flows)} points: --slip-viscosity {slope:.5g} --slip-yield {offset:.5g}; the closed "
               f"form is then off by {100 * min(off):+.2g} to {100 * max(off):+.2g} %\n")  # fmt: skip
    return found


def read_points(path: Path) -> tuple[list[float], list[float]]:
    """Flows [m3/s] and pressures [Pa] of a CSV file whose header names both, with units: `flow [m3/h],pressure [bar]`.

    Raises :class:`SceneError` for a file without them.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        refuse("fit", str(path), f"cannot be read ({error})", "give a CSV file")
    heads = [re.fullmatch(r"\s*(\w+)\s*(?:\[([^\[\]]+)\])?\s*", head) for head in (rows[0] if rows else [])]
    places = {head[1]: (place, head[2] or "") for place, head in enumerate(heads) if head is not None}
    found = []
    for name, unit in (("flow", "m3/s"), ("pressure", "Pa")):
        if name not in places:
            refuse(
                "fit", str(path), f"has no column {name!r}", "its first line must be as 'flow [m3/h],pressure [bar]'"
            )
        place, own = places[name]
        column = {k: row[place] if place < len(row) else "" for k, row in enumerate(rows[1:], 2) if row}
        fields = {k: f"{path.name}, line {k}: {name}" for k in column}
        found.append([amount(fields[k], f"{text.strip()} {own}".strip(), unit) for k, text in column.items()])
        for field, value in zip(fields.values(), found[-1], strict=True):
            positive(field, value, unit, "leave points at rest out")
    return found[0], found[1]
