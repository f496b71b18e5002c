"""Data that recorders draw: displays of a run, snapshots of a state, colour scales and HTML tables.

Modules here import `core.device` and `core.inputs`, but no solver. Start with `display`, the interface between a
solver and the recorders.
"""
