"""Command `warpcrete theory`: the closed-form solution for a yield stress fluid with a slip layer."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click

from ..core.errors import between, refuse
from ..core.inputs.amounts import amount, bare_number, is_amount
from ..core.inputs.limits import check_limit, check_velocity
from ..core.inputs.parameters import Field, declared_fields
from ..core.inputs.scene_functions import resolved
from ..core.records import SceneArguments
from ..mix.mix import FACTORS, mix_named
from ..mix.points import read_points
from ..mps.column import FLOW, ColumnParameters
from ..mps.common.mixes import CONSTANTS, ConcreteParameters, concrete_of, file_constants
from ..theory.pipe import Concrete, Line, measured_layer, steady
from ..theory.pipe_table import restart_table, table
from ..theory.segregated import segregation_table
from .help_pages import ParameterOption
from .option_amounts import growth_of
from .option_types import LENGTH

LINE = ("length", "gravity")
"""Attributes of :class:`Line` for which the command has options with the same names. Instead of the radius, the user
states the diameter; the rise may also be stated as a height."""
MOST_FLOWS_SHOWN = 20
"""Maximum number of measured flows for which tables show the closed form; a data logger measures thousands."""


def fields() -> dict[str, Field]:
    """Return the parameters of the command `theory` by name: the parameters of pipe flows that the closed form uses."""
    pipe = {"diameter": declared_fields(ColumnParameters)["diameter"]}
    pipe |= {name: declared_fields(Line)[name] for name in LINE}
    return {**declared_fields(ConcreteParameters), **{name: replace(x, group="Pipe.") for name, x in pipe.items()}}


def rise_option() -> ParameterOption:
    """Return the option `--rise`, the height of the pipe's end above its start, or its rise per length."""
    text = (
        "Height of the pipe's end above its start, such as '60 ft'; a number without a unit is the height per "
        "length: 1 for an upright pipe, 0 for a level one"
    )
    option = ParameterOption(["--rise"], type=LENGTH, default="1", show_default=True, help=text)
    option.group = "Pipe."
    return option


def _rise(stated: str, length: float) -> float:
    """Return the rise per length of a pipe from the text `stated` of the option `--rise`.

    `length` is the length of the pipe [m].
    """
    field = declared_fields(Line)["rise"]
    if bare_number(stated) or is_amount(stated, "1"):
        value = field.converted(amount("rise", stated, "1"), "rise")
        hint = "it is the height gained per length of the pipe; write a height with its unit, as in '45 m'"
        between("rise", value, -1.0, 1.0, "", hint)
        field.check_limits(value, "rise")
        return value
    if not is_amount(stated, "m"):
        problem = "must be a height with a unit of length, or the height per length from -1 to 1"
        refuse("rise", stated, problem, "for example '60 ft', or 1 for an upright pipe")
    height = amount("rise", stated, "m")
    check_limit("rise", height, "m", "length")
    hint = f"the pipe has a length of {length:g} m; state another, as in --length '{abs(height):g} m'"
    between("rise", height, -length, length, "m", hint)
    return height / length


def run(
    given: SceneArguments, flows: Sequence[float], pressures: Sequence[float], fit: Path | None = None,
    rest: float | None = None, thixotropy: float | None = None, segregation: Sequence[float] = (),
    aggregate: float | None = None,
) -> None:  # fmt: skip
    """Print the closed-form solution for the parameters in `given`; all other parameters have their default values.

    The rise in `given` is a text: a height with its unit, or the height per length.

    The pressure is computed for each of the `flows` [m3/s], and the flow for each of the `pressures` [Pa]. If `fit` is
    a file of measured flows and pressures, the slip layer is fitted to them first. With a time of `rest` [s], the
    pressure for a restart after this time is also printed. With `segregation` indices, which
    :class:`warpcrete.theory.segregated.Segregated` defines, their effect on the pressure is also printed. `aggregate`
    is the volume fraction of aggregate in the whole concrete.
    """
    growth, rise = growth_of(rest, thixotropy), given.pop("rise", "1")
    known = fields()
    values = {name: field.default for name, field in known.items()} | resolved(known, given)
    values |= {name: value for name, value in file_constants(values).items() if values[name] is None}
    for name, field in known.items():
        values[name] = field.converted(values[name], name)
        field.check(values[name], name)
        field.check_limits(values[name], name)
    thickness = values["slip_thickness"]
    constants = {name: values[name] for name in CONSTANTS}
    # The fit below determines the constants of the slip layer, so the value 1 of a missing constant has no effect.
    if fit is not None:
        constants |= {name: constants[name] or 1.0 for name in ("slip_viscosity", "slip_yield")}
    concrete = concrete_of(values["concrete"], thickness, **constants)
    for flow in flows:
        check_velocity("flow", flow, 4 * flow / (math.pi * values["diameter"] ** 2))
    line = Line(radius=values["diameter"] / 2, slip_thickness=thickness, rise=_rise(rise, values["length"]),
                **{name: values[name] for name in LINE})  # fmt: skip
    if fit is not None:
        measured, pressed = read_points(fit)
        factors = {name: values[name] or 1.0 for name in FACTORS}
        concrete = _fitted(concrete, line, measured, pressed, factors)
        flows = flows or _tabulated(measured)
    tables = [table(concrete, line, flows or (() if pressures else (FLOW,)), pressures)]
    if rest is not None:
        tables += [restart_table(concrete, line, rest, growth, each) for each in flows or (FLOW,)]
    if segregation:
        share = _share(aggregate, values["concrete"])
        tables.append(segregation_table(concrete, line, share, segregation, flows or (FLOW,)))
    elif aggregate is not None:
        refuse("aggregate", aggregate, "has no effect without --segregation", "add, for example, --segregation -0.2")
    click.echo("\n\n".join(tables))


def _tabulated(flows: Sequence[float]) -> list[float]:
    """Return the measured flows that tables show: all, or a few from the smallest to the largest if there are many."""
    if len(flows) <= MOST_FLOWS_SHOWN:
        return list(flows)
    different = sorted(set(flows))
    last = len(different) - 1
    shown = min(MOST_FLOWS_SHOWN, len(different))
    return [different[round(k * last / max(shown - 1, 1))] for k in range(shown)]


def _share(given: float | None, name: str) -> float:
    """Return the volume fraction of aggregate: `given` by the user, or from the mix if `given` is None.

    `name` is the name of the concrete. Raises :class:`SceneError` if its mix states no fraction either.
    """
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

    The points are flows [m3/s] and the pressures measured at these flows [Pa]. The constants of the layer are printed
    as options for a later call. That call multiplies the options by the `factors` for age and temperature, so the
    printed values are divided by these factors.
    """
    fit = measured_layer(concrete, line, flows, pressures)
    fitted = replace(concrete, slip_viscosity=fit.slope, slip_yield=fit.offset)
    off = [steady(fitted, line, flow).pressure / pressure - 1 for flow, pressure in zip(flows, pressures)]
    errors = f"standard errors {fit.slope_error:.2g} Pa s/m and {fit.offset_error:.2g} Pa"
    if len(flows) < 3:
        errors = "two points give no standard errors"
    eta, tau = fit.slope / factors["viscosity_factor"], fit.offset / factors["yield_factor"]
    before = "" if set(factors.values()) == {1.0} else " (before the factors of age and temperature)"
    click.echo(
        f"fitted to {len(flows)} points: --slip-viscosity {eta:.5g} --slip-yield {tau:.5g}{before}; "
        f"the closed form then deviates by {100 * min(off):+.2g} to {100 * max(off):+.2g} %; {errors}\n"
    )
    return fitted
