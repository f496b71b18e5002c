"""Command `warpcrete theory`: the closed-form solution for a yield stress fluid with a slip layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..core.errors import refuse
from ..core.inputs.amounts import amount
from ..core.inputs.limits import check_limit, check_velocity
from ..core.inputs.parameters import Field, declared_fields, resolved
from ..mix.mix import mix_named
from ..mix.points import read_points
from ..mps.column import FLOW, ColumnParameters, ConcreteParameters
from ..mps.mixes import CONSTANTS, concrete_of, file_constants
from ..theory.pipe import Concrete, Line, measured_layer, restart_table, steady, table
from ..theory.segregated import segregation_table

THIXOTROPY = 0.5
"""Default growth rate A_thix of the yield stress at rest [Pa/s], for moderate stiffening (Roussel 2006)."""
LINE = ("length", "rise", "gravity")
"""Fields of a pipeline that are parameters of the command under the same name. The pipeline's radius is half the
parameter `diameter`."""


def fields() -> dict[str, Field]:
    """Return the parameters of the command by name.

    They are those parameters of the scenes `channel` and `tube` that the closed form uses.
    """
    pipe = {"diameter": declared_fields(ColumnParameters)["diameter"]}
    return {**declared_fields(ConcreteParameters), **pipe, **{name: declared_fields(Line)[name] for name in LINE}}


def option_amount(field: str, given: str | None, unit: str) -> float | None:
    """Return the value of an option as a number in `unit`, or None if the option is missing."""
    if given is None:
        return None
    found = amount(field, given, unit)
    check_limit(field, found, unit)
    return found


def option_amounts(field: str, given: Sequence[str], unit: str) -> list[float]:
    """Return the values of a repeatable option as numbers in `unit`."""
    return [found for each in given if (found := option_amount(field, each, unit)) is not None]


def run(
    given: dict[str, Any], flows: Sequence[float], pressures: Sequence[float], fit: Path | None = None,
    rest: float | None = None, thixotropy: float | None = None, segregation: Sequence[float] = (),
    aggregate: float | None = None,
) -> None:  # fmt: skip
    """Print the closed-form solution for the parameters `given`, with defaults for the others.

    With `fit`, a file of measured points, the slip layer is fitted to these points. With `rest` [s], the pressure for a
    restart after that time at rest is added. With `segregation`, the effect of segregation on the pressure is added;
    `aggregate` is the volume fraction of the aggregate.
    """
    growth = growth_of(rest, thixotropy)
    known = fields()
    values = {name: field.default for name, field in known.items()} | resolved(known, given)
    values |= {name: value for name, value in file_constants(values).items() if values[name] is None}
    for name, field in known.items():
        values[name] = field.converted(values[name], name)
        field.check(values[name], name)
        field.check_limits(values[name], name)
    thickness = values["slip_thickness"]
    constants = {name: values[name] for name in CONSTANTS}
    if fit is not None:  # The fit replaces the slip layer's constants, so placeholders stand for missing ones.
        constants |= {name: constants[name] or 1.0 for name in ("slip_viscosity", "slip_yield")}
    concrete = concrete_of(values["concrete"], **constants)
    for flow in flows:
        check_velocity("flow", flow, 4 * flow / (math.pi * values["diameter"] ** 2))
    line = Line(radius=values["diameter"] / 2, slip_thickness=thickness, **{name: values[name] for name in LINE})
    if fit is not None:
        measured, pressed = read_points(fit)
        concrete = _fitted(concrete, line, measured, pressed)
        flows = flows or tuple(measured)
    tables = [table(concrete, line, flows or (() if pressures else (FLOW,)), pressures)]
    if rest is not None:
        tables += [restart_table(concrete, line, rest, growth, each) for each in flows or (FLOW,)]
    if segregation:
        share = _share(aggregate, values["concrete"])
        tables.append(segregation_table(concrete, line, share, segregation, flows or (FLOW,)))
    elif aggregate is not None:
        refuse("aggregate", aggregate, "needs --segregation", "add, for example, --segregation -0.2")
    click.echo("\n\n".join(tables))


def _share(given: float | None, name: str) -> float:
    """Return the volume fraction of aggregate in the concrete, stated by the user or computed from the mix."""
    if given is not None:
        return given
    mix = mix_named(name)
    if mix is None or mix.given.share is None:
        refuse("aggregate", None, "must be given for --segregation, as the concrete does not state its aggregate",
               "add, for example, --aggregate 0.36")  # fmt: skip
    return mix.given.share


def growth_of(rest: float | None, thixotropy: float | None) -> float:
    """Return the stated or usual rate A_thix [Pa/s]; refuse a stated rate if no time of rest is given."""
    if thixotropy is not None and rest is None:
        refuse("thixotropy", thixotropy, "needs the time of rest", "add, for example, --rest 600")
    return THIXOTROPY if thixotropy is None else thixotropy


def _fitted(concrete: Concrete, line: Line, flows: list[float], pressures: list[float]) -> Concrete:
    """Return the concrete with a slip layer fitted to measured points, and print the quality of the fit."""
    fit = measured_layer(concrete, line, flows, pressures)
    found = replace(concrete, slip_viscosity=fit.slope, slip_yield=fit.offset)
    off = [steady(found, line, flow).pressure / pressure - 1 for flow, pressure in zip(flows, pressures)]
    errors = f"standard errors {fit.slope_error:.2g} Pa s/m and {fit.offset_error:.2g} Pa"
    if len(flows) < 3:
        errors = "two points give no standard errors"
    click.echo(
        f"fitted to {len(flows)} points: --slip-viscosity {fit.slope:.5g} --slip-yield {fit.offset:.5g}; "
        f"the closed form then deviates by {100 * min(off):+.2g} to {100 * max(off):+.2g} %; {errors}\n"
    )
    return found
