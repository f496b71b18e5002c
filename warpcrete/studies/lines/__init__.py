"""Pressure of whole pump lines, from closed forms, from flow simulations or from discrete elements.

Modules here import `core`, `geometry.lines`, `theory`, both simulation methods, `record` and `scenes`. Start with
`losses` for the closed forms and `run` for simulated lines.
"""
