"""Command `warpcrete theory`: the closed-form solution for a yield stress fluid with a slip layer."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..core.errors import refuse
from ..core.inputs.limits import check_velocity
from ..core.inputs.parameters import Field, declared_fields
from ..core.inputs.scene_functions import resolved
from ..mix.mix import FACTORS, mix_named
from ..mix.points import read_points
from ..mps.column import FLOW, ColumnParameters
from ..mps.common.mixes import CONSTANTS, ConcreteParameters, concrete_of, file_constants
from ..theory.pipe import Concrete, Line, measured_layer, steady
from ..theory.pipe_table import restart_table, table
from ..theory.segregated import segregation_table
from .option_amounts import growth_of

LINE = ("length", "rise", "gravity")
"""Properties of a pipeline that are also options of the command `theory`. The radius is not one of them, because the
user states the diameter."""


def fields() -> dict[str, Field]:
    """Return the parameters of the command `theory` by name: the parameters of pipe flows that the closed form uses."""
    pipe = {"diameter": declared_fields(ColumnParameters)["diameter"]}
    pipe |= {name: declared_fields(Line)[name] for name in LINE}
    return {**declared_fields(ConcreteParameters), **{name: replace(x, group="Pipe.") for name, x in pipe.items()}}


def run(
    given: dict[str, Any], flows: Sequence[float], pressures: Sequence[float], fit: Path | None = None,
    rest: float | None = None, thixotropy: float | None = None, segregation: Sequence[float] = (),
    aggregate: float | None = None,
) -> None:  # fmt: skip
    """Print the closed-form solution for the parameters in `given`; all other parameters have their default values.

    `flows` [m3/s] and `pressures` [Pa] are the values for which the pressure or the flow is computed. If `fit` is a
    file of measured flows and pressures, the slip layer is fitted to them first. `rest` is a time at rest [s], for
    which the pressure of a restart is added. `segregation` holds segregation indices, whose effect on the pressure is
    added; :class:`warpcrete.theory.segregated.Segregated` defines this index. `aggregate` is the volume fraction of
    aggregate in the whole concrete.
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
    # The fit below replaces the constants of the slip layer, so missing constants get the value 1 until then.
    if fit is not None:
        constants |= {name: constants[name] or 1.0 for name in ("slip_viscosity", "slip_yield")}
    concrete = concrete_of(values["concrete"], thickness, **constants)
    for flow in flows:
        check_velocity("flow", flow, 4 * flow / (math.pi * values["diameter"] ** 2))
    line = Line(radius=values["diameter"] / 2, slip_thickness=thickness, **{name: values[name] for name in LINE})
    if fit is not None:
        measured, pressed = read_points(fit)
        factors = {name: values[name] or 1.0 for name in FACTORS}
        concrete = _fitted(concrete, line, measured, pressed, factors)
        flows = flows or tuple(measured)
    tables = [table(concrete, line, flows or (() if pressures else (FLOW,)), pressures)]
    if rest is not None:
        tables += [restart_table(concrete, line, rest, growth, each) for each in flows or (FLOW,)]
    if segregation:
        share = _share(aggregate, values["concrete"])
        tables.append(segregation_table(concrete, line, share, segregation, flows or (FLOW,)))
    elif aggregate is not None:
        refuse("aggregate", aggregate, "has no effect without --segregation", "add, for example, --segregation -0.2")
    click.echo("\n\n".join(tables))


def _share(given: float | None, name: str) -> float:
    """Return the volume fraction of aggregate in the concrete, stated by the user or computed from the mix."""
    if given is not None:
        return given
    mix = mix_named(name)
    if mix is None or mix.given.share is None:
        problem = "must be given for --segregation, because the concrete does not state its share of aggregate"
        refuse("aggregate", None, problem, "add, for example, --aggregate 0.36")
    return mix.given.share


def _fitted(
    concrete: Concrete, line: Line, flows: list[float], pressures: list[float], factors: Mapping[str, float]
) -> Concrete:
    """Return the concrete with a slip layer fitted to measured points, and print the quality of the fit.

    The points are flows [m3/s] and the pressures measured at these flows [Pa]. `factors` for age and temperature would
    multiply the printed options in the next call, so these are divided by them.
    """
    fit = measured_layer(concrete, line, flows, pressures)
    found = replace(concrete, slip_viscosity=fit.slope, slip_yield=fit.offset)
    off = [steady(found, line, flow).pressure / pressure - 1 for flow, pressure in zip(flows, pressures)]
    errors = f"standard errors {fit.slope_error:.2g} Pa s/m and {fit.offset_error:.2g} Pa"
    if len(flows) < 3:
        errors = "two points give no standard errors"
    eta, tau = fit.slope / factors["viscosity_factor"], fit.offset / factors["yield_factor"]
    before = "" if set(factors.values()) == {1.0} else " (before the factors of age and temperature)"
    click.echo(
        f"fitted to {len(flows)} points: --slip-viscosity {eta:.5g} --slip-yield {tau:.5g}{before}; "
        f"the closed form then deviates by {100 * min(off):+.2g} to {100 * max(off):+.2g} %; {errors}\n"
    )
    return found
