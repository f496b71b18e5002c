"""Command line of warpcrete: the `warpcrete` command, with one module for each larger subcommand.

Modules here may import every other package, and no other package imports them. To read the code, start with `main`,
which lists the subcommands, and continue with `run` and `options`.
"""

from .main import cli, main

__all__ = ["cli", "main"]
