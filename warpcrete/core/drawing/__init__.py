"""Data for pictures of a run: views of it (displays), copies of its state (snapshots), colour scales, HTML tables.

Modules here import `core.device`, `core.inputs` and the modules of `core` itself, but no solver. Start with `display`,
the interface between a solver and the recorders.
"""
