"""Types of options whose values a shell completes. The possible values are determined only during a completion."""

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from ..core.inputs.amounts import amount
from .scene_commands import load


class Completed(click.ParamType):
    """Type of a text option whose value the shell completes.

    `by` is the name of a function in the module `completion` that returns the possible values. The function is called
    with the arguments in `first`, followed by the text that the user has typed so far.
    """

    name = "text"

    def __init__(self, by: str, *first: str) -> None:
        self.by, self.first = by, first

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the values that begin with the typed text."""
        return getattr(load("completion"), self.by)(*self.first, incomplete)


class AmountOption(click.ParamType):
    """Option type that accepts a number in SI units, or an amount with a unit, such as "20 m"."""

    name = "number"

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the option's value as a number in its unit; raises :class:`SceneError` for any other text."""
        return amount(str(param.name) if param is not None else "option", value, self.unit)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the typed number, followed by each unit that the option accepts."""
        return load("completion").amounts(self.unit, incomplete)


DEVICE = Completed("devices")
PATH = click.Path(path_type=Path)
LENGTH, TIME, PRESSURE, POWER = (Completed("amounts", unit) for unit in ("m", "s", "Pa", "W"))
FLOW, GROWTH = Completed("amounts", "m3/s"), Completed("amounts", "Pa/s")
