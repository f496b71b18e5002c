"""Measurements during a run of discrete elements: series, stresses, segregation, blockage, wear, results.

Modules here import `core`, `geometry`, `dem.scene`, `dem.engine` and the kernels; they read the arrays of `dem.engine`
and never change them. Start with `sampling`, which fills the rows, and go on with `quantities`, which lists the
results.
"""
