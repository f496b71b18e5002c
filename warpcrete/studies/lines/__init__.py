"""Pressure of whole pump lines, from closed forms, from flow simulations or from discrete elements.

Modules here import `core`, `geometry`, `theory`, `mix`, the simulation methods, `methods`, `record`, `scenes` and the
modules of `studies` itself. Start with `losses` for the closed forms and `run` for simulated lines.
"""
