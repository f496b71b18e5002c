"""Command line of warpcrete: the `warpcrete` command, with one module for each larger subcommand.

Modules here import every other package, and only the package `warpcrete` itself stands above them. Start with `main`,
which lists the subcommands, and go on with `run` and `options`.
"""

from .main import cli, main

__all__ = ["cli", "main"]
