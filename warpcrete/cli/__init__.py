"""Command line of warpcrete: the `warpcrete` command."""

from .main import cli, main

__all__ = ["cli", "main"]
