"""Types of options whose values the shell completes; the values are listed only when the shell asks for them."""

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from .scene_commands import load


class Completed(click.ParamType):
    """Type of a text option whose value the shell completes.

    `by` is the name of a function in the module `completion`, which returns the possible values. The function is called
    with the arguments in `first`, followed by the text that the user has typed so far.
    """

    name = "text"

    def __init__(self, by: str, *first: str) -> None:
        self.by, self.first = by, first

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the values that begin with the typed text."""
        return getattr(load("completion"), self.by)(*self.first, incomplete)


DEVICE = Completed("devices")
PATH = click.Path(path_type=Path)
LENGTH, TIME, PRESSURE, POWER = (Completed("amounts", unit) for unit in ("m", "s", "Pa", "W"))
FLOW, GROWTH = Completed("amounts", "m3/s"), Completed("amounts", "Pa/s")
