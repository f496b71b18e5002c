"""Modules of the command, whose functions tests replace, and a short line for them."""

import importlib

MODULES = ("study", "trade", "calibrate", "run", "line_simulated", "line_blocked", "validate", "reproduce", "explain")
CLI = {name: importlib.import_module(f"warpcrete.cli.{name}") for name in MODULES}
LINE = "diameter: 125 mm\nflow: 30 m3/h\nconcrete: no1\nparts:\n  - straight: 10 m\n  - bend: up\n  - straight: 2 m\n"
