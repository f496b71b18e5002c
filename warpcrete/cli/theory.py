"""`warpcrete theory`: the closed form of a Bingham fluid with a slip layer."""

from __future__ import annotations

from typing import Any

import click

from ..core.parameters import Field, declared_fields, resolved
from ..mps.column import FLOW, ColumnParameters, ConcreteParameters
from ..mps.mixes import CONSTANTS, concrete_of, file_constants
from ..mps.theory import Line, table

LINE = ("length", "rise", "gravity")
"""Fields of a line that have the same name there and here; its radius is half of the diameter."""


def fields() -> dict[str, Field]:
    """Parameters by name: those of the scenes `channel` and `tube` as far as the closed form knows them."""
    pipe = {"diameter": declared_fields(ColumnParameters)["diameter"]}
    return {**declared_fields(ConcreteParameters), **pipe, **{name: declared_fields(Line)[name] for name in LINE}}


def run(given: dict[str, Any], flows: tuple[float, ...], pressures: tuple[float, ...]) -> None:
    """Print the table for the parameters `given`, others at their defaults."""
    known = fields()
    values = {name: field.default for name, field in known.items()} | resolved(known, given)
    values |= {name: value for name, value in file_constants(values).items() if values[name] is None}
    for name, field in known.items():
        field.check(values[name], name)
    thickness = values["slip_thickness"]
    concrete = concrete_of(values["concrete"], **{name: values[name] for name in CONSTANTS})
    line = Line(radius=values["diameter"] / 2, slip_thickness=thickness, **{name: values[name] for name in LINE})
    click.echo(table(concrete, line, flows or (() if pressures else (FLOW,)), pressures))
