"""Aggregates suspended in mortar: rigid bodies whose motion is solved together with the flow of the mortar on a grid.

Modules in this package import `core`, `geometry`, `theory`, `kernels`, `mps` and `dem`. `mps` and `dem` do not import
this package. To read the code, start with `flow`, which contains one time step, and go on with `solve`, which solves
its equations.
"""
