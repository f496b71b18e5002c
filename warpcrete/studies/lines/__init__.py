"""Pressure of whole pump lines, from closed forms, from flow simulations or from discrete elements.

Modules here import `geometry.lines`, `theory` and both solvers. Start with `losses` for the closed forms and `run` for
simulated lines.
"""
